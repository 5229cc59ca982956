"""Passes that blur an image by its map of blur radii, passes after the blur, and the plan for a user's image."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from clsco.frame.strips import Grid, Strip, cut_strips
from clsco.optics.depth_layers import margin_of_layers
from clsco.optics.psf_grid import table_reach
from clsco.optics.sensor import GRAY, LEAST_DARK_NOISE, SensorModel
from clsco.plan.buffers import (
    SHARED,
    Sizes,
    blur_buffers,
    cluster_buffers,
    image_buffers,
    label_buffers,
    layered_buffers,
    map_buffers,
    sensor_buffers,
    source_buffers,
)
from clsco.plan.device import DeviceFacts
from clsco.plan.methods import MANY_RADII, BlurSpec
from clsco.plan.passes import Parameters, Pass
from clsco.scene.model import Scene

CLUSTERED = (("layers", "of the image's pixels by R, each extended behind nearer ones"),)
FROM_R = ("R", "from the inverse depth of every pixel")
SLOPE = ("gradient", "from differences of R")
COLORS = ("red", "green", "blue")
JOINED = (("colors", "each blurred by itself"),)


def prefix_names(owner: str, sizes: Sizes) -> Sizes:
    """Sizes of buffers, with `owner` before each name, so that names are unique in the plan."""
    return {f"{owner} {name}": size for name, size in sizes.items()}


def light_of(spec: BlurSpec) -> str:
    """Name of the output that the blur starts from: "image" if pixels have different radii, "sources" if all have one
    radius, "plane" if everything is in focus.
    """
    if spec.method == "none":
        return "plane"
    return "image" if spec.method in MANY_RADII else "sources"


def blur_passes(spec: BlurSpec, grid: Grid, device: DeviceFacts, parameters: Parameters = ()) -> Iterator[Pass]:
    """The passes from the output that `light_of` names to the blurred plane; parameters: those of the "blur" or "depth
    layers" pass, for reports.
    """
    blur = prefix_names("blur", blur_buffers(spec, grid, device))
    if spec.layered:
        sizes = prefix_names("depth layer", layered_buffers(spec, grid, device)) | blur
        clusters = prefix_names("depth layer", cluster_buffers(spec, grid))
        for number in range(max(spec.images, 1)):
            clusters |= prefix_names(f"depth layer {number + 1}", label_buffers(spec, grid))
        yield Pass("cluster", CLUSTERED, clusters, ("image",), ("layers",))
        yield Pass("depth layers", parameters, sizes, ("layers",), ("plane", "depth_layers"))
        return
    if spec.method in MANY_RADII:
        slope = (SLOPE,) if spec.tilt else ()
        yield Pass("sources", (FROM_R, *slope), source_buffers(spec, grid), ("image",), ("sources",))
    if spec.method != "none":
        yield Pass("blur", parameters, blur, ("sources",), ("plane",))


def color_passes(passes: Sequence[Iterable[Pass]], grid: Grid) -> Iterator[Pass]:
    """The passes that blur red, green and blue separately, each up to the blurred plane, and join them in one plane.

    grid: grid with the channels of the joined plane.
    """
    sizes = {"colors": 4 * grid.channels * grid.rows * grid.columns}
    for color, (name, steps) in enumerate(zip(COLORS, passes, strict=True)):
        for step in steps:
            buffers = {key if key in SHARED else f"{name} {key}": size for key, size in step.buffers.items()}
            yield replace(step, buffers=buffers, color=color)
        inputs, last = ("plane", "colors") if color else ("plane",), name == COLORS[-1]
        yield Pass("join colors", JOINED, sizes, inputs, ("plane" if last else "colors",), color=color)


def vignetting_pass(scene: Scene, rows: int, columns: int) -> Pass:
    """The pass that darkens the blurred plane of a time sample, of rows x columns px."""
    kind = "none" if scene.lens is None else scene.lens.vignetting
    text = "cos^4 of the angle from the axis" if kind == "natural" else f"a1, a2, a3 = {kind}"
    return Pass("vignetting", (("share", text),), {"vignetting": 4 * rows * columns}, ("plane",), ("plane",))


def sensor_pass(model: SensorModel, grid: Grid, takes: str) -> Pass:
    """The pass that reads out the irradiance of a complete frame; takes: name of its input, "frame" or "plane"."""
    sensor = model.sensor
    electrons = f"{model.scale[GRAY]:.6g} e- of white, full well {sensor.full_well:.6g} e-"
    codes = f"{model.gain:.4g} DN/e- from {sensor.black_level}, {sensor.bits} bits"
    noise = f"{model.dark_noise:.3g} DN rms in the dark"
    if model.dark_noise < LEAST_DARK_NOISE:
        noise += f": posterized, as below {LEAST_DARK_NOISE} DN means of many frames follow the steps of the codes"
    parameters: Parameters = (("electrons", electrons), ("codes", codes), ("noise", noise))
    if sensor.mosaic != "none":
        parameters += (("mosaic", f"{sensor.mosaic}, demosaic {sensor.demosaic}"),)
    return Pass("sensor", parameters, prefix_names("sensor", sensor_buffers(model, grid)), (takes,), ("codes",))


@dataclass(frozen=True)
class ImagePlan:
    """Plan for blurring an image by its map of radii, as in `clsco.defocus`.

    guard_px: width of the guard band around the image that contributes light; strip_rows: rows of the tallest strip, 0
    for all rows.
    """

    spec: BlurSpec
    device: DeviceFacts
    rows: int
    columns: int
    channels: int
    guard_px: int
    strip_rows: int = 0
    forward = False  # a forward warp would need the whole frame at once

    @cached_property
    def strips(self) -> tuple[Strip, ...]:
        """The strips in which the image is blurred, in order; the first one is the tallest."""
        reach = table_reach(self.spec.psf, self.spec.largest) + 2
        return strips_of(self.spec, self.rows, self.strip_rows, self.guard_px, reach)

    @property
    def grid(self) -> Grid:
        """Sizes of the image, or of the tallest of its strips."""
        return Grid.of(self.strips, self.columns, self.guard_px, self.channels)

    @cached_property
    def passes(self) -> tuple[Pass, ...]:
        """Passes that blur a strip, in the order in which they run."""
        sizes, light = map_buffers(self.grid) | image_buffers(self.spec, self.grid), light_of(self.spec)
        if light == "sources":
            sizes = {"value": sizes["value"]}
        return Pass("static image", (), sizes, (), (light,)), *blur_passes(self.spec, self.grid, self.device)


def strips_of(spec: BlurSpec, rows: int, tallest: int, guard: int, reach: int) -> tuple[Strip, ...]:
    """Strips of a frame with `rows` rows; tallest: most rows of a strip, 0 for all; guard: width of the guard band,
    px; reach: largest distance at which a source may affect a pixel, px.
    """
    far, step = margin_of_layers(spec.psf, spec.largest) if spec.layered else (reach, 1)
    return cut_strips(rows, tallest or rows, guard, far, step)
