"""Data sets in a folder or a store: opened, resumed, measured and completed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clsco.data.containers import CONTAINERS
from clsco.data.containers.base import is_png
from clsco.data.manifest import (
    LOG,
    UNSPLIT,
    Identity,
    ManifestPart,
    ManifestParts,
    Merged,
    files_of,
    numbers_of,
    parsed_part,
    part_key,
    rows_of,
    shard_numbers,
)
from clsco.data.storage import Storage
from clsco.errors import FileError, SceneError
from clsco.files.strict_json import strict_json

MOST_SHARDS = 10**6
LARGEST_CARD = 2**26
LATEST = 64  # shards from whose times the rate is taken


@dataclass(frozen=True)
class DataSet:
    """A set in a storage. about: entries of the card about what made the set, where it is there already."""

    storage: Storage
    identity: Identity
    samples: range
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def shards(self) -> range:
        """Numbers of all shards."""
        return shard_numbers(self.samples, self.identity.shard_size)

    def listed(self) -> frozenset[str]:
        """Keys of the parts that are there."""
        return frozenset(ManifestParts(self.storage).keys)

    def numbers(self, shard: int) -> range:
        """Numbers of the samples of a shard."""
        return numbers_of(shard, self.samples, self.identity.shard_size)

    def done(
        self, shards: Iterable[int], hashes: bool, faults: list[str], merged: Merged | None = None
    ) -> dict[int, ManifestPart]:
        """`ManifestParts.done` of this set."""
        return ManifestParts(self.storage).done(self.identity, self.samples, shards, hashes, faults, merged)

    def lines(self, shard: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Rows of the manifest about the samples of a shard, and about those that failed; none without a part."""
        data = self.storage.read(part_key(shard))
        return ([], []) if data is None else rows_of(data)

    def write(self, about: Mapping[str, Any]) -> None:
        """Write the card, which is there before any shard. about: what else it says."""
        card = {"identity": self.identity.record(), "samples": [self.samples.start, self.samples.stop], **about}
        self.storage.write(CARD, f"{json.dumps(card, indent=2, allow_nan=False)}\n".encode())


def open_set(storage: Storage) -> DataSet:
    """The set in a storage. Raises FileError where there is none, or its card is damaged."""
    data = storage.read(CARD)
    if data is None:
        raise FileError(f"{storage.where}: must hold a data set that clsco dataset make made; got no {CARD}")
    try:
        if len(data) > LARGEST_CARD:
            raise ValueError(f"{len(data)} bytes")
        card = strict_json(data)
        about = dict(card["identity"])
        texts = (card.get("license", ""), card.get("recipe", ""), about["format"])
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("a license, recipe or format that is no text")
        about["arrays"] = tuple(map(str, about["arrays"]))
        about["splits"] = tuple((str(name), float(share)) for name, share in about["splits"])
        about["types"] = tuple((str(name), str(kind)) for name, kind in about["types"])
        samples, identity = range(*(int(number) for number in card["samples"])), Identity(**about)
        if not samples or samples.start < 0 or len(shard_numbers(samples, identity.shard_size)) > MOST_SHARDS:
            raise ValueError(f"samples are {samples}")
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, RecursionError) as error:
        raise FileError(f"{storage.where}/{CARD}: must describe a data set; got {error!r}") from None
    return DataSet(storage, identity, samples, card)


def check_resumable(new: DataSet, resumes: bool) -> Mapping[str, Any]:
    """The card of the set that a storage holds and that may be resumed as `new`, {} for an empty storage.

    Raises SceneError: the set there is another one, has more samples, or is not to be resumed; or the folder has other
    files.
    """
    storage, where = new.storage, new.storage.where
    if storage.read(CARD) is None:
        if storage.has_others():
            raise SceneError(f"{where}: must be an empty folder, or hold a data set; got other files")
        return {}
    there = open_set(storage)
    if not resumes:
        raise SceneError(f"{where}: must hold no data set, unless that is resumed; got one")
    faults = there.identity.differences(new.identity.record())
    if there.samples.stop > new.samples.stop:
        faults.append(f"count must be at least {there.samples.stop}, as in the set; got {new.samples.stop}")
    if faults:
        raise SceneError([f"{where}: {fault}" for fault in faults])
    return there.about


