"""Memory on the device: what the buffers of a plan take, how much there is, and the strips that fit; without OpenCL."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import ceil
from typing import Literal

import numpy as np

from clsco.errors import SceneError
from clsco.frame.strips import BAND, Strip, cut
from clsco.optics.multigrid import coarse_frame, coarse_psf, coarse_radii, plane_shape
from clsco.optics.psf import shape_of
from clsco.optics.psf_tables import TAP_LANES, WIDE_LANES, is_near, table_bytes, table_reach
from clsco.optics.slabs import levels_of, margin_of_slabs, most_deep
from clsco.optics.stencil import is_summed
from clsco.plan.approximation import METHODS, place_count
from clsco.plan.methods import Blur
from clsco.plan.plan import Plan
from clsco.records import WIDE_BYTES
from clsco.scene.model import Psf

Scratch = Literal["none", "columns", "rows", "near"]
ROW_TILE, ROW_WINDOW = (
    256,
    16,
)  # columns that `gather` makes at a time, and rows of small reach, as in kernels/blur/cpu/rows.clh
BANDS_PER_CORE = 4  # of `gather` at a time, where they need memory of their own
SUMS_BEYOND = 64  # sums of `convolve` beyond the last row that a vector there reads, and that are used for nothing
PAGE, BESIDE_PAGE = 64, 5  # vectors of 8 doubles in 4 KiB, and how far from a multiple of it rows should be long
ITEMS, ITEMS_BYTES, ITEM_BYTES, SIDE = (
    256,
    2**18,
    20,
    5,
)  # of columns, as in kernels/blur/cpu/many.clh and kernels/blur/cpu/gaussians.clh
MOST_IN_ONE_SUM = 256  # taps of `gather` that a float adds up before it goes into another sum
# Outputs that ground_truth writes, with what one pixel of each takes: dtype and components (0: the channels).
TRUTH_BUFFERS: dict[str, tuple[type[np.generic], int]] = {
    "object_id": (np.int32, 1),
    "depth": (np.float32, 1),
    "blur_radius": (np.float32, 1),
    "normal": (np.float32, 3),
    "flow": (np.float32, 2),
    "hidden": (np.uint8, 1),
    "sharp": (np.float32, 0),
    "disparity": (np.float32, 1),
    "occluded": (np.uint8, 1),
}
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
    of_text = int(float(match[1]) * bytes_of_unit) if match and bytes_of_unit else 0
    found = size if isinstance(size, int) else of_text
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


def band_scratch(psf: Psf, largest: float, fp64: bool) -> Scratch:
    """What `gather` keeps for each band of a frame with radii up to `largest` px: of sampled discs whole rows of them,
    of small reach ("near") or any ("rows"), and of others columns of them."""
    if is_near(psf, largest):
        return "near"
    if shape_of(psf).kind == "disc":
        return "rows" if fp64 else "none"
    return "none" if shape_of(psf).kind == "general" else "columns"


def source_bytes(sources: int, tilt: bool, marked: bool = False) -> int:
    """Planes of sources.clh for so many sources; marked: with sub-pixel sources, or something in their way."""
    return 4 * (1 + 2 * tilt + marked) * sources


def margin(columns: int, guard: int, far: int) -> tuple[int, int]:
    """Scratch columns on both sides of a row of the blurred frame, and the length of the row, in whole vectors.

    Not near a multiple of PAGE of them, and not an even number: what lies below each other in a few rows would have the
    same place in a processor's cache, and take up to four times as long (benchmarks/optimisation_log.md).
    """
    pad = ceil((guard + far + TAP_LANES) / TAP_LANES) * TAP_LANES
    vectors = ceil(columns / TAP_LANES) + 2 * pad // TAP_LANES | 1
    while not BESIDE_PAGE <= vectors % PAGE <= PAGE - BESIDE_PAGE:
        vectors += 2
    return pad, vectors * TAP_LANES


def row_bytes(psf: Psf, channels: int, far: int, near: bool) -> int:
    """Scratch of a work-item of `gather` for whole rows of sources, see rows.clh; a whole number of doubles."""
    beside = (far // TAP_LANES + 3) * TAP_LANES
    planes, width = (3 if psf.tilt else 1) * channels, ROW_TILE + 2 * beside
    if near:
        return 4 * (channels * ROW_WINDOW * ROW_TILE + width * (1 + planes))
    return 8 * channels * BAND * ROW_TILE + 4 * width * (1 + 3 * planes)


def column_bytes(psf: Psf, channels: int, far: int) -> int:
    """The same for columns of sources, see kernels/blur/cpu/columns.clh."""
    tiles, slopes = 8 * channels * BAND * (far // WIDE_LANES + 2 | 1) * WIDE_LANES, 2 * psf.tilt
    if shape_of(psf).kind == "separable":
        item = 4 * WIDE_LANES * (slopes + channels + far + 1 + WIDE_LANES)
        sums = 4 * WIDE_LANES * SIDE * BAND * (1 + psf.tilt)
        return sums + tiles + min(max(ITEMS_BYTES // item, 2 * WIDE_LANES), ITEMS) * (item + 8)
    ends, sums = (1 + slopes) * channels, (1 + psf.tilt) * channels
    items = ITEMS * (4 * WIDE_LANES * (2 + slopes + 2 * channels) + ITEM_BYTES)
    return 8 * WIDE_LANES * ends * (BAND + 1) + 4 * WIDE_LANES * sums * (BAND + 2 * far) + tiles + items


def spread_bytes(
    psf: Psf, method: Blur, channels: int, rows: int, columns: int, guard: int, far: int, kept: Scratch, cores: int
) -> dict[str, int]:
    """Buffers of `blur.Spreader` besides its tables: total, and part, scratch, sums, across where they are.

    rows: of the tallest strip; far: largest half-width in the tables, px; kept: see `band_scratch`; the others as for
    the Spreader.
    """
    _, pitch = margin(columns, guard, far)
    sizes = {"total": 4 * channels * rows * pitch}
    bands = 4 * channels * bands_at_a_time(rows, cores) * BAND * pitch
    if method == "gather" and (2 * far + 1) ** 2 > MOST_IN_ONE_SUM:
        sizes["part"] = bands
    if method == "gather" and kept != "none":
        each = column_bytes(psf, channels, far) if kept == "columns" else row_bytes(psf, channels, far, kept == "near")
        sizes["scratch"] = each * bands_at_a_time(rows, cores)
    if method == "scatter":
        sizes["sums"] = 8 * channels * rows * columns
    if method == "convolve" and is_summed(psf, far):
        sizes["sums"] = 8 * ((rows + 2 * guard) * (columns + 2 * guard) + SUMS_BEYOND)
    if method == "convolve" and shape_of(psf).kind == "separable":
        sizes["across"] = 4 * (rows + 2 * guard) * ceil(columns / 64) * 64
    return sizes


def _spreader(
    psf: Psf, method: Blur, channels: int, rows: int, columns: int, guard: int, ends: tuple[float, float],
    silhouettes: int, cores: int,
) -> dict[str, int]:  # fmt: skip
    """All buffers of a Spreader for radii between two ends, on a device with fp64."""
    far = max(table_reach(psf, ends[1]), table_reach(psf, ends[1], True) if silhouettes else 0)
    tables = table_bytes(psf, *ends) + (table_bytes(psf, *ends, silhouettes) if silhouettes else 0)
    kept = band_scratch(psf, ends[1], True)
    return {"tables": tables} | spread_bytes(psf, method, channels, rows, columns, guard, far, kept, cores)


def grid_bytes(channels: int, width: int, height: int, tilt: bool, finest: bool) -> dict[str, int]:
    """Buffers of a grid of `clsco.passes.multigrid.Coarse` besides those of its Spreader."""
    plane, area = 4 * int(np.prod(plane_shape(width, height))), width * height
    sizes = {"radius": plane, "tilt": 2 * plane * tilt, "moved": plane, "light": channels * plane}
    return sizes | {"kept": 4 * channels * area} | ({} if finest else {"source": source_bytes(area, tilt)})


def _coarse(
    psf: Psf, method: Blur, channels: int, rows: int, columns: int, guard: int, largest: float, least: float,
    tilt: bool, cores: int,
) -> dict[str, int]:  # fmt: skip
    """Buffers of `multigrid.Coarse` besides those of a Spreader: all its grids, and where its error is measured."""
    radii, count, found = coarse_radii(psf, largest, least), place_count(rows, columns), dict[str, int]()
    for level, radius in enumerate((largest, *radii) if radii else ()):
        sizes: dict[str, int] = {}
        if level:
            rows, columns, guard = coarse_frame(rows, columns, guard)
            sizes = _spreader(coarse_psf(psf), method, channels, rows, columns, guard, (least, radius), 0, cores)
        sizes |= grid_bytes(channels, columns + 2 * guard, rows + 2 * guard, tilt, level == 0)
        found |= {f"grid {level} {name}": size for name, size in sizes.items()}
    return found | {"places": (8 + 4 * channels) * count * bool(radii)}


def _layers(
    psf: Psf, method: Blur, channels: int, rows: int, columns: int, guard: int, height: int, largest: float, cores: int
) -> dict[str, int]:
    """Buffers of `clsco.passes.layered.Layers`: planes of a slab and of where it is, its pyramid, and its own blur.

    rows: of the tallest strip; height: of the tallest grid of one.
    """
    width, values = columns + 2 * guard, channels + 1  # with coverage
    area, planes = height * width, 4 + 4 + 4 * values + WIDE_BYTES + 1
    sizes = {"source": source_bytes(area, psf.tilt), "planes": planes * area, "covered": 4 * rows * columns}
    sizes["pyramid"] = pyramid_bytes(psf, channels, width, height, largest)
    sizes |= _spreader(psf, method, values, rows, columns, guard, (0.0, largest), 0, cores)
    return {f"slab {name}": size for name, size in sizes.items()}


def pyramid_bytes(psf: Psf, channels: int, width: int, height: int, largest: float) -> int:
    """Pyramid of `clsco.passes.layered.Layers` over a grid, for radii up to `largest` px."""
    planes = channels + 2  # radius, and how far it is known
    rows, columns, start = levels_of(height, width, most_deep(psf, largest), planes)[-1]
    return 4 * (start + planes * rows * columns)


def buffer_bytes(plan: Plan, cores: int) -> dict[str, int]:
    """Buffers on the device while a frame of a plan is made, in the strips that the plan has; on a device with fp64.

    cores: compute units of the device. Those of ground truth, "truth ...", are there only while it is made.
    """
    psf, channels, each = plan.scene.psf, plan.channels, plan.silhouettes**2
    rows, area, ends = plan.strips[0].rows, plan.width * plan.tallest, (plan.smallest_blur, plan.largest_blur)
    features = plan.features()
    wide = WIDE_BYTES * bool(features["OCCLUDED"])
    textures = len({item.texture for item in plan.scene.objects})
    sizes = {"texture": 4 * channels * textures * plan.rows * plan.columns * (not plan.still_map)}
    marked, layered = bool(each or features["OCCLUDED"]), plan.occlusion == "layered"
    sizes |= {"source": source_bytes(area, bool(features["TILT"]), marked) * (not layered)}
    sizes |= {"value": 4 * channels * area}
    sizes |= {"depth": wide * area, "label": area * bool(each)}
    sizes |= {"pixels": 4 * plan.slots, "sub_source": 16 * each * plan.slots, "sub_depth": wide * each * plan.slots}
    sizes |= {"sub_value": 4 * channels * each * plan.slots}
    blur = (psf, plan.blur, channels, rows, plan.columns, plan.guard_px)
    sizes |= _spreader(*blur, ends, plan.silhouettes, cores)
    if plan.approximations:  # the first one has the most grids
        least = METHODS[plan.approximations[0]]
        frame = (psf, plan.blur, channels, plan.rows, plan.columns, plan.guard_px)
        sizes |= _coarse(*frame, plan.largest_blur, least, plan.tilt, cores)
    if layered or plan.still_map:
        sizes |= {"coc": WIDE_BYTES * area, "valid": area}
    if layered:
        sizes |= _layers(*blur, plan.tallest, plan.largest_blur, cores)
    if plan.forward:
        sizes |= _warp(plan, area)
    maps = any(item.shape == "depth_map" for item in plan.scene.objects)
    if plan.truth and not maps:  # no ray is cast at a depth map
        values = {name: np.dtype(kind).itemsize * (n or channels) for name, (kind, n) in TRUTH_BUFFERS.items()}
        values |= {"mask": 1} | ({"sharp": 0} if plan.forward else {})
        wanted = {"mask", *plan.truth} & set(values)
        sizes |= {f"truth {name}": values[name] * rows * plan.columns for name in wanted}
    return sizes


def _warp(plan: Plan, area: int) -> dict[str, int]:
    """Buffers of `clsco.passes.warp.ForwardWarp` and its filling."""
    scene, channels, pixels = plan.scene, plan.channels, plan.rows * plan.columns
    several, maps = len(scene.objects) > 1, sum(item.shape == "depth_map" for item in scene.objects)
    # value, w, coc, valid, status, two lists; a second set to smooth in; bounds of the far side, and objects
    planes = 4 * channels + 26 + (4 * channels + 12 if scene.fill.method == "mean_median" else 0)
    planes += 4 * (several or maps > 0) + several
    return {"warp": planes * area, "warp at rest": (2 * WIDE_BYTES + several + WIDE_BYTES * maps) * pixels}


def is_layered(psf: Psf, method: Blur) -> bool:
    """Whether `clsco.defocus` puts its image into slabs."""
    return psf.occlusion == "layered" and method != "convolve"


def defocus_strips(psf: Psf, method: Blur, rows: int, guard: int, largest: float, tallest: int) -> tuple[Strip, ...]:
    """Strips of `clsco.defocus` of an image of so many rows with radii up to `largest` px."""
    reach, step = margin_of_slabs(psf, largest) if is_layered(psf, method) else (table_reach(psf, largest) + 2, 1)
    return cut(rows, tallest, guard, reach, step)


def defocus_bytes(
    psf: Psf, method: Blur, channels: int, shape: tuple[int, int], guard: int, ends: tuple[float, float],
    least: float | None, cores: int, strip_rows: int,
) -> dict[str, int]:  # fmt: skip
    """Buffers of `clsco.defocus` for an image of this shape with radii between two ends, in strips of so many rows.

    least: of an approximation, as for `clsco.passes.multigrid.Coarse`, None for the exact blur.
    """
    strips = defocus_strips(psf, method, shape[0], guard, ends[1], strip_rows)
    height = max(strip.height for strip in strips)
    area = (shape[1] + 2 * guard) * height
    sizes = {"value": 4 * channels * area}
    layered = is_layered(psf, method)
    if method != "convolve":
        sizes |= {"source": source_bytes(area, psf.tilt) * (not layered), "coc": WIDE_BYTES * area, "valid": area}
    blur = (psf, method, channels, strips[0].rows, shape[1], guard)
    sizes |= _spreader(*blur, ends, 0, cores)
    if least is not None:
        sizes |= _coarse(psf, method, channels, *shape, guard, ends[1], least, psf.tilt, cores)
    return sizes | (_layers(*blur, height, ends[1], cores) if layered else {})


def hit_bytes(plan: Plan) -> int:
    """Planes of `clsco.engine.renderer.Hits`, which lenses share."""
    return len(plan.layers) * (4 * plan.channels + WIDE_BYTES + 1) * plan.width * plan.height


def device_bytes(plan: Plan, cores: int, views: int = 1) -> int:
    """All of `buffer_bytes` for one view, or several that are on the device together."""
    return _sum(buffer_bytes(plan, cores), views)


def _sum(sizes: Mapping[str, int], views: int) -> int:
    """Views get their ground truth one after the other."""
    return sum(size * (1 if name.startswith("truth") else views) for name, size in sizes.items())


def fits(sizes: Mapping[str, int], limit: Limit) -> bool:
    """Whether buffers of these sizes fit the limit, for all views together."""
    return _sum(sizes, limit.views) <= limit.total and max(sizes.values()) <= limit.buffer


def fitted(plan: Plan, limit: Limit) -> Plan:
    """The plan with as few strips as fit the limit: the whole frame where it does. Raises as `rows_that_fit`.

    Approximations need the whole frame: where a tolerance leaves the choice, those that do not fit are left out.
    """
    if plan.tolerance is not None:
        tried = (replace(plan, approximations=(name,)) for name in plan.approximations)
        names = (each.approximations[0] for each in tried if fits(buffer_bytes(each, limit.cores), limit))
        plan = replace(plan, approximations=tuple(names))
    needs_whole = {
        "the forward warp": plan.forward,
        "an approximation": bool(plan.approximations),
    }
    why = next((what for what, needed in needs_whole.items() if needed), None)

    def sizes(rows: int) -> Mapping[str, int]:
        return buffer_bytes(replace(plan, strip_rows=rows), limit.cores)

    return replace(plan, strip_rows=rows_that_fit(plan.rows, limit, sizes, why))


def rows_that_fit(rows: int, limit: Limit, sizes: Callable[[int], Mapping[str, int]], whole: str | None) -> int:
    """Rows of the tallest strips that fit the limit: all of them, or a multiple of BAND.

    rows: of the frame; sizes: gives the buffers for strips of so many rows; whole: what needs the whole frame, if
    anything does. Where nothing fits it raises SceneError if the limit was given; else the least strips are taken, or
    the whole frame where something needs it.
    """

    if fits(sizes(rows), limit):
        return rows
    least = rows if whole else min(BAND, rows)
    if not whole and fits(sizes(least), limit):
        few, many = 1, (rows - 1) // BAND
        while few < many:
            middle = (few + many + 1) // 2
            few, many = (middle, many) if fits(sizes(middle * BAND), limit) else (few, middle - 1)
        return few * BAND
    needed = _sum(sizes(least), limit.views)
    if limit.given and needed > limit.total:
        why = f"as {whole} needs the whole frame" if whole else f"in strips of {least} rows"
        least_mib, got = ceil(needed / 2**20), f"{limit.total / 2**20:.4g} MiB"
        raise SceneError(f"memory: must be at least {least_mib} MiB for this frame, {why}; got {got}")
    return least
