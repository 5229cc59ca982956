"""Card of a data set: dataset.json for programs, README.md for people and for the Hugging Face hub."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from clsco.data.containers import CONTAINERS
from clsco.data.encoding import is_png
from clsco.data.manifest import UNSPLIT, Identity, ManifestParts, files_of, parsed_part
from clsco.data.storage import Storage

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

    Returns: split to files, in the order of the shards; "" of a set without splits. Raises ImageError: a part is
    damaged.
    """
    found: dict[str, list[tuple[str, int]]] = {}
    for _, data in ManifestParts(storage).read():
        for split, listed in files_of(parsed_part(data), data).items():
            found.setdefault(split, []).extend(listed)
    return {split: found[split] for split in sorted(found)}


def write_card(storage: Storage, identity: Identity, listed: Mapping[str, list[tuple[str, int]]]) -> None:
    """Complete the card of a set whose shards are all done, and write README.md.

    Parameters
    ----------
    storage : Storage
        Its `dataset.json` is kept, what it has of the license and the distribution above all, and gains arrays, files,
        counts, how to load it and how to cite it.
    identity : Identity
        Identity of the set.
    listed : mapping
        Split to its files, with the number of samples in them.

    Raises
    ------
    ImageError
        The set cannot be read or written.
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
    """The text of README.md: a header for the hub, and what people want to know.

    Parameters
    ----------
    card : mapping
        The whole card.
    """
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
