"""Renderer of a plan's frames: runs the passes for each time sample, and again if a frame needs a larger plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cache, partial
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco import __version__
from clsco.engine.film import Film
from clsco.engine.workspace import ColorChannel, Pixels, SceneWorkspace
from clsco.errors import DeviceError
from clsco.frame.frame import Frame
from clsco.frame.strips import Strip
from clsco.inputs.textures import select_channels
from clsco.opencl.buffers import download
from clsco.opencl.session import Session
from clsco.optics.exposure import line_times, middle_time
from clsco.optics.lens import Lens
from clsco.optics.lens_path import camera_at, reference_camera
from clsco.optics.point_spread import exposure_factor
from clsco.optics.sensor import camera_word
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.job import SceneJob
from clsco.passes.pack import camera_grid, towards
from clsco.passes.placed import PlacedScene
from clsco.passes.static_image import StaticMap
from clsco.passes.trace import EMPTY_STATISTICS, Hits
from clsco.passes.truth import GroundTruth
from clsco.passes.warp import ForwardWarp
from clsco.plan.larger import SourceStatistics, larger_plan
from clsco.plan.memory import Limit, device_bytes
from clsco.plan.passes import Kind
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared
from clsco.records import Real, Struct


class Renderer:
    """Renders the frames of one plan on one device.

    plan: a plan that fits the limit; limit: also applies to a larger plan, if this one is too small; hits: ray hits
    shared with the renderers of other lenses, whose plans have the same guard band. Raises DeviceError and KernelError.
    """

    def __init__(
        self, session: Session, plan: Plan, prepared: Prepared, limit: Limit, hits: Hits | None = None
    ) -> None:
        device, precision = session.device, prepared.request.precision
        if (needed := device_bytes(plan)) > device.global_mem:
            raise DeviceError(f"device {device}: the scene needs {needed >> 20} MiB; got {device.global_mem >> 20} MiB")
        wants_double = precision == "double" or (precision is None and device.has_fp64)
        real: Real = "double" if wants_double else "float"
        if plan.sensor_model is not None:
            from clsco.frame.development import check_development

            check_development(plan.sensor_model, plan.rows, plan.columns)
        self.session, self.plan, self.limit, self.prepared, self.hits = session, plan, limit, prepared, hits
        self.scene = PlacedScene(session, plan.scene, plan.psf, prepared.textures, real, plan.eye, plan.alpha)
        self.pixels, self.grids = self._pixels(plan, self.scene), dict[Strip, Struct]()
        self.space, self.truth = self._spaces()

    def _spaces(self) -> tuple[SceneWorkspace, GroundTruth]:
        space = SceneWorkspace(self.plan, self._channels(), self.hits, self._grid(self.plan.strips[0]))
        return space, GroundTruth(self.plan, self.scene, self.pixels)

    def _pixels(self, plan: Plan, scene: PlacedScene) -> Pixels:
        maps = self.prepared.maps
        if plan.static_map:
            radiance, (depth,) = scene.textures[0].radiance, (w for w in maps if w is not None)
            camera = reference_camera(plan.scene)
            lens = Lens.of(camera, plan.scene.lens, plan.only)
            return StaticMap(self.session, camera, lens, radiance, depth, plan.guard_px, self.scene.real)
        return ForwardWarp(plan, scene, maps) if plan.forward else None

    def _channels(self) -> tuple[ColorChannel, ...]:
        """One channel with all colors, or a channel for each color if colors are blurred separately."""
        plan, color_channels = self.plan, list[ColorChannel]()
        for color_plan in plan.color_plans:
            channels = (color_plan.only or 0, plan.colors)[: color_plan.channels]
            select = cache(partial(select_channels, channels=channels))
            textures = tuple(select(texture) for texture in self.prepared.textures)
            scene = PlacedScene(
                self.session, plan.scene, color_plan.psf, textures, self.scene.real, plan.eye, plan.alpha
            )
            color_channels.append(ColorChannel(scene, self._pixels(color_plan, scene)))
        return tuple(color_channels) or (ColorChannel(self.scene, self.pixels),)

    def begin(self, index: int) -> Film:
        """Begin frame `index`: reset its statistics and, if it has several strips, determine its depth layers."""
        film, statistics = Film(self.plan, index), self.space.buffers.get("statistics")
        if isinstance(self.pixels, StaticMap):
            film.missing |= self.pixels.missing
        if statistics is not None:
            cl.enqueue_copy(self.session.queue, statistics, EMPTY_STATISTICS)
        for number in range(len(film.times)) if len(self.plan.strips) > 1 else ():
            jobs = (self._job(film, strip, number) for strip, parts in film.strip_parts.items() if number in parts)
            film.bounds[number] = self.space.find_layers(self.plan.passes, jobs)
        return film

    def _job(self, film: Film, strip: Strip, number: int) -> SceneJob:
        weights, parts = film.weights[number], film.strip_parts[strip]
        part = parts[number]
        if not self.plan.scene.sequence.by_columns:
            weights = weights[part.inside]
        sample, grid = self.scene.at(film.times[number]), self._grid(part)
        if self.plan.scene.zooms:
            grid = towards(grid, sample.camera)
        stream = camera_word(film.index, self.plan.eye) if number == max(parts) else None
        return SceneJob(
            strip=part, grid=grid, events=film.events, bounds=film.bounds.get(number), sample=sample, weights=weights,
            is_first=number == min(parts), whole_strip=strip, noise_stream=stream, changes=self._changes(film, number),
        )  # fmt: skip

    def _changes(self, film: Film, number: int) -> dict[OcclusionGroup, tuple[Any, ...] | None]:
        """Value of `SceneJob.changes` for a time sample, or for the still sources after the last one."""
        plan = self.plan
        if plan.splits_still and not film.changes:
            from clsco.optics.still import map_changes, moving_objects

            samples = [self.scene.at(time) for time in film.times]
            poses, surfaces = zip(*((sample.poses, sample.placed) for sample in samples), strict=True)
            where = moving_objects(poses), surfaces, samples[0].camera, plan.psf.extent, plan.guard_px
            for group in plan.groups:
                changes = map_changes(group, *where)
                film.changes[group] = self.scene.hold(changes), bool((changes > 0).any())
        changing = number < film.samples
        return {
            group: None if changing and not some else (changes, np.int32(changing))
            for group, (changes, some) in film.changes.items()
        }

    def _grid(self, strip: Strip) -> Struct:
        """grid_t of a strip, or of a part of it."""
        if strip not in self.grids:
            plan = self.plan
            self.grids[strip] = camera_grid(reference_camera(plan.scene), plan.guard_px, self.scene.real, strip)
        return self.grids[strip]

    def add(self, film: Film, strip: Strip, number: int, after: Callable[[Kind], None] | None = None) -> None:
        """Run the passes of a time sample on a strip, and add the result to the film. number: number of the time
        sample; after: called after each pass with the kind of the pass.
        """
        job = self._job(film, strip, number)
        passes = (step for step in self.plan.passes if step.kind != "ground truth")
        film.add(self.session, strip, number, self.space.run(passes, job, after))

    def finish(self, film: Film) -> Frame:
        """The frame of a completed film; if the plan was too small, the frame is rendered again with a larger plan."""
        while self.enlarge():
            (film,) = expose([self], film.index)
        truth = self._truth(film)
        self.scene.release()
        eye = self.plan.eye if self.plan.scene.stereo else ""
        return Frame(index=film.index, metadata=self._metadata(film), eye=eye, **self._image(film), **truth)

    def _image(self, film: Film) -> dict[str, Any]:
        """Color and alpha of the frame."""
        plan = self.plan
        if plan.sensor_model is not None:
            from clsco.frame.development import develop

            color = develop(film.code, plan.sensor_model)
        else:
            color = _without_alpha(film.color) if plan.alpha else film.color
        coverage = {"alpha": np.ascontiguousarray(film.color[..., -1])} if plan.alpha and plan.color else {}
        return {"color": color if plan.color else None} | coverage

    def _truth(self, film: Film) -> dict[str, Any]:
        """The outputs besides color and alpha."""
        plan = self.plan
        truth: dict[str, Any] = self.truth.compute(film.index, film.events)
        sample_outputs = {"missing": film.missing, "subframes": film.subframes}
        truth |= {name: array for name, array in sample_outputs.items() if name in plan.truth}
        if plan.alpha and plan.color:
            truth |= {name: _without_alpha(truth[name]) for name in {"sharp", "subframes"} & truth.keys()}
        if plan.sensor_model is not None:
            from clsco.frame.development import sensor_truth

            light = (_without_alpha(film.color) if plan.alpha else film.color) if plan.needs_light else None
            truth |= sensor_truth(plan.truth, film.code, film.saturated, light, plan.sensor_model)
        return truth

    def enlarge(self) -> bool:
        """Switch to a larger plan if the latest frame needed more than predicted; returns True if the plan changed."""
        if self.plan.static_map or not self.plan.color:
            return False
        statistics = download(self.session, self.space.buffers["statistics"], EMPTY_STATISTICS.shape, np.int32)
        before, plan = self.plan, larger_plan(self.plan, SourceStatistics.parse(statistics), self.limit)
        if plan is None:
            return False
        if plan.guard_px != before.guard_px or plan.strips != before.strips:
            self.hits = None  # the guard band may differ from those of the other lenses
        del self.space, self.truth, self.pixels  # releases memory for the larger plan
        self.plan, self.grids = plan, {}
        self.pixels = self._pixels(plan, self.scene)
        self.space, self.truth = self._spaces()
        return True

    def _metadata(self, film: Film) -> dict[str, Any]:
        report, plan, spec, scene = self.prepared.approximation, self.plan, self.plan.spec, self.plan.scene
        metadata = {
            "frame": film.index,
            "intermediate": [*film.reports.values()],
            "samples": len(film.reports),
            "guard_px": plan.guard_px,
            "strips": len(plan.strips),
            "blur_method": plan.blur,
            "approximation": None if report is None else asdict(report),
            "bits": self.scene.bits,
            "f_number": camera_at(scene, middle_time(scene.sequence, film.index)).opening,
            "device": str(self.session.device),
            "precision": "double" if self.scene.real == "double" else "single",
            "version": __version__,
            "seconds": film.seconds(),
        }
        if scene.aperture.exposure != "normalized":  # ratio of the irradiance to that of an open circular aperture
            metadata["exposure"] = exposure_factor(scene.aperture, plan.psf)
        if spec.psf.diffracted:  # fraction of a point's light that the truncated PSF loses, as in `clsco plan`
            from clsco.optics.waves import light_cut

            metadata["light_cut"] = light_cut(spec.psf, spec.smallest, spec.largest)
        metadata |= {name: list(numbers) for name, numbers in self.prepared.color.exr_attributes().items()}
        if scene.rolls:  # times of the ground truth in the first and the last line
            metadata["row_time"] = line_times(scene, film.index)[[0, -1]].tolist()
        return metadata


def _without_alpha(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Color (..., rows, columns[, 3]) of images (..., rows, columns, channels) whose last channel is coverage."""
    return np.ascontiguousarray(image[..., 0] if image.shape[-1] == 2 else image[..., :-1])


def expose(renderers: Sequence[Renderer], index: int) -> list[Film]:
    """Expose frame `index` with several renderers, which have the same strips and time samples; returns their films."""
    session, plan = renderers[0].session, renderers[0].plan
    films = [renderer.begin(index) for renderer in renderers]
    if {step.kind for step in plan.passes} <= {"ground truth"}:
        return films
    steps = {strip: sorted({n for film in films for n in film.strip_parts[strip]}) for strip in films[0].strip_parts}
    samples = films[0].samples
    total, done = sum(number < samples for numbers in steps.values() for number in numbers), 0
    for strip, numbers in steps.items():
        for number in numbers:
            before = [event for film in films for _, event in film.events[-1:]]
            for renderer, film in zip(renderers, films, strict=True):
                if number in film.strip_parts[strip]:
                    renderer.add(film, strip, number)
            if (progress := session.progress) is not None:
                for event in before:  # events of the previous time sample, so that cancellation is quick
                    event.wait()
                progress.done, progress.total = done, total
            done += number < samples  # still sources are no time sample
        for film in films:
            film.read(session)
    return films
