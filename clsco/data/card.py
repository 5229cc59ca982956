"""Cards of data sets: `dataset.json` for programs, and README.md for readers and the Hugging Face hub."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clsco.data.containers import CONTAINERS
from clsco.data.containers.base import is_png
from clsco.data.fields import ARRAY, SHORT, misfit
from clsco.data.manifest import UNSPLIT, Identity, files_by_split
from clsco.data.storage import Storage
from clsco.errors import FileError

CARD, README = "dataset.json", "README.md"
# Licenses of https://huggingface.co/docs/hub/repositories-licenses that suit data; the hub shows others by their name.
_HUB_LICENSES = (
    "cc0-1.0", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-4.0",
    "odc-by", "odbl", "pddl", "cdla-permissive-2.0", "mit", "apache-2.0", "bsd-3-clause",
)  # fmt: skip
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))


def write_card(storage: Storage, identity: Identity, files: Iterable[tuple[str, int]]) -> None:
    """Complete the card of a set whose shards are all done, and write README.md. Raises FileError.

    Other entries of `dataset.json`, such as the license, stay. files: each with its number of samples.
    """
    card = json.loads(storage.read(CARD) or b"{}")
    by_split = files_by_split(files)
    counts = {split: sum(count for _, count in own) for split, own in by_split.items()}
    samples = range(*card["samples"])
    total = sum(counts.values())
    first = _describe_sample(storage, identity, by_split)
    source = f"distribution {identity.distribution[:16]}, seed {identity.seed}, clsco {identity.version}"
    card["license"] = card.get("license") or "unspecified"
    card |= {
        "counts": {"samples": total, "failed": len(samples) - total, "splits": counts},
        "arrays": first.arrays,
        "conventions": "Row 0 is on top, column 0 on the left, pixel centers at integer coordinates; lengths in mm.",
        "load": _loading(identity.format, first),
        "cite": f"Synthetic images with defocus and motion blur and their ground truth: {source}.",
        "files": by_split,
    }
    storage.write(README, readme(card).encode())
    storage.write(CARD, f"{json.dumps(card, indent=2, allow_nan=False)}\n".encode())


@dataclass(frozen=True)
class _SampleDescription:
    """The first sample of a set: its shard, its key, and the description of its arrays by name."""

    file: str = "SPLIT/000000"
    key: str = "000000000"
    arrays: Mapping[str, Any] = field(default_factory=dict)


def loading_lines(storage: Storage, identity: Identity, by_split: Mapping[str, Sequence[tuple[str, int]]]) -> list[str]:
    """Code that loads a set: one line for each package. Raises FileError.

    It is not taken from the card, which is untrusted, but made from names that are checked.
    """
    first = _describe_sample(storage, identity, by_split)
    return [f"{package}: {code}" for package, code in _loading(identity.format, first).items()] if first.arrays else []


def _describe_sample(
    storage: Storage, identity: Identity, by_split: Mapping[str, Sequence[tuple[str, int]]]
) -> _SampleDescription:
    """The first sample of the largest split, which is usually the one to learn from."""
    largest = max(by_split.values(), key=lambda files: sum(count for _, count in files), default=())
    file = next((file for file, count in largest if count), None)
    if file is None:
        return _SampleDescription()
    reader = CONTAINERS[identity.format].read(storage.local(file))
    arrays = reader.record(0, ()).meta["arrays"]
    if fault := misfit(arrays, {SHORT: ARRAY}):
        raise FileError(f"{file}: arrays must be described as clsco dataset make does it; got {fault}")
    for about in arrays.values():
        about.pop("clipped", None)  # it differs between samples
        about["encoding"] = _encoding(identity.format, about)
    return _SampleDescription(file, reader.keys[0], arrays)


def _encoding(form: str, about: Mapping[str, Any]) -> str:
    name, _, raw = form.partition("+")
    picture = is_png(about["dtype"], tuple(about["shape"]))
    if name == "webdataset":
        return "npy" if raw else "png" if picture else "npy.zst"
    return {"npz": "npy", "hdf5": "dataset", "zarr": "array"}[name]


def _loading(form: str, first: _SampleDescription) -> dict[str, str]:
    """Code that loads a set, by package, with names of folders, files and arrays of this set."""
    folder = first.file.partition("/")[0]
    opened = "" if folder == UNSPLIT else f", {json.dumps(folder)}"
    pattern, shard = json.dumps(f"DATA/{folder}/*{CONTAINERS[form].suffix}"), json.dumps(f"DATA/{first.file}")
    name = next(iter(first.arrays), "color")
    array = json.dumps(name)
    code = {
        "clsco": f'import clsco.data\nrecord = clsco.data.open("DATA"{opened})[0]\nrecord[{array}], record.meta',
        "torch": f'torch.utils.data.DataLoader(clsco.data.open("DATA"{opened}), batch_size=None, num_workers=4)',
    }
    more = {
        "webdataset": {
            "webdataset": f"webdataset.WebDataset(glob.glob({pattern}), shardshuffle=100).decode()",
            "datasets": f'datasets.load_dataset("webdataset", data_files={pattern}, streaming=True)',
        },
        "hdf5": {"h5py": f"h5py.File({shard})[{json.dumps(f'{first.key}/{name}')}][()]"},
        "zarr": {"zarr": f'zarr.open_group({shard}, mode="r")[{array}][0]'},
        "npz": {"numpy": f"numpy.load({json.dumps(f'DATA/{first.file}/{first.key}.npz')})[{array}]"},
    }
    return code | more.get(form.partition("+")[0], {})


def readme(card: Mapping[str, Any]) -> str:
    """The text of README.md from the whole card: a YAML header for the hub, and a description for readers."""
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
        fence = "`" * (1 + max([2, *map(len, re.findall("`+", card["recipe"]))]))  # longer than any in the text
        language = "python" if card.get("function") else "toml"
        lines += ["## Distribution", "", f"{fence}{language}", card["recipe"].rstrip("\n"), fence, ""]
    lines += ["## How to cite", "", card["cite"], ""]
    return "\n".join(lines)


def _header(card: Mapping[str, Any]) -> list[str]:
    """YAML header for the hub; its strings are written as JSON, which is valid YAML."""
    license_text, identity = str(card["license"]), card["identity"]
    if license_text.lower() == "unspecified":
        lines = ["license: unknown"]
    elif license_text.lower() in _HUB_LICENSES:
        lines = [f"license: {license_text.lower()}"]
    else:
        lines = ["license: other", f"license_name: {json.dumps(license_text)}"]
    lines += ["task_categories:", "- depth-estimation", "- image-to-image"]
    lines += ["tags:", "- synthetic", "- defocus", "- motion-blur", "- depth-from-defocus"]
    total = card["counts"]["samples"]
    lines += ["size_categories:", f"- {next((text for most, text in _SIZES if total < most), 'n>10M')}"]
    form = identity["format"]
    if form.startswith("webdataset"):
        lines += ["configs:", "- config_name: default", "  data_files:"]
        for split in card["files"]:
            path = json.dumps(f"{split or UNSPLIT}/*{CONTAINERS[form].suffix}")
            lines += [f"  - split: {json.dumps(split or 'train')}", f"    path: {path}"]
    return lines


def _cell(text: str) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")
