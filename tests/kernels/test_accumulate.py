"""accumulate.cl: the weighted sum of planes, and that it adds nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clsco.frame.strips import Grid
from clsco.opencl.buffers import copied
from clsco.opencl.session import Session
from clsco.passes.accumulate import FrameSum
from clsco.passes.blur import Plane
from clsco.plan.buffers import sum_buffers
from tests.kernels.launches import Amid, run

RNG = np.random.default_rng


@pytest.mark.parametrize(("local", "begins"), [((8, 1), 0), ((3, 5), 0), ((8, 1), 1)])
def test_the_frame_without_what_is_around_it_is_added(session: Session, local: tuple[int, int], begins: int) -> None:
    """Work-groups that reach beyond it add nothing of the next channel's; the first plane is added to nothing."""
    plane = RNG(6).random((3, 15, 23), np.float32)
    weights, total = RNG(7).random(8, np.float32), RNG(8).random((3, 8, 17), np.float32)
    sums, lost = Amid(session, total, 5.0), Amid(session, np.full_like(total, begins), 7.0)
    total *= 1 - begins
    given: dict[str, Any] = {"rows": 8, "columns": 17, "channels": 3}
    given |= {"begins": begins, "apart": 15 * 23, "start": 2 * 23 + 3, "pitch": 23}
    target = FrameSum(session, sum_buffers(Grid.whole(8, 17, 0, 3))).target
    given |= {"plane": plane, "weights": weights, "top": 0, "height": 8, "sum": sums, "lost": lost}
    run(session, target, "accumulate", (17, 8), local, **given)
    part = weights[:, None] * plane[:, 2:10, 3:20]
    np.testing.assert_array_equal(sums.now(), total + part)
    np.testing.assert_array_equal(lost.now(), ((total + part) - total) - part)


@pytest.mark.parametrize("channels", [1, 3])
def test_many_planes_are_off_by_no_more_than_a_few(session: Session, channels: int) -> None:
    """Half a unit in the last place of each weight, and one of the sum: what 2000 roundings of a plain sum exceed."""
    rows, columns, samples = 6, 140, 2000
    found = FrameSum(session, sum_buffers(Grid.whole(rows, columns, 0, channels)))
    image = RNG(9).random((channels, rows, columns), np.float32)
    plane = Plane(copied(session, image), image.shape, rows, columns)
    ramp = RNG(10).random((samples, rows))
    ramp /= ramp.sum(axis=0)
    found.clear()
    plain, exact = np.zeros(image.shape, np.float32), np.zeros((rows, columns, channels))
    for weights in ramp:
        frame = found.add(plane, weights, [])
        plain += weights[:, None].astype(np.float32) * image
        exact = exact + weights[:, None, None] * np.moveaxis(image, 0, -1).astype(np.float64)
    error = np.abs(frame.read(session).reshape(exact.shape) - exact)
    assert error.max() < 1.2e-7 < 1e-6 < np.abs(np.moveaxis(plain, 0, -1) - exact).max()
    found.clear()
    again = found.add(plane, np.ones(rows), []).read(session)
    np.testing.assert_array_equal(again.reshape(exact.shape), np.moveaxis(image, 0, -1))


def test_planes_of_some_rows_are_added_to_these(session: Session) -> None:
    """The first one as well, which the frame has nothing before of."""
    rows, columns = 9, 20
    found = FrameSum(session, sum_buffers(Grid.whole(rows, columns, 0, 3)))
    total = np.zeros((rows, columns, 3))
    for _ in range(2):
        found.clear()
        total[...] = 0.0
        for top, count in ((2, 4), (0, 9), (5, 4)):
            image, weights = RNG(top).random((3, count, columns), np.float32), RNG(count).random(count)
            plane = Plane(copied(session, image), image.shape, count, columns)
            frame = found.add(plane, weights, [], top, rows)
            part = total[top : top + count]
            total[top : top + count] = part + weights[:, None, None] * np.moveaxis(image, 0, -1).astype(np.float64)
    np.testing.assert_allclose(frame.read(session), total, atol=3e-7)


@pytest.mark.parametrize("columns", [20, 67])
def test_weights_of_columns(session: Session, columns: int) -> None:
    rows = 3
    found = FrameSum(session, sum_buffers(Grid.whole(rows, columns, 0, 1)), by_columns=True)
    total = np.zeros((rows, columns, 1))
    for k in range(3):
        image, weights = RNG(k).random((1, rows, columns), np.float32), RNG(9 + k).random(columns)
        frame = found.add(Plane(copied(session, image), image.shape, rows, columns), weights, [])
        total = total + weights[:, None] * np.moveaxis(image, 0, -1).astype(np.float64)
    np.testing.assert_allclose(frame.read(session), total[..., 0], atol=3e-7)
