"""fill.cl against its twin: each kernel, whole fillings of any mask, and that the order of lists changes no bit."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.constants import FILL_LANES, SCORE_SUMS, SCORED_COLUMNS
from clsco.frame.strips import Grid
from clsco.inpainting.rules import score_of_sums
from clsco.opencl.buffers import download, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.motion import pose_at
from clsco.optics.quadrics import place
from clsco.passes import fill
from clsco.passes.fill import Filler
from clsco.passes.pack import camera_grid, lens_struct, surface_structs
from clsco.passes.warp import KERNELS
from clsco.plan.buffers import COUNTERS, fill_buffers
from clsco.records import REAL, Real, flat
from clsco.reference.common.geometry import pixel_ray, solve_quadric
from clsco.reference.inpainting.fill import Method, fill_objects, find_spans, mark_missing
from clsco.reference.inpainting.fill_mean_median import smooth_median
from clsco.reference.inpainting.score import score_mean_median
from clsco.reference.trace.trace import padded_grid
from clsco.scene.model import Camera, Sphere
from tests.kernels.launches import parameters, whole
from tests.slow import combined, mostly_slow

Array = NDArray[Any]
Mask = NDArray[np.bool_]
NONE = np.iinfo(np.int32).max
FLOAT_EPS = float(np.finfo(np.float32).eps)
BALL = Sphere(center=(0.0, 0.0, 280.0), radius=3.0)


class Planes:
    """A filler with the planes of a mask: values (H, W, K), radiance and then inverse depth, in floats.

    far: of several objects, whose holes are filled from the far side; what is known shows object 0, 1, 2, 0, 1 ...
    """

    def __init__(
        self, session: Session, values: Array, known: Mask, method: str, guard: int = 0,
        domain: str = "span", real: Real = "double", far: bool = False,
    ) -> None:  # fmt: skip
        self.session, self.shape, self.channels, self.real = session, known.shape, values.shape[2] - 1, real
        rows, columns = (n - 2 * guard for n in self.shape)
        self.camera = Camera(resolution=(columns, rows))
        of_camera = camera_grid(self.camera, guard, real), lens_struct(Lens.of(self.camera), real)
        self.placed = place(BALL, pose_at(BALL.motion, 0.0, "euler"))
        self.surface = upload(session, surface_structs([BALL], [self.placed], real))
        features = {"CHANNELS": self.channels, "QUADRATIC": 1, "DOMAIN_SURFACE": int(domain == "surface")}
        features |= {"SEVERAL": int(far), "FILL_FAR": int(far)}
        features |= {"FILL_AIT": int(method == "ait"), "FILL_MEAN_MEDIAN": int(method == "mean_median")}
        self.target = Target(session, KERNELS[1:], features, real)
        sizes = fill_buffers(Grid.whole(rows, columns, guard, self.channels), far, far, method == "mean_median")
        self.filler = Filler(self.target, *of_camera, features, sizes)
        self.write("value", flat(np.where(known[..., None], values, 0.0)[..., :-1], np.float32))
        self.write("w", np.where(known, values[..., -1], 0.0).astype(REAL[real]))
        self.write("valid", known.astype(np.uint8))
        for name in ("coc", "status", "spans", "grown", "counters"):
            self.write(name, np.zeros(getattr(self.filler.planes, name).size, np.uint8))
        if far:
            self.write("object", objects_of(known))

    def write(self, name: str, array: Array) -> None:
        cl.enqueue_copy(self.session.queue, getattr(self.filler.planes, name), np.ascontiguousarray(array))

    def read(self, name: str, dtype: Any = np.uint8, shape: tuple[int, ...] | None = None) -> Array:
        return download(self.session, getattr(self.filler.planes, name), self.shape if shape is None else shape, dtype)

    def values(self) -> Array:
        """Values (H, W, K) as they are now."""
        radiance = self.read("value", np.float32, (self.channels, *self.shape)).astype(np.float64)
        w = whole(self.session, self.filler.planes.w, self.shape, self.real)
        return np.concatenate([np.moveaxis(radiance, 0, -1), w[..., None]], axis=-1)

    def listed(self, mask: Mask) -> tuple[cl.Buffer, np.int32]:
        """A list of the pixels of a mask, not in their order."""
        pixels = np.random.default_rng(1).permutation(np.flatnonzero(mask)).astype(np.int32)
        cl.enqueue_copy(self.session.queue, self.filler.planes.indices[0], pixels)
        return self.filler.planes.indices[0], np.int32(pixels.size)

    def run(self, name: str, size: int, *args: Any, local: int = 8) -> None:
        head = [getattr(self.filler, each) for each in ("grid", "lens") if each in parameters(name)]
        launch(self.session, self.target[name], (size,), (local,), *head, *args)

    def fill_ait(self, mask: Mask) -> None:
        f, (pixels, count) = self.filler.planes, self.listed(mask)
        planes = (f.far, f.valid, f.value, f.w, f.coc, f.status, f.object)
        self.run("fill_ait", int(count), pixels, count, np.int32(1), *planes)

    def smooth_median(self, mask: Mask, bounds: NDArray[np.float32], *planes: cl.Buffer) -> None:
        """planes: values and inverse depth before, and after."""
        self.write("far", bounds)
        f, (pixels, count) = self.filler.planes, self.listed(mask)
        size = -(-int(count) // FILL_LANES)
        self.run("smooth_median", size, pixels, count, f.far, f.valid, *planes, f.coc)

    def fill(self) -> tuple[Array, Array, dict[str, int]]:
        """Values, status and report of a whole filling."""
        report = self.filler.fill(self.surface, 1, [])
        return self.values(), self.read("status"), report


def objects_of(known: Mask) -> NDArray[np.uint8]:
    """Objects seen in known pixels."""
    return np.where(known, np.arange(known.size).reshape(known.shape) % 3, 255).astype(np.uint8)


def cases(count: int, largest: int, channels: int = 1) -> list[tuple[Array, Mask]]:
    """Floats on random masks of random density and sizes from 1 x 1, and masks with nothing or everything known."""
    rng = np.random.default_rng(53)
    shapes = [(1, 1), (1, 9), (9, 1), (2, 11), (11, 2), (3, 3), (64, 61)]
    shapes += [tuple(rng.integers(1, largest, 2)) for _ in range(count)]
    masks = [rng.random(shape) < rng.random() for shape in shapes]
    masks += [np.zeros((7, 9), dtype=bool), np.ones((7, 9), dtype=bool)]
    return [(rng.random((*m.shape, channels + 1)).astype(np.float32).astype(np.float64), m) for m in masks]


def close(found: Array, expected: Array, roundings: int = 1) -> None:
    """Equal but for so many roundings of values up to 1 to float32; inverse depth stays in double."""
    np.testing.assert_allclose(found[..., :-1], expected[..., :-1], rtol=0, atol=roundings * FLOAT_EPS)
    np.testing.assert_allclose(found[..., -1], expected[..., -1], rtol=1e-12, atol=0)


def spans_of(known: Mask) -> Array:
    """Spans as the device has them."""
    spans = find_spans(known)
    return np.where(spans[:, 1:] < 0, np.array([NONE, -1]), spans).astype(np.int32)


@pytest.mark.parametrize("domain", ["span", "surface"])
def test_missing_pixels_are_listed(session: Session, domain: str) -> None:
    marked = 0
    for values, known in cases(40, 90):
        guard = 0 if min(known.shape) < 20 else 4
        planes = Planes(session, values, known, "none", guard, domain)
        allowed = None
        if domain == "surface":
            rays = pixel_ray(planes.camera, *padded_grid(planes.camera, guard))
            allowed = solve_quadric(planes.placed, None, rays)[1] > 0
        missing = mark_missing(known, allowed)
        report = planes.filler.fill(planes.surface, 1, [])
        assert (planes.read("spans", np.int32, (sum(known.shape), 2)) == spans_of(known)).all()
        assert (planes.read("status") == np.where(missing, 2, 0)).all()
        pixels = download(session, planes.filler.planes.indices[0], (int(missing.sum()),), np.int32)
        assert (np.sort(pixels) == np.flatnonzero(missing)).all()
        inside = missing[guard : known.shape[0] - guard, guard : known.shape[1] - guard]
        assert report["missing_pixels"] == report["unfilled_pixels"] == inside.sum()
        marked += int(missing.sum())
    assert marked > 500


def test_any_root_of_any_object_allows_missing_pixels(session: Session) -> None:
    """The lens is within a ball, which is seen at the second root of every ray."""
    known = np.random.default_rng(5).random((9, 21)) < 0.4
    planes = Planes(session, np.ones((9, 21, 2)), known, "none", domain="surface", far=True)
    around = Sphere(center=(0.0, 0.0, 0.0), radius=300.0)
    placed = place(around, pose_at(around.motion, 0.0, "euler"))
    _, roots = solve_quadric(placed, None, pixel_ray(planes.camera, *padded_grid(planes.camera, 0)))
    assert (roots == 2).all()
    planes.surface = upload(session, surface_structs([around], [placed], "double"))
    _, status, _ = planes.fill()
    assert (status == np.where(mark_missing(known, None), 2, 0)).all()


def test_spans_and_lists_end_where_they_should(session: Session) -> None:
    known = np.random.default_rng(7).random((9, 70)) < 0.5
    lines, missing = sum(known.shape), mark_missing(known, None)
    planes = Planes(session, np.ones((9, 70, 2)), known, "none")
    f = planes.filler.planes
    f.spans, f.grown = (upload(session, np.full((lines + 8, 2), -9, np.int32)) for _ in range(2))
    f.indices = upload(session, np.full(known.size, -9, np.int32)), f.indices[1]
    planes.fill()
    for spans in (f.spans, f.grown):
        found = download(session, spans, (lines + 8, 2), np.int32)
        assert (found[:lines] == spans_of(known)).all()
        assert (found[lines:] == -9).all()
    pixels = download(session, f.indices[0], known.shape, np.int32).ravel()
    assert (np.sort(pixels[: missing.sum()]) == np.flatnonzero(missing)).all()
    assert (pixels[missing.sum() :] == -9).all()


def test_the_first_pixel_of_all_serves_as_any_other(session: Session) -> None:
    known, missing = np.zeros((2, 3, 4), dtype=bool)
    known[0, [0, 2]] = missing[1, 1] = True
    planes = Planes(session, np.arange(24.0).reshape(3, 4, 2) + 1.0, known, "ait")
    given = planes.values()
    planes.fill_ait(missing)
    assert (planes.values()[1, 1] == given[0, 0]).all()


def test_only_the_eight_neighbors_serve(session: Session) -> None:
    """Neither a pixel itself, which is valid here, nor one farther away."""
    listed, known = np.zeros((7, 9), dtype=bool), np.ones((7, 9), dtype=bool)
    listed[3, 4], known[2:5, 3:6] = True, listed[2:5, 3:6]
    for west in (False, True):
        known[3, 3] = west
        planes = Planes(session, np.random.default_rng(9).random((7, 9, 2)), known, "ait")
        expected = planes.values()
        planes.fill_ait(listed)
        expected[listed] = expected[3, 3] if west else expected[listed]
        assert (planes.values() == expected).all()
        assert (planes.read("status") == (listed & west)).all()


@pytest.mark.parametrize(
    ("domain", "method"),
    combined(("span", "surface"), ("ait", "mean_median"), kept=[("span", "mean_median"), ("surface", "ait")]),
)
def test_settling_a_sweep_lists_what_is_missing_then(session: Session, method: str, domain: str) -> None:
    grown = 0
    rng = np.random.default_rng(3)
    for values, known in cases(60, 40):
        planes = Planes(session, values, known, method, 0, domain)
        rays = pixel_ray(planes.camera, *padded_grid(planes.camera, 0))
        allowed = solve_quadric(planes.placed, None, rays)[1] > 0 if domain == "surface" else None
        missing = mark_missing(known, allowed)
        if not missing.any():
            continue
        filled = missing & (rng.random(known.shape) < 0.5)
        pixels, count = planes.listed(missing)
        for name in ("spans", "grown"):
            planes.write(name, spans_of(known))
        planes.write("status", np.where(filled, 1, np.where(missing, 2, 0)).astype(np.uint8))
        f, left = planes.filler.planes, planes.filler.planes.indices[1]
        args = (pixels, count, f.spans, f.grown, f.status, f.valid, left, f.counters, f.done)
        planes.run("settle_sweep", int(count), *args)
        grown_args = (planes.surface, np.int32(1), f.valid, f.spans, f.grown, f.status, left, f.counters, f.w, f.far)
        planes.run("mark_grown", sum(known.shape), *grown_args)
        after = known | filled
        expected = missing & ~filled | mark_missing(after, allowed)
        assert (planes.read("valid") == after).all()
        assert (planes.read("spans", np.int32, (sum(known.shape), 2)) == spans_of(after)).all()
        counters = planes.read("counters", np.int32, (COUNTERS,)).tolist()
        done = [int(filled.sum())] * 2 + [int(filled.sum()) if planes.filler.smooths else 0]
        assert counters == [int(expected.sum())] * 2 + done
        found = download(session, left, (int(expected.sum()),), np.int32)
        assert (np.sort(found) == np.flatnonzero(expected)).all()
        if planes.filler.smooths:
            finished = download(session, f.done, (int(filled.sum()),), np.int32)
            assert (np.sort(finished) == np.flatnonzero(filled)).all()
        grown += int((expected & ~missing).sum())
    assert grown > (100 if domain == "span" else 0)


@pytest.mark.parametrize("channels", [1, 3])
def test_scores_are_those_of_its_twin(session: Session, channels: int) -> None:
    rng = np.random.default_rng(59)
    for shape in [(3, 3), (2, 9), (3, 11), (12, 9), (20, 18), (31, 10), (40, 67), (4, 257), (5, 258), (6, 600)]:
        values = rng.random((*shape, channels + 1)).astype(np.float32).astype(np.float64)
        known = rng.random(shape) < 0.97
        planes = Planes(session, values, known, "mean_median", far=channels > 1)
        f = planes.filler.planes
        count = shape[0] * -(-shape[1] // SCORED_COLUMNS)
        planes.run("score_mean_median", count, np.float32(2**16), f.value, f.valid, f.sums, local=1)
        found = score_of_sums(download(session, f.sums, (count, SCORE_SUMS), np.int64), 2**16)
        assert found == score_mean_median(values[..., :-1], known, 2**16)
        assert found.samples or min(shape) < 4


def test_smoothing_writes_all_that_is_listed(session: Session) -> None:
    """Also what no neighbor may serve: planes to write to may hold anything before."""
    rng = np.random.default_rng(73)
    values, filled = rng.random((9, 11, 4)).astype(np.float32).astype(np.float64), rng.random((9, 11)) < 0.6
    planes = Planes(session, values, np.ones_like(filled), "mean_median", far=True)
    f, bounds = planes.filler.planes, np.where(rng.random((9, 11)) < 0.5, 0.0, 0.7).astype(np.float32)
    out = f.other_value, f.other_w
    for buffer in out:
        cl.enqueue_fill_buffer(session.queue, buffer, np.array(1, np.uint8), 0, buffer.size)
    planes.smooth_median(filled, bounds, f.value, f.w, *out)
    f.value, f.w = out
    close(planes.values()[filled], smooth_median(values, filled, np.ones_like(filled), bounds)[filled])


@pytest.mark.parametrize("method", mostly_slow(["ait", "mean_median", "none"], ["mean_median"]))
@pytest.mark.parametrize(
    ("channels", "guard", "far"),
    mostly_slow([(1, 0, False), (3, 2, False), (1, 0, True), (3, 2, True)], [(3, 2, True)]),
)
def test_whole_fillings_are_their_twins(session: Session, method: Method, channels: int, guard: int, far: bool) -> None:
    filled, most_sweeps = 0, 0
    for values, known in cases(120 if method == "ait" else 25, 22, channels):
        if min(known.shape) <= 2 * guard:
            continue
        given, seen = np.where(known[..., None], values, 0.0), objects_of(known)
        expected, objects, expected_status, report = fill_objects(given, seen, known, None, method, guard, far)
        planes = Planes(session, values, known, method, guard, far=far)
        found, status, counters = planes.fill()
        assert (status == expected_status).all()
        if far:
            assert (planes.read("object") == objects).all()
        assert counters == asdict(report)
        close(found, expected, roundings=report.sweeps + 1)  # one per sweep, and medians of them
        filled, most_sweeps = filled + report.filled_pixels, max(most_sweeps, report.sweeps)
    assert (filled > 1000 and most_sweeps > 5) or method == "none"


@pytest.mark.parametrize("method", mostly_slow(["ait", "mean_median"], ["ait"]))
def test_what_cannot_be_filled_is_left(session: Session, method: Method) -> None:
    """The ball is allowed to have missing pixels, and is nowhere near a known one."""
    known = np.zeros((150, 150), dtype=bool)
    known[75, [0, 149]] = True
    planes = Planes(session, np.ones((150, 150, 2)), known, method, 0, "surface")
    _, status, counters = planes.fill()
    assert 20 < counters["unfilled_pixels"] < 100
    assert counters["missing_pixels"] == counters["unfilled_pixels"] == (status == 2).sum()
    assert counters["filled_pixels"] == counters["sweeps"] == 0
    assert (planes.read("valid") == known).all()


@pytest.mark.parametrize(
    ("method", "real", "far"),
    combined(("ait", "mean_median"), ("float", "double"), (False, True), kept=[("ait", "float", False)]),
)
def test_lists_and_local_sizes_change_no_bit(
    session: Session, method: str, real: Real, far: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(71)
    known = rng.random((120, 130)) < 0.6
    known[30:60, 40:90] = False
    values = rng.random((120, 130, 2))
    first, status, counters = Planes(session, values, known, method, 0, "span", real, far).fill()
    assert counters["filled_pixels"] > 5000
    for local in (1, 4, 64):
        for name in ("LISTED", "LINES", "OWNERS"):
            monkeypatch.setattr(fill, name, (local,))
        again, again_status, again_counters = Planes(session, values, known, method, 0, "span", real, far).fill()
        assert (again == first).all()
        assert (again_status == status).all()
        assert again_counters == counters
