"""Host side of the forward warp, which moves each pixel of the reference pose to its position at a time sample."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import NO_WINNER, OWNED_PIXELS
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import Events, Target
from clsco.optics.lens import Lens
from clsco.optics.lens_path import reference_camera
from clsco.passes.blur import PIXELS
from clsco.passes.fill import LINES, LISTED, OWNERS, ZERO, Filler, FillPlanes
from clsco.passes.job import TimeSample
from clsco.passes.pack import camera_grid, lens_struct
from clsco.passes.placed import PlacedScene
from clsco.plan.buffers import fill_sizes, warp_buffers
from clsco.plan.features import curvature_of
from clsco.plan.plan import Plan
from clsco.records import REAL

KERNELS = ("warp/warp.cl", "inpainting/fill.cl", "inpainting/score.cl", "inpainting/fill_mean_median.cl")
NOWHERE = np.array(NO_WINNER, np.int32)

# Bands of rows in reproject_nearest: few, because each band reads all segments of sources, but enough for all cores.
BANDS_PER_CORE, SMALLEST_BAND = 4, 16

SHAPE_FEATURES = ("CHANNELS", "SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED")


def forward_features(plan: Plan, owned: bool) -> dict[str, int]:
    """Features that warp.cl and fill.cl are compiled for.

    In a scene with a depth map, whose outline rays cannot find, domain "span" replaces "surface". FILL_FAR: holes are
    filled from their far side, because with several objects or a depth map their sides may be at different depths.
    """
    fill, mapped = plan.scene.fill, not plan.scene.is_analytic
    shape = {name: value for name, value in plan.features().items() if name in SHAPE_FEATURES}
    return shape | {
        "CURVED": curvature_of(plan.scene),
        "OWNED": int(owned),
        "MAPPED": int(mapped),
        "FILL_AIT": int(fill.method == "ait"),
        "FILL_MEAN_MEDIAN": int(fill.method == "mean_median"),
        "FILL_FAR": int(mapped or len(plan.scene.objects) > 1),
        "DOMAIN_SURFACE": int(fill.domain == "surface" and not mapped),
    }


class ForwardWarp:
    """Moves the pixels of a scene's reference pose to their positions at a time, and fills missing pixels.

    maps: for each object that is a depth map, its inverse depth (rows, columns) in 1/mm, 0 without a surface; None for
    others. owned: True for the depth test in which each work-item owns a band of the image, False for the one by
    atomics, by default True on processors; both give the same bits. Validated against `clsco.reference.warp.warp` and
    `clsco.reference.inpainting.fill`.
    """

    def __init__(
        self, plan: Plan, scene: PlacedScene, maps: Sequence[NDArray[np.float64] | None], owned: bool | None = None
    ) -> None:
        session, real = scene.session, scene.real
        self.plan, self.scene, self.grid = plan, scene, camera_grid(reference_camera(plan.scene), plan.guard_px, real)
        self.lens = lens_struct(Lens.of(reference_camera(plan.scene), plan.scene.lens, plan.only), real)
        self.owned = session.device.kind == "cpu" if owned is None else owned
        features = forward_features(plan, self.owned)
        self.kernels = Target(session, KERNELS, features, real)
        self.filler = Filler(self.kernels, self.grid, self.lens, features, fill_sizes(plan.scene, plan.grid))
        # The filling, which starts when the pixels have been moved, uses the same buffers for its lists.
        self.target, self.winner = self.filler.planes.indices
        sizes = warp_buffers(plan.scene, plan.grid, session.device)
        self.rest, self.moved = (empty(session, sizes[name]) for name in ("rest", "moved"))
        self.object = empty(session, sizes["object"]) if "object" in sizes else None
        if self.object:  # kernels move one object at a time, and write only the pixels of that object
            for buffer in (self.target, self.moved):
                cl.enqueue_fill_buffer(session.queue, buffer, ZERO, 0, buffer.size)
        depths = [depth for depth in maps if depth is not None]
        self.maps = upload(session, np.stack(depths).astype(REAL[real])) if depths else None
        self.bounds = empty(session, sizes["bounds"]) if self.owned else None
        # The buffer of radii is unused until the radii are written.
        self.depth = self.filler.planes.coc if self.owned else empty(session, self.winner.size)
        reference = scene.in_reference_pose()
        self.rest_surfaces = reference.surfaces
        members = np.uint64(sum(1 << k for k, surface in enumerate(reference.placed) if surface is not None))
        count = np.int32(len(reference.placed))
        args = (self.grid, self.rest_surfaces, count, members, self.maps, self.rest, self.object)
        self.kernels.run("reproject_rest", (plan.columns, plan.rows), PIXELS, [], *args)

    def warp(self, sample: TimeSample, events: Events) -> FillPlanes:
        """Move the pixels of the reference pose to a time sample, and fill missing pixels as the scene specifies.

        Returns planes (height, width) with guard band, which the next call overwrites.
        """
        self.nearest(sample, events)
        self.gather(events)
        self.fill(sample, events)
        return self.filler.planes

    def fill(self, sample: TimeSample, events: Events) -> dict[str, int]:
        """Fill missing pixels after `gather`; returns the counters of `Filler.fill`."""
        planes, plan = self.filler.planes, self.plan
        counters = self.filler.fill(sample.surfaces, len(sample.placed), events, self.scene.brightest)
        if self.maps:
            out = (self.lens, planes.value, planes.w, planes.coc, planes.valid)
            if self.filler.fills:
                self._per_line("fill_entered", events, *out, planes.status, planes.object)
            self.kernels.run("extend_border", (plan.width, plan.height), PIXELS, events, self.grid, *out)
        return counters

    def nearest(self, sample: TimeSample, events: Events) -> None:
        """Enqueue the depth test, which finds the target of each reference pixel and each target's nearest source."""
        scene, real = self.plan.scene, self.scene.real
        if scene.lens_moves or self.plan.only is not None:
            self.lens = self.filler.lens = lens_struct(Lens.of(sample.camera, scene.lens, self.plan.only), real)
            self.grid = self.filler.grid = camera_grid(sample.camera, self.plan.guard_px, real, reference=scene.camera)
        poses = self.scene.poses(sample)
        args = (self.grid, self.rest_surfaces, poses, self.rest, self.target, self.moved, self.object, self.bounds)
        (self._test_in_bands if self.owned else self._test_by_atomics)(args, events)

    def gather(self, events: Events) -> None:
        """Enqueue kernels that copy the winners of the depth test to the planes of `filler`, without filling."""
        planes, plan = self.filler.planes, self.plan
        if self.filler.is_far:
            self._per_chunk("reproject_gaps", events, self.depth, self.winner, planes.valid)
        head = (self.grid, self.lens, self.scene.texture, self.moved, self.winner, self.rest_surfaces, self.object)
        out = (planes.value, planes.w, planes.coc, planes.valid, planes.status, planes.object)
        self.kernels.run("reproject_gather", (plan.width, plan.height), PIXELS, events, *head, *out)
        if self.maps:
            self._per_line("mark_entered", events, self.winner, planes.valid, planes.status)

    def note_radii(self, statistics: cl.Buffer, events: Events) -> None:
        """Include |R| of the warped pixels in the largest and smallest |R| of `statistics`."""
        self._per_chunk("note_radii", events, self.filler.planes.coc, self.filler.planes.valid, statistics)

    def missing(self) -> NDArray[np.bool_]:
        """Mask (rows, columns) of pixels of the frame that were missing, whether they have been filled or not."""
        return self._frame(self.filler.planes.status, np.uint8) > 0

    def truth(self, sample: TimeSample, names: Collection[str], events: Events) -> dict[str, NDArray[Any]]:
        """The arrays in `names` that the warp has, (rows, columns[, channels]), float32 unless stated otherwise.

        "sharp": radiance after the move; "filled": `FillPlanes.status`, uint8. A scene with a depth map, which rays
        cannot hit, also has arrays of the surface in each known or filled pixel; the values are those of the source
        that was moved to the pixel, up to half a pixel from its center: "depth" in mm, +inf without a surface, float64
        because normals are computed from its differences; "blur_radius" in px, 0 without a surface; "mask", bool;
        "object_id", int32, -1 without a surface.
        """
        plan = self.plan
        available = {"sharp", "filled"} | ({"depth", "blur_radius", "mask", "object_id"} if self.maps else set())
        if not available & set(names):
            return {}
        warped = self.warp(sample, events)
        real, valid = REAL[self.scene.real], self._frame(warped.valid, np.bool_)
        arrays: dict[str, NDArray[Any]] = {"mask": valid}
        if "sharp" in names:
            planes = self._frame(warped.value, np.float32, plan.channels)
            arrays["sharp"] = np.ascontiguousarray(planes[0] if plan.channels == 1 else np.moveaxis(planes, 0, -1))
        if "filled" in names:
            arrays["filled"] = self._frame(warped.status, np.uint8)
        if self.maps:
            w = self._frame(warped.w, real).astype(np.float64)
            arrays["depth"] = np.where(valid, 1.0 / np.where(valid, w, 1.0), np.inf)
            arrays["blur_radius"] = self._frame(warped.coc, real).astype(np.float32)
            numbers = 0 if warped.object is None else self._frame(warped.object, np.uint8).astype(np.int32)
            arrays["object_id"] = np.where(valid, numbers, -1).astype(np.int32)
        return {name: array for name, array in arrays.items() if name in available & set(names)}

    def _frame(self, buffer: cl.Buffer, dtype: Any, channels: int | None = None) -> NDArray[Any]:
        """Download a plane (rows, columns), or planes (channels, rows, columns), without the guard band."""
        plan, guard = self.plan, self.plan.guard_px
        shape = (plan.height, plan.width) if channels is None else (channels, plan.height, plan.width)
        inside = (..., slice(guard, guard + plan.rows), slice(guard, guard + plan.columns))
        return np.ascontiguousarray(download(self.scene.session, buffer, shape, dtype)[inside])

    def _test_in_bands(self, args: tuple[Any, ...], events: Events) -> None:
        """Enqueue the depth test in which each work-item owns a band of the image."""
        rows, cores = self.plan.height, self.scene.session.device.compute_units
        band = max(SMALLEST_BAND, -(-rows // (BANDS_PER_CORE * cores)))
        segments = self.plan.rows * -(-self.plan.columns // OWNED_PIXELS)
        self.kernels.run("reproject_targets", (segments,), LINES, events, *args)
        owned = (self.grid, self.target, self.moved, self.bounds, np.int32(band), self.winner, self.depth)
        self.kernels.run("reproject_nearest", (-(-rows // band),), OWNERS, events, *owned)

    def _test_by_atomics(self, args: tuple[Any, ...], events: Events) -> None:
        """Enqueue the depth test by atomics, with a work-item per source."""
        queue, sources = self.scene.session.queue, (self.plan.rows * self.plan.columns,)
        cl.enqueue_fill_buffer(queue, self.depth, ZERO, 0, self.depth.size)
        cl.enqueue_fill_buffer(queue, self.winner, NOWHERE, 0, self.winner.size)
        tested = (self.grid, self.target, self.moved, self.depth)
        self.kernels.run("reproject_targets", sources, LISTED, events, *args)
        self.kernels.run("reproject_depth", sources, LISTED, events, *tested)
        self.kernels.run("reproject_winner", sources, LISTED, events, *tested, self.winner)

    def _per_line(self, name: str, events: Events, *args: Any) -> None:
        """Run a kernel for all rows of the frame, then for all columns."""
        rows, lines = self.plan.rows, self.plan.rows + self.plan.columns
        for first, end in ((0, rows), (rows, lines)):
            self.kernels.run(name, (end - first,), LINES, events, self.grid, np.int32(first), np.int32(end), *args)

    def _per_chunk(self, name: str, events: Events, *args: Any) -> None:
        """Run a kernel for all pixels, OWNED_PIXELS of them per work-item if work-items own bands, else one."""
        size = (-(-self.plan.width // (OWNED_PIXELS if self.owned else 1)), self.plan.height)
        self.kernels.run(name, size, (1, *LINES) if self.owned else PIXELS, events, self.grid, *args)