@dataclass(frozen=True, repr=False)
class Status:
    """Progress of a set of so many shards and samples.

    `done` has the parts of the shards that are whole, by number; `faults` a line for each part whose shard is not;
    `rate` samples per second over the latest shards, of all processes together, None where it is not known.
    """

    shards: int
    samples: int
    done: Mapping[int, ManifestPart]
    faults: tuple[str, ...]
    rate: float | None

    def __repr__(self) -> str:
        return f"<Status: {self.made} of {self.samples} samples made, {self.failed} failed>"

    @property
    def is_whole(self) -> bool:
        """True if all shards are done."""
        return len(self.done) == self.shards

    @property
    def made(self) -> int:
        """Samples that are in files."""
        return sum(part.made for part in self.done.values())

    @property
    def failed(self) -> int:
        """Samples that failed."""
        return sum(part.failed for part in self.done.values())

    @property
    def bytes(self) -> int:
        """Size of all files of shards."""
        return sum(size for part in self.done.values() for size, _ in part.files.values())

    @property
    def seconds_left(self) -> float | None:
        """Until the set is whole, at the rate that it has."""
        return None if not self.rate else (self.samples - self.made - self.failed) / self.rate


def status_of(
    there: DataSet, hashes: bool = False, shards: Sequence[int] | None = None, merged: Merged | None = None
) -> Status:
    """Measure the progress of a set, of all shards or some; arguments are those of `DataSet.done`."""
    faults: list[str] = []
    done = there.done(there.shards if shards is None else shards, hashes, faults, merged)
    return Status(len(there.shards), len(there.samples), done, tuple(faults), _rate(there, done))


def finish(there: DataSet, own: Sequence[int] | None = None) -> Status:
    """Measure the progress of a set; where it is whole, put its manifest together and complete its card.

    Each part is read once. While some are missing only those of the shards `own` are read, so that the work of many
    jobs grows with the number of shards, and not with its product with theirs.
    """
    listed = there.listed()
    if any(part_key(shard) not in listed for shard in there.shards):
        return status_of(there, shards=own)
    merged = Merged(there.storage)
    status = status_of(there, merged=merged)
    if status.is_whole:
        merged.put()
        write_card(there.storage, there.identity, merged.files)
        there.storage.close()
    return status


def _rate(there: DataSet, done: Iterable[int]) -> float | None:
    """From the log, which counts for nothing else."""
    found = []
    for shard in sorted(done)[-LATEST:]:
        data = there.storage.read(f"{LOG}/{shard:06d}.jsonl")
        try:
            known = json.loads(data or b"")
            found.append((float(known["began"]), float(known["ended"]), int(known["samples"])))
        except (ValueError, KeyError, TypeError):
            continue
    if not found:
        return None
    spent = max(end for _, end, _ in found) - min(begin for begin, _, _ in found)
    return sum(count for _, _, count in found) / max(1e-3, spent)


def ranges(numbers: Iterable[int]) -> str:
    """Numbers as people write them: 3, 7-9."""
    found: list[list[int]] = []
    for number in sorted(numbers):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return ", ".join(f"{first}" if first == last else f"{first}-{last}" for first, last in found)


CARD, README = "dataset.json", "README.md"
# Of https://huggingface.co/docs/hub/repositories-licenses those that data have; others have a name of their own.
_HUB_LICENSES = (
    "cc0-1.0", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-4.0",
    "odc-by", "odbl", "pddl", "cdla-permissive-2.0", "mit", "apache-2.0", "bsd-3-clause",
)  # fmt: skip
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
_HUB_FORMATS = ("webdataset", "parquet")


