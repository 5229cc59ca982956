"""Rows of sampled discs (discs.clh), where their tiles, segments and vectors begin and end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import ROW_TILE
from clsco.opencl.session import Session
from clsco.scene.model import Psf
from tests.kernels.sources import (
    ROUNDING,
    Light,
    Signed,
    assert_close,
    blur_of,
    blurred,
    features,
    light,
    on_device,
)

Array = NDArray[Any]
BOUND_COLUMNS = 64  # columns, as in discs.clh
DISCS = Psf(edge="sampled", tilt=False)


def discs(shape: tuple[int, int], guard: int, largest: float, channels: int = 1, tilt: bool = False) -> Light:
    """Sources of which most are small; wide enough that their rows go by sums."""
    psf = DISCS.model_copy(update={"tilt": tilt})
    given = light(psf, shape=shape, guard=guard, largest=largest, channels=channels, steepest=0.1)
    assert features(psf, channels, 0, largest)["BY_ROWS"]
    return given


def with_radius(given: Light, radius: Array, lit: Array | None = None) -> Light:
    there = given.sources.lit if lit is None else lit
    return replace(given, sources=replace(given.sources, lit=there, radius=np.where(there, radius, 0.0)))


@pytest.mark.parametrize("tilt", [False, True])
def test_color_and_coverage(session: Session, tilt: bool) -> None:
    """Four channels, of which a segment has registers for one vector at a time."""
    given = discs((9, 2 * BOUND_COLUMNS + 11), 5, 21.0, 4, tilt)
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


@pytest.mark.parametrize("tilt", [False, True])
@pytest.mark.parametrize("psf", [DISCS, Psf(model="gaussian")], ids=["discs", "gaussians"])
def test_shorter_vectors_change_no_bit(session: Session, monkeypatch: pytest.MonkeyPatch, psf: Psf, tilt: bool) -> None:
    """The device's registers decide how many taps go together; the result does not depend on it."""
    psf = psf.model_copy(update={"tilt": tilt})
    given = light(psf, shape=(20, 2 * BOUND_COLUMNS + 11), guard=5, largest=21.0, steepest=0.05, channels=2)
    found = []
    for width in (4, 16):
        monkeypatch.setattr(session, "device", replace(session.device, vector_width=width))
        found.append(blurred(session, given, "gather"))
    np.testing.assert_array_equal(found[1], found[0])
    assert_close(found[0], blurred(session, given, "scatter"), ROUNDING)
