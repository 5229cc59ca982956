"""Columns of sources: groups of both signs, runs, where sums are kept, and in which order light is added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clsco.constants import BAND
from clsco.frame.strips import Grid
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.passes.blur import FILES_OF
from clsco.passes.frame_blur import make_blur
from clsco.passes.pack import grid_struct
from clsco.plan.methods import BlurSpec
from clsco.scene.model import Aperture, Psf
from tests.kernels import sources as light_sources
from tests.kernels.sources import RNG, ROUNDING, assert_close, blur_of, blurred, features, light, on_device
from tests.kernels.test_pupils import APERTURES
from tests.slow import combined

OPENINGS = {"circle": Aperture()} | APERTURES
DISCS = Psf(edge="sampled", tilt=False)
GENTLE = 0.03  # px per px: no source is by itself


@pytest.mark.parametrize(
    ("psf", "name"), [(Psf(), "circle"), (DISCS, "circle"), (Psf(model="gaussian"), "circle"), (Psf(), "pentagon")]
)
def test_columns_of_any_guard_band_have_the_same_bits(session: Session, psf: Psf, name: str) -> None:
    """They begin at the same places of the frame, so light is added in the same order."""
    shape, largest, images = (20, 45), 14.0, []
    for guard in (0, 5, 18):
        given = light(psf, shape=shape, guard=guard, largest=largest, aperture=OPENINGS[name])
        assert features(psf, 1, 0, largest, given.aperture)["BY_COLUMNS"]
        frame = slice(guard, guard + shape[0]), slice(guard, guard + shape[1])
        size, rng = given.sources.lit.shape, RNG(51)
        lit, radius, radiance = np.zeros(size, dtype=bool), np.zeros(size), np.zeros((*size, 1))
        lit[frame] = True
        radius[frame] = rng.choice([-1, 1], shape) * rng.uniform(6.0, largest, shape)
        radiance[frame] = rng.random((*shape, 1))
        sources = replace(given.sources, lit=lit, radius=radius, radiance=radiance, gradient=np.zeros((*size, 2)))
        images.append(blurred(session, replace(given, sources=sources), "gather"))
    assert np.ptp(images[0]) > 0.1
    for other in images[1:]:
        np.testing.assert_array_equal(other, images[0])


@pytest.mark.parametrize(
    ("name", "tilt", "radius"),
    combined(
        ["circle", "pentagon"], [False, True], [26.0, -26.0], kept=[("circle", False, 26.0), ("pentagon", True, 26.0)]
    ),
)
def test_bright_light_that_reaches_all_that_is_kept(session: Session, name: str, tilt: bool, radius: float) -> None:
    """The first rows of a band are lit, up to the widest tap above them: nothing of it is taken for that of another
    row, and runs leave nothing behind their ends."""
    given = light(
        Psf(tilt=tilt), shape=(BAND + 9, 7), guard=3, largest=26.0, smallest=20.0, aperture=OPENINGS[name]
    ).constant(radius)
    sources = replace(given.sources, radiance=np.where(given.sources.lit[..., None], 1e7, 0.0))
    given = replace(given, sources=sources)
    assert_close(blurred(session, given, "gather") / 1e7, blurred(session, given, "scatter") / 1e7, 2 * ROUNDING)


@pytest.mark.parametrize(
    ("name", "tilt"),
    combined(
        ["pentagon", "concave", "ellipse", "narrow heart"], [False, True],
        kept=[("pentagon", True), ("narrow heart", False)],
    ),
)  # fmt: skip
def test_neighbors_of_both_signs_and_any_radius(session: Session, name: str, tilt: bool) -> None:
    """Narrow and wide ones lie in many intervals of the table, beside each other and below."""
    given = light(
        Psf(tilt=tilt), shape=(BAND + 9, 40), guard=9, largest=24.0, steepest=GENTLE, aperture=APERTURES[name],
    )  # fmt: skip
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize(
    ("name", "psf", "channels"), [("pentagon", Psf(), 3), ("narrow heart", Psf(tilt=False), 1), ("circle", DISCS, 1)]
)
def test_only_memory_of_its_own(session: Session, name: str, psf: Psf, channels: int) -> None:
    """Sources of a work-item stand amid wide and bright ones, and its scratch beside that of others."""
    given = light(
        psf, shape=(9, 40), guard=6, largest=15.0, steepest=GENTLE, channels=channels, aperture=OPENINGS[name]
    )
    assert_close(light_sources.gather_alone(session, given), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize(("model", "edge"), [("pillbox", "area"), ("gaussian", "sampled")])
def test_a_last_column_of_one_tap(session: Session, model: str, edge: str) -> None:
    """The row of the source alone is lit there: once, not from above and from below."""
    psf = Psf.model_validate({"model": model, "edge": edge, "tilt": False})
    given = light(psf, shape=(23, 24), guard=9, largest=5.0)
    table = psf_table(point_spread(psf), given.smallest, given.largest)
    assert (table.outlines[:, 1:, 1] == 0).any()
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


def test_sampled_discs_in_focus_beside_wide_ones(session: Session) -> None:
    given = light(DISCS, shape=(9, 30), guard=3, largest=21.0)
    rows, _ = np.indices(given.sources.lit.shape)
    radius = np.where(given.sources.lit & (rows % 3 > 0), 20.0, 0.0)
    given = replace(given, sources=replace(given.sources, radius=radius))
    assert_close(blurred(session, given, "gather"), given.expected(), ROUNDING)


def test_nothing_is_added_behind_the_last_row(session: Session) -> None:
    """Not even 0, which would be lost light where another work-item adds to the same place."""
    given = light(DISCS, shape=(1, 301), guard=5, largest=21.0)
    owner = blur_of(session, given, "gather")
    total = light_sources.Signed(session, (1, owner.pitch))
    owner.total = total.buffer
    sources = on_device(session, given, 1.0)  # kept until the device is done
    owner.add(replace(sources, radius=given.largest), [])
    row = total.now()[:, owner.pad : owner.pad + given.shape[1]]
    assert_close(row[..., None], given.expected(), ROUNDING)


def test_shorter_vectors_change_no_bit(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device's registers decide how many sums of Gaussians go together; the result does not depend on it."""
    given = light(Psf(model="gaussian"), shape=(20, 139), guard=5, largest=21.0, steepest=0.05)
    images = []
    for width in (4, session.device.vector_width):
        monkeypatch.setattr(session, "device", replace(session.device, vector_width=width))
        images.append(blurred(session, given, "gather"))
    np.testing.assert_array_equal(images[1], images[0])
    assert_close(images[0], blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize(
    ("name", "tilt"), combined(["circle", "pentagon"], [False, True], kept=[("circle", True), ("pentagon", True)])
)
def test_a_device_without_doubles(session: Session, monkeypatch: pytest.MonkeyPatch, name: str, tilt: bool) -> None:
    """There are no sums over the ends of rows of one weight: all taps are added one by one."""
    given = light(Psf(tilt=tilt), shape=(BAND + 9, 24), guard=5, largest=14.0, steepest=GENTLE, aperture=OPENINGS[name])
    expected = blurred(session, given, "scatter")
    monkeypatch.setattr(session, "device", replace(session.device, has_fp64=False))
    chosen = features(given.psf, 1, 0, given.largest, given.aperture)
    target = Target(session, FILES_OF["gather"], chosen, "float")
    strip = grid_struct(*given.shape, given.guard, "float")
    spec = BlurSpec(given.spread, "gather", given.smallest, given.largest, tilt=tilt)
    grid = Grid.whole(*given.shape, given.guard, 1)
    owner = make_blur(target, spec, grid, strip)
    owner.clear()
    sources = on_device(session, given, 1.0)
    owner.add(sources, [])
    assert_close(owner.plane([]).read(session)[..., None], expected, ROUNDING)
