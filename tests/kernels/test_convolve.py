"""convolve.cl against its twin: every PSF, narrow and wide, and light that is far above white."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import TAP_LANES
from clsco.frame.strips import Grid
from clsco.opencl.buffers import copied, download
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.stencil import SUMMED
from clsco.passes import convolve as convolution
from clsco.passes.blur import Sources
from clsco.passes.convolve import Convolve
from clsco.passes.frame_blur import make_blur
from clsco.passes.pack import grid_struct
from clsco.plan.buffers import SUMS_BEYOND
from clsco.plan.methods import BlurSpec
from clsco.records import flat
from clsco.scene.model import Psf
from tests.spreads import PSFS, convolve, name_of

Array = NDArray[Any]
RNG = np.random.default_rng
SMOOTH = Psf(model="gaussian")
# A float adds up 64 runs of up to 8 weights in two steps: some 1e-7 RMS of the brightest light.
RMS, LARGEST = 2e-7, 1e-6


def guard_of(psf: Psf, radius: float) -> int:
    return point_spread(psf).reach(abs(radius)) + 2 * TAP_LANES


def lit(psf: Psf, radius: float, shape: tuple[int, ...]) -> Array:
    """Light (rows, columns, channels) in a guard band, a tenth of it dark."""
    guard, rng = guard_of(psf, radius), RNG(51)
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard, shape[2])
    return rng.random(size) * (rng.random(size) < 0.9)


class Convolver:
    """The blur of one image with one PSF."""

    def __init__(self, session: Session, psf: Psf, light: Array, radius: float, brightest: float = 1.0) -> None:
        guard, size = guard_of(psf, radius), abs(radius)
        strip = grid_struct(light.shape[0] - 2 * guard, light.shape[1] - 2 * guard, guard, "double")
        spec = BlurSpec(point_spread(psf), "convolve", size, size, brightest=brightest)
        rows, columns, channels = light.shape
        grid = Grid.whole(rows - 2 * guard, columns - 2 * guard, guard, channels)
        blur = make_blur(Target(session, (), {}, "double"), spec, grid, strip)
        assert isinstance(blur, Convolve)
        self.blur = blur
        self.session, self.radius, self.value = session, size, copied(session, flat(light, np.float32))

    def __call__(self) -> Array:
        self.blur.clear()
        self.blur.add(Sources(None, self.value, radius=self.radius), [])
        image = self.blur.plane([]).read(self.session)
        return image if image.ndim == 3 else image[..., None]


FRAMES: list[tuple[Psf, float, tuple[int, int, int]]] = [
    *((psf, radius, (37, 45, 3)) for psf in PSFS for radius in (0.0, 1e-7, 0.4, -2.7, 10.99, 20.0)),
    *((psf, 60.0 if psf.model == "pillbox" else 25.3, (34, 66, 1)) for psf in (*PSFS[:3], PSFS[5])),
    # Small and odd ones, and those of more tiles than lie side by side.
    *(
        (psf, radius, (rows, columns, 1))
        for rows, columns in ((1, 1), (1, 150), (150, 1), (2, 3), (33, 65), (32, 64), (63, 31), (64, 129))
        for psf, radius in ((Psf(), 5.5), (Psf(), 12.5), (SMOOTH, 3.0))
    ),
    *((Psf(), 2.5, (rows, columns, 1)) for rows, columns in ((3, 1100), (270, 5))),
    *((psf, radius, (20, 40, channels)) for psf, radius in ((Psf(), 12.5), (SMOOTH, 2.5)) for channels in (1, 2, 16)),
]


@pytest.mark.parametrize(("psf", "radius", "shape"), FRAMES, ids=lambda value: getattr(value, "model", None))
def test_frames_are_exact(session: Session, psf: Psf, radius: float, shape: tuple[int, int, int]) -> None:
    light = lit(psf, radius, shape)
    expected = convolve(point_spread(psf), light.astype(np.float32).astype(np.float64), radius, guard_of(psf, radius))
    error = Convolver(session, psf, light, radius)() - expected
    assert np.sqrt(np.mean(error**2)) < RMS
    assert np.abs(error).max() < LARGEST


@pytest.mark.parametrize("radius", [4.3, 17.7])
@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_a_lamp_lights_its_disc_only(session: Session, psf: Psf, radius: float) -> None:
    """Light of 1e4 white: nothing of it where the PSF has no weight, and no error there; never less than nothing."""
    light, guard, far = lit(psf, radius, (90, 130, 1)), guard_of(psf, radius), point_spread(psf).reach(radius)
    lamp = np.zeros_like(light)
    lamp[guard + 40, guard + 60] = 1e4
    at_most = 1e4 * np.abs(convolve(point_spread(psf), lamp / 1e4, radius, guard))
    rows, columns = np.indices((90, 130))
    away = np.maximum(abs(rows - 40), abs(columns - 60)) > far
    assert away.any()
    alone = Convolver(session, psf, lamp, radius, 1e4)()
    assert (alone[away] == 0).all()
    assert (alone >= 0).all()
    np.testing.assert_allclose(alone, at_most, rtol=1e-6, atol=1e-12)
    both = Convolver(session, psf, light + lamp, radius, 1e4)()
    expected = convolve(point_spread(psf), light, radius, guard)
    np.testing.assert_allclose(both[away], expected[away], atol=LARGEST)


def test_sums_of_either_width(session: Session) -> None:
    """Both find the same, but for what rounding of each pixel to a part of the brightest light leaves."""
    psf, radius = Psf(), 23.4
    light = lit(psf, radius, (50, 70, 1))
    expected = convolve(point_spread(psf), light.astype(np.float32).astype(np.float64), radius, guard_of(psf, radius))
    for brightest in (convolution.BRIGHTEST, 1e3 * convolution.BRIGHTEST):
        found = Convolver(session, psf, light, radius, brightest)
        assert found.blur.wide == (brightest > convolution.BRIGHTEST)
        error = np.abs(found() - expected)
        assert error.max() < 1e-7 * (4.0 if brightest == convolution.BRIGHTEST else 2.0)
    assert point_spread(psf).reach(radius) > SUMMED


@pytest.mark.parametrize("psf", [Psf(), SMOOTH], ids=name_of)
def test_dark_images(session: Session, psf: Psf) -> None:
    """Errors are relative to the brightest value of an image, if it is not black."""
    for brightest in (1e-9, 0.0):
        light = brightest * lit(psf, 13.3, (30, 40, 1))
        expected = convolve(point_spread(psf), light, 13.3, guard_of(psf, 13.3))
        found = Convolver(session, psf, light, 13.3, brightest)()
        np.testing.assert_allclose(found, expected, rtol=0, atol=LARGEST * brightest)


def test_no_sums_beyond_the_last_row(session: Session) -> None:
    """Vectors that end a row read there, so there is memory, but nobody writes to it."""
    psf, radius = Psf(), 13.3
    light = lit(psf, radius, (20, 41, 1))
    found = Convolver(session, psf, light, radius)
    found()
    assert found.blur.sums is not None
    sums = download(session, found.blur.sums, (light.size + SUMS_BEYOND,), np.uint32)
    assert sums[: light.size].any()
    assert not sums[light.size :].any()


@pytest.mark.parametrize("psf", [Psf(), SMOOTH], ids=name_of)
def test_same_bits_again_and_in_other_groups(session: Session, psf: Psf, monkeypatch: pytest.MonkeyPatch) -> None:
    found = Convolver(session, psf, lit(psf, 13.3, (70, 161, 2)), 13.3)
    first = found().tobytes()
    assert found().tobytes() == first

    def other(session: Any, kernel: Any, size: Any, usual: Any, *args: Any, **given: Any) -> Any:
        return launch(session, kernel, size, (3, 2, 1)[: len(usual)], *args, **given)

    monkeypatch.setattr("clsco.opencl.program.launch", other)
    assert found().tobytes() == first


def test_tables_outlive_their_launches(session: Session) -> None:
    """The host runs ahead of the device: 60 tables are made and dropped before the first one is read."""
    found = Convolver(session, Psf(), lit(Psf(), 15.0, (200, 300, 1)), 15.0)

    def last(wait: bool) -> Array:
        for radius in np.linspace(9.0, 15.0, 60).tolist():
            found.blur.add(Sources(None, found.value, radius=radius), [])
            if wait:
                session.queue.finish()
        return found.blur.plane([]).read(session)

    assert (last(False) == last(True)).all()
