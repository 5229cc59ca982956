"""Implementation of `clsco check`: compares all outputs with the NumPy reference, and color with rays."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from clsco import reference
from clsco.cli.output import echo
from clsco.cli.tables import print_tables, table
from clsco.engine.sequence import render
from clsco.errors import ClscoError
from clsco.files.images import save_image, write_json
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, OUTPUTS, SENSOR_NAMES
from clsco.optics.sensor import camera_word, sensor_model
from clsco.reference.sensor.sensor import sensor_outputs
from clsco.scene.model import Scene

if TYPE_CHECKING:  # these modules need the extra `check`
    from clsco.truth.judge import Judgement

# In single precision, tolerances are 10 times larger, and at edges 1 in LEAST_AGREEING pixels may exceed them.
LEAST_AGREEING = 500


@dataclass(frozen=True)
class Difference:
    """Difference between an output of the device and of the reference.

    unit: unit of all errors. largest, rms: largest error, and root mean square error. row, column: pixel with the
    largest error. figure: tolerance. count: number of pixels whose error exceeds the tolerance. allowed: largest
    `count` that passes.
    """

    output: str
    unit: str
    largest: float
    rms: float
    row: int
    column: int
    count: int
    figure: float
    allowed: int

    @property
    def agrees(self) -> bool:
        return self.count <= self.allowed


@dataclass(frozen=True)
class Checked:
    """Comparison of a frame, or one view of a stereo pair, with the reference; and the time that each took, s."""

    frame: Frame
    differences: tuple[Difference, ...]
    seconds: float
    reference_seconds: float

    @property
    def place(self) -> str:
        """Text that names the frame and, in a stereo pair, the view."""
        return f"in frame {self.frame.index}" + (f" ({self.frame.eye})" if self.frame.eye else "")


def difference(output: str, got: NDArray[Any], expected: NDArray[Any], single: bool = False) -> Difference:
    """Compare two arrays (rows, columns[, channels]) of an output. Equal infinities agree, and NaN never agrees.

    single: True if `got` was computed in single precision, which has a larger tolerance.
    """
    about = OUTPUTS[output]
    unit, figure = about.measure or about.unit, about.figure * (10.0 if single else 1.0)
    values, exact = np.asarray(got, np.float64), np.asarray(expected, np.float64)
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        error = np.abs(values - exact)
    if unit == "relative":
        error = error / np.where(np.isfinite(exact) & (exact != 0.0), np.abs(exact), 1.0)
    if unit == "relative beyond 1":  # millions of copies of an image may lie on a surface
        error = error / np.maximum(np.abs(exact), 1.0)
    error = np.where(values == exact, 0.0, np.where(np.isnan(error), np.inf, error))
    error = error.reshape(len(error), *error.shape[1:2], -1).max(axis=-1).reshape(len(error), -1)
    row, column = np.unravel_index(int(error.argmax()), error.shape)
    rms = float(np.sqrt(np.mean(error**2)))
    count = int((error > figure).sum())
    allowed = error.size // LEAST_AGREEING if single and not np.isnan(values).any() else 0
    return Difference(output, unit, float(error.max()), rms, int(row), int(column), count, figure, allowed)


def compare(frame: Frame, exact: Frame) -> tuple[Difference, ...]:
    """Differences between a frame and the reference's frame `exact`, in each output that both have."""
    single = frame.metadata.get("precision") == "single"
    return tuple(
        difference(name, getattr(frame, name), getattr(exact, name), single)
        for name in ("color", *ALL_TRUTH)
        if getattr(frame, name) is not None and getattr(exact, name) is not None
    )


def _sensor_of(scene: Scene, frame: Frame) -> Frame:
    """Outputs that the reference's model of the sensor computes from a frame's irradiance."""
    light = np.atleast_3d(frame.color)
    model = sensor_model(scene, light.shape[2])
    camera = camera_word(frame.index, "right" if frame.eye == "right" else "left")
    return Frame(index=frame.index, **sensor_outputs(model, light, camera, SENSOR_NAMES))


def compare_frames(scene: Scene, device: str | None, precision: str | None) -> Iterator[Checked]:
    """Render each frame, or both views of each stereo pair, on the device and with the reference.

    If the scene has a sensor, the irradiance is compared in place of color. Sensor codes are compared with those that
    the reference computes from the device's irradiance, because the last bit of an irradiance may change a code. Raises
    as `clsco.render`.
    """
    plain = scene.model_copy(update={"sensor": None})
    frames, exacts = render(plain, device=device, precision=precision), reference.render(plain)
    sensed = render(scene, truth=SENSOR_NAMES, device=device, precision=precision) if scene.sensor else None
    for _ in range(scene.sequence.frames * (1 if scene.stereo is None else 2)):
        start = time.perf_counter()
        frame = next(frames)
        differences: tuple[Difference, ...] = ()
        if sensed is not None:
            differences = compare(next(sensed), _sensor_of(scene, frame))[1:]  # without color, made from codes
        middle = time.perf_counter()
        exact = next(exacts)
        end = time.perf_counter()
        yield Checked(frame, compare(frame, exact) + differences, middle - start, end - middle)


