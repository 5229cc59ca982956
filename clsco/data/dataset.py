"""The loader: a data set as a sequence of records."""

from __future__ import annotations

import os
import threading
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from itertools import accumulate
from typing import Any, overload

import numpy as np

from clsco.data.card import CARD
from clsco.data.containers import ShardReader, container_named
from clsco.data.draws import shuffled
from clsco.data.fields import SHORT
from clsco.data.manifest import files_by_split, files_of, parsed_part
from clsco.data.record import PICTURES, Record, is_named
from clsco.data.sets import open_set
from clsco.data.storage import Storage, checked_key, open_storage, remove_path
from clsco.errors import MissingDependencyError, SceneError
from clsco.files.atomic import raise_file_error
from clsco.frame.contact_sheet import contact_sheet, split_into_rows
from clsco.frame.notebook import html_to_show
from clsco.frame.outputs import ATTRIBUTES, FILE_NAMES
from clsco.frame.views import Picture
from clsco.scene.text import brief, meant

MOST_COPIES = 16  # local copies of shards of an object store at a time


class _Shards:
    """The shards of a set. Each is opened at its first use; a shard in an object store is copied to this machine first.

    Threads and processes may share the object.
    """

    def __init__(self, where: str, form: str, files: Sequence[tuple[str, int]]) -> None:
        self.where, self.form, self.files = where, form, tuple(files)
        self.ends = list(accumulate(count for _, count in files))
        self._begin()

    def _begin(self) -> None:
        self._process, self._lock = os.getpid(), threading.Lock()
        self._readers: OrderedDict[int, tuple[ShardReader, threading.Lock]] = OrderedDict()  # latest use last

    def __reduce__(self) -> tuple[type[_Shards], tuple[Any, ...]]:
        return _Shards, (self.where, self.form, self.files)

    def record(self, place: int, names: frozenset[str] | None) -> Record:
        number = bisect_right(self.ends, place)
        reader, lock = self._reader(number)
        with lock:
            return reader.record(place - self.ends[number] + self.files[number][1], names)

    def key(self, place: int) -> str:
        number = bisect_right(self.ends, place)
        return self._reader(number)[0].keys[place - self.ends[number] + self.files[number][1]]

    def _reader(self, number: int) -> tuple[ShardReader, threading.Lock]:
        if self._process != os.getpid():  # after a fork: the parent removes its own copies
            self._begin()
        with self._lock:
            storage = open_storage(self.where)
            if number not in self._readers:
                self._readers[number] = (self._opened(storage, *self.files[number]), threading.Lock())
            self._readers.move_to_end(number)
            if len(self._readers) > MOST_COPIES and not storage.is_local:
                oldest, lock = self._readers.popitem(last=False)[1]
                with lock:
                    remove_path(oldest.path)
            return self._readers[number]

    def _opened(self, storage: Storage, file: str, count: int) -> ShardReader:
        path = storage.local(file)
        reader = container_named(self.form).read(path)
        if len(reader) != count:
            raise_file_error(path, f"must hold {count} samples, as {CARD} says", len(reader))
        return reader

    def close(self) -> None:
        if not open_storage(self.where).is_local:
            for reader, _ in self._readers.values():
                remove_path(reader.path)
        self._begin()


