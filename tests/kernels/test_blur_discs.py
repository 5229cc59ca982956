"""Rows of sampled discs, small and wide: where their tiles, segments and vectors begin and end, and single ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import BAND, ROW_TILE
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.plan.buffers import band_scratch, margin
from clsco.scene.model import Psf
from tests.kernels.launches import Amid
from tests.kernels.sources import (
    ROUNDING,
    Light,
    Signed,
    assert_close,
    blur_of,
    blurred,
    features,
    gather_alone,
    light,
    on_device,
)

Array = NDArray[Any]
LEFT_ALONE = 7.0
BOUND_COLUMNS = 64  # columns, as in discs.clh
DISCS = Psf(edge="sampled", tilt=False)


def discs(shape: tuple[int, int], guard: int, largest: float, channels: int = 1) -> Light:
    """Sources of which most are small; wide enough that their rows go by sums."""
    given = light(DISCS, shape=shape, guard=guard, largest=largest, channels=channels, steepest=0.1)
    assert features(DISCS, channels, 0, largest)["BY_ROWS"]
    return given


def with_radius(given: Light, radius: Array, lit: Array | None = None) -> Light:
    there = given.sources.lit if lit is None else lit
    return replace(given, sources=replace(given.sources, lit=there, radius=np.where(there, radius, 0.0)))


def test_color_and_coverage(session: Session) -> None:
    """Four channels, of which a segment has registers for one vector at a time."""
    given = discs((9, 2 * BOUND_COLUMNS + 11), 5, 21.0, 4)
    rows, columns = np.indices(given.sources.lit.shape)
    given = with_radius(given, np.asarray(14.0 + 0.1 * rows + 0.03 * columns))
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


def test_wide_frames_with_a_wide_guard_band(session: Session) -> None:
    """Each tile begins at its own columns of the grid, and lights nothing beyond the frame."""
    given = discs((3, ROW_TILE + 45), 40, 21.0)
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize("radius", [16, 17, 18, 19, 20, 21, 22, 23])
def test_a_source_just_so_far_from_a_segment(session: Session, radius: int) -> None:
    """On both sides it ends in the first and the last column of a segment, where nothing else is."""
    given = discs((3, 3 * BOUND_COLUMNS), 2, 24.0)
    sources = given.sources
    lit = np.zeros_like(sources.lit)
    for beside in (0, 4):  # one alone would not be taken with its row
        lit[3, 2 + BOUND_COLUMNS - radius - beside] = lit[3, 1 + 2 * BOUND_COLUMNS + radius + beside] = True
    sources = replace(sources, radiance=np.ones_like(sources.radiance))
    given = with_radius(replace(given, sources=sources), np.full(lit.shape, float(radius)), lit)
    found = blurred(session, given, "gather")
    assert found[1, BOUND_COLUMNS] > 0
    assert found[1, 2 * BOUND_COLUMNS - 1] > 0
    assert_close(found, given.expected(), ROUNDING)


def test_rows_in_focus(session: Session) -> None:
    """Exactly so, beside rows of wide discs."""
    given = discs((9, 30), 3, 21.0)
    rows, _ = np.indices(given.sources.lit.shape)
    given = with_radius(given, np.where(rows % 3 == 0, 0.0, 20.0))
    assert_close(blurred(session, given, "gather"), given.expected(), ROUNDING)


@pytest.mark.parametrize("largest", [2.0, 21.0])
def test_nothing_is_added_behind_the_last_row(session: Session, largest: float) -> None:
    """Not even 0, which would be lost light where another work-item adds to the same place."""
    given = light(DISCS, shape=(1, ROW_TILE + 45), guard=5, largest=largest)
    owner = blur_of(session, given, "gather")
    total = Signed(session, (1, owner.pitch))
    owner.total = total.buffer
    sources = on_device(session, given, 1.0)  # kept until the device is done
    owner.add(replace(sources, radius=largest), [])
    row = total.now()[:, owner.pad : owner.pad + given.shape[1]]
    assert_close(row[..., None], given.expected(), ROUNDING)


@pytest.mark.parametrize("psf", [DISCS, Psf(model="gaussian")], ids=["level discs", "gaussians"])
def test_shorter_vectors_change_no_bit(session: Session, monkeypatch: pytest.MonkeyPatch, psf: Psf) -> None:
    """The device's registers decide how many taps go together; the result does not depend on it."""
    given = light(psf, shape=(20, 2 * BOUND_COLUMNS + 11), guard=5, largest=21.0, steepest=0.05, channels=2)
    found = []
    for width in (4, 16):
        monkeypatch.setattr(session, "device", replace(session.device, vector_width=width))
        found.append(blurred(session, given, "gather"))
    np.testing.assert_array_equal(found[1], found[0])
    assert_close(found[0], blurred(session, given, "scatter"), ROUNDING)


