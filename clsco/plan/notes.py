"""Notes, before rendering, on scenes that may not look as intended, judged by geometry, and on keys without effect."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from clsco.optics.exposure import shutter_span
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at
from clsco.optics.light import PlacedLight, place_light
from clsco.optics.motion import poses_at
from clsco.optics.quadrics import PlacedSurface, predict_inverse_depth
from clsco.optics.quadrics import place as surface_at
from clsco.optics.rays import slopes_at
from clsco.plan.plan import Plan
from clsco.scene.model import Camera, Object, Rectangle, Scene

CLOSE = 0.02  # fraction by which sizes may differ from those of textbook formulas without a note
RAYS = 65  # rays per axis of the frame; if they miss an object, also per axis of its image's bounds
FEW_FRAMES, MOST_FRAMES = 5, 64  # number of examined frames: at first, and if these do not show an object
LENS_POINTS = np.exp(0.25j * np.pi * np.arange(8))  # at the edge, which may see objects that the middle does not
MOST_NAMED = 3
SECTIONS = ("aperture", "psf", "sequence", "motion", "fill")

Array = NDArray[np.float64]


def close_focus_note(camera: Camera) -> str | None:
    """A note if the focus is so close that sizes differ from textbook formulas. None if they do not, or if the scene
    sets the key normalization_distance.
    """
    share = 1.0 - camera.normalization_distance / camera.sensor_distance
    if "normalization_distance" in camera.model_fields_set or abs(share) <= CLOSE:
        return None
    return (
        f"camera.normalization_distance: image and blur are {100 * share:.2g} % (f/u) smaller than a textbook's, being "
        'those at the focal length; "sensor" gives the textbook\'s'
    )


@dataclass
class _Sight:
    """Visibility of each body at the times examined so far. A body is an object, or a box with all its faces.

    lit: True if the light reaches a visible side of any body.
    """

    visible: dict[Hashable, bool] = field(default_factory=dict)
    widest: dict[Hashable, float] = field(default_factory=dict)  # largest width of the image, px
    names: dict[Hashable, str] = field(default_factory=dict)
    lit: bool = False

    @property
    def missing(self) -> list[Hashable]:
        return [body for body, visible in self.visible.items() if not visible]


def sight_notes(plans: tuple[Plan, ...]) -> list[str]:
    """Notes on objects that no frame shows or whose image is narrower than a pixel, on a light that shines only on
    hidden sides, and on black frames; empty for scenes with depth maps.

    plans: plans of the views of a scene. FEW_FRAMES frames are examined at the beginning, middle and end of their
    exposures, from the middle of the lens. If these do not show an object, up to MOST_FRAMES frames are examined and,
    with visibility tests, also from points near the edge of the lens.
    """
    scene = plans[0].scene
    if not scene.is_analytic:
        return []
    sight, dark = _Sight(), dict[int, bool]()
    count = scene.sequence.frames if scene.moves else 1
    for most in (FEW_FRAMES, MOST_FRAMES):
        for frame in np.unique(np.linspace(0, count - 1, most).round().astype(int)).tolist():
            if frame not in dark and (most == FEW_FRAMES or sight.missing):
                times = np.linspace(*shutter_span(scene.sequence, frame), 3).tolist() if scene.moves else [0.0]
                looks = [_examine(sight, scene, plan, time) for plan in plans for time in times]
                dark[frame] = not any(looks)
    if sight.missing and scene.psf.occlusion == "visibility":
        for frame, plan, place in product(dark, plans, 0.9 * LENS_POINTS):
            if sight.missing:
                middle = sum(shutter_span(scene.sequence, frame)) / 2 if scene.moves else 0.0
                dark[frame] &= not _examine(sight, scene, plan, middle, (place.real, place.imag))
    notes = []
    looked = "" if len(dark) == count else f", of {len(dark)} frames that were looked at"
    if sight.missing:
        names = _join_first([sight.names[body] for body in sight.missing])
        notes.append(f"objects that are not in sight, beside or behind the picture or hidden: {names}{looked}")
    small = [f"{sight.names[body]} ({width:.2g} px)" for body, width in sight.widest.items() if 0.0 < width < 1.0]
    if small:
        notes.append(f"objects whose image is less than a pixel wide: {_join_first(small)}")
    if scene.light is not None and scene.light.ambient == 0.0 and any(sight.visible.values()) and not sight.lit:
        notes.append("light: falls on no side that is in sight, so that all of them are black without light.ambient")
    if black := sorted(frame for frame in dark if dark[frame]):
        which = f"frame{'s' * (len(black) > 1)} {_join_first(black)}" if any(sight.visible.values()) else "all frames"
        notes.append(f"nothing is in sight, and all is black, in {which}{looked}")
    return notes


def _join_first(words: list[str] | list[int]) -> str:
    omitted = len(words) - MOST_NAMED
    return ", ".join(map(str, words[:MOST_NAMED])) + (f" and {omitted} more" if omitted > 0 else "")


def _body(index: int, item: Object) -> tuple[Hashable, str]:
    """Key and name of an object's body: the object, or the whole box if the object is a face of a box."""
    if isinstance(item, Rectangle) and item.offset:
        name = item.name.rpartition(" ")[0] or item.name
        return (item.center, name), name
    return index, item.name


