"""Pixels that get sub-pixels, by labels alone."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.frame.outputs import TRUTH_NAMES
from clsco.opencl.buffers import copied, download, empty
from clsco.opencl.program import build
from clsco.opencl.session import Program, Session
from clsco.passes.pack import grid_struct
from clsco.passes.trace import EMPTY_STATISTICS
from clsco.records import structs
from clsco.reference.trace import trace as twin
from clsco.scene.model import Sphere
from tests.kernels.launches import run
from tests.scenes import plan_of


def marks_program(session: Session) -> Program:
    plan = plan_of(Sphere(), size=(16, 16), truth=TRUTH_NAMES)
    features = plan.features() | {"SUBPIXELS": 2, "GATHER": 0}
    return build(session, ["trace/trace.cl"], features, structs("double"), "double")


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (4, 4), (5, 9), (8, 6)])
def test_a_change_of_label_anywhere(session: Session, shape: tuple[int, int]) -> None:
    """Borders, too: scenes have nothing but a guard band there."""
    program = marks_program(session)
    grid, area = grid_struct(*shape, 0, "double"), shape[0] * shape[1]
    for odd in range(area):
        label = np.full(shape, 3, np.uint8)
        label.flat[odd] = 130
        source, pixels = copied(session, np.full((4, area), -1.0, np.float32)), empty(session, 4 * area)
        statistics = copied(session, EMPTY_STATISTICS)
        given = {"grid": grid, "label": label, "source": source, "pixels": pixels, "statistics": statistics}
        run(session, program, "mark_silhouettes", shape[::-1], (64, 1), capacity=area, **given)
        count = download(session, statistics, EMPTY_STATISTICS.shape, np.int32)[2]
        marked = twin.mark_silhouettes(label)
        assert sorted(download(session, pixels, (area,), np.int32)[:count]) == np.flatnonzero(marked).tolist()


def test_no_pixel_beyond_the_grid(session: Session) -> None:
    """Work-groups reach beyond it, to labels that differ from all of its own."""
    rows, columns, spare = 8, 17, 64
    grid, area = grid_struct(rows, columns, 0, "double"), rows * columns
    label = np.full(area + spare, 3, np.uint8)
    label[area:] = 130
    statistics = copied(session, EMPTY_STATISTICS)
    pixels = copied(session, np.full(area + spare, -1, np.int32))
    source = copied(session, np.full(4 * (area + spare), -1.0, np.float32))
    given = {"grid": grid, "label": label, "source": source, "pixels": pixels, "statistics": statistics}
    run(session, marks_program(session), "mark_silhouettes", (columns, rows), (7, 5), capacity=area + spare, **given)
    assert download(session, statistics, EMPTY_STATISTICS.shape, np.int32).tolist() == EMPTY_STATISTICS.tolist()
    assert (download(session, pixels, (area + spare,), np.int32) == -1).all()
