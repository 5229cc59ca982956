"""Checks of a data set: files against the manifest, samples rendered again, flow against depth and motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco import __version__
from clsco.data.build import located
from clsco.data.containers import container_named
from clsco.data.distribution import Sample
from clsco.data.manifest import ManifestParts, Merged, parsed_part, part_key
from clsco.data.record import Record, make_record
from clsco.data.sets import DataSet
from clsco.data.shards import SampleRenderer, device_family
from clsco.errors import ClscoError, FileError, SceneError
from clsco.files.atomic import sha256
from clsco.frame.frame import Frame
from clsco.opencl.device import choose
from clsco.optics.exposure import middle_time
from clsco.optics.lens_path import camera_at
from clsco.optics.line_truth import LinePoints, lines_of
from clsco.optics.motion import Eye, moved_points, poses_at, rest_center
from clsco.reference.common.geometry import pixel_ray, project
from clsco.scene.file import FILE_KEYS
from clsco.scene.model import Scene
from clsco.scene.sweep import parse_sweep
from clsco.scene.text import shown

FLOW_PX, FLOW_SHARE = 0.01, 1e-4
"""By how much flow may differ from where depth and motion lead: px, and of its length. Depth has 24 bits."""
NEAREST = 1e-3  # mm; what ends behind the lens has no flow

Advance = Callable[[], object]


def chosen_samples(there: DataSet, count: int) -> list[int]:
    """Numbers of samples, spread over a set."""
    count = min(count, len(there.samples))
    return [there.samples[k * len(there.samples) // count] for k in range(count)]


def hold_arrays(there: DataSet, numbers: Sequence[int]) -> list[int]:
    """Samples whose scenes have arrays, which their function in Python alone makes again."""
    found = []
    for number in numbers if "function" in there.about else ():
        with suppress(ClscoError):  # which is a finding of its own
            table = scene_table(there, number)
            items = [*table.get("object", ()), table.get("aperture", {})]
            if any(isinstance(item.get(key), Mapping) for item in items for key in FILE_KEYS):
                found.append(number)
    return found


def verify_files(there: DataSet, advance: Advance) -> list[str]:
    """List where a set differs from its manifest, a line each: parts, files, and arrays in them."""
    findings: list[str] = []
    for shard in there.shards:
        faults: list[str] = []
        if shard not in there.done([shard], True, faults):
            findings += faults or [f"{part_key(shard)}: shard {shard} must be there; got none"]
        else:
            findings += _verify_shard(there, shard)
        advance()
    if not findings:
        findings += _strays(there) + _merged(there)
    return findings


def verify_samples(
    there: DataSet, numbers: Sequence[int], device: str | None, advance: Advance, folder: Path
) -> list[str]:
    """List samples that differ when they are rendered again, a line each, and flow that does not follow from the
    motion.

    folder: of the distribution file, where textures lie.
    """
    chosen = choose(device, "device")
    if numbers and device_family(chosen) != there.identity.device_family:
        rule = f"samples must be rendered again on a device of the family {there.identity.device_family}"
        return [f"{rule}; got {device_family(chosen)}"]
    if numbers and there.identity.version != __version__:
        return [f"samples must be rendered again by clsco {there.identity.version}; got {__version__}"]
    more = ("object_id", "depth") if "flow" in there.identity.arrays else ()
    arrays = tuple(dict.fromkeys((*there.identity.arrays, *more)))
    renderer = SampleRenderer(chosen, arrays, there.identity.precision)
    findings: list[str] = []
    for number in numbers:
        try:
            findings += _verify_sample(there, number, renderer, folder)
        except ClscoError as error:
            findings += [f"sample {number}: must be rendered again; got {text}" for text in str(error).splitlines()]
        advance()
    return findings


def scene_table(there: DataSet, number: int) -> Mapping[str, Any]:
    """The scene of a sample, or of one that failed, in the folder of the distribution file.

    Raises SceneError where there is none.
    """
    if number not in there.samples:
        raise SceneError(f"sample: must be from {there.samples.start} to {there.samples.stop - 1}; got {number}")
    rows, failures = there.lines(number // there.identity.shard_size)
    for row in failures:
        if row["number"] == number:
            if row["scene"] is None:
                raise SceneError(f"sample {number}: has no scene, as none could be drawn; got {row['error']}")
            found: Mapping[str, Any] = row["scene"]
            return found
    for row in rows:
        if row["number"] == number:
            table: Mapping[str, Any] = _stored(there, row).meta["scene"]
            return table
    got = part_key(number // there.identity.shard_size)
    raise SceneError(f"sample {number}: its shard must be made; got no part {got}")


def flow_error(scene: Scene, frame: Frame, depth: NDArray[np.float32], flow: NDArray[np.float32]) -> float:
    """By how much the flow of a frame exceeds what it may differ from motion, in px; not above 0 where it is right.

    frame: with `object_id`; depth (rows, columns) in mm: of each surface point, which the scene's motion takes to the
    middle of the next frame's shutter; flow (rows, columns, 2) in px.
    """
    assert frame.object_id is not None
    rows, columns = depth.shape
    camera = scene.camera.model_copy(update={"resolution": (columns, rows)})
    scene = scene.model_copy(update={"camera": camera})
    eye: Eye = "right" if frame.eye == "right" else "left"
    if scene.rolls:
        return _line_flow_error(scene, frame, depth, flow)
    now, then = (middle_time(scene.sequence, k) if scene.moves else 0.0 for k in (frame.index, frame.index + 1))
    camera, later = (camera_at(scene, time) for time in (now, then))
    row, column = np.mgrid[:rows, :columns].astype(np.float64)
    points = pixel_ray(camera, row, column) * np.where(np.isfinite(depth), depth, 0.0)[..., None].astype(np.float64)
    worst = 0.0
    for k, (item, one, two) in enumerate(
        zip(scene.objects, poses_at(scene, now, eye), poses_at(scene, then, eye), strict=True)
    ):
        own = (frame.object_id == k) & np.isfinite(depth)
        moved = moved_points(points[own], rest_center(item), one, two)
        seen = moved[:, 2] > NEAREST
        at_row, at_column = project(later, moved[seen])
        expected = np.stack([at_column - column[own][seen], at_row - row[own][seen]], axis=-1)
        worst = max(worst, _excess(flow[own][seen], expected))
    return worst


def _excess(flow: NDArray[np.floating], expected: NDArray[np.float64]) -> float:
    """By how much vectors (points, 2) differ more from expected ones than they may, px."""
    excess = np.abs(flow - expected).max(axis=-1, initial=0.0)
    excess -= FLOW_PX + FLOW_SHARE * np.abs(expected).max(axis=-1, initial=0.0)
    return float(excess.max(initial=-1.0))


def _line_flow_error(scene: Scene, frame: Frame, depth: NDArray[np.float32], flow: NDArray[np.float32]) -> float:
    """`flow_error` under a rolling shutter, infinite where other points have a flow than should."""
    assert frame.object_id is not None
    eye: Eye = "right" if frame.eye == "right" else "left"
    now, then = (lines_of(scene, number, eye) for number in (frame.index, frame.index + 1))
    expected = LinePoints(scene.objects, depth, frame.object_id, now).flow(then)
    known = np.isfinite(expected).all(axis=-1)
    if not np.array_equal(known, np.isfinite(flow).all(axis=-1)):
        return np.inf
    return max(0.0, _excess(flow[known], expected[known]))


def _verify_shard(there: DataSet, shard: int) -> Iterator[str]:
    """Arrays of a shard whose files are whole."""
    rows, failures = there.lines(shard)
    numbers = sorted(row["number"] for row in (*rows, *failures))
    if numbers != list(there.numbers(shard)):
        yield f"{part_key(shard)}: must have each sample once; got others"
        return
    for key in sorted({row["file"] for row in rows}):
        try:
            with closing(container_named(there.identity.format).read(there.storage.local(key))) as reader:
                for row in (row for row in rows if row["file"] == key):
                    yield from _compared(f"{key}: sample {row['number']}", there, row, reader[row["offset"]])
        except (ClscoError, IndexError) as error:
            yield f"{key}: must be read; got {error}"


def _compared(where: str, there: DataSet, row: Mapping[str, Any], record: Record) -> Iterator[str]:
    found = record.sha256()
    number, seed = record.meta.get("number"), record.meta.get("seed")
    if number != row["number"] or seed != there.identity.seed:
        got = f"sample {shown(number)} of seed {shown(seed)}"
        yield f"{where}: must be of seed {there.identity.seed}; got {got}"
    for name in sorted(found.keys() | row["arrays"].keys()):
        if found.get(name) != row["arrays"].get(name):
            yield f"{where}: {name} must have the SHA-256 in the manifest; got another"


def _verify_sample(there: DataSet, number: int, renderer: SampleRenderer, folder: Path) -> Iterator[str]:
    rows, _ = there.lines(number // there.identity.shard_size)
    row = next((row for row in rows if row["number"] == number), None)
    if row is None:
        return  # it failed, or its shard is missing, which is a finding already
    record = _stored(there, row)
    meta = record.meta
    sweep = parse_sweep(located(meta["scene"], folder), f"sample {number}")
    sample = Sample(
        number, meta["split"], meta["attempts"], dict(meta["parameters"]), dict(meta["scene"]),
        sweep.labels, sweep.scenes,
    )  # fmt: skip
    frames = renderer.render(sample)
    identity = there.identity
    again = make_record(sample, identity.seed, frames, identity.arrays, dict(identity.types)).sha256()
    stored = record.sha256()
    for name in sorted(again.keys() | stored.keys()):
        if again.get(name) != stored.get(name):
            yield f"{row['file']}: sample {number}: {name} must be what is rendered again, bit by bit; got other values"
    prefixes = iter(each["prefix"] for each in meta["frames"])
    for scene, views in zip(sample.scenes, frames, strict=True):
        for frame in views:
            prefix = next(prefixes)
            flow = record.arrays.get(f"{prefix}flow")
            if flow is None:
                continue
            depth = record.arrays.get(f"{prefix}depth", frame.depth)
            assert depth is not None
            if (excess := flow_error(scene, frame, depth, flow)) > 0:
                rule = f"{prefix}flow must lead where depth and motion do, within {FLOW_PX:g} px"
                yield f"{row['file']}: sample {number}: {rule}; got {excess + FLOW_PX:.3g} px"


def _stored(there: DataSet, row: Mapping[str, Any]) -> Record:
    """The record of a sample, by its line in the manifest."""
    with closing(container_named(there.identity.format).read(there.storage.local(row["file"]))) as reader:
        if row["offset"] >= len(reader):
            raise FileError(f"{row['file']}: must hold sample {row['number']} as number {row['offset']}; got no such")
        record = reader[row["offset"]]
    kinds = {"scene": dict, "frames": list, "split": str, "attempts": int, "parameters": dict}
    for name, kind in kinds.items():
        if not isinstance(record.meta.get(name), kind):
            rule = f"{row['file']}: sample {row['number']}: {name} must be there, as clsco dataset make writes it"
            raise FileError(f"{rule}; got {shown(record.meta.get(name))}")
    return record


def _strays(there: DataSet) -> list[str]:
    """Files beside those that parts name."""
    known = {key for _, data in ManifestParts(there.storage).read() for key in parsed_part(data).files}
    folders = sorted({key.partition("/")[0] for key in known} | {name for name, _ in there.identity.splits})
    strays = [key for folder in folders for key in there.storage.sizes(folder) if key not in known]
    strays += [
        key for key in ManifestParts(there.storage).keys if key not in {part_key(shard) for shard in there.shards}
    ]
    return [f"{key}: must be a file of a shard of the set; got one that no part names" for key in strays]


def _merged(there: DataSet) -> list[str]:
    """Differences of the manifest of all shards, where it is there, from the parts."""
    merged, findings = Merged(there.storage), []
    for _, data in ManifestParts(there.storage).read():
        merged.add(parsed_part(data), data)
    for key, path in merged.paths.items():
        got = there.storage.digest(key)
        if got is not None and got != sha256(path):
            findings.append(f"{key}: must hold the lines of all parts; got others")
    return findings
