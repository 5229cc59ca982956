"""Data sets made again by what their cards say, and compared."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from clsco.data.making import DistributionLike, Progress, make
from clsco.data.manifest import part_key
from clsco.data.sets import DataSet, open_set
from clsco.data.storage import open_storage
from clsco.errors import SceneError


def remake(
    data: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    distribution: DistributionLike | None = None,
    folder: str | os.PathLike[str] | None = None,
    devices: str | Sequence[str] = (),
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[str]:
    """Make a data set again by what its card says, and compare.

    Parameters
    ----------
    data : path
        Folder or address of the set, which is not changed.
    out : path, optional
        Folder or address of the new one; by default a temporary folder that is removed.
    distribution : path, mapping or callable, optional
        As for `clsco.data.make`; by default the one on the card. A set of a function needs the function, as code of a
        stranger's set is not run.
    folder : path, optional
        Folder in which the distribution file was, with its textures; by default the current one.
    devices, workers, progress
        As for `clsco.data.make`.

    Returns
    -------
    list of str
        A line for each difference; none where all bytes are the same.

    Raises
    ------
    SceneError
        A function made the set, and none is given; or as `clsco.data.make`.
    ImageError
        There is no set, or it is damaged.

    Examples
    --------
    >>> import clsco.data
    >>> clsco.data.remake("DATA")  # doctest: +SKIP
    []
    """
    with ExitStack() as stack:
        storage = open_storage(data)
        stack.callback(storage.close)
        there = open_set(storage)
        identity = there.identity
        made_by = there.about.get("distribution") if distribution is None else distribution
        if made_by is None:
            name = there.about.get("function", "none")
            raise SceneError(
                f"distribution: must be given for a set that a function made, as it is not run; got {name}"
            )
        target = stack.enter_context(tempfile.TemporaryDirectory()) if out is None else os.fspath(out)
        make(
            made_by, target, only=there.samples, seed=identity.seed, truth=[n for n in identity.arrays if n != "color"],
            color="color" in identity.arrays, types=dict(identity.types), splits=identity.splits or None,
            format=identity.format, shard_size=identity.shard_size, precision=identity.precision, devices=devices,
            workers=workers, folder=folder, license=str(there.about.get("license", "")), progress=progress,
            allow_failures=len(there.samples),
        )  # fmt: skip
        again = open_storage(target)
        stack.callback(again.close)
        return list(_differences(there, open_set(again)))


def _differences(there: DataSet, again: DataSet) -> Iterator[str]:
    yield from again.identity.differences(there.identity.record())
    for shard in there.shards:
        key = part_key(shard)
        old, new = there.storage.read(key), again.storage.read(key)
        if old is None:
            yield f"{key}: shard {shard} must be there; got none"
        elif old != new:
            yield from _of_samples(there, again, shard) or [f"{key}: must be what is made again; got other lines"]


def _of_samples(there: DataSet, again: DataSet, shard: int) -> list[str]:
    """Differences of the samples of a shard."""
    found = []
    old, new = (_lines(each, shard) for each in (there, again))
    for number in there.numbers(shard):
        one, two = old.get(number, {}), new.get(number, {})
        found += [
            f"sample {number}: {name} must be what is made again; got another"
            for name in sorted(one.keys() | two.keys())
            if one.get(name) != two.get(name)
        ]
    return found


def _lines(there: DataSet, shard: int) -> dict[int, dict[str, Any]]:
    """Digests of the arrays of each sample, or its error, by number."""
    rows, failures = there.lines(shard)
    return {row["number"]: row["arrays"] for row in rows} | {row["number"]: {"error": row["error"]} for row in failures}
