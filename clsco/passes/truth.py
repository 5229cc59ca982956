"""Ground truth of a frame at the middle of its exposure; with a rolling shutter, of the exposure of each line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.outputs import MOTION_NAMES, OUTPUTS, RAY_OUTPUTS, STEREO_NAMES
from clsco.opencl.buffers import allocate, download_into
from clsco.opencl.program import Events, Target
from clsco.optics.depth_truth import MapPoints, map_flow, map_normal, map_occluded, map_stereo
from clsco.optics.distortion import Distortion
from clsco.optics.exposure import line_times, middle_time
from clsco.optics.lens import Lens, ray_step
from clsco.optics.lens_path import camera_at, lens_at, lenses_at
from clsco.optics.line_truth import LinePoints, lines_of
from clsco.optics.motion import Eye
from clsco.optics.rims import frame_throughput
from clsco.passes.blur import PIXELS
from clsco.passes.job import TimeSample
from clsco.passes.pack import camera_grid, lens_struct
from clsco.passes.placed import PlacedScene
from clsco.passes.static_image import StaticMap
from clsco.passes.trace import everything, ray_target
from clsco.passes.warp import ForwardWarp
from clsco.plan.buffers import LINE_OUTPUTS, truth_buffers
from clsco.plan.plan import Plan
from clsco.scene.model import Camera

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Computes the outputs of a plan besides color. pixels: those of the reference pose, None if rays are cast."""

    plan: Plan
    scene: PlacedScene
    pixels: ForwardWarp | StaticMap | None

    @cached_property
    def target(self) -> Target:
        """Target with the kernels that cast rays; built when first used."""
        return ray_target(self.plan, self.scene)

    def compute(self, index: int, events: Events) -> Arrays:
        """The requested outputs of frame `index` as arrays (rows, columns[, channels]), named as in `Frame`."""
        plan = self.plan
        if not plan.truth:
            return {}
        times = self._middles(index)
        if plan.scene.rolls:
            outputs = self._from_lines(index, events)
        else:
            outputs = self._from_rays(*times, events) if plan.scene.is_analytic else self._from_maps(*times, events)
        if "throughput" in plan.truth:
            share = frame_throughput(plan.scene, times[1], plan.psf)
            outputs["throughput"] = share.astype(np.float32)
        return {name: array for name, array in outputs.items() if name in plan.truth}

    def _middles(self, index: int) -> tuple[float, float, float]:
        """Times in s of the ground truth of the previous frame, frame `index` and the next frame."""
        if not self.plan.moves:
            return 0.0, 0.0, 0.0
        sequence = self.plan.scene.sequence
        return middle_time(sequence, index - 1), middle_time(sequence, index), middle_time(sequence, index + 1)

    @property
    def _opposite(self) -> Eye:
        return "left" if self.plan.eye == "right" else "right"

    def _from_rays(self, before: float, time: float, later: float, events: Events) -> Arrays:
        """Outputs from rays cast at analytic surfaces; before, time, later: from `_middles`."""
        plan, scene, names = self.plan, self.scene, self.plan.device_truth
        sample, after = scene.at(time), scene.at(later)
        other_view = scene.at(time, eye=self._opposite) if set(STEREO_NAMES) & set(names) else None
        earlier = scene.at(before) if set(MOTION_NAMES) & set(names) else None
        reference = scene.in_reference_pose() if plan.moves or plan.eye_moved else sample
        out = self._cast([(sample.camera, self._arguments(reference, sample, after, other_view, earlier))], events)
        self._split_colors(out, np.array(time))
        self._clear_background(out)
        if isinstance(self.pixels, ForwardWarp):
            out |= self.pixels.truth(sample, plan.truth, events)
        # Flow and hidden are 0 everywhere if the scene is static, and need no rays.
        shape = plan.rows, plan.columns
        zeros = {"flow": np.zeros((*shape, 2), np.float32), "hidden": np.zeros(shape, np.bool_)}
        return {"filled": np.zeros(shape, np.uint8)} | zeros | out

    def _arguments(
        self, reference: TimeSample, sample: TimeSample, after: TimeSample, other_view: TimeSample | None = None,
        earlier: TimeSample | None = None,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Arguments of the ground-truth kernel that stand between the grid and the outputs, for a frame or one of its
        lines.

        Each parameter is the scene at one time. reference: in its reference pose; sample: in this frame; after: in the
        next frame, or `sample` again for a line; other_view: in the other view of a stereo pair; earlier: in the
        previous frame. The last two are None if they are not needed.
        """
        plan, scene = self.plan, self.scene
        poses = scene.poses(after)
        appearance = (scene.texture, scene.texture_maps, *sample.light)
        lens = lens_struct(Lens.of(sample.camera, plan.scene.lens), scene.real)
        head = (lens, sample.surfaces, reference.surfaces, poses, everything(plan), *appearance)
        view: tuple[Any, ...] = (sample.surfaces, poses, np.int32(0))  # read only for a stereo pair
        if other_view is not None:
            view = other_view.surfaces, scene.poses(other_view), np.int32(1 if plan.eye == "right" else -1)
        return *head, *view, poses if earlier is None else scene.poses(earlier), after.surfaces

    def _cast(self, samples: Sequence[tuple[Camera, tuple[Any, ...]]], events: Events) -> Arrays:
        """Outputs from rays, of a camera and the result of `_arguments` for the frame, or of those for each line."""
        plan, names, session = self.plan, self.plan.device_truth, self.scene.session
        lines, by_columns = len(samples) > 1, plan.scene.sequence.by_columns
        buffers, out = allocate(session, truth_buffers(names, plan.grid)), self._arrays(names)
        planes = (buffers["mask"], *(buffers.get(name) for name in RAY_OUTPUTS))
        for strip in plan.strips:
            size = (plan.columns, strip.rows) if not lines else (1, strip.rows) if by_columns else (plan.columns, 1)
            for n, (camera, arguments) in enumerate(samples[strip.inside] if lines and not by_columns else samples):
                grid = camera_grid(camera, plan.guard_px, self.scene.real, strip, plan.scene.camera)
                local, origin = PIXELS if size[0] > 1 else PIXELS[::-1], (n, 0) if by_columns else (0, n)
                self.target.run("ground_truth", size, local, events, grid, *arguments, *planes, origin=origin)
            for name, array in out.items():
                download_into(session, buffers[name], array[strip.inside])
        return out

    def _from_lines(self, index: int, events: Events) -> Arrays:
        """Outputs from rays cast at analytic surfaces with a rolling shutter, where each line has its own time."""
        plan, scene = self.plan, self.scene
        times, by_columns = line_times(plan.scene, index), plan.scene.sequence.by_columns
        reference = scene.in_reference_pose()
        out = self._cast([(s.camera, self._arguments(reference, s, s)) for s in map(scene.at, times.tolist())], events)
        self._split_colors(out, times if by_columns else times[:, None])
        self._clear_background(out)
        out |= {"row_time": times, "filled": np.zeros((plan.rows, plan.columns), np.uint8)}
        return out | (self._between_lines(index, out) if set(LINE_OUTPUTS) & set(plan.truth) else {})

    def _between_lines(self, index: int, outputs: Arrays) -> Arrays:
        """Flow, disparity and masks of occluded points with a rolling shutter, computed from the other `outputs`."""
        plan, out = self.plan, Arrays()
        items, eye = plan.scene.objects, plan.eye
        points = LinePoints(items, outputs["depth"], outputs["object_id"], lines_of(plan.scene, index, eye))
        pairs = {"flow": (1, eye), "flow_backward": (-1, eye), "disparity": (0, self._opposite)}
        for name, (step, view) in pairs.items():
            occlusion = {"flow": "flow_occluded", "disparity": "occluded"}.get(name)
            if not {name, occlusion} & set(plan.truth):
                continue
            lines = lines_of(plan.scene, index + step, view)
            flow = points.flow(lines)
            out[name] = flow.astype(np.float32)
            if occlusion in plan.truth:
                out[occlusion] = points.occluded(lines, flow)
        if "disparity" in out:
            out["disparity"] = out["disparity"][..., 0] * np.float32(1 if eye == "right" else -1)
        return out

    def _split_colors(self, outputs: Arrays, times: NDArray[np.float64]) -> None:
        """If the lens separates colors, replace the blur radius in `outputs` by one radius per color. times: time in s
        of the ground truth, or times of its lines in a shape that broadcasts to the image.
        """
        if not self.plan.scene.separates_colors or "blur_radius" not in outputs:
            return
        sizes, shifts, steps = np.empty((*times.shape, 3)), np.empty((*times.shape, 3)), np.empty(times.shape)
        for line in np.ndindex(times.shape):
            time = float(times[line])
            middle, lenses = lens_at(self.plan.scene, time), lenses_at(self.plan.scene, time)
            sizes[line] = [lens.blur_scale / middle.blur_scale for lens in lenses]
            shifts[line] = [lens.blur_scale * (lens.focus_power - middle.focus_power) for lens in lenses]
            steps[line] = ray_step(camera_at(self.plan.scene, time))
        radius = outputs["blur_radius"][..., None] * sizes + shifts * self._stretch(steps)
        outputs["blur_radius"] = np.where(outputs["mask"][..., None], radius, 0.0).astype(np.float32)

    def _stretch(self, steps: NDArray[np.float64]) -> NDArray[np.float64] | float:
        """Ratio (rows, columns, 1) of sizes in the distorted image to sizes without distortion; 1 without distortion.

        steps: slope between neighboring rays, for the frame or for each line.
        """
        distortion = Distortion.of(self.plan.scene.lens)
        if distortion is None:
            return 1.0
        x = (np.arange(self.plan.columns) - 0.5 * (self.plan.columns - 1)) * steps
        y = (0.5 * (self.plan.rows - 1) - np.arange(self.plan.rows)[:, None]) * steps
        return distortion.stretch(*distortion.undistorted(x, y))[..., None]

    def _clear_background(self, outputs: Arrays) -> NDArray[np.bool_]:
        """Set outputs in pixels of the background to their values for no surface; returns the mask of these pixels."""
        if self.plan.background is None:
            return np.zeros((), np.bool_)
        beyond = np.asarray(outputs["object_id"] == self.plan.background)
        for name, array in outputs.items():
            if (empty := OUTPUTS[name].empty) is not None:
                array[beyond] = empty
        return beyond

    def _arrays(self, names: Sequence[str]) -> Arrays:
        plan = self.plan
        out: Arrays = {}
        for name in ("mask", *names):
            depth = OUTPUTS[name].components or plan.channels
            shape = (plan.rows, plan.columns) if depth == 1 else (plan.rows, plan.columns, depth)
            out[name] = np.empty(shape, OUTPUTS[name].dtype)
        return out

    def _from_maps(self, before: float, time: float, later: float, events: Events) -> Arrays:
        """Outputs of a scene with depth maps, computed from its static or warped pixels, as rays cannot hit a map."""
        scene, plan, pixels = self.scene, self.plan, self.pixels
        now, then = scene.at(time), scene.at(later)
        out: Arrays = {}
        if isinstance(pixels, StaticMap):
            out = pixels.truth()
        elif isinstance(pixels, ForwardWarp):
            out = pixels.truth(now, {"depth", "object_id", "filled", *plan.truth}, events)  # for other outputs
        self._split_colors(out, np.array(time))
        beyond = self._clear_background(out)
        points = MapPoints(plan.scene.objects, out["depth"], out["object_id"], now.camera, now.poses)
        out |= {"normal": map_normal(now.camera, out["depth"]), "flow": map_flow(points, then.camera, then.poses)}
        out["hidden"] = (out["filled"] > 0) & ~beyond
        if isinstance(pixels, ForwardWarp) and "flow_backward" in plan.truth:
            earlier = scene.at(before)
            out["flow_backward"] = map_flow(points, earlier.camera, earlier.poses)
        if isinstance(pixels, ForwardWarp) and "flow_occluded" in plan.truth:
            following = pixels.truth(then, ("depth",), events)["depth"]
            out["flow_occluded"] = map_occluded(points, then.camera, then.poses, following)
        if isinstance(pixels, ForwardWarp) and plan.scene.stereo is not None:
            other_view = scene.at(time, eye=self._opposite)
            opposite = pixels.truth(other_view, ("depth",), events)["depth"]
            out["disparity"], out["occluded"] = map_stereo(points, other_view.poses, opposite, plan.eye)
        return out | {"depth": out["depth"].astype(np.float32)}
