"""Sizes in bytes, by name, of the buffers of each pass; the plan adds them up, and the passes allocate them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from math import ceil

import numpy as np

from clsco.constants import (
    BAND,
    CONVOLVED_COLUMNS,
    COUNTER_DONE,
    CURVED_FIELD,
    CURVED_IMAGE,
    CURVED_SPHERE,
    DISCONTINUITY_CLASSES,
    FILL_LANES,
    ITEMS_BYTES,
    LAYER_TILE,
    MOST_ASIDE,
    MOST_ITEMS,
    NOISE_LANES,
    OWNED_PIXELS,
    SCORE_SUMS,
    SCORED_COLUMNS,
    STATISTIC_BEYOND,
    TAP_LANES,
    WIDE_LANES,
)
from clsco.frame.outputs import OUTPUTS, RAY_OUTPUTS
from clsco.frame.strips import Grid
from clsco.inputs.mipmaps import mipmap_floats
from clsco.inputs.textures import mapped_size
from clsco.optics.depth_layers import bins_of, levels_of, most_deep
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_tables import rounded_span, table_sizes
from clsco.optics.ray_means import has_ray_means, ray_floats
from clsco.optics.sensor import SensorModel
from clsco.optics.stencil import is_by_axes, is_summed, stencil_sizes
from clsco.optics.visibility import lens_floats
from clsco.plan.device import DeviceFacts
from clsco.plan.features import curvature_of
from clsco.plan.methods import MANY_RADII, BlurSpec
from clsco.records import REAL_BYTES, structs
from clsco.scene.model import Scene

Sizes = dict[str, int]
TABLES = ("intervals", "coefficients", "taps", "outlines")  # buffers of a table of weights
BANDS_PER_CORE = 4  # bands per core that `gather` processes at a time, if each needs memory of its own
SUMS_BEYOND = 64  # sums beyond the last row, which vectors of `convolve` read and discard
PAGE, BESIDE_PAGE = 64, 5  # in vectors: 2 KiB of floats; least distance of a row's length from a multiple of PAGE
ITEM_BYTES = 32  # bytes of a group of sources of a column without its vectors
MOST_IN_ONE_SUM = 256  # taps that `gather` adds up in one float before it adds this sum to another one
MAP_BYTES = structs("double")["texture_map_t"].itemsize
COUNTERS = COUNTER_DONE + 1  # number of counters of a filling, ints
STATISTICS = STATISTIC_BEYOND + 1  # number of statistics of a frame, ints
# Buffers that several passes share; only one pass uses each of the other buffers.
SHARED = (
    "statistics", "value", "coc", "valid", "source", "depth", "label", "pixels", "sub_label", "sub_source", "sub_value",
    "sub_depth", "share", "sharper",
)  # fmt: skip
# Outputs that are 0 if nothing moves and there is one view.
MOTION_OUTPUTS = ("flow", "hidden")
# Outputs that the host computes from depth and objects for a rolling shutter.
LINE_OUTPUTS = ("flow", "disparity", "occluded", "flow_backward", "flow_occluded")


def ray_truth(scene: Scene, names: Collection[str], is_forward: bool) -> tuple[str, ...]:
    """Outputs that rays must compute so that the host can derive `names`.

    is_forward: True if a forward warp makes the focused image.
    """
    outputs = {*names}
    if outputs and any(item.is_background for item in scene.objects):
        outputs.add("object_id")
    if is_forward:
        outputs.discard("sharp")
    if not (scene.moves or scene.stereo):
        outputs -= {*MOTION_OUTPUTS}
    if scene.rolls and outputs & {*LINE_OUTPUTS}:
        outputs = (outputs - {*LINE_OUTPUTS}) | {"depth", "object_id"}
    return tuple(name for name in RAY_OUTPUTS if name in outputs)


def bands_at_a_time(rows: int, cores: int) -> int:
    """Number of bands of a strip that are processed together, if each needs memory of its own."""
    return min(ceil(rows / BAND), BANDS_PER_CORE * cores)


def by_columns(psf: PointSpread) -> bool:
    """True if `gather` processes the sources of a column together, for which each band needs scratch memory."""
    return psf.layout != "general" or psf.has_runs


def has_spans(spec: BlurSpec, fp64: bool) -> bool:
    """True if `gather` adds partly hidden sources with a wide, uniform blur as runs of equal weights (spans.clh)."""
    uniform = spec.psf.uniform and not spec.psf.stretched and not has_ray_means(spec.psf)
    return spec.method == "gather" and spec.occluders > 0 and uniform and fp64 and _in_parts(spec.reach)


def _in_parts(reach: int) -> bool:
    """True if a pixel may receive more taps of single sources than one float can sum accurately."""
    return (2 * reach + 1) ** 2 > MOST_IN_ONE_SUM


def ends_bytes(spec: BlurSpec, channels: int, columns: int) -> int:
    """Size in bytes of the buffer for the ends of runs in a band, see kernels/blur/cpu/spans.clh."""
    return 8 * BAND * (columns + 1) * (1 + spec.tilt) * (4 if channels == 3 else channels)


def source_bytes(sources: int, tilt: bool, marked: bool = False) -> int:
    """Size in bytes of the planes in which sources.clh stores `sources` sources; tilt, marked: as in `BlurSpec`."""
    return 4 * (1 + 2 * tilt + marked) * sources


def margin(columns: int, guard: int, far: int) -> tuple[int, int]:
    """Scratch columns on each side of a row of the blurred frame, and the length of the row with them, both in floats.

    The length is an odd number of vectors, and not near a multiple of PAGE vectors: otherwise vertical neighbors would
    compete for the same place in a processor's cache, and blurring would take up to four times as long
    (docs/lessons.md).
    """
    pad = ceil((guard + far + TAP_LANES) / TAP_LANES) * TAP_LANES
    vectors = ceil(columns / TAP_LANES) + 2 * pad // TAP_LANES | 1
    while not BESIDE_PAGE <= vectors % PAGE <= PAGE - BESIDE_PAGE:
        vectors += 2
    return pad, vectors * TAP_LANES


def column_bytes(psf: PointSpread, tilt: bool, channels: int, far: int) -> int:
    """Scratch memory in bytes that a work-item of `gather` needs for columns of sources (kernels/blur/cpu/columns.clh).

    The size is a multiple of 8. far: reach of the blur, px.
    """
    tiles, slopes = 8 * channels * BAND * (far // WIDE_LANES + 2 | 1) * WIDE_LANES, 2 * tilt
    if psf.layout == "separable":
        item = 4 * WIDE_LANES * (slopes + channels + far + 1 + WIDE_LANES)
        sums = 4 * WIDE_LANES * MOST_ASIDE * BAND * (1 + tilt)
        return sums + tiles + min(max(ITEMS_BYTES // item, 2 * WIDE_LANES), MOST_ITEMS) * (item + ITEM_BYTES)
    chords = 8 * WIDE_LANES * (1 + tilt) * channels * BAND + MOST_ITEMS * ITEM_BYTES
    if psf.stretched:
        return chords + tiles + MOST_ITEMS * 4 * WIDE_LANES * (3 + slopes + channels)
    mirrored = psf.layout != "general"
    ends, sums = (1 + (1 + mirrored) * tilt) * channels, (1 + mirrored * tilt) * channels
    item = 2 + slopes + int(tilt and psf.diffracted) + 2 * channels
    items = MOST_ITEMS * (4 * WIDE_LANES * item + ITEM_BYTES)
    if psf.cut_by_chords and psf.pupil.borders is None:
        items += chords + MOST_ITEMS * 4 * WIDE_LANES * (3 + slopes + channels + 3 * len(psf.rims))
    return 8 * WIDE_LANES * ends * (BAND + 1) + 4 * WIDE_LANES * sums * (BAND + 2 * far * mirrored) + tiles + items


def blur_buffers(spec: BlurSpec, grid: Grid, device: DeviceFacts) -> Sizes:
    """Buffers of a blur (`clsco.passes.frame_blur.make_blur`).

    "total" is the plane of a time sample, with rows as long as in `margin`; other buffers depend on the method.
    """
    reach, channels, rows, columns = spec.reach, grid.channels, grid.rows, grid.columns
    _, pitch = margin(columns, grid.guard, reach)
    planes = channels * (4 if spec.by_quadrants else 1)
    sizes = {"total": 4 * planes * rows * pitch}
    if spec.method in MANY_RADII:
        sizes |= _table_buffers(spec)
    if spec.method == "gather":
        bands = bands_at_a_time(rows, device.compute_units)
        columnwise = by_columns(spec.psf)
        in_parts = _in_parts(reach) and not spec.by_quadrants
        sizes["position"] = 4 * (bands if in_parts or columnwise else ceil(rows / BAND))
        if in_parts:
            sizes["part"] = 4 * channels * bands * BAND * pitch
        if has_spans(spec, device.has_fp64):
            sizes["ends"] = bands * ends_bytes(spec, channels, columns)
        if columnwise:
            sizes["scratch"] = bands * column_bytes(spec.psf, spec.tilt, channels, reach)
    if spec.method == "scatter":
        sizes["sums"] = 8 * planes * rows * columns
    if spec.method == "convolve":
        height, width = rows + 2 * grid.guard, columns + 2 * grid.guard
        if is_summed(spec.psf, reach):
            sizes["sums"] = 8 * (height * width + SUMS_BEYOND)
        if is_by_axes(spec.psf):
            sizes["across"] = 4 * height * ceil(columns / CONVOLVED_COLUMNS) * CONVOLVED_COLUMNS
        sizes |= stencil_sizes(spec.psf, reach)
    return sizes


def sum_buffers(grid: Grid) -> Sizes:
    """Buffers of the sum of time samples (`clsco.passes.accumulate.FrameSum`)."""
    pixels = grid.rows * grid.columns
    return {"sum": 4 * grid.channels * pixels, "lost": 4 * grid.channels * pixels}


def sensor_buffers(sensor_model: SensorModel, grid: Grid) -> Sizes:
    """Buffers of a sensor's codes and saturation (`clsco.passes.sensor.FrameSensor`)."""
    pixels = len(sensor_model.filters) * grid.rows * padded_columns(grid.columns)
    return {"code": 2 * pixels, "saturated": pixels}


