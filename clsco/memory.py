"""Memory on the device: what the buffers of a plan take, how much there is, and the strips that fit; without OpenCL."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil

from clsco.errors import SceneError
from clsco.layout import WIDE_BYTES
from clsco.plan import Blur, Plan
from clsco.psf import LANES, SPANNED, table_bytes, table_reach
from clsco.scene import Psf
from clsco.strips import BAND

BANDS_PER_CORE = 4  # of `gather` at a time, where they need memory of their own
MOST_IN_ONE_SUM = 256  # taps of `gather` that a float adds up before it goes into another sum
# What a pixel of each output of ground_truth takes, in bytes; that of `sharp` per channel.
TRUTH_BYTES = {
    "object_id": 4, "depth": 4, "coc": 4, "normal": 12, "flow": 8, "hidden": 1, "sharp": 4, "disparity": 4,
    "occluded": 1,
}  # fmt: skip
_UNITS = {"": 1, "b": 1} | {f"{p}b": 1000**n for n, p in enumerate("kmgt", 1)}
_UNITS |= {f"{p}ib": 1024**n for n, p in enumerate("kmgt", 1)}


@dataclass(frozen=True)
class Limit:
    """What the buffers of a frame may take, in bytes.

    total: all of them; buffer: each of them; cores: compute units, which work at a time; given: by the user, who is
    told where nothing fits; views: that are on the device together and share `total`, as those of a stereo pair.
    """

    total: int
    buffer: int
    cores: int
    given: bool
    views: int = 1


def parse_size(size: str | int) -> int:
    """Bytes of a size like 1.5GiB, 800MB or 100000. Raises SceneError for what is none."""
    match = re.fullmatch(r"\s*(\d{1,15}(?:\.\d{1,15})?)\s*([a-z]{0,3})\s*", str(size).lower(), re.ASCII)
    bytes_of_unit = _UNITS.get(match[2]) if match else None
    found = int(float(match[1]) * bytes_of_unit) if match and bytes_of_unit else 0
    if found < 1:
        raise SceneError(f"memory: must be a size greater than 0, like 1.5GiB or 800MB; got {size}")
    return found


def free_bytes() -> int | None:
    """Memory of this machine that is free, in bytes; None where the system does not tell."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            told = dict(line.split(":", 1) for line in file)
        return int(told["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        names = getattr(os, "sysconf_names", {})
        known = {"SC_PHYS_PAGES", "SC_PAGE_SIZE"} <= set(names)
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if known else None


def limit_of(
    memory: str | int | None, on_device: int | None = None, buffer: int | None = None, cores: int | None = None,
    shared: bool = True,
) -> Limit:  # fmt: skip
    """The limit that a user gives, or half of what is free.

    memory: as `parse_size` takes it, or None. Of the device: on_device: its memory, buffer: its largest buffer, both
    in bytes, cores: its compute units, shared: it works in the machine's memory; by default the processor.
    Raises SceneError as `parse_size`.
    """
    units = cores or os.cpu_count() or 1
    there = [size for size in (on_device, free_bytes() if shared else None) if size is not None]
    total = min(there) // 2 if there else 2**62
    if memory is not None:
        total = parse_size(memory)
    return Limit(total, buffer or 2**62, units, memory is not None)


def bands_at_a_time(rows: int, cores: int) -> int:
    """Bands of a strip of so many rows that are worked on together where each needs memory of its own."""
    return min(ceil(rows / BAND), BANDS_PER_CORE * cores)


def spread_bytes(
    psf: Psf, method: Blur, channels: int, rows: int, columns: int, guard: int, reach: int, spans: bool, cores: int
) -> dict[str, int]:
    """Buffers of `clsco.spread.Spreader` besides its tables: total, and part, spans and sums where there are any.

    rows: of the tallest strip; reach: half-width of the table's largest weights, px; the others as for the Spreader.
    """
    pitch = ceil((columns + 2 * (guard + reach + LANES)) / LANES) * LANES
    sizes = {"total": 4 * channels * rows * pitch}
    if method == "gather" and (spans or (2 * reach + 1) ** 2 > MOST_IN_ONE_SUM):
        sizes["part"] = 4 * channels * bands_at_a_time(rows, cores) * BAND * pitch
        if spans:
            sizes["spans"] = (4 if psf.tilt else 2) * sizes["part"]
    if method == "scatter":
        sizes["sums"] = 8 * channels * rows * columns
    return sizes


def buffer_bytes(plan: Plan, cores: int) -> dict[str, int]:
    """Buffers on the device while a frame of a plan is made, in the strips that the plan has; on a device with fp64."""
    psf, channels, each = plan.scene.psf, plan.channels, plan.silhouettes**2
    rows, area = plan.strips[0].rows, plan.width * plan.tallest
    wide = WIDE_BYTES * bool(plan.features()["OCCLUDED"])
    textures = len({item.texture for item in plan.scene.objects})
    sizes = {"texture": 4 * channels * textures * plan.rows * plan.columns}
    sizes |= {"source": 16 * area, "value": 4 * channels * area, "depth": wide * area, "label": area * bool(each)}
    sizes |= {"pixels": 4 * plan.slots, "sub_source": 16 * each * plan.slots, "sub_depth": wide * each * plan.slots}
    sizes |= {"sub_value": 4 * channels * each * plan.slots}
    sizes |= _spread(plan, channels, rows, cores)
    ends = plan.smallest_blur, plan.largest_blur
    sizes["tables"] = table_bytes(psf, *ends) + (table_bytes(psf, *ends, plan.silhouettes) if each else 0)
    if plan.occlusion == "layered":
        sizes |= {"coc": WIDE_BYTES * area, "valid": area}
        sizes |= {f"slab {name}": size for name, size in _layer_bytes(plan, area, cores).items()}
    if plan.forward:
        sizes |= {f"warp {name}": size for name, size in _warp_bytes(plan, area).items()}
    if plan.truth:
        values = {name: TRUTH_BYTES[name] * (channels if name == "sharp" else 1) for name in TRUTH_BYTES}
        sizes |= {f"truth {name}": values[name] * rows * plan.columns for name in plan.truth if name in values}
        sizes["truth mask"] = rows * plan.columns
    return sizes


def _spread(plan: Plan, channels: int, rows: int, cores: int) -> dict[str, int]:
    psf, largest = plan.scene.psf, plan.largest_blur
    reach = max(table_reach(psf, largest), table_reach(psf, largest, True) if plan.silhouettes else 0)
    spans = plan.blur == "gather" and psf.model == "pillbox" and reach >= SPANNED[psf.edge]
    return spread_bytes(psf, plan.blur, channels, rows, plan.columns, plan.guard_px, reach, spans, cores)


def _layer_bytes(plan: Plan, area: int, cores: int) -> dict[str, int]:
    """Buffers of `clsco.layers.Layers`: planes of a slab and of where it is, its pyramid, and its own blur."""
    channels = plan.channels + 1  # with coverage
    planes = 16 + 4 + 4 + 4 * channels + WIDE_BYTES + 1
    sizes = {"planes": planes * area, "pyramid": 4 * (channels + 1) * area * 4 // 3}
    sizes |= {"covered": 4 * plan.rows * plan.columns}
    return sizes | _spread(plan, channels, plan.rows, cores)


def _warp_bytes(plan: Plan, area: int) -> dict[str, int]:
    """Buffers of `clsco.forward.ForwardWarp` and its filling."""
    scene, channels, pixels = plan.scene, plan.channels, plan.rows * plan.columns
    several, maps = len(scene.objects) > 1, sum(item.shape == "depth_map" for item in scene.objects)
    # value, w, coc, valid, status, two lists; a second set to smooth in; bounds of the far side, and objects
    planes = 4 * channels + 26 + (4 * channels + 12 if scene.fill.method == "mean_median" else 0)
    planes += 4 * (several or maps > 0) + several
    return {"planes": planes * area, "sources": (2 * WIDE_BYTES + several + WIDE_BYTES * maps) * pixels}


def hit_bytes(plan: Plan) -> int:
    """Planes of `clsco.renderer.Hits`, which lenses share."""
    return len(plan.layers) * (4 * plan.channels + WIDE_BYTES + 1) * plan.width * plan.height


def device_bytes(plan: Plan, cores: int) -> int:
    """All of `buffer_bytes`."""
    return sum(buffer_bytes(plan, cores).values())


def fitted(plan: Plan, limit: Limit) -> Plan:
    """The plan with as few strips as fit the limit: the whole frame where it does.

    Raises SceneError where nothing fits a limit that was given; else the least strips are taken, or the whole frame
    where a pass needs it.
    """

    def of(rows: int) -> Plan:
        return replace(plan, strip_rows=rows)

    def fits(rows: int) -> bool:
        sizes = buffer_bytes(of(rows), limit.cores).values()
        return sum(sizes) * limit.views <= limit.total and max(sizes) <= limit.buffer

    if fits(plan.rows):
        return of(0)
    whole = needs_whole(plan)
    if whole is None:
        return of(tallest_strip(plan.rows, fits) or _refused(of(min(BAND, plan.rows)), limit, "in strips of 64 rows"))
    _refused(of(plan.rows), limit, f"as {whole} needs the whole frame")
    return of(0)


def _refused(plan: Plan, limit: Limit, why: str) -> int:
    """Rows of the strips of a plan that does not fit; raises SceneError where the limit was given."""
    needed = limit.views * device_bytes(plan, limit.cores)
    if limit.given and needed > limit.total:
        raise SceneError(
            f"memory: must be at least {ceil(needed / 2**20)} MiB for this scene, {why}; got {limit.total / 2**20:.4g} MiB"
        )
    return plan.strip_rows


def needs_whole(plan: Plan) -> str | None:
    """The pass that cannot be done in strips, if there is one."""
    if plan.forward:
        return "the forward warp"
    return "layered occlusion" if plan.occlusion == "layered" else None


def tallest_strip(rows: int, fits: Callable[[int], bool]) -> int:
    """Most rows of a strip that fit, a multiple of BAND below `rows`; 0 where one band does not."""
    least, most = 0, (rows - 1) // BAND
    while least < most:
        middle = (least + most + 1) // 2
        least, most = (middle, most) if fits(middle * BAND) else (least, middle - 1)
    return least * BAND
