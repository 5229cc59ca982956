"""Schedule of the tasks of a set: which are left, and what follows when one of them fails."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

from clsco.errors import ClscoError

RETRIES = 3
DIED = f"sample: must be made; got a process that ended, {RETRIES} times"


@dataclass(frozen=True)
class ShardTask:
    """A shard that is to be made, or some of its samples that are tried only.

    Attributes
    ----------
    shard : int
    tried : range or None
        Numbers of samples that are made and dropped; None to make the shard.
    failed : tuple of (int, str)
        Samples that are known to fail, with their messages.
    """

    shard: int
    tried: range | None = None
    failed: tuple[tuple[int, str], ...] = ()


class Schedule:
    """The tasks of a set.

    A shard whose process dies is made again, up to `RETRIES` times in all; then halves of its samples are tried, down
    to those that fail by themselves. The rest of the shard is made without them.

    Parameters
    ----------
    shards : iterable of (int, range)
        Numbers of the shards that are to be made, each with those of its samples.
    """

    def __init__(self, shards: Iterable[tuple[int, range]]) -> None:
        self.samples = dict(shards)
        self.waiting = deque(ShardTask(shard) for shard in self.samples)
        self._deaths: Counter[ShardTask] = Counter()
        self._trials: Counter[int] = Counter()  # of each shard, those that are waiting or under way
        self._rounds: Counter[int] = Counter()  # of trials of each shard
        self._failed: dict[int, dict[int, str]] = {}
        self._left = len(self.samples)

    @property
    def is_over(self) -> bool:
        """True if all shards are made."""
        return self._left == 0

    def done(self, task: ShardTask) -> None:
        """A task has ended well."""
        if task.tried is None:
            self._left -= 1
        else:
            self._after_trial(task.shard)

    def died(self, task: ShardTask, cause: str | None = None) -> None:
        """A task has failed.

        cause: what it raised; None where its process ended, so that it may succeed at the next time.

        Raises ClscoError for a shard that fails though each of its samples by itself does not.
        """
        self._deaths[task] += 1
        again = cause is None and self._deaths[task] < RETRIES
        if task.tried is None:
            numbers = self.samples[task.shard]
            if again:
                self.waiting.appendleft(task)
            elif self._rounds[task.shard] == RETRIES or not numbers:
                rule = "must be made, as each of its samples by itself was"
                raise ClscoError(f"shard {task.shard}: {rule}; got {cause or DIED}")
            else:
                self._rounds[task.shard] += 1
                self._failed.setdefault(task.shard, {})
                self._try(task.shard, numbers)
        elif len(task.tried) > 1:
            middle = task.tried.start + len(task.tried) // 2
            self._try(task.shard, range(task.tried.start, middle))
            self._try(task.shard, range(middle, task.tried.stop))
            self._after_trial(task.shard)
        elif again:
            self.waiting.appendleft(task)
        else:
            self._failed[task.shard][task.tried.start] = cause or DIED
            self._after_trial(task.shard)

    def _try(self, shard: int, numbers: range) -> None:
        self._trials[shard] += 1
        self.waiting.append(ShardTask(shard, numbers))

    def _after_trial(self, shard: int) -> None:
        self._trials[shard] -= 1
        if not self._trials[shard]:
            self.waiting.appendleft(ShardTask(shard, failed=tuple(sorted(self._failed[shard].items()))))
