"""Decisions of a plan, each made by one function: which parts of the pipeline a scene needs, and why not the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from clsco.errors import SceneError
from clsco.frame.outputs import ALL_TRUTH, OUTPUTS, SENSOR_NAMES, Group
from clsco.optics.exposure import frame_exposure, subframes_of
from clsco.optics.lens_path import reference_camera
from clsco.optics.motion import poses_at
from clsco.optics.quadrics import Extent, place
from clsco.optics.resolved_view import ResolvedView
from clsco.optics.visibility import OcclusionGroup
from clsco.plan.device import DeviceFacts
from clsco.plan.methods import MANY_RADII, Blur, Choice, Occlusion, choose_blur
from clsco.plan.request import Request
from clsco.scene.model import Aperture, Fill, Scene

LEAST_SAVED = 3.0  # time samples' worth of still sources that are blurred once, which has to outweigh their own pass
MOST_NAMED = 3  # largest number of objects whose time samples are reported
WHOLE_PIXELS = "the forward warp moves whole pixels"
NO_COLOR = "nobody asked for the color: neither its rays nor its blur"
EXPOSURE_KEYS = ("samples", "sampling", "shutter", "shutter_curve", "shutter_start", "readout", "scan")
MOTION_KEYS = (*(f"sequence.{key}" for key in EXPOSURE_KEYS), "motion.rotation")
FILL_KEYS = tuple(f"fill.{key}" for key in Fill.model_fields)
SPREAD_KEYS = ("psf.tilt", "psf.occlusion", "psf.border")  # keys that have no effect if light stays in its pixel
OPENING_KEYS = tuple(f"aperture.{key}" for key in Aperture.model_fields if key != "exposure")
# Groups of outputs that some scenes do not have. Each has the condition under which a scene has its outputs, and the
# reason that reports state otherwise.
POSSIBLE: tuple[tuple[Group, Callable[[Scene], bool], str], ...] = (
    ("stereo", lambda scene: scene.stereo is not None, "there is one view"),
    ("motion", lambda scene: scene.moves, "nothing moves"),
    ("surfaces", lambda scene: scene.has_mapped_textures, "no texture lies on a surface"),
    ("sensor", lambda scene: scene.sensor is not None, "there is no sensor"),
    ("lens", lambda scene: scene.darkens or bool(scene.aperture.rim), "the lens darkens nothing"),
    ("readout", lambda scene: scene.rolls, "all rows are exposed at once"),
)


@dataclass(frozen=True)
class Choices:
    """Decisions of a plan, in the order in which reports list the parts that are left out."""

    image: Choice[bool]
    motion: Choice[int]  # time samples while a line is exposed
    trace: Choice[bool]
    texture_sampling: Choice[bool]  # interpolate textures between their texels
    reproject: Choice[bool]  # move pixels of the reference pose
    fill: Choice[bool]
    silhouettes: Choice[int]  # sub-pixel sources per axis
    tilt: Choice[bool]  # weights depend on the gradient of R
    blur: Choice[Blur]
    renormalize: Choice[bool]  # return light that crosses the border to the frame
    guard_band: Choice[bool]  # include light from surfaces beyond the frame
    color: Choice[bool]
    occlusion: Choice[Occlusion]
    ground_truth: Choice[tuple[str, ...]]  # outputs besides color and alpha
    still_sources: Choice[bool]  # blur sources that all time samples share once
    other_outputs: Choice[bool]  # False if only some outputs are requested; the reason names the others

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """Pairs (name, reason) of the parts of the pipeline that are left out; without an image, only "image"."""
        if self.image.left_out:
            return (("image", self.image.reason),)
        return tuple((name, choice.reason) for name, choice in self._all().items() if choice.left_out)

    @property
    def unused(self) -> dict[str, str]:
        """Reasons why keys of the scene have no effect, by key."""
        return {key: choice.reason for choice in self._all().values() for key in choice.unused}

    def _all(self) -> dict[str, Choice[object]]:
        return {field.name.replace("_", " "): getattr(self, field.name) for field in fields(self)}


def choose(
    view: ResolvedView, request: Request, channels: int, device: DeviceFacts
) -> tuple[Choices, tuple[OcclusionGroup, ...], tuple[Extent, ...]]:
    """Make all decisions for a view of a scene; also returns its occlusion groups, and the extents of objects within
    which the groups are valid. Raises SceneError if the requested method of blur cannot be used.
    """
    scene, silhouettes = view.scene, choose_silhouettes(view)
    occlusion, groups, extents = choose_occlusion(view)
    one_stencil, occluded = view.one_radius and scene.psf.border == "lose", occlusion.value == "visibility"
    properties = view.largest, channels, one_stencil, silhouettes.left_out, occluded
    blur = choose_blur(request.method, view.psf, device, *properties)
    if blur.left_out:
        aperture = OPENING_KEYS if view.largest <= 0.5 else ()  # any aperture keeps all light in its pixel
        why = f"in focus: R up to {view.largest:.3g} px stays within its pixel"
        blur = replace(blur, reason=why, unused=(*SPREAD_KEYS, *aperture))
    renormalize, guard_band = choose_border(view)
    truth, other_outputs = choose_truth(view, request)
    choices = Choices(
        image=Choice(True) if request.color else Choice(False, NO_COLOR),
        motion=choose_samples(view),
        trace=choose_rays(view),
        texture_sampling=choose_texture_sampling(view),
        reproject=choose_warp(view),
        fill=choose_fill(view),
        silhouettes=silhouettes,
        tilt=choose_tilt(view, blur.value),
        blur=blur,
        renormalize=renormalize,
        guard_band=guard_band,
        color=Choice(True) if channels > 1 else Choice(False, "gray texture: one channel"),
        occlusion=occlusion,
        ground_truth=truth,
        still_sources=Choice(True),
        other_outputs=other_outputs,
    )
    return replace(choices, still_sources=choose_still_sources(view, choices, groups)), groups, extents


def choose_samples(view: ResolvedView) -> Choice[int]:
    """Choose the number of time samples while a line of the frame is exposed; 0 if nothing moves. Raises SceneError for
    too many time samples.
    """
    scene = view.scene
    if not scene.moves:
        return Choice(0, "nothing moves: one sample, in the reference pose", MOTION_KEYS)
    from clsco.optics.image_motion import MOST_SUBFRAMES, lens_samples, motion_needs, motion_samples

    if scene.sequence.samples == "auto":
        # Without visibility tests, an outline is as sharp as the surface behind.
        soft = scene.psf.occlusion != "none" or len(scene.objects) == 1
        gradual = view.casts_rays and soft
        needs = motion_needs(scene, view.psf, view.maps, view.guard, gradual)
        object_words = [f"{scene.objects[need.number].name} {need}" for need in needs[:MOST_NAMED]]
        omitted = [f"{len(needs) - MOST_NAMED} more"] if len(needs) > MOST_NAMED else []
        lens = lens_samples(scene, view.maps)
        words = ([f"the lens {lens}"] if lens > 1 else []) + object_words + omitted
        why = f"from the motion: {', '.join(words) or 'none is seen'}"
        choice = Choice(max(motion_samples(scene, needs), lens), why)
    else:
        choice = Choice(scene.sequence.samples)
    if (count := subframes_of(scene, choice.value)) > MOST_SUBFRAMES:
        hint = "fewer samples, a shorter readout or a longer shutter need fewer"
        raise SceneError(f"sequence.readout: must give at most {MOST_SUBFRAMES} sub-frames; got {count} ({hint})")
    return choice if scene.rolls else replace(choice, unused=("sequence.scan",))


def choose_warp(view: ResolvedView) -> Choice[bool]:
    """Decide whether a forward warp moves pixels of the reference pose."""
    scene = view.scene
    if view.is_forward:
        return Choice(True)
    if scene.motion.warp == "forward" and scene.is_analytic:
        return Choice(False, "no forward warp, as nothing moves", ("motion.warp",))
    return Choice(False, "no forward warp")


def choose_rays(view: ResolvedView) -> Choice[bool]:
    """Decide whether to cast rays."""
    if view.is_static_map:
        return Choice(False, "a static depth map: its own pixels")
    return Choice(True) if view.casts_rays else Choice(False, "replaced by the forward warp")


def choose_texture_sampling(view: ResolvedView) -> Choice[bool]:
    """Decide whether to interpolate textures between their texels."""
    scene, key = view.scene, ("motion.texture_filter",)
    if view.is_forward:
        return Choice(False, WHOLE_PIXELS, key)
    if scene.is_displaced or view.is_shifted or scene.has_mapped_textures or scene.shifts_colors:
        return Choice(True)
    return Choice(False, "nothing moves: every pixel shows its own texel", key if scene.stereo is None else ())


def choose_fill(view: ResolvedView) -> Choice[bool]:
    """Decide whether to fill missing pixels."""
    if view.casts_rays:
        return Choice(False, "only a forward warp leaves pixels missing", FILL_KEYS)
    if view.scene.fill.method == "none":
        return Choice(False, "fill.method is none", ("fill.domain",))
    if view.is_static_map:
        return Choice(False, "a depth map is filled as it is read", ("fill.domain",))
    return Choice(True)


def choose_silhouettes(view: ResolvedView) -> Choice[int]:
    """Choose the number of sub-pixel sources per axis; 0 if every source is a pixel."""
    settings, key = view.scene.psf, ("psf.silhouette_samples",)
    samples = settings.silhouette_samples
    if samples == 1:
        return Choice(0, "silhouette_samples = 1")
    if not view.casts_rays:
        return Choice(0, "a depth map has whole pixels" if view.is_static_map else WHOLE_PIXELS, key)
    if settings.occlusion == "layered" and not view.hides_nothing:
        return Choice(0, "depth layers have whole pixels", key)
    if view.is_uniform:
        return Choice(0, "no silhouette in sight", key)
    return Choice(samples)


def choose_occlusion(view: ResolvedView) -> tuple[Choice[Occlusion], tuple[OcclusionGroup, ...], tuple[Extent, ...]]:
    """Choose the method of occlusion; also returns the occlusion groups, and the extents of objects within which the
    groups are valid, which are empty if the groups are always valid.
    """
    method, key = view.scene.psf.occlusion, ("psf.occlusion",)
    one_group = (OcclusionGroup((1 << len(view.scene.objects)) - 1, 0),)
    if method == "none":
        return Choice("none", 'occlusion = "none"'), one_group, ()
    if view.hides_nothing:
        return Choice("none", "one object", key), one_group, ()
    if method == "layered" or not view.casts_rays:
        return Choice("layered"), one_group, ()
    hides = any(group.occluders for group in view.occlusion_groups)
    choice: Choice[Occlusion] = Choice("none", "no object hides another within its blur", key)
    return Choice("visibility") if hides else choice, view.occlusion_groups, view.extents


def choose_tilt(view: ResolvedView, blur: Blur) -> Choice[bool]:
    """Decide whether weights depend on the gradient of R."""
    if not view.scene.psf.tilt:
        return Choice(False, "tilt = false")
    if blur == "none":
        return Choice(False, "everything is in focus", ("psf.tilt",))
    return Choice(False, "one radius for all pixels", ("psf.tilt",)) if view.one_radius else Choice(True)


def choose_border(view: ResolvedView) -> tuple[Choice[bool], Choice[bool]]:
    """Choose the values of `Choices.renormalize` and `Choices.guard_band`."""
    if view.scene.psf.border == "renormalize":
        return Choice(True), Choice(False, "light stays inside the frame")
    beyond = "the mirrored map" if view.is_static_map else "surface"
    return Choice(False, 'border = "lose"'), Choice(True, f"{beyond} outside the frame lights it")


def choose_still_sources(
    view: ResolvedView, choices: Choices, groups: tuple[OcclusionGroup, ...]
) -> Choice[bool]:  # fmt: skip
    """Decide whether to blur sources that all time samples share once."""
    scene = view.scene
    if not scene.moves:
        return Choice(True)
    if not choices.trace.value or choices.occlusion.value == "layered" or choices.blur.value not in MANY_RADII:
        return Choice(False, "sources are not made one by one from rays")
    if scene.camera.moves or scene.lens_moves:
        return Choice(False, "the camera or its lens changes")
    if scene.shifts_colors or (scene.lens is not None and scene.lens.distorts):
        return Choice(False, "the lens distorts the image")
    if "subframes" in choices.ground_truth.value:
        return Choice(False, "each sub-frame needs all sources")
    from clsco.optics.still import map_changes, moving_objects

    exposure = frame_exposure(scene, 0, choices.motion.value)
    poses = [poses_at(scene, time, view.eye) for time in exposure.times.tolist()]
    moving, rest = moving_objects(poses), [place(*pair) for pair in zip(scene.objects, poses[0], strict=True)]
    surfaces = [[place(scene.objects[k], each[k]) if k in moving else s for k, s in enumerate(rest)] for each in poses]
    changing = total = 0
    for group in groups:
        changes = map_changes(group, moving, surfaces, reference_camera(scene), view.psf.extent, view.guard)
        w = view.w[[k for k in range(len(scene.objects)) if group.members >> k & 1], 0].max(axis=0)
        places = (np.linspace(0, size - 1, len(w)).round().astype(int) for size in changes.shape)
        total, changing = total + (w > 0).sum(), changing + ((w > 0) & (w <= changes[np.ix_(*places)])).sum()
    share = float(changing / max(total, 1))
    samples = (exposure.weights.reshape(len(poses), -1) > 0.0).sum(axis=0).mean()  # in which a line is exposed
    enough = samples * (1.0 - share) >= LEAST_SAVED
    return Choice(True) if enough else Choice(False, f"{share:.0%} of the sources of {samples:.3g} samples may change")


def choose_truth(view: ResolvedView, request: Request) -> tuple[Choice[tuple[str, ...]], Choice[bool]]:
    """Choose the values of `Choices.ground_truth` and `Choices.other_outputs`."""
    names, reasons = request.truth, {group: why for group, can, why in POSSIBLE if not can(view.scene)}
    impossible = {name: reasons[row.group] for name, row in OUTPUTS.items() if row.group in reasons}
    impossible |= {} if request.color else dict.fromkeys(SENSOR_NAMES, "no image is made")
    chosen = tuple(name for name in names if name != "alpha" and name not in impossible)
    omitted = [name for name in ALL_TRUTH if name not in chosen and name not in impossible]
    why = "; ".join(dict.fromkeys(impossible[name] for name in names if name in impossible))
    choice = Choice(chosen) if chosen else Choice(chosen, why or "nobody asked for it")
    return choice, Choice(False, f"nobody asked for {', '.join(omitted)}") if chosen and omitted else Choice(True)