def split_files(storage: Storage) -> dict[str, list[tuple[str, int]]]:
    """Files of each split with the number of samples in them, by the parts of the manifest.

    Returns: split to files, in the order of the shards; "" of a set without splits. Raises FileError: a part is
    damaged.
    """
    found: dict[str, list[tuple[str, int]]] = {}
    for _, data in ManifestParts(storage).read():
        for split, listed in files_of(parsed_part(data), data).items():
            found.setdefault(split, []).extend(listed)
    return {split: found[split] for split in sorted(found)}


def write_card(storage: Storage, identity: Identity, listed: Mapping[str, list[tuple[str, int]]]) -> None:
    """Complete the card of a set whose shards are all done, and write README.md.

    What `dataset.json` has stays, of the license and the distribution above all. listed: split to its files, with the
    number of samples in them. Raises FileError: the set cannot be read or written.
    """
    card = json.loads(storage.read(CARD) or b"{}")
    files = {split: listed[split] for split in sorted(listed)}
    counts = {split: sum(count for _, count in listed) for split, listed in files.items()}
    samples = range(*card["samples"])
    total = sum(counts.values())
    first = _first(storage, identity, files)
    card["license"] = card.get("license") or "unspecified"
    card |= {
        "counts": {"samples": total, "failed": len(samples) - total, "splits": counts},
        "arrays": first.arrays,
        "conventions": "Row 0 is on top, column 0 on the left, pixel centers at integer coordinates; lengths in mm.",
        "load": _loading(identity.format, first),
        "cite": _citation(identity),
        "files": files,
    }
    storage.write(README, readme(card).encode())
    storage.write(CARD, f"{json.dumps(card, indent=2, allow_nan=False)}\n".encode())


@dataclass(frozen=True)
class _First:
    """The first sample of a set: its shard, its key, and what it says of its arrays, by their names."""

    file: str = "SPLIT/000000"
    key: str = "000000000"
    arrays: Mapping[str, Any] = field(default_factory=dict)


def _first(storage: Storage, identity: Identity, files: Mapping[str, list[tuple[str, int]]]) -> _First:
    file = next((file for listed in files.values() for file, count in listed if count), None)
    if file is None:
        return _First()
    container = CONTAINERS[identity.format]
    reader = container.read(storage.local(file))
    try:
        described = reader.record(0, ()).meta["arrays"]
        key = reader.keys[0]
    finally:
        reader.close()
    for about in described.values():
        about.pop("clipped", None)  # of this sample alone
        about["encoding"] = _encoding(container.name, about)
    return _First(file, key, dict(described))


def _encoding(form: str, about: Mapping[str, Any]) -> str:
    name, _, raw = form.partition("+")
    picture = is_png(about["dtype"], tuple(about["shape"]))
    if name in ("webdataset", "folders"):
        return "npy" if raw else "png" if picture else "npy.zst"
    if name == "parquet":
        return "Image" if picture else f"Array{len(about['shape'])}D"
    return {"npz": "npy", "hdf5": "dataset", "zarr": "array"}[name]


def _loading(form: str, first: _First) -> dict[str, str]:
    """Code that loads a set, by package, with names that the set has."""
    folder = first.file.partition("/")[0]
    opened = "" if folder == UNSPLIT else f", {_text(folder)}"
    name, pattern = form.partition("+")[0], _text(f"DATA/{folder}/*{CONTAINERS[form].suffix}")
    array = next(iter(first.arrays), "color")
    found = {
        "clsco": f'import clsco.data\nrecord = clsco.data.open("DATA"{opened})[0]\nrecord[{_text(array)}], record.meta',
        "torch": f'torch.utils.data.DataLoader(clsco.data.open("DATA"{opened}), batch_size=None, num_workers=4)',
    }
    shard, place = f"DATA/{first.file}", f"{first.key}/{array}"
    more = {
        "webdataset": {
            "webdataset": f"webdataset.WebDataset(glob.glob({pattern}), shardshuffle=100).decode()",
            "datasets": f'datasets.load_dataset("webdataset", data_files={pattern}, streaming=True)',
        },
        "parquet": {"datasets": f'datasets.load_dataset("parquet", data_files={pattern})'},
        "hdf5": {"h5py": f"h5py.File({_text(shard)})[{_text(place)}][()]"},
        "zarr": {"zarr": f'zarr.open_group({_text(shard)}, mode="r")[{_text(array)}][0]'},
        "npz": {"numpy": f"numpy.load({_text(f'{shard}/{first.key}.npz')})[{_text(array)}]"},
    }
    return found | more.get(name, {})


