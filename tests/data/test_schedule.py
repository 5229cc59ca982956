"""Samples that are left out where processes die, whatever order tasks end in."""

from __future__ import annotations

import random

import pytest

from clsco.data.pool import DIED, RETRIES, RETRIES_OF_ERROR, Schedule, ShardTask
from clsco.errors import ClscoError


def run(schedule: Schedule, deadly: set[int], rng: random.Random, cause: str | None = None) -> list[ShardTask]:
    """Do all tasks, several at a time; those with a deadly sample fail. The ones that made a shard."""
    made, running = [], list[ShardTask]()
    while not schedule.is_over:
        while schedule.waiting and len(running) < 3:
            running.append(schedule.waiting.popleft())
        task = running.pop(rng.randrange(len(running)))
        numbers = task.tried if task.tried is not None else schedule.samples[task.shard]
        if deadly & set(numbers) - {number for number, _ in task.failed}:
            schedule.died(task, cause)
            continue
        schedule.done(task)
        made += [task] if task.tried is None else []
    assert not running
    assert not schedule.waiting
    return made


@pytest.mark.parametrize("cause", [None, "sample: must be finite; got nan"])
def test_samples_that_end_their_process_are_found_and_the_rest_is_made(cause: str | None) -> None:
    for seed in range(50):
        rng = random.Random(seed)
        deadly = set(rng.sample(range(40), rng.randint(0, 5)))
        schedule = Schedule((k, range(8 * k, 8 * k + 8)) for k in range(5))
        made = run(schedule, deadly, rng, cause)
        assert sorted(task.shard for task in made) == list(range(5))
        failed = {number: text for task in made for number, text in task.failed}
        assert failed == dict.fromkeys(deadly, cause or DIED)


def test_a_process_that_dies_by_chance_costs_nothing() -> None:
    schedule = Schedule([(0, range(4))])
    for _ in range(RETRIES - 1):
        schedule.died(schedule.waiting.popleft())
    task = schedule.waiting.popleft()
    assert task == ShardTask(0)
    schedule.done(task)
    assert schedule.is_over


def test_an_error_is_believed_when_a_fresh_process_has_it_too() -> None:
    schedule = Schedule([(0, range(1))])
    schedule.died(schedule.waiting.popleft(), "device: must go on")
    task = schedule.waiting.popleft()
    assert task == ShardTask(0)  # as a whole again
    schedule.done(task)
    assert schedule.is_over


def test_a_shard_that_fails_though_its_samples_do_not_ends_the_run() -> None:
    schedule = Schedule([(7, range(4))])
    message = "shard 7: must be made, as each of its samples by itself was; got no room"
    for _ in range(RETRIES_OF_ERROR - 1 + 2 * RETRIES):  # it fails as a whole, and then all of its samples are made
        task = schedule.waiting.popleft()
        if task.tried is None:
            schedule.died(task, "no room")
        else:
            schedule.done(task)
    with pytest.raises(ClscoError, match=message):
        schedule.died(schedule.waiting.popleft(), "no room")
