"""Splits of a data set: which one a sample, or a file, belongs to, whatever else there is."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.draws import Words, stream_words, unit
from clsco.data.manifest import CONFLICT, LOG, PARTS, UNSPLIT
from clsco.errors import SceneError
from clsco.scene.text import shown

Splits = tuple[tuple[str, float], ...]
SplitsLike = Mapping[str, float] | Sequence[tuple[str, float]] | str | None
MAX_SPLITS = 32
TAKEN = (PARTS, LOG, UNSPLIT, CONFLICT)  # by folders that sets have besides
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


def splits_of(given: SplitsLike) -> Splits:
    """Splits of any form that users may give.

    Parameters
    ----------
    given : str, mapping, sequence of pairs or None
        Names and shares, such as "train=0.9,val=0.05,test=0.05"; None or "": no splits.

    Raises
    ------
    SceneError
        Names must be able to name folders and differ, also without regard to case; shares must be positive and be 1 in
        all.
    """
    if not given:
        return ()
    pairs: list[tuple[Any, Any]]
    if isinstance(given, str):
        pairs = [_split_of(part) for part in given.split(",")]
    else:
        pairs = list(given.items() if isinstance(given, Mapping) else given)
    if len(pairs) > MAX_SPLITS:
        raise SceneError(f"split: must be at most {MAX_SPLITS} splits; got {len(pairs)}")
    messages, seen = [], set()
    for name, share in pairs:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            messages.append(f"split: a name must be 1 to 64 letters, digits, _ or -; got {shown(name)}")
        elif name.lower() in seen:
            messages.append(f"split: names must differ; got {shown(name)} twice")
        elif name in TAKEN:
            messages.append(f"split: names must be others than {', '.join(TAKEN)}; got {name}")
        else:
            seen.add(name.lower())
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0.0 < share <= 1.0:
            messages.append(f"split: a share must be between 0 and 1, 0 excluded; got {shown(share)}")
    if not messages and abs(math.fsum(share for _, share in pairs) - 1.0) > 1e-9:
        messages.append(f"split: shares must be 1 in all; got {math.fsum(share for _, share in pairs):.9g}")
    if messages:
        raise SceneError(messages)
    return tuple((name, float(share)) for name, share in pairs)


def _split_of(part: str) -> tuple[str, float]:
    """A split from NAME=SHARE."""
    name, _, share = part.partition("=")
    try:
        return name.strip(), float(share)
    except ValueError:
        raise SceneError(f"split: must be NAME=SHARE,..., like train=0.9,test=0.1; got {shown(part)}") from None


def positions(splits: Splits, place: NDArray[np.float64]) -> NDArray[np.int64]:
    """Positions of the splits in which numbers of [0, 1) fall, 0 where there are no splits."""
    ends = [math.fsum(share for _, share in splits[: k + 1]) for k in range(len(splits) - 1)]
    return np.searchsorted(ends, place, side="right")


def of_samples(splits: Splits, seed: int, numbers: Words) -> NDArray[np.int64]:
    """Position of the split of each sample, (n,): by a hash of seed and number alone."""
    if not splits:
        return np.zeros(len(numbers), np.int64)
    (words,) = stream_words(seed, numbers, ["split"], [1], attempt=0)
    return positions(splits, unit(words[:, 0]))


def of_files(splits: Splits, digests: Sequence[str]) -> NDArray[np.int64]:
    """Position of the split of each file, (n,): by its SHA-256 alone, so that copies are in one."""
    words = np.array([int(digest[:16], 16) for digest in digests], np.uint64)
    return positions(splits, unit(words))