def _text(text: str) -> str:
    """A text as Python code has it."""
    return json.dumps(text)


def _citation(identity: Identity) -> str:
    made = f"distribution {identity.distribution[:16]}, seed {identity.seed}, clsco {identity.version}"
    return f"Synthetic images with defocus and motion blur and their ground truth: {made}."


def readme(card: Mapping[str, Any]) -> str:
    """The text of README.md from the whole card: a header for the hub, and what people want to know."""
    identity, counts = card["identity"], card["counts"]
    lines = [
        "---", *_header(card), "---", "", "# Synthetic images with defocus and motion blur", "",
        f"{counts['samples']} samples" + (f", {counts['failed']} that failed" if counts["failed"] else "")
        + f", made by clsco {identity['version']} from one distribution of scenes. `dataset.json` has all that follows"
        " for programs, `manifest.jsonl` a line for each sample with its parameters and hashes.", "",
        "| | |", "|---|---|",
        *(f"| split {split} | {count} |" for split, count in counts["splits"].items() if split),
        f"| seed | {identity['seed']} |",
        f"| distribution, SHA-256 | `{identity['distribution']}` |",
        f"| devices | {_cell(identity['device_family'])} |",
        f"| format | {identity['format']} |",
        f"| license | {_cell(card['license'])} |", "",
        "## Arrays", "", card["conventions"], "",
        "| array | type | shape | unit | in files | what it is |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for name, about in card["arrays"].items():
        shape = " x ".join(map(str, about["shape"]))
        transfer = f" Codes: {about['transfer']}." if "transfer" in about else ""
        convention = f"{about['convention']}.{transfer}"
        lines.append(f"| {name} | {about['dtype']} | {shape} | {about['unit']} | {about['encoding']} | {convention} |")
    lines += ["", "## Loading", ""]
    for package, code in card["load"].items():
        lines += [f"{package}:", "", "```python", code, "```", ""]
    if card.get("recipe"):
        lines += ["## Distribution", "", *_fenced(card["recipe"], "python" if card.get("function") else "toml"), ""]
    lines += ["## How to cite", "", card["cite"], ""]
    return "\n".join(lines)


def _header(card: Mapping[str, Any]) -> list[str]:
    """YAML that the hub reads. JSON strings are YAML strings."""
    license_text, identity = str(card["license"]), card["identity"]
    known = license_text.lower()
    if known == "unspecified":
        found = ["license: unknown"]
    elif known in _HUB_LICENSES:
        found = [f"license: {known}"]
    else:
        found = ["license: other", f"license_name: {json.dumps(license_text)}"]
    found += ["task_categories:", "- depth-estimation", "- image-to-image"]
    found += ["tags:", "- synthetic", "- defocus", "- motion-blur", "- depth-from-defocus"]
    total = card["counts"]["samples"]
    found += ["size_categories:", f"- {next((text for most, text in _SIZES if total < most), 'n>10M')}"]
    form = identity["format"]
    if form.partition("+")[0] in _HUB_FORMATS:
        found += ["configs:", "- config_name: default", "  data_files:"]
        for split in card["files"]:
            path = json.dumps(f"{split or UNSPLIT}/*{CONTAINERS[form].suffix}")
            found += [f"  - split: {json.dumps(split or 'train')}", f"    path: {path}"]
    return found


def _cell(text: str) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


def _fenced(text: str, language: str) -> list[str]:
    fence = "```"
    while fence in text:
        fence += "`"
    return [f"{fence}{language}", text.rstrip("\n"), fence]
