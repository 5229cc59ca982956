"""Caches of PSF weights: tables in the memory of the process; the blocks of which tables consist, also on disk."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any, TypeVar

import numpy as np

from clsco import constants
from clsco.cache import Cache
from clsco.files.array_cache import ArrayCache, user_cache
from clsco.opencl.pages import SMALLEST, is_in_pages, joined_in_pages, trim
from clsco.opencl.session import Session
from clsco.optics import point_spread, psf_blocks, psf_grid, pupils
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_blocks import WeightBlock, weight_block
from clsco.optics.psf_tables import PsfTable, narrow_table, rounded_span, span_sizes, table_of
from clsco.plan.methods import BlurSpec
from clsco.resources import code_digest

CACHE_BYTES = 2**27  # memory limit of tables in this process; the latest two tables stay even if they exceed it
BLOCK_BYTES = 2**25  # memory limit of blocks in this process
JOINED_BYTES = 2**24  # size up to which a table is extended to include the radii of other renderings
R = TypeVar("R", PsfTable, WeightBlock)


class TableStore:
    """PSF tables of this process, and their blocks of weights, which are also on `disk`. Threads may share a store.

    limit: memory limit of the tables in bytes; the least recently used tables are evicted, except the latest two.
    """

    def __init__(self, disk: ArrayCache, limit: int = CACHE_BYTES) -> None:
        self.disk, self.blocks, self.limit = disk, Cache(BLOCK_BYTES), limit
        self._lock = threading.Lock()
        self._tables: OrderedDict[Hashable, PsfTable] = OrderedDict()

    def table(
        self, psf: PointSpread, smallest: float, largest: float, subpixel: int = 0, go_on: Callable[[], object] = tuple
    ) -> PsfTable:
        """The table of `clsco.optics.psf_tables.psf_table`, cut from a cached table if that includes the radii.

        If the cached table of a PSF takes up to JOINED_BYTES, it is extended to include new radii. Of the larger tables
        of a PSF only the latest is cached, so that a series of renderings with wide blur does not fill the memory.
        go_on: called before each block is computed; may raise an error.
        """

        def block(psf: PointSpread, first: int, subpixel: int) -> WeightBlock:
            go_on()
            return self.block(psf, first, subpixel)

        span = rounded_span(psf, smallest, largest, subpixel)
        large = _size(psf, span, subpixel) > JOINED_BYTES
        place = _key(psf, subpixel), large
        # Each range of a sampled disc has its own table.
        key: Hashable = (place, span.start, span.stop) if psf.layout == "disc" and not subpixel else place
        with self._lock:
            table = self._tables.get(key)
            first, end = (table.first, table.first + table.count) if table else (span.start, span.start)
            if table is None or not first <= span.start <= span.stop <= end:
                wider = range(min(span.start, first), max(span.stop, end))
                if _size(psf, wider, subpixel) <= JOINED_BYTES:
                    span = wider
                built = table_of(psf, span, subpixel, block, joined_in_pages)
                table = self._tables[key] = _in_pages(replace(built, place=place))
                trim()  # memory that building the table used
            self._tables.move_to_end(key)
            # A rendering has two tables, for pixels and for sub-pixel sources, and neither must evict the other.
            while sum(map(_bytes, self._tables.values())) > self.limit and len(self._tables) > 2:
                self._tables.popitem(last=False)
        return narrow_table(table, psf, smallest, largest, subpixel > 0)

    def block(self, psf: PointSpread, first: int, subpixel: int) -> WeightBlock:
        """A block of weights, from the cache in memory or on disk, or computed if it is in neither."""
        key = f"{_code()} {_key(psf, subpixel)} {first}"
        return self.blocks.get(key, lambda: self._block(key, psf, first, subpixel), lambda block: block.nbytes)

    def _block(self, key: str, psf: PointSpread, first: int, subpixel: int) -> WeightBlock:
        arrays = self.disk.get(key)
        if arrays is not None and arrays.keys() == WeightBlock.__dataclass_fields__.keys():
            return WeightBlock(**arrays)
        block = weight_block(psf, first, subpixel)
        self.disk.put(key, vars(block))
        return _in_pages(block)

    def clear(self, blocks: bool = True) -> None:
        """Remove all tables and, with `blocks`, also the blocks in memory."""
        with self._lock:
            self._tables.clear()
            if blocks:
                self.blocks.clear()


@cache
def _code() -> str:
    """Digest of the code that computes blocks, so that other versions of the code do not use blocks of this one."""
    return code_digest(constants, point_spread, pupils, psf_blocks, psf_grid)


@cache
def shared_tables() -> TableStore:
    """The table store of this process; it caches blocks on disk only if no other user can write to the cache folder."""
    return TableStore(user_cache("tables"))


def tables_of(spec: BlurSpec, session: Session) -> tuple[PsfTable, PsfTable | None]:
    """Tables of weights for pixels, and for sub-pixel sources, None without such sources. Raises CanceledError."""

    def table(subpixel: int) -> PsfTable:
        return shared_tables().table(spec.psf, spec.smallest, spec.largest, subpixel, session.go_on)

    return table(0), table(spec.subpixels) if spec.subpixels else None


def forget_others(session: Session) -> None:
    """Release cached buffers of earlier calls, so that a call with a memory limit has only planned buffers."""
    session.cache.clear()
    shared_tables().clear(blocks=False)


def _key(psf: PointSpread, subpixel: int) -> str:
    """Cache key: everything that the weights depend on except the radius."""
    return f"{psf!r} {subpixel}"


@lru_cache(maxsize=256)
def _size(psf: PointSpread, span: range, subpixel: int) -> int:
    """Size of the table for a range of intervals, bytes."""
    return sum(span_sizes(psf, span, subpixel).values())


def _in_pages(record: R) -> R:
    """A copy of a table or block with large arrays in pages of their own, so that freeing them leaves no gaps."""
    arrays = {name: value for name, value in vars(record).items() if isinstance(value, np.ndarray)}
    large = {name: array for name, array in arrays.items() if array.nbytes >= SMALLEST and not is_in_pages(array)}
    placed: dict[str, Any] = {name: joined_in_pages([array]) for name, array in large.items()}
    return replace(record, **placed)


def _bytes(table: PsfTable) -> int:
    return sum(array.nbytes for array in (table.intervals, table.coefficients, table.taps, table.outlines))