def _reference_tables(checked: Checked) -> list[RenderableType]:
    """Tables of the differences between one frame and the reference, and of the time that each took."""
    columns = ("output", "largest", "RMS", "unit", "row", "column", "above", "figure")
    rows = [
        (d.output, f"{d.largest:.2e}", f"{d.rms:.2e}", d.unit, f"{d.row}", f"{d.column}", f"{d.count}", f"{d.figure:g}")
        for d in checked.differences
    ]
    frame, metadata = checked.frame, checked.frame.metadata
    title = f"Frame {frame.index}{f', {frame.eye} view,' if frame.eye else ''} against the reference"
    in_kernels = sum(spent for name, spent in metadata["seconds"].items() if name != "host")
    times = (
        f"{metadata['device']}, {metadata['precision']} precision: {checked.seconds:.3f} s, in kernels "
        f"{in_kernels:.3f} s; reference: {checked.reference_seconds:.3f} s"
    )
    return [table(title, columns, rows, right=columns[1:3] + columns[4:]), Text(times)]


def _judged_tables(judgement: Judgement) -> list[RenderableType]:
    """Tables of deviations of one frame from rays, by class of pixel and by object, and of light of small objects."""
    columns = ("", "pixels", "RMS", "noise", "dB", "mean", "beyond", "column", "row", "right", "got", "errors")
    tables: list[RenderableType] = []
    for title, rows in (("Pixels against rays", judgement.classes), ("Their objects", judgement.objects)):
        cells = [
            (
                r.name, f"{r.pixels}", f"{r.rms:.5f}", f"{r.noise:.5f}", f"{r.decibels:.1f}", f"{r.mean:+.5f}",
                f"{r.beyond}", f"{r.column}", f"{r.row}", f"{r.right:.4f}", f"{r.got:.4f}", f"{min(r.errors, 999):.1f}",
            )
            for r in rows
        ]  # fmt: skip
        tables.append(table(title, columns, cells, right=columns[1:]))
    if judgement.lights:
        lights = [
            (r.name, f"{r.right:.4f}", f"{r.error:.4f}", f"{r.got:.4f}", f"{r.own:.4f}") for r in judgement.lights
        ]
        names = ("small object", "right", "noise", "got", "its own")
        tables.append(table("Light around small objects, px of white", names, lights, right=names[1:]))
    tables.append(Text(f"{judgement.rays} rays in {judgement.seconds:.1f} s"))
    return tables


def require_report(out: Path) -> None:
    """Raise ClscoError if `out` does not end in .json or .png, the formats of a report."""
    if out.suffix.lower() not in (".json", ".png"):
        raise ClscoError(f"-o: must be a file .json or .png; got {out}")


def check_scene(
    path: Path, scene: Scene, extent: tuple[int, float], out: Path | None, device: str | None, precision: str | None
) -> None:  # fmt: skip
    """Print how each view of a scene differs from the reference and from rays, and write the report to `out`.

    extent: largest number of rays per pixel, and time for all rays, s. Raises ClscoError if a difference is too large.
    """
    rays, seconds = extent
    why = "no rays were asked for" if not rays else None
    if rays:
        from clsco.truth.judge import judge
        from clsco.truth.problem import make_problem, not_judged

        why = not_judged(scene)
    views: list[tuple[Checked, Judgement]] = []
    count = scene.sequence.frames * (1 if scene.stereo is None else 2)
    for checked in compare_frames(scene, device, precision):
        print_tables(*_reference_tables(checked))
        color, frame = checked.differences[0], checked.frame
        if not color.agrees:
            got = f"{color.largest:.2g} {checked.place} ({color.count} pixels above)"
            raise ClscoError(f"{path}: color must agree within {color.figure:g} of white; got {got}")
        if why is None:
            judged = judge(make_problem(scene, frame.index, frame.eye), frame.color, rays, seconds / count)
            print_tables(*_judged_tables(judged))
            views.append((checked, judged))
    if why is not None:
        echo(f"the lens: not judged: {why}")
    if out is not None:
        _write_report(out, views, why)
    if wrong := [f"{judged.wrong} {each.place}" for each, judged in views if not judged.agrees]:
        raise ClscoError(f"{path}: pixels must be within 0.01 of white and 5 errors of rays; got {'; '.join(wrong)}")


def _write_report(out: Path, views: list[tuple[Checked, Judgement]], why: str | None) -> None:
    """Write a report: to a .json all figures, to a .png the darkened frames with the tested pixels marked. These are
    red if too bright, blue if too dark, green if they agree, saturated at 0.01 of white. why: why rays are missing.
    """
    if out.suffix.lower() == ".json":
        values = [{"frame": each.frame.index, "eye": each.frame.eye} | judged.values() for each, judged in views]
        write_json(out, {"not_judged": why, "views": values})
        return
    if why is not None:
        raise ClscoError(f"-o: a picture needs rays; got {why}")
    pictures = []
    for each, judged in views:
        light = np.clip(np.atleast_3d(each.frame.color).mean(axis=2, keepdims=True), 0.0, 1.0)
        picture = np.repeat(0.25 * light, 3, axis=2)
        off = (judged.got - judged.right).mean(axis=1) / 0.01
        tried = np.stack([off, 1.0 - np.abs(off), -off], axis=-1)
        picture[judged.pixels.row, judged.pixels.column] = np.clip(tried, 0.0, 1.0)
        pictures.append(picture.astype(np.float32))
    save_image(out, np.concatenate(pictures), 8)
