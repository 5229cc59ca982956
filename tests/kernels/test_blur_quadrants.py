"""Columns of sources whose weights differ from tap to tap: where sums are kept, and in which order light is added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clsco.constants import BAND
from clsco.frame.strips import Grid
from clsco.opencl.program import build
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.passes.blur import FILES_OF, Target
from clsco.passes.frame_blur import make_blur
from clsco.passes.pack import grid_struct
from clsco.plan.methods import BlurSpec
from clsco.records import structs
from clsco.scene.model import Psf
from tests.kernels.sources import RNG, ROUNDING, assert_close, blurred, features, light, on_device


@pytest.mark.parametrize("model", ["pillbox", "gaussian"])
def test_columns_of_any_guard_band_have_the_same_bits(session: Session, model: str) -> None:
    """They begin at the same places of the frame, so light is added in the same order."""
    psf, shape, largest = Psf.model_validate({"model": model}), (20, 45), 14.0
    found = []
    for guard in (0, 5, 18):
        given = light(psf, shape=shape, guard=guard, largest=largest)
        assert features(psf, 1, 0, largest)["BY_COLUMNS"]
        frame = slice(guard, guard + shape[0]), slice(guard, guard + shape[1])
        size, rng = given.sources.lit.shape, RNG(51)
        lit, radius, radiance = np.zeros(size, dtype=bool), np.zeros(size), np.zeros((*size, 1))
        lit[frame] = True
        radius[frame] = rng.uniform(8.0, largest, shape)
        radiance[frame] = rng.random((*shape, 1))
        gradient = np.zeros((*size, 2))
        sources = replace(given.sources, lit=lit, radius=radius, radiance=radiance, gradient=gradient)
        found.append(blurred(session, replace(given, sources=sources), "gather"))
    assert np.ptp(found[0]) > 0.1
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


@pytest.mark.parametrize("tilt", [False, True])
def test_bright_light_that_reaches_all_that_is_kept(session: Session, tilt: bool) -> None:
    """The first rows of a band are lit, up to the widest tap above them: nothing of it is taken for that of another
    row."""
    given = light(Psf(tilt=tilt), shape=(BAND + 9, 7), guard=3, largest=26.0, smallest=20.0).constant(26.0)
    sources = replace(given.sources, radiance=np.where(given.sources.lit[..., None], 1e7, 0.0))
    given = replace(given, sources=sources)
    assert_close(blurred(session, given, "gather") / 1e7, blurred(session, given, "scatter") / 1e7, 2 * ROUNDING)


@pytest.mark.parametrize(("model", "edge"), [("pillbox", "area"), ("gaussian", "sampled")])
def test_a_last_column_of_one_tap(session: Session, model: str, edge: str) -> None:
    """The row of the source alone is lit there: once, not from above and from below."""
    psf = Psf.model_validate({"model": model, "edge": edge, "tilt": False})
    given = light(psf, shape=(23, 24), guard=9, largest=5.0)
    table = psf_table(point_spread(psf), given.smallest, given.largest)
    assert (table.outlines[:, 1:, 1] == 0).any()
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize("tilt", [False, True])
def test_a_device_without_doubles(session: Session, monkeypatch: pytest.MonkeyPatch, tilt: bool) -> None:
    """There are no sums over the ends of rows of one weight: all taps are added one by one."""
    given = light(Psf(tilt=tilt), shape=(BAND + 9, 24), guard=5, largest=14.0, steepest=0.05)
    expected = blurred(session, given, "scatter")
    monkeypatch.setattr(session, "device", replace(session.device, has_fp64=False))
    chosen = features(given.psf, 1, 0, given.largest)
    program = build(session, FILES_OF["gather"], chosen, structs("float"), "float")
    strip = grid_struct(*given.shape, given.guard, "float")
    spec = BlurSpec(point_spread(given.psf), "gather", given.smallest, given.largest, tilt=tilt)
    grid = Grid.whole(*given.shape, given.guard, 1)
    owner = make_blur(Target(session, program, "float"), spec, grid, strip)
    owner.clear()
    sources = on_device(session, given, 1.0)
    owner.add(sources, [])
    assert_close(owner.plane([]).read(session)[..., None], expected, ROUNDING)