def padded_columns(columns: int) -> int:
    """Columns rounded up to whole vectors of the sensor kernel."""
    return -(-columns // NOISE_LANES) * NOISE_LANES


def _table_buffers(spec: BlurSpec) -> Sizes:
    """Buffers of the tables of weights, and of the lens if sources may be hidden."""
    main = table_sizes(spec.psf, spec.smallest, spec.largest)
    names = main.keys() if spec.method == "gather" else ("intervals", "coefficients")
    sizes = {name: main[name] for name in names}
    if spec.subpixels:
        sub = table_sizes(spec.psf, spec.smallest, spec.largest, spec.subpixels)
        sizes |= {f"subpixel {name}": sub[name] for name in ("intervals", "coefficients")}
    if spec.occluders:
        sizes["lens"] = 4 * lens_floats(spec.psf).size
    if spec.occluders and has_ray_means(spec.psf):
        sizes["rays"] = 4 * ray_floats(spec.psf, spec.largest)
    return sizes


def sheet_spec(spec: BlurSpec) -> BlurSpec:
    """Specification of the blur of a sheet; spec: specification of the frame's blur."""
    brightest = max(spec.brightest, 1.0)
    return replace(spec, smallest=0.0, subpixels=0, small=False, brightest=brightest, layered=False)


TILE_PLANES = (
    "reach", "edge", "marked", "to_marked", "to_plain", "left", "still_left", "to_left", "sheet_reach", "needed",
    "to_needed",
)  # fmt: skip


def label_buffers(spec: BlurSpec, grid: Grid) -> Sizes:
    """Buffers that assign the pixels of one image to depth layers, in the order of kernel arguments."""
    pixels, colors = grid.sources, grid.channels - (spec.images > 0)
    return {"layer": pixels, "sides": pixels, "mixed": 4 * (2 * colors + 1) * pixels}


def cluster_buffers(spec: BlurSpec, grid: Grid) -> Sizes:
    """Buffers for splitting images into depth layers (`clsco.passes.clusters.Clusters`) that all images share. These
    are the planes of tiles, and the planes of one sheet with its pyramid. spec: specification of the frame's blur.
    """
    pixels, colors = grid.sources, grid.channels - (spec.images > 0)
    planes = colors + 4  # of the pyramid: also radius, coverage, and where both are known
    rows, columns, start = levels_of(grid.height, grid.width, most_deep(spec.psf, spec.largest), planes)[-1]
    tiles = 4 * ceil(grid.height / LAYER_TILE) * ceil(grid.width / LAYER_TILE)
    return {
        "latest": 4 * DISCONTINUITY_CLASSES * bins_of(spec.largest)[1],
        "pyramid": 4 * (start + planes * rows * columns),
        "value": 4 * (colors + 2) * pixels,  # with coverage and ones
        "coc": REAL_BYTES * pixels,
        "valid": pixels,
    } | dict.fromkeys(TILE_PLANES, tiles)


def layered_buffers(spec: BlurSpec, grid: Grid, device: DeviceFacts) -> Sizes:
    """Buffers of layered occlusion (`clsco.passes.layered.DepthLayers`), in addition to those of the frame's blur.

    They hold sources, the light of all sheets so far, the room behind them, and the blur of a sheet, for which names
    begin with "blur ". spec: specification of the frame's blur.
    """
    pixels, layer, colors = grid.rows * grid.columns, sheet_spec(spec), grid.channels - (spec.images > 0)
    rooms = spec.cells**2 + (spec.cells > 1)  # of each cell, and the light of ones
    sizes = source_buffers(spec, grid) | {"room": 4 * rooms * pixels, "light": 4 * colors * pixels}
    inner = blur_buffers(layer, replace(grid, channels=colors + 2), device)
    span, layer_span = (rounded_span(each.psf, each.smallest, each.largest, 0) for each in (spec, layer))
    if span == layer_span:  # one table serves both
        inner = {name: size for name, size in inner.items() if name not in TABLES}
    return sizes | {f"blur {name}": size for name, size in inner.items()}


def warp_buffers(scene: Scene, grid: Grid, device: DeviceFacts) -> Sizes:
    """Buffers of `clsco.passes.warp.ForwardWarp` without those of its filling; grid: grid of the whole frame."""
    pixels, objects = grid.rows * grid.columns, len(scene.objects)
    maps = sum(not item.is_analytic for item in scene.objects)
    surfaces = objects * structs("double")["surface_t"].itemsize
    sizes = {"rest": REAL_BYTES * pixels, "moved": REAL_BYTES * pixels, "rest surfaces": surfaces}
    if objects > 1:
        sizes["object"] = pixels
    if maps:
        sizes["maps"] = REAL_BYTES * maps * pixels
    if device.kind == "cpu":
        sizes["bounds"] = 8 * grid.rows * ceil(grid.columns / OWNED_PIXELS)
    else:
        sizes["depth"] = 4 * grid.sources
    return sizes


def fill_buffers(grid: Grid, several: bool, far: bool, smooths: bool) -> Sizes:
    """Buffers of `clsco.passes.fill.Filler`. grid: grid of the whole frame; several: True for several objects; far:
    True if holes are filled from the far side; smooths: True for mean/median filling.
    """
    pixels, lines = grid.sources, grid.width + grid.height
    sizes = {
        "value": 4 * (grid.channels * pixels + FILL_LANES),
        "w": REAL_BYTES * pixels,
        "coc": REAL_BYTES * pixels,
        "valid": pixels + FILL_LANES,
        "status": pixels,
        "list": 4 * pixels,
        "next list": 4 * pixels,
        "spans": 8 * lines,
        "grown": 8 * lines,
        "counters": 4 * COUNTERS,
    }
    sizes |= {"object": pixels} if several else {}
    sizes |= {"far": 4 * pixels} if far else {}
    if smooths:
        sizes |= {"done": 4 * pixels, "sums": 8 * SCORE_SUMS * grid.height * ceil(grid.width / SCORED_COLUMNS)}
        sizes |= {"other value": sizes["value"], "other w": sizes["w"]}
    return sizes


def fill_sizes(scene: Scene, grid: Grid) -> Sizes:
    """`fill_buffers` for filling after a forward warp of a scene."""
    several = len(scene.objects) > 1
    return fill_buffers(grid, several, several or not scene.is_analytic, scene.fill.method == "mean_median")


def trace_buffers(spec: BlurSpec, grid: Grid, mapped: bool, scene: Scene) -> Sizes:
    """Buffers of kernels/trace for an occlusion group at one time sample: ray hits, sources, the lens's effect on rays
    and, if there are several objects, their predicted extents. mapped: as for `hit_buffers`.
    """
    objects, bends = len(scene.objects), bend_buffers(scene, grid.sources)
    sources = source_buffers(spec, grid) if spec.method in MANY_RADII else {}
    extents = {"extents": 6 * REAL_BYTES * objects} if objects > 1 else {}
    return hit_buffers(grid, mapped) | sources | extents | bends


def bend_buffers(scene: Scene, pixels: int) -> Sizes:
    """Planes of the lens's effect on rays (kernels/trace/bend.cl); pixels: number of pixels of frame and guard band."""
    curved = curvature_of(scene)
    distorts = bool(curved & CURVED_IMAGE)
    floats = 2 * bool(curved & (CURVED_FIELD | CURVED_SPHERE)) + 6 * distorts
    sizes = {"bends": 4 * floats * pixels} if floats else {}
    return sizes | ({"slopes": 2 * REAL_BYTES * pixels} if distorts else {})


def silhouette_buffers(spec: BlurSpec, grid: Grid, slots: int, mapped: bool) -> Sizes:
    """Buffers of sub-pixel sources for `slots` pixels near silhouettes. mapped: True if textures are on surfaces; then
    buffers are added for the detail that neighboring pixels exchange.
    """
    subs = slots * spec.subpixels**2
    sizes = {"pixels": 4 * slots, "sub_label": subs, "sub_depth": REAL_BYTES * subs}
    sizes |= {"sub_source": 16 * subs, "sub_value": 4 * grid.channels * subs}
    return sizes | ({"share": 4 * grid.sources, "sharper": 4 * grid.channels * grid.sources} if mapped else {})


def texture_buffers(scene: Scene, channels: int, alpha: bool = False) -> Sizes:
    """Buffers of the textures of a scene that has a resolution; a texture that several objects share counts once.

    alpha: True if the last channel is coverage, which is 0 for the background. The background then needs a copy of a
    texture that it shares with other objects.
    """
    columns, rows = scene.camera.resolution or (0, 0)
    unmapped = [item for item in scene.objects if item.mapped is None]
    count = len({(item.inputs()["texture"], alpha and item.is_background) for item in unmapped})
    size = 4 * channels * count * rows * columns
    mapped = dict.fromkeys(item.textures() for item in scene.objects if item.mapped is not None)
    size += sum(4 * mipmap_floats(*mapped_size(names), channels, len(names)) for names in mapped)
    return {"texture": size} | ({"texture maps": len(scene.objects) * MAP_BYTES} if mapped else {})


def source_buffers(spec: BlurSpec, grid: Grid) -> Sizes:
    """Buffers of sources, one per pixel, and of their depths if occluders or rims may hide their light."""
    depth = {"depth": REAL_BYTES * grid.sources} if spec.occluders else {}
    return {"source": source_bytes(grid.sources, spec.tilt, spec.marked)} | depth


def hit_buffers(grid: Grid, mapped: bool) -> Sizes:
    """Planes of an occlusion group's ray hits, which all lenses share (`clsco.passes.trace.Hits`). mapped: True if
    textures are on surfaces, which adds a plane with the number of texels in each pixel.
    """
    pixels, planes = grid.sources, grid.channels + mapped
    return {"value": 4 * planes * pixels, "depth": REAL_BYTES * pixels, "label": pixels}


def image_buffers(spec: BlurSpec, grid: Grid) -> Sizes:
    """Buffers of images with alpha after the first one, which `map_buffers` has."""
    each = map_buffers(grid)
    return {f"{name} {number}": size for number in range(2, spec.images + 1) for name, size in each.items()}


def map_buffers(grid: Grid, scene: Scene | None = None) -> Sizes:
    """Buffers of an image with its map of signed radii; scene: the scene if rays make the image, else None."""
    bends = {} if scene is None else bend_buffers(scene, grid.sources)
    return {"value": 4 * grid.channels * grid.sources, "coc": REAL_BYTES * grid.sources, "valid": grid.sources} | bends


def truth_buffers(names: Collection[str], grid: Grid) -> Sizes:
    """Buffers of the outputs `names` and of the mask for one strip; allocated only while ground truth is computed."""
    pixels, outputs = grid.rows * grid.columns, (OUTPUTS[name] for name in ("mask", *names))
    return {out.name: np.dtype(out.dtype).itemsize * (out.components or grid.channels) * pixels for out in outputs}