def _examine(
    sight: _Sight, scene: Scene, plan: Plan, time: float, place: tuple[float, float] = (0.0, 0.0)
) -> bool:  # fmt: skip
    """Examine a view of a scene at a time, and record in `sight` what is visible; returns True if any object is.

    place: point of the lens from which to look, in lens radii from its middle.
    """
    camera, light = camera_at(scene, time), place_light(scene, time, plan.eye)
    eye, power = np.array([*place, 0.0]) * camera.aperture_diameter / 2, 1.0 / camera.focused_distance
    poses = (replace(pose, shift=pose.shift - eye) for pose in poses_at(scene, time, plan.eye))
    surfaces = [surface_at(*values) for values in zip(scene.objects, poses, strict=True)]
    if light is not None and light.is_near:
        light = replace(light, place=light.place - eye)
    guard = 0 if any(place) else plan.guard_px  # the guard band is for rays from the middle
    across = (np.linspace(-0.5, 0.5, RAYS) * (size - 1 + 2 * guard) for size in camera.frame_size)
    x, y = slopes_at(camera, *np.meshgrid(*across))
    frame = x - eye[0] * power, y - eye[1] * power  # rays from all points of the lens cross in the focal surface
    depths, any_seen = _depths(scene, surfaces, frame), False
    for k, (item, surface) in enumerate(zip(scene.objects, surfaces, strict=True)):
        body, name = _body(k, item)
        sight.names[body] = name
        rays, w = frame, depths
        visible = (w[k] > 0) & (w[k] >= w.max(axis=0))
        missed = not visible.any() and not sight.visible.get(body)
        if missed and (near_rays := _rays_around(surface, frame)) is not None:
            rays, w = near_rays, _depths(scene, surfaces, near_rays)
            visible = (w[k] > 0) & (w[k] >= w.max(axis=0))
        sight.visible[body] = sight.visible.get(body, False) or bool(visible.any())
        if not visible.any():
            continue
        any_seen = True
        low, high = surface.extent.x
        sight.widest[body] = max(sight.widest.get(body, 0.0), (high - low) / ray_step(camera))
        if light is not None and not sight.lit and light.members >> k & 1:
            sight.lit = _is_lit(surface, light, *(values[visible] for values in (*rays, w[k])))
    return any_seen


def _depths(scene: Scene, surfaces: list[PlacedSurface], rays: tuple[Array, Array]) -> Array:
    """Inverse depths (objects, ...) of all objects along rays; 0 for a miss."""
    pairs = zip(scene.objects, surfaces, strict=True)
    return np.stack([predict_inverse_depth(item, surface, *rays) for item, surface in pairs])


def _rays_around(surface: PlacedSurface, frame: tuple[Array, Array]) -> tuple[Array, Array] | None:
    """Rays within the bounds of an object's image; None if the bounds are outside of the frame."""
    ends = []
    for slopes, bounds in zip(frame, (surface.extent.x, surface.extent.y), strict=True):
        low, high = max(float(slopes.min()), bounds[0]), min(float(slopes.max()), bounds[1])
        if low > high:
            return None
        ends.append(np.linspace(low, high, RAYS))
    x, y = np.meshgrid(*ends)
    return x, y


def _is_lit(surface: PlacedSurface, light: PlacedLight, x: Array, y: Array, w: Array) -> bool:
    """True if the light shines on the visible side of a surface at any of its points. x, y: slopes of the rays to the
    points; w: inverse depths of the points.
    """
    ray = np.stack([x, y, np.ones_like(x)])
    shape, turn = surface.canonical, surface.turn
    point = turn @ ray + surface.offset[:, None] * w  # times w
    normal = turn.T @ (shape.q[:, None] * point + shape.l[:, None] * w)
    normal *= -np.sign((normal * ray).sum(axis=0))  # towards the lens
    towards = light.place[:, None] * (w if light.is_near else 1.0) - (ray if light.is_near else 0.0)
    return bool(((normal * towards).sum(axis=0) > 0.0).any())


def unused_keys(plan: Plan) -> list[tuple[str, str]]:
    """Keys that the scene sets although they have no effect, as pairs of key and reason."""
    scene, reasons = plan.scene, plan.choices.unused | _idle_keys(plan.scene)
    tables = [(name, getattr(scene, name)) for name in SECTIONS]
    tables += [(f"object[{k}]", item) for k, item in enumerate(scene.objects)]
    tables += [(f"group[{k}]", group) for k, group in enumerate(scene.groups)]
    keys = [f"{place}.{key}" for place, table in tables for key in sorted(table.model_fields_set)]
    return [(key, reasons[key]) for key in keys if key in reasons]


def _idle_keys(scene: Scene) -> dict[str, str]:
    """Reasons for keys that have no effect whatever is requested, by key."""
    reasons = {}
    motions = [scene.camera.motion, *(motion for item in scene.objects for motion in scene.motions(item))]
    if scene.moves and all(sum(motion.turns) < 2 for motion in motions):
        reasons["motion.rotation"] = "euler and axis differ only for turns about several axes"
    for k, item in enumerate(scene.objects):
        if not item.is_analytic and item.group is None and not any(item.motion.turns):
            reasons[f"object[{k}].center"] = "the depth map does not turn"
    for k, group in enumerate(scene.groups):
        if all(item.group != group.name for item in scene.objects):
            reasons |= {f"group[{k}].{key}": "no object is in it" for key in type(group).model_fields}
    return reasons
