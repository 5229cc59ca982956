"""Sources that blur.cl takes many at a time, in frames of several tiles and amid other numbers: small sampled discs,
wide ones, and Gaussians."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.cli.check import compare
from clsco.constants import BAND, ROW_TILE
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.plan.buffers import band_scratch, column_bytes, margin, row_bytes
from clsco.records import flat
from clsco.reference.blur.blur import tilt_factor
from clsco.reference.common.geometry import tilt_slope
from clsco.scene.file import parse_scene
from clsco.scene.model import Psf
from tests.kernels.conftest import source_planes
from tests.kernels.launches import Amid
from tests.kernels.sources import FIGURE, ROUNDING, SMOOTH, Light, Signed, assert_close, blurred, gather, light, records

Array = NDArray[Any]
DISC = Psf(edge="sampled", tilt=False)
LEFT_ALONE = 7.0


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


def gathered(session: Session, given: Light, part_rows: int = 0, part: Amid | None = None) -> Array:
    """The frame (rows, columns, channels) after one work-item, of the first band; part_rows, part: of gather.cl.

    The grid's sources stand amid wide and bright ones. Nothing is written beyond the frame and the memory that the host
    gives to a work-item.
    """
    psf, (rows, columns) = given.psf, given.shape
    table = given.table()
    pad, pitch = margin(columns, given.guard, table.reach)
    source = source_planes(
        records(given, given.sources.radius, given.sources.gradient, given.sources.lit, False), psf.tilt, False
    )
    planes = Amid(session, source, float(source[0].max()))
    value = Amid(session, flat(given.sources.radiance, np.float32), 1.0)
    total = Signed(session, (given.channels, rows, pitch))
    kept = band_scratch(given.spread, True)
    if kept == "columns":
        size = column_bytes(given.spread, psf.tilt, given.channels, table.reach)
    else:
        size = row_bytes(psf.tilt, given.channels, table.reach)
    own = np.zeros((3, -(-size // 128) * 32), np.float32)  # that of three work-items, and the one in the middle runs
    memory = Amid(session, own, 0.0)
    begin = memory.buffer.offset + own[0].nbytes
    scratch = memory.all.get_sub_region(begin, own[0].nbytes)
    gather(
        session, given, 1, {}, source=planes, value=value, total=total, part_rows=part_rows, part=part or total,
        scratch=scratch, scratch_size=own[0].nbytes // 8,
    )  # fmt: skip
    assert memory.now().view(np.uint32).any(axis=1).tolist() == [False, True, False]
    return np.moveaxis(total.now()[..., pad : pad + columns], 0, -1)


@pytest.mark.parametrize(("shape", "guard"), [((9, 45), 3), ((3, ROW_TILE + 40), 9), ((5, ROW_TILE), 0)])
def test_small_discs_amid_others(session: Session, shape: tuple[int, int], guard: int) -> None:
    """Nothing comes from rows above and below the grid, nor goes to what is beyond the frame."""
    given = light(DISC, shape=shape, guard=guard, largest=7.4)
    assert_close(gathered(session, given), given.expected(), ROUNDING)


def summed(given: Light) -> Array:
    """The sum over all pairs of a source and a pixel (rows, columns, channels), of a Gaussian that is separable."""
    (rows, columns), sources = given.shape, given.sources
    y, x = np.argwhere(sources.lit).T - given.guard
    radius = np.abs(sources.radius[sources.lit])
    down: Array = np.arange(rows)[:, None] - y
    right: Array = np.arange(columns)[:, None] - x
    along = [point_spread(given.psf).axis_weights(np.abs(offset).astype(float), radius) for offset in (down, right)]
    share = along[0][:, None] * along[1]
    if given.psf.tilt:
        slope = tilt_slope(sources.gradient[sources.lit], sources.radius[sources.lit])
        share = share * tilt_factor(right, down[:, None], slope)
    return np.asarray(share @ sources.radiance[sources.lit])


@pytest.mark.parametrize(
    ("psf", "radius", "brightness", "shape"),
    [
        (SMOOTH.model_copy(update={"tilt": False}), 38.0, 1.0, (37, 45)),
        (SMOOTH.model_copy(update={"tilt": True}), 124.0, 1.0, (BAND, 20)),
        (SMOOTH.model_copy(update={"tilt": False}), 4600.0, 3e5, (9, 20)),
    ],
    ids=["as many as ITEMS_BYTES hold", "the least number", "each more than ITEMS_BYTES"],
)
def test_memory_of_wide_gaussians(
    session: Session, psf: Psf, radius: float, brightness: float, shape: tuple[int, int]
) -> None:
    """In their own memory, however much a source takes of it; relative to light of about 1."""
    given = light(psf, shape=shape, guard=3, largest=radius, smallest=0.97 * radius, steepest=0.5)
    sources = replace(given.sources, radiance=brightness * given.sources.radiance)
    given = replace(given, sources=sources)
    expected = summed(given)
    np.testing.assert_allclose(gathered(session, given), expected, rtol=2e-5)


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
    sources = light(DISC, shape=(side, width), guard=0, channels=2).sources
    size, there = np.full((side, width), 20.0), np.full((side, width), radius != 20.0)
    for row, place in enumerate(places):
        size[row, place], there[row, place] = radius, True
    sources = replace(sources, lit=there, radius=size * there, gradient=0 * sources.gradient)
    given = Light(DISC, sources, (side, width), 0, 0.0, 45.0)
    assert band_scratch(point_spread(DISC), True) == "rows"
    beside, pitch = margin(width, 0, 45)
    part = np.zeros((2, BAND, pitch), np.float32)
    part[..., : beside - 45] = LEFT_ALONE
    held = Amid(session, part, LEFT_ALONE)
    assert_close(gathered(session, given, 1, held), given.expected(), ROUNDING)
    assert (held.now() == part).all() != alone


def test_subpixel_sources_of_the_first_slot(session: Session) -> None:
    """In pixels without a source of their own, of which all are."""
    given = light(Psf(), shape=(9, 11), guard=1, channels=3, samples=2)
    given = replace(given, sources=replace(given.sources, lit=np.zeros_like(given.sources.lit)))
    expected = given.expected()
    assert expected.max() > 0.1
    assert_close(blurred(session, given, "gather"), expected, FIGURE["area"])


def test_partly_hidden_sources_in_focus(session: Session) -> None:
    """All light of theirs that there is stays in their own pixels."""
    wanted = parse_scene(
        {
            "camera": {"resolution": [26, 18], "pixel_pitch": 0.2, "aperture_diameter": 24.0, "focus_distance": 250.0},
            "object": [
                {"shape": "sphere", "center": [-9.0, 4.0, 190.0], "radius": 12.0},
                {"shape": "plane", "distance": 250.0},
            ],
            "psf": {"edge": "sampled", "tilt": False, "silhouette_samples": 1},
        }
    )
    (exact,) = reference.render(wanted)
    (frame,) = clsco.render(wanted, precision="double", method="gather")
    assert frame.metadata["blur_method"] == "gather"
    assert [found for found in compare(frame, exact) if found.count] == []
