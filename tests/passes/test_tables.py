"""Tables of weights that are kept: the same bits whatever they were made for, from the process, the disk or anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.files.array_cache import ArrayCache
from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.psf_blocks import WeightBlock, weight_block
from clsco.optics.psf_tables import PsfTable, psf_table, table_sizes
from clsco.optics.pupils.image import image_pupil
from clsco.passes import tables
from clsco.passes.tables import TableStore
from clsco.scene.model import Aperture, Psf

PSFS = [
    *(
        point_spread(Psf(model=model, edge=edge))
        for model in ("pillbox", "gaussian")
        for edge in ("integrated", "area", "sampled")
    ),
    point_spread(Psf(), Aperture(shape="polygon", blades=6)),
    point_spread(Psf(), Aperture(shape="ring")),
    PointSpread(image_pupil(np.eye(6))),
]
DISC = point_spread(Psf())


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """First intervals of the blocks that are computed."""
    found: list[int] = []

    def counted(psf: PointSpread, first: int, subpixel: int = 0) -> WeightBlock:
        found.append(first)
        return weight_block(psf, first, subpixel)

    monkeypatch.setattr(tables, "weight_block", counted)
    return found


def weights_of(table: PsfTable, number: int, disc: bool) -> Any:
    """Coefficients of an interval; some of them, where it has many rows."""
    start, width = table.intervals[number - table.first]
    return width, table.coefficients[start : start + (1 if disc else 4 * (2 * width + 1))].tobytes()


@pytest.mark.parametrize("psf", PSFS, ids=lambda psf: psf.name)
@pytest.mark.parametrize("samples", [0, 2])
def test_tables_have_the_same_bits_whatever_came_before(tmp_path: Path, psf: PointSpread, samples: int) -> None:
    alone, disc = psf_table(psf, 1.1, 2.6, samples), psf.layout == "disc" and not samples
    store = TableStore(ArrayCache(tmp_path))
    for ends in ((0.0, 0.9), (2.0, 4.1), (1.1, 2.6)):
        table = store.table(psf, *ends, samples)
    again = TableStore(ArrayCache(tmp_path)).table(psf, 1.1, 2.6, samples)
    for other in (table, again):
        assert (other.low, other.end, other.reach) == (alone.low, alone.end, alone.reach)
        for number in range(alone.low, alone.end):
            assert weights_of(other, number, disc) == weights_of(alone, number, disc)


def test_no_table_is_made_for_a_range_that_is_there(tmp_path: Path, made: list[int]) -> None:
    store, psf = TableStore(ArrayCache(tmp_path)), DISC
    wide = store.table(psf, 0.0, 5.0)
    count = len(made)
    narrow = store.table(point_spread(Psf(tilt=False)), 0.3, 4.0)
    assert len(made) == count > 0
    assert narrow.coefficients is wide.coefficients
    assert narrow.reach < wide.reach
    wider = store.table(psf, 0.0, 9.0)
    assert len(made) > count
    assert len(set(made)) == len(made)  # only what was missing
    assert store.table(psf, 1.0, 2.0).coefficients is wider.coefficients


def test_blocks_come_from_the_disk(tmp_path: Path, made: list[int]) -> None:
    TableStore(ArrayCache(tmp_path)).table(DISC, 0.0, 3.0, 4)
    count = len(made)
    TableStore(ArrayCache(tmp_path)).table(DISC, 0.0, 3.0, 4)
    assert len(made) == count
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    TableStore(ArrayCache(tmp_path)).table(DISC, 0.0, 3.0, 4)
    assert len(made) == 2 * count


def test_tables_are_as_large_as_predicted_and_never_more_than_a_limit(tmp_path: Path) -> None:
    store = TableStore(ArrayCache(None), limit=2**21)
    for psf in PSFS:
        table = store.table(psf, 0.0, 3.0)
        sizes = {name: getattr(table, name).nbytes for name in ("intervals", "coefficients", "taps", "outlines")}
        assert sizes == table_sizes(psf, 0.0, 3.0)
    assert sum(tables._bytes(table) for table in store._tables.values()) <= 2**21
    assert np.isfinite(table.coefficients).all()


def test_the_two_tables_of_a_rendering_stay_whatever_they_take() -> None:
    store = TableStore(ArrayCache(None), limit=1)
    pixels, subpixels = ([store.table(DISC, 0.0, 3.0, samples) for samples in (0, 4)] for _ in range(2))
    for first, again in zip(pixels, subpixels, strict=True):
        assert np.shares_memory(first.coefficients, again.coefficients)
