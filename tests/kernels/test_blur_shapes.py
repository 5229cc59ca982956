"""Columns of sources with pupils of any shape: groups of both signs, runs, where sums are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clsco.constants import BAND
from clsco.opencl.session import Session
from clsco.scene.model import Psf
from tests.kernels.sources import RNG, ROUNDING, assert_close, blurred, features, light
from tests.kernels.test_blur_columns import gathered
from tests.kernels.test_pupils import APERTURES
from tests.slow import combined

SHAPES = ["pentagon", "narrow heart"]
GENTLE = 0.03  # px per px: no source is by itself


@pytest.mark.parametrize("name", SHAPES)
def test_columns_of_any_guard_band_have_the_same_bits(session: Session, name: str) -> None:
    """They begin at the same places of the frame, so light is added in the same order."""
    shape, largest, found = (20, 45), 14.0, []
    for guard in (0, 5, 18):
        given = light(Psf(), shape=shape, guard=guard, largest=largest, aperture=APERTURES[name])
        assert features(given.psf, 1, 0, largest, given.aperture)["BY_COLUMNS"]
        frame = slice(guard, guard + shape[0]), slice(guard, guard + shape[1])
        size, rng = given.sources.lit.shape, RNG(51)
        lit, radius, radiance = np.zeros(size, dtype=bool), np.zeros(size), np.zeros((*size, 1))
        lit[frame] = True
        radius[frame] = rng.uniform(-largest, largest, shape)
        radiance[frame] = rng.random((*shape, 1))
        sources = replace(given.sources, lit=lit, radius=radius, radiance=radiance, gradient=np.zeros((*size, 2)))
        found.append(blurred(session, replace(given, sources=sources), "gather"))
    assert np.ptp(found[0]) > 0.1
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


@pytest.mark.parametrize(
    ("name", "tilt"),
    combined(
        ["pentagon", "concave", "ellipse", "narrow heart"], [False, True],
        kept=[("pentagon", True), ("concave", True), ("narrow heart", False)],
    ),
)  # fmt: skip
def test_neighbors_of_both_signs_and_any_radius(session: Session, name: str, tilt: bool) -> None:
    """Narrow and wide ones lie in many intervals of the table, beside each other and below."""
    given = light(
        Psf(tilt=tilt), shape=(BAND + 9, 40), guard=9, largest=24.0, steepest=GENTLE, channels=1 + tilt,
        aperture=APERTURES[name],
    )  # fmt: skip
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize(("tilt", "radius"), combined([False, True], [26.0, -26.0], kept=[(True, 26.0)]))
def test_bright_light_that_reaches_all_that_is_kept(session: Session, tilt: bool, radius: float) -> None:
    """Runs leave nothing behind their ends, and rows beyond the band come to no other."""
    given = light(
        Psf(tilt=tilt), shape=(BAND + 9, 7), guard=3, largest=26.0, smallest=20.0, aperture=APERTURES["pentagon"]
    ).constant(radius)
    sources = replace(given.sources, radiance=np.where(given.sources.lit[..., None], 1e7, 0.0))
    given = replace(given, sources=sources)
    assert_close(blurred(session, given, "gather") / 1e7, given.expected() / 1e7, 1e-5)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("name", "tilt"), [("pentagon", True), ("narrow heart", False)])
def test_only_memory_of_its_own(session: Session, name: str, tilt: bool, channels: int) -> None:
    """Sources of a work-item stand amid wide and bright ones, and its scratch beside that of others."""
    given = light(
        Psf(tilt=tilt), shape=(9, 40), guard=6, largest=15.0, steepest=GENTLE, channels=channels,
        aperture=APERTURES[name],
    )  # fmt: skip
    assert_close(gathered(session, given), blurred(session, given, "scatter"), ROUNDING)
