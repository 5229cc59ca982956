"""Progress of a frame by the time that its steps take."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from clsco.engine.renderer import _finished_share, _keep_pace
from clsco.opencl.session import Progress, Session
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.file import parse_scene

STILL = [True, False, False, False, False]


@pytest.mark.parametrize(
    ("still", "ends", "share"),
    [
        ([False] * 4, [5.0], 0.0),
        ([False] * 4, [5.0, 6.0], 0.25),
        ([False] * 4, [5.0, 6.0, 7.0, 8.0], 0.75),
        (STILL, [5.0, 13.0], 0.0),  # how long a time sample takes is not known yet
        (STILL, [5.0, 13.0, 15.0], 10.0 / 16.0),
        (STILL, [5.0, 13.0, 15.0, 17.0, 19.0], 14.0 / 16.0),
        (STILL * 2, [5.0, 13.0, 15.0, 17.0, 19.0, 21.0], 16.0 / 32.0),  # of two strips
    ],
)
def test_each_kind_of_step_counts_by_its_time(still: Sequence[bool], ends: Sequence[float], share: float) -> None:
    assert _finished_share(still[: len(ends) - 1], still, ends) == pytest.approx(share)


def test_what_stands_still_is_no_time_sample() -> None:
    progress, ends, shares = Progress(), list[float](), list[tuple[int, int, bool]]()
    for _ in STILL:
        _keep_pace([], progress, STILL, ends)
        shares.append((progress.done, progress.total, progress.finished > 0.0))
    assert shares == [(0, 4, False), (0, 4, False), (1, 4, True), (2, 4, True), (3, 4, True)]
    assert len(ends) == len(STILL)


def test_a_divided_frame_has_a_step_of_what_stands_still_and_its_time_samples(session: Session) -> None:
    from clsco.engine.renderer import Renderer, expose
    from clsco.plan.memory import limit_of

    ball = {"shape": "sphere", "center": [0, 0, 200], "radius": 1.0, "motion": {"velocity": [1.0, 0, 0]}}
    wall = {"shape": "rectangle", "center": [0, 0, 300], "size": [40.0, 40.0]}
    given = {"camera": {"resolution": [64, 48]}, "sequence": {"samples": 3}, "object": [ball, wall]}
    prepared = prepare(parse_scene(given), Request())
    assert prepared.plan.splits_still
    session.progress = progress = Progress()
    try:
        renderer = Renderer(session, prepared.plan, prepared, limit_of(None, session.device))
        expose([renderer], 0)
    finally:
        session.progress = None
    assert (progress.done, progress.total) == (2, 3)
    assert 0.0 < progress.finished < 1.0