class Dataset(Sequence[Record]):
    """The samples of a data set, or of a part of it, in the order of its shards.

    An index gives a `Record`; a slice gives another Dataset, a view. A Dataset can be pickled, and forked and spawned
    workers of a DataLoader can use it. Shards are opened when they are read.

    Attributes
    ----------
    card : mapping
        Content of dataset.json.

    Examples
    --------
    >>> import clsco.data
    >>> records = clsco.data.open("DATA")
    >>> len(records), len(records[:4]), records[0].key
    (9, 4, '000000000')
    """

    def __init__(
        self, card: dict[str, Any], shards: _Shards, names: frozenset[str] | None, span: Sequence[int],
        functions: tuple[Callable[[Any], Any], ...] = (),
    ) -> None:  # fmt: skip
        self.card = card
        self._shards, self._names, self._span, self._functions = shards, names, span, functions

    def __len__(self) -> int:
        return len(self._span)

    @overload
    def __getitem__(self, index: int) -> Record: ...
    @overload
    def __getitem__(self, index: slice) -> Dataset: ...
    def __getitem__(self, index: int | slice) -> Record | Dataset:
        """One record, or a view for a slice. Raises IndexError beyond the end, FileError if a shard is damaged."""
        if isinstance(index, slice):
            return self._view(span=self._span[index])
        if not -len(self) <= index < len(self):
            raise IndexError(f"index: must be below {len(self)}, the number of samples; got {index}")
        return self._record(self._span[index])

    def __iter__(self) -> Iterator[Record]:
        return (self._record(place) for place in self._span)

    def _record(self, place: int) -> Any:
        value: Any = self._shards.record(int(place), self._names)
        for function in self._functions:
            value = function(value)
        return value

    def _view(self, **other: Any) -> Dataset:
        own = {"span": self._span, "functions": self._functions}
        return Dataset(self.card, self._shards, self._names, **own | other)

    def map(self, function: Callable[[Any], Any]) -> Dataset:
        """A view that applies a function to each record when the record is read.

        Parameters
        ----------
        function : callable
            Takes a `Record`, or the result of the previous `map`. Spawned workers of a DataLoader must be able to
            import it.

        Returns
        -------
        Dataset

        Examples
        --------
        >>> import clsco.data
        >>> depths = clsco.data.open("DATA").map(lambda record: record["depth"])
        >>> depths[0].shape
        (9, 12)
        """
        return self._view(functions=(*self._functions, function))

    def shuffle(self, seed: int, epoch: int = 0) -> Dataset:
        """A view in a random order, which depends only on seed and epoch.

        The shards are in a random order, and so are the samples within each shard. Consecutive samples are therefore
        close together on disk.

        Parameters
        ----------
        seed : int
            0 to 2^64 - 1.
        epoch : int
            Number of the pass over the set, from 0.

        Returns
        -------
        Dataset

        Examples
        --------
        >>> import clsco.data
        >>> records = clsco.data.open("DATA").shuffle(seed=1)
        >>> sorted(record.key for record in records) == sorted(clsco.data.open("DATA").keys)
        True
        """
        span = np.asarray(self._span, np.int64)
        shard = np.searchsorted(self._shards.ends, span, side="right")
        order = shuffled(seed, "samples", len(span), epoch)
        rank = np.empty(len(self._shards.ends), np.int64)
        rank[shuffled(seed, "shards", len(rank), epoch)] = np.arange(len(rank))
        return self._view(span=span[order][np.argsort(rank[shard[order]], kind="stable")])

    def stacked(self) -> Dataset:
        """A view of records in which the variants of each array are stacked, as by `Record.stacked`.

        Returns
        -------
        Dataset

        Examples
        --------
        >>> import clsco.data
        >>> stack = clsco.data.open("STACKS").stacked()[0]  # of focal stacks of five
        >>> stack["color"].shape, stack["depth"].shape
        ((5, 9, 12, 3), (9, 12))
        """
        return self.map(Record.stacked)

    def to_torch(self) -> Dataset:
        """A view of dictionaries of PyTorch tensors.

        Returns
        -------
        Dataset
            Color images are linear float32 (3, rows, columns), gray images (1, rows, columns). Other arrays are
            float32, bool or int64, depending on their stored type; their components are the first axis, too.

        Raises
        ------
        MissingDependencyError
            PyTorch is not installed.

        Examples
        --------
        >>> import clsco.data
        >>> clsco.data.open("DATA").to_torch()[0]["color"].shape  # doctest: +SKIP
        torch.Size([3, 9, 12])
        """
        if find_spec("torch") is None:
            raise MissingDependencyError("to_torch: needs PyTorch: pip install torch; got no such module")
        return self.map(tensors_of)

    def __repr__(self) -> str:
        arrays = [name for name in self.card.get("arrays", ()) if is_named(name, self._names)]
        named = f": {', '.join(map(str, arrays))}" if arrays else ""
        named += f", functions: {len(self._functions)}" if self._functions else ""
        return f"<Dataset of {len(self)} samples, {self._shards.form}{named}>"

    def _repr_html_(self) -> str:
        """The text of `repr` and the images of the first samples, for notebooks."""
        pictures = [radiance for record in self._view(functions=())[:4] for radiance in record.pictures().values()]
        return html_to_show(repr(self), pictures[:8])

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of all samples; opens every shard."""
        return tuple(self._shards.key(place) for place in self._span)

    def close(self) -> None:
        """Close the shards of this data set and its views; they open again when they are read."""
        self._shards.close()


def tensors_of(record: Record) -> dict[str, Any]:
    """Arrays of a record as PyTorch tensors, see `Dataset.to_torch`."""
    torch = import_module("torch")
    tensors = {}
    for name, array in record.items():
        inner = array.ndim - bool(record.meta["arrays"][name].get("stacked"))
        if name.rpartition(".")[2] in PICTURES:
            array = record.radiance(name)
            array, inner = (array[..., None], 3) if inner == 2 else (array, inner)
        elif array.dtype.kind in "iu":
            array = array.astype(np.int64)
        elif array.dtype.kind == "f":
            array = array.astype(np.float32)
        tensors[name] = torch.from_numpy(np.ascontiguousarray(np.moveaxis(array, -1, -3) if inner == 3 else array))
    return tensors


def open(data: str | os.PathLike[str], split: str | None = None, arrays: Iterable[str] | None = None) -> Dataset:  # noqa: A001
    """Open a data set that `clsco dataset make` or `clsco dataset convert` made.

    Parameters
    ----------
    data : path
        Folder of the set, or an address like "s3://bucket/set", from which each shard is copied when it is read.
    split : str, optional
        Name of a split, such as "train"; by default all splits.
    arrays : iterable of str, optional
        Names of the arrays to read, such as ("color", "depth"); by default all.

    Returns
    -------
    Dataset

    Raises
    ------
    SceneError
        The set has no such split or array.
    FileError
        There is no data set, its card is damaged, or the extra that its format needs is missing.

    Notes
    -----
    Only the card is read: a set of 10^6 samples in 4,000 shards opens in 0.02 s. For an unfinished set, the manifest is
    read instead, and the data set has the samples of the finished shards.

    Examples
    --------
    >>> import clsco.data
    >>> clsco.data.open("DATA", "train", arrays=("color", "depth"))  # made by clsco dataset make -o DATA
    <Dataset of 7 samples, npz: color, depth>
    """
    storage = open_storage(data)
    data_set = open_set(storage)
    container_named(data_set.identity.format)
    listed = data_set.about.get("files")  # which the card of an unfinished set does not have
    if listed is None:
        listed = files_by_split(each for _, data in data_set.parts() for each in files_of(parsed_part(data), data))
    files = {split: [(checked_key(file), count) for file, count in each] for split, each in listed.items()}
    if split is not None and split not in files:
        raise SceneError(f"split: must be one of {brief(', '.join(files), SHORT)}; got {split}")
    chosen = [each for name, listed in files.items() if split in (None, name) for each in listed]
    names = None if arrays is None else frozenset(map(_in_files, [arrays] if isinstance(arrays, str) else arrays))
    if unknown := sorted(name for name in names or () if name.rpartition(".")[2] not in ATTRIBUTES):
        hint = meant(unknown[0], ATTRIBUTES)
        raise SceneError(f"arrays: must be some of {', '.join(ATTRIBUTES)}; got {unknown[0]}{hint}")
    by_number = sorted(chosen, key=lambda file: file[0].partition("/")[::-1])  # by shard number, then by split
    shards = _Shards(storage.where, data_set.identity.format, by_number)
    return Dataset({**data_set.about, "files": files}, shards, names, range(sum(count for _, count in chosen)))


def _in_files(name: str) -> str:
    """The name that an array has in files, such as "v01.coc" for "v01.blur_radius"."""
    prefix, dot, kind = name.rpartition(".")
    return f"{prefix}{dot}{FILE_NAMES.get(kind, kind)}"


TILE = 200  # px, the longer side of a picture


def _shrink(codes: Picture) -> Picture:
    """Shrink a picture to at most TILE px a side, by selecting the nearest pixels."""
    rows, columns = codes.shape[:2]
    scale = min(1.0, TILE / max(columns, rows))
    small = (max(1, round(rows * scale)), max(1, round(columns * scale)))
    row, column = ((np.arange(n) * m) // n for n, m in zip(small, (rows, columns), strict=True))
    return codes[row][:, column]


def record_sheet(records: Iterable[Record]) -> Picture:
    """Contact sheet of samples. Of a sample with several color images, it shows the first and the last of these; of any
    other sample, the first and the last image.
    """
    tiles = []
    for record in records:
        names = [name for name in record if name.rpartition(".")[2] in PICTURES]
        colors = [name for name in names if name.rpartition(".")[2] == "color"]
        names = colors if len(colors) > 1 else names
        pictures = [_shrink(record.image(name)) for name in dict.fromkeys([*names[:1], *names[-1:]])]
        pictures = pictures or [np.full((TILE // 2, TILE // 2, 3), 128, np.uint8)]
        height = max(len(picture) for picture in pictures)
        padded = [np.pad(each, ((0, height - len(each)), (0, 0), (0, 0))) for each in pictures]
        label = " ".join(filter(None, (record.key, str(record.meta.get("split") or ""))))
        tiles.append((np.concatenate(padded, axis=1), label))
    return contact_sheet(split_into_rows(tiles))
