"""Checks a data set: compares its files with the manifest, and renders samples again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from clsco import __version__
from clsco.data.build import located
from clsco.data.containers import container_named
from clsco.data.distribution import Sample, ScriptedDistribution, scripted
from clsco.data.fields import NUMBER, SHORT, misfit
from clsco.data.manifest import Merged, parsed_part, part_key
from clsco.data.record import Record, make_record
from clsco.data.sets import DataSet
from clsco.data.shards import SampleRenderer, device_family
from clsco.errors import ClscoError, FileError, SceneError
from clsco.files.atomic import sha256
from clsco.frame.outputs import ATTRIBUTES
from clsco.opencl.device import choose
from clsco.scene.file import FILE_KEYS
from clsco.scene.sweep import parse_sweep
from clsco.scene.text import shown

Advance = Callable[[], object]


def chosen_samples(data_set: DataSet, count: int) -> list[int]:
    """Numbers of `count` samples, evenly spread over a set."""
    count = min(count, len(data_set.samples))
    return [data_set.samples[k * len(data_set.samples) // count] for k in range(count)]


def hold_arrays(data_set: DataSet, numbers: Sequence[int]) -> list[int]:
    """Numbers of the samples whose scenes contain arrays: only the function that made the set can draw them."""
    with_arrays = []
    for number in numbers if "function" in data_set.about else ():
        with suppress(ClscoError):  # other checks report the error
            table = scene_table(data_set, number)
            items = [*table.get("object", ()), table.get("aperture", {})]
            if any(isinstance(item.get(key), Mapping) for item in items for key in FILE_KEYS):
                with_arrays.append(number)
    return with_arrays


def verify_files(data_set: DataSet, advance: Advance) -> list[str]:
    """List how a set differs from its manifest, in its parts, files and arrays; one line for each difference."""
    findings: list[str] = []
    for shard in data_set.shards:
        faults: list[str] = []
        if shard not in data_set.done([shard], True, faults):
            findings += faults or [f"{part_key(shard)}: shard {shard} must be there; got none"]
        else:
            findings += _verify_shard(data_set, shard)
        advance()
    if not findings:
        findings += _unknown_files(data_set) + _merged_faults(data_set)
    return findings


def drawn_again(data_set: DataSet, name: str, folder: Path) -> ScriptedDistribution:
    """The distribution of the function that made a set; name: "module:function". Raises SceneError for another one."""
    try:
        function = resolve_name(name) if ":" in name else None
    except Exception as error:  # the module may raise anything
        raise SceneError(f"draw: must be MODULE:FUNCTION that Python can import; got {name}: {error!r}") from error
    if not callable(function):
        raise SceneError(f"draw: must be MODULE:FUNCTION that Python can import; got {name}")
    drawn = scripted(function, data_set.identity.splits or None, folder, data_set.about.get("split_by", ""))
    if drawn.digest != data_set.identity.distribution:
        raise SceneError(f"draw: must be the function that made the set, from the same source; got {name}")
    return drawn


def verify_samples(
    data_set: DataSet, numbers: Sequence[int], device: str | None, advance: Advance, folder: Path,
    drawn: ScriptedDistribution | None = None,
) -> list[str]:  # fmt: skip
    """Render samples again, and list the differences from the set, one line each.

    folder: folder of the distribution file, where paths of textures begin. drawn: distribution that draws the samples;
    None to use the scenes that the set stores.
    """
    chosen = choose(device, "device")
    if numbers and device_family(chosen) != data_set.identity.device_family:
        rule = f"samples must be rendered again on a device of the family {data_set.identity.device_family}"
        return [f"{rule}; got {device_family(chosen)}"]
    if numbers and data_set.identity.version != __version__:
        return [f"samples must be rendered again by clsco {data_set.identity.version}; got {__version__}"]
    if unknown := set(data_set.identity.arrays) - ATTRIBUTES.keys():
        return [f"arrays: must be some of {', '.join(ATTRIBUTES)}; got {min(unknown)}"]
    renderer = SampleRenderer(chosen, data_set.identity.arrays, data_set.identity.precision)
    findings: list[str] = []
    for number in numbers:
        try:
            findings += _verify_sample(data_set, number, renderer, folder, drawn)
        except ClscoError as error:
            findings += [f"sample {number}: must be rendered again; got {text}" for text in str(error).splitlines()]
        advance()
    return findings


def scene_table(data_set: DataSet, number: int) -> Mapping[str, Any]:
    """The scene file of a sample or a failed sample; its paths are relative to the distribution's folder.

    Raises SceneError if the set has no such sample, or no scene of it.
    """
    if number not in data_set.samples:
        raise SceneError(f"sample: must be from {data_set.samples.start} to {data_set.samples.stop - 1}; got {number}")
    shard = number // data_set.identity.shard_size
    rows, failures = ({row["number"]: row for row in listed} for listed in data_set.lines(shard))
    if number in rows:
        return dict(_stored(data_set, rows[number]).meta["scene"])
    if number not in failures:
        raise SceneError(f"sample {number}: its shard must be made; got no part {part_key(shard)}")
    if (table := failures[number]["scene"]) is None:
        got = failures[number]["error"][:SHORT]
        raise SceneError(f"sample {number}: has no scene, as none could be drawn; got {got}")
    return dict(table)


def _verify_shard(data_set: DataSet, shard: int) -> Iterator[str]:
    """Findings on the samples and arrays of a shard, whose files match the manifest, one line each."""
    rows, failures = data_set.lines(shard)
    numbers = sorted(row["number"] for row in (*rows, *failures))
    if numbers != list(data_set.numbers(shard)):
        yield f"{part_key(shard)}: must have each sample once; got others"
        return
    for key in sorted({row["file"] for row in rows}):
        try:
            reader = container_named(data_set.identity.format).read(data_set.storage.local(key))
            for row in (row for row in rows if row["file"] == key):
                where, record = f"{key}: sample {row['number']}", reader[row["offset"]]
                got, seed = (record.meta.get("number"), record.meta.get("seed")), data_set.identity.seed
                if got != (row["number"], seed):
                    yield f"{where}: must be of seed {seed}; got sample {shown(got[0])} of seed {shown(got[1])}"
                for name in _differing(record.sha256(), row["arrays"]):
                    yield f"{where}: {name} must have the SHA-256 in the manifest; got another"
        except (ClscoError, IndexError) as error:
            yield f"{key}: must be read; got {error}"


def _differing(hashes: Mapping[str, str], others: Mapping[str, str]) -> list[str]:
    """Names of arrays whose hashes differ, or that are in only one of the mappings."""
    return sorted(name for name in hashes.keys() | others.keys() if hashes.get(name) != others.get(name))


def _verify_sample(
    data_set: DataSet, number: int, renderer: SampleRenderer, folder: Path, drawn: ScriptedDistribution | None
) -> Iterator[str]:
    rows, _ = data_set.lines(number // data_set.identity.shard_size)
    row = next((row for row in rows if row["number"] == number), None)
    if row is None:
        return  # it failed, or its shard is missing, which is a finding already
    record = _stored(data_set, row)
    meta, identity = record.meta, data_set.identity
    if drawn is None:
        sweep = parse_sweep(located(meta["scene"], folder), f"sample {number}")
        sample = Sample(
            number, meta["split"], meta["attempts"], dict(meta["parameters"]), dict(meta["scene"]),
            sweep.labels, sweep.scenes,
        )  # fmt: skip
    else:
        sample = drawn.draw(identity.seed, number)
    again = make_record(sample, identity.seed, renderer.render(sample), identity.arrays, dict(identity.types))
    for name in _differing(again.sha256(), record.sha256()):
        yield f"{row['file']}: sample {number}: {name} must be what is rendered again, bit by bit; got other values"


def _stored(data_set: DataSet, row: Mapping[str, Any]) -> Record:
    """The record of a sample; row: line of the sample in the manifest."""
    reader = container_named(data_set.identity.format).read(data_set.storage.local(row["file"]))
    if row["offset"] >= len(reader):
        raise FileError(f"{row['file']}: must hold sample {row['number']} as number {row['offset']}; got no such")
    record = reader[row["offset"]]
    kinds = {"scene": dict, "frames": list, "split": str, "attempts": NUMBER, "parameters": dict}
    if fault := misfit(record.meta, kinds):
        raise FileError(f"{row['file']}: sample {row['number']}: must be as clsco dataset make writes it; got {fault}")
    return record


def _unknown_files(data_set: DataSet) -> list[str]:
    """Messages on files that no part names."""
    known = {key for _, data in data_set.parts() for key in parsed_part(data).files}
    folders = sorted({key.partition("/")[0] for key in known} | {name for name, _ in data_set.identity.splits})
    unknown = [key for folder in folders for key in data_set.storage.sizes(folder) if key not in known]
    unknown += sorted(set(data_set.part_keys()) - {part_key(shard) for shard in data_set.shards})
    return [f"{key}: must be a file of a shard of the set; got one that no part names" for key in unknown]


def _merged_faults(data_set: DataSet) -> list[str]:
    """Messages on differences between the merged manifest, if it exists, and the parts."""
    merged = Merged(data_set.storage)
    for _, data in data_set.parts():
        merged.add(parsed_part(data), data)
    digests = {key: (data_set.storage.digest(key), sha256(path)) for key, path in merged.paths.items()}
    differing = [key for key, (digest, expected) in digests.items() if digest not in (None, expected)]
    return [f"{key}: must hold the lines of all parts; got others" for key in differing]
