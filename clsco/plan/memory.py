"""Device memory: sizes of a plan's buffers, the memory limit, and strips whose buffers fit; independent of OpenCL."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import ceil
from typing import TypeVar

from clsco.constants import BAND
from clsco.errors import SceneError
from clsco.plan.buffers import Sizes, hit_buffers
from clsco.plan.device import UNKNOWN, DeviceFacts, ThisMachine
from clsco.plan.image import ImagePlan
from clsco.plan.plan import Plan
from clsco.resources import machine_bytes

P = TypeVar("P", Plan, ImagePlan)
_UNITS = {"": 1, "b": 1} | {f"{p}b": 1000**n for n, p in enumerate("kmgt", 1)}
_UNITS |= {f"{p}ib": 1024**n for n, p in enumerate("kmgt", 1)}


@dataclass(frozen=True)
class Limit:
    """Memory limit for a frame's buffers, in bytes.

    total: limit of all buffers together; buffer: limit of each buffer; set_by_user: True if the user set `total`, so
    that exceeding it is an error; views: number of views that share `total` on the device, 2 for a stereo pair.
    """

    total: int
    buffer: int
    set_by_user: bool
    views: int = 1


def parse_size(size: str | int, name: str = "memory") -> int:
    """Parse a size like 1.5GiB or 100000 into bytes. Raises SceneError for other text; name: key named in the error."""
    match = re.fullmatch(r"\s*(\d{1,15}(?:\.\d{1,15})?)\s*([a-z]{0,3})\s*", str(size).lower(), re.ASCII)
    bytes_of_unit = _UNITS.get(match[2]) if match else None
    parsed = int(float(match[1]) * bytes_of_unit) if match and bytes_of_unit else 0
    count = size if isinstance(size, int) else parsed
    if count < 1:
        raise SceneError(f"{name}: must be a size greater than 0, like 1.5GiB or 800MB; got {size}")
    return count


def limit_of(memory: str | int | None, device: DeviceFacts | None = None) -> Limit:
    """The memory limit: `memory`, or by default half of the memory of the device.

    For a device that uses the host's memory, such as a processor, the default is half of the free memory. memory: size
    as for `parse_size`, or None; device: by default the processor. Raises SceneError as `parse_size`.
    """
    facts = device or ThisMachine()
    total = min(facts.global_mem, machine_bytes(free=True)) if facts.unified_memory else facts.global_mem
    total = total if total == UNKNOWN else total // 2
    if memory is not None:
        total = parse_size(memory)
    return Limit(total, facts.max_alloc, memory is not None)


def buffer_bytes(plan: Plan | ImagePlan) -> Sizes:
    """Sizes by name of a plan's buffers on the device; those with "truth" in front exist only for ground truth."""
    return {name: size for step in plan.passes for name, size in step.buffers.items()}


def lens_bytes(plans: Sequence[Plan]) -> int:
    """Bytes of the buffers of lenses that are rendered together and share ray hits; plans: one plan for each lens."""
    hits = sum(hit_buffers(plans[0].grid, plans[0].mapped > 0).values())
    return sum(device_bytes(plan) - hits for plan in plans) + len(plans[0].groups) * hits


def device_bytes(plan: Plan | ImagePlan, views: int = 1) -> int:
    """Total of `buffer_bytes` for one view, or for `views` views that are on the device together."""
    return _sum(buffer_bytes(plan), views)


def _sum(sizes: Mapping[str, int], views: int) -> int:
    """Total size for several views; ground truth counts once, as the views compute it one after the other."""
    return sum(size * (1 if name.startswith("truth") else views) for name, size in sizes.items())


def fits(sizes: Mapping[str, int], limit: Limit) -> bool:
    """True if buffers of these sizes fit within the limit, for all views together."""
    return _sum(sizes, limit.views) <= limit.total and max(sizes.values(), default=0) <= limit.buffer


def fit_strips(plan: P, limit: Limit) -> P:
    """The plan in as few strips as fit within the limit, in one if possible. Raises the errors of `rows_that_fit`."""

    @cache  # passes are costly to list, and each plan caches its own
    def in_strips(rows: int) -> P:
        return plan if rows == plan.strip_rows else replace(plan, strip_rows=rows)

    return in_strips(rows_that_fit(plan.rows, limit, lambda rows: buffer_bytes(in_strips(rows)), plan.forward))


def rows_that_fit(rows: int, limit: Limit, sizes: Callable[[int], Mapping[str, int]], one_strip: bool = False) -> int:
    """Rows of the tallest strips that fit within the limit: all rows, or a multiple of BAND.

    rows: rows of the frame; sizes: returns the sizes of buffers for strips of a height; one_strip: True for a forward
    warp, which needs the whole frame. If even the smallest strips do not fit, returns their rows, but raises SceneError
    if the user set the limit that they exceed.
    """
    if fits(sizes(rows), limit):
        return rows
    least = rows if one_strip else min(BAND, rows)
    if not one_strip and fits(sizes(least), limit):
        more = range(2 * BAND, rows, BAND)
        return BAND * (1 + bisect_left(more, True, key=lambda tall: not fits(sizes(tall), limit)))
    needed = _sum(sizes(least), limit.views)
    if limit.set_by_user and needed > limit.total:
        why = "as the forward warp needs the whole frame" if one_strip else f"in strips of {least} rows"
        least_mib, limit_mib = ceil(needed / 2**20), f"{limit.total / 2**20:.4g} MiB"
        raise SceneError(f"memory: must be at least {least_mib} MiB for this frame, {why}; got {limit_mib}")
    return least