def test_small_discs_in_several_tiles(session: Session) -> None:
    """Two whole tiles and a part of one, colors, any tilt; very bright sources where the second tile's row begins."""
    given = light(Psf(edge="sampled"), shape=(9, 2 * ROW_TILE + 45), guard=7, largest=7.4, steepest=1.0, channels=2)
    assert band_scratch(point_spread(given.psf), True) == "rows"
    radiance = given.sources.radiance.copy()
    radiance[:, ROW_TILE - 32 : ROW_TILE - 25] *= 1e5
    given = replace(given, sources=replace(given.sources, radiance=radiance))
    expected = given.expected()
    dim = expected < 2.0
    assert dim.mean() > 0.9
    found = blurred(session, given, "gather")
    assert_close(found[dim], expected[dim], 2 * ROUNDING)  # of sums of up to 2
    np.testing.assert_allclose(found[~dim], expected[~dim], rtol=2e-6)


@pytest.mark.parametrize(("shape", "guard"), [((9, 45), 3), ((3, ROW_TILE + 40), 9), ((5, ROW_TILE), 0)])
def test_small_discs_amid_others(session: Session, shape: tuple[int, int], guard: int) -> None:
    """Nothing comes from rows above and below the grid, nor goes to what is beyond the frame."""
    given = light(DISCS, shape=shape, guard=guard, largest=7.4)
    assert_close(gather_alone(session, given), given.expected(), ROUNDING)


# Of rows of sources: one disc in each at these places, amid others of 20 px; or 8 of 20 px and no others.
ANYWHERE, EIGHT = range(3, 61), [range(20 + k, 28 + k) for k in range(16)]


@pytest.mark.parametrize(
    ("radius", "places", "width", "alone"),
    [
        (20.0, EIGHT, 68, False),
        (39.5, ANYWHERE, 68, False),
        (44.0, [16], 68, True),
        (44.0, [48], 68, True),
        (44.0, [*range(16), *range(64, 68)], 68, False),
        (44.0, [*range(16), *range(64, 79)], 79, False),
    ],
    ids=["alike", "less than twice as wide", "wider", "wider, 4 px before the last", "at the ends", "close to the end"],
)
def test_discs_that_are_taken_one_by_one(
    session: Session, radius: float, places: list[range | int], width: int, alone: bool
) -> None:
    """Only those that are more than twice as wide as others 4 px away on both sides: it takes much longer.

    What is added one by one goes through `part`, all of it, whose columns beside the frame are looked at.
    """
    side = len(places)
    sources = light(DISCS, shape=(side, width), guard=0, channels=2).sources
    size, there = np.full((side, width), 20.0), np.full((side, width), radius != 20.0)
    for row, place in enumerate(places):
        size[row, place], there[row, place] = radius, True
    sources = replace(sources, lit=there, radius=size * there, gradient=0 * sources.gradient)
    given = Light(DISCS, sources, (side, width), 0, 0.0, 45.0)
    assert band_scratch(point_spread(DISCS), True) == "rows"
    beside, pitch = margin(width, 0, 45)
    part = np.zeros((2, BAND, pitch), np.float32)
    part[..., : beside - 45] = LEFT_ALONE
    held = Amid(session, part, LEFT_ALONE)
    assert_close(gather_alone(session, given, 1, held), given.expected(), ROUNDING)
    assert (held.now() == part).all() != alone
