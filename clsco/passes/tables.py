"""Tables of PSF weights: made once, kept in the process by what they depend on, and their blocks on disk."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import replace
from functools import cache

from clsco import constants
from clsco.files.array_cache import ArrayCache, user_cache
from clsco.kept import Kept
from clsco.opencl.session import Session
from clsco.optics import polygon, psf_blocks, psf_grid
from clsco.optics import psf as psf_module
from clsco.optics.psf import shape_of
from clsco.optics.psf_blocks import WeightBlock, weight_block
from clsco.optics.psf_grid import block_intervals
from clsco.optics.psf_tables import PsfTable, narrowed, rounded_span, span_sizes, table_of
from clsco.plan.methods import BlurSpec
from clsco.resources import code_digest
from clsco.scene.model import Psf

KEPT_BYTES = 2**27  # of tables in this process, and as many of blocks
JOINED_BYTES = 2**25  # up to which a table grows by the radii of other renderings


class TableStore:
    """Tables of this process. Safe to share between threads.

    Parameters
    ----------
    disk : ArrayCache
        For blocks of weights.
    limit : int
        Most bytes of tables, and of blocks; those used longest ago go.
    """

    def __init__(self, disk: ArrayCache, limit: int = KEPT_BYTES) -> None:
        self.disk, self.blocks, self.limit = disk, Kept(limit), limit
        self._lock = threading.Lock()
        self._tables: OrderedDict[Hashable, PsfTable] = OrderedDict()

    def table(self, psf: Psf, smallest: float, largest: float, subpixel: int = 0) -> PsfTable:
        """`clsco.optics.psf_tables.psf_table`, with the arrays of an earlier one where these hold the range."""
        span = rounded_span(psf, smallest, largest, subpixel)
        shared = _is_whole(psf, span, subpixel)  # of other tables each range has one of its own
        key: Hashable = _key(psf, subpixel) if shared else (_key(psf, subpixel), span.start, span.stop)
        with self._lock:
            table = self._tables.get(key)
            if table is None or not _holds(table, span):
                wider = span if table is None else range(min(span.start, table.first), max(span.stop, _end(table)))
                if sum(span_sizes(psf, wider, subpixel).values()) <= JOINED_BYTES:
                    span = wider
                table = self._tables[key] = replace(
                    table_of(psf, span, subpixel, self.block), place=(_key(psf, subpixel), shared)
                )
            self._tables.move_to_end(key)
            while sum(map(_bytes, self._tables.values())) > self.limit and len(self._tables) > 1:
                self._tables.popitem(last=False)
        return narrowed(table, psf, smallest, largest, subpixel > 0)

    def block(self, psf: Psf, first: int, subpixel: int) -> WeightBlock:
        """A block of weights, from the process or the disk where it is there."""
        key = f"{_code()} {_key(psf, subpixel)} {first}"
        return self.blocks.get(key, lambda: self._block(key, psf, first, subpixel), lambda block: block.nbytes)

    def _block(self, key: str, psf: Psf, first: int, subpixel: int) -> WeightBlock:
        found = self.disk.get(key)
        if found is not None and found.keys() == WeightBlock.__dataclass_fields__.keys():
            return WeightBlock(**found)
        block = weight_block(psf, first, subpixel)
        self.disk.put(key, vars(block))
        return block

    def clear(self, blocks: bool = True) -> None:
        """Forget all tables, and the blocks that are not on disk as well."""
        with self._lock:
            self._tables.clear()
            if blocks:
                self.blocks.clear()


@cache
def _code() -> str:
    """What decides what blocks contain, besides their PSF."""
    return code_digest(constants, polygon, psf_module, psf_blocks, psf_grid)


@cache
def shared_tables() -> TableStore:
    """The tables of this process, with blocks in the user's cache where nobody else can write to it."""
    return TableStore(user_cache("tables"))


def tables_of(spec: BlurSpec) -> tuple[PsfTable, PsfTable | None]:
    """Tables of weights of pixels and, where there are such, of sub-pixel sources."""
    store, ends = shared_tables(), (spec.smallest, spec.largest)
    return store.table(spec.psf, *ends), store.table(spec.psf, *ends, spec.subpixels) if spec.subpixels else None


def forget_others(session: Session) -> None:
    """Let go of what earlier calls have left on the device, before one whose memory is limited: tables are then those
    that it has planned."""
    session.kept.clear()
    shared_tables().clear(blocks=False)


def _key(psf: Psf, subpixel: int) -> str:
    """All that the weights depend on but the radius."""
    parts = [psf.model, psf.edge, str(subpixel)]
    if psf.model == "gaussian":
        parts += [repr(psf.sigma_ratio), repr(psf.truncation), str(psf.silhouette_samples)]
    if shape_of(psf).signed:
        parts.append(repr(psf.aperture))
    return " ".join(parts)


def _end(table: PsfTable) -> int:
    return table.first + table.count


def _holds(table: PsfTable, span: range) -> bool:
    return table.first <= span.start and span.stop <= _end(table)


def _is_whole(psf: Psf, span: range, subpixel: int) -> bool:
    """Whether a span has whole blocks, as tables do that serve several ranges."""
    if shape_of(psf).kind == "disc" and not subpixel:
        return False
    size = block_intervals(psf, subpixel > 0)
    return span.start % size == span.stop % size == 0


def _bytes(table: PsfTable) -> int:
    return sum(array.nbytes for array in (table.intervals, table.coefficients, table.taps, table.outlines))
