"""Acceptance of samples, and values derived from their images. A coarse grid of rays is traced in float64 by NumPy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.folder import RefusedError
from clsco.errors import SceneError
from clsco.optics.exposure import middle_time
from clsco.optics.lens import LARGEST_BLUR
from clsco.optics.lens_path import camera_at, lenses_at
from clsco.optics.motion import moved_points, poses_at, rest_center
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.rays import places_of, slopes_at
from clsco.optics.resolved_view import without_lens
from clsco.scene.model import Rectangle, Scene
from clsco.scene.text import shown

Array = NDArray[np.float64]
RAYS = 64  # per axis
DIGITS = 6  # digits of a derived value: too few to show differences between machines in the last bits
MOMENT = 1e-6  # s, first value of the search for an interval
STEPS, LONGEST = 60, 1e6  # steps of that search, and its longest interval in s
MEASURES = ("max_blur_px", "max_flow_px", "visible_fraction", "valid_fraction")
DERIVED = {
    ("sequence", "interval"): "largest_flow_px",
    ("sequence", "shutter"): "share_of_interval",
    ("camera", "focus_distance"): "depth_quantile",
    ("camera", "f_number"): "largest_blur_px",
}
"""Keys that may be derived, in the order of derivation, each with the name of the target that its table states."""


class UnfitError(SceneError):
    """A key cannot be derived from the drawn values. The sample is drawn again."""


@dataclass(frozen=True)
class Look:
    """Measures of surfaces that RAYS x RAYS rays, on a regular grid over each of some frames of a sample, meet.

    inverse_depth: 1/Z where each ray meets a surface, 1/mm. blur: |R| there and in the background, px. flow: length of
    the flow there to the next frame, px. valid: share of rays that meet a surface, in the frame where it is smallest.
    visible: share of an object's rays that are not occluded, for the object and the frame where it is smallest; 0 if an
    object is outside the frame. A box is one object.
    """

    inverse_depth: Array
    blur: Array
    flow: Array
    valid: float
    visible: float

    def measure(self, name: str) -> float:
        """The measure with a name from MEASURES."""
        values = dict(zip(MEASURES, (self.blur, self.flow, self.visible, self.valid), strict=True))
        return float(np.max(np.asarray(values[name]), initial=0.0))


@dataclass(frozen=True)
class _Frame:
    """Rays through one frame."""

    number: int
    w: Array  # (RAYS, RAYS), 1/Z of the nearest object, 1/mm; 0 without an object
    front: NDArray[np.int64]  # (RAYS, RAYS), number of the nearest object; -1 without an object
    hits: NDArray[np.bool_]  # (objects, RAYS, RAYS), True where a ray meets an object, even an occluded one


def looks_of(scenes: Sequence[Scene]) -> list[Look]:
    """Cast rays at each variant of a sample. The scenes are analytic and have a resolution.

    Stereo pairs are seen from the left view.
    """
    by_lens: dict[Scene, list[_Frame]] = {}  # rays by scene without its lens: all lenses share them
    looks = []
    for scene in scenes:
        key = without_lens(scene)
        if key not in by_lens:
            numbers = sorted({0, scene.sequence.frames // 2, scene.sequence.frames - 1})
            by_lens[key] = [_cast_rays(scene, number) for number in numbers]
        looks.append(_measure_frames(scene, by_lens[key]))
    return looks


def _slopes(scene: Scene, time: float) -> tuple[Array, Array]:
    assert scene.camera.resolution is not None
    columns, rows = scene.camera.resolution
    share = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    return slopes_at(camera_at(scene, time), *np.meshgrid(share * columns, -share * rows))


def _cast_rays(scene: Scene, number: int) -> _Frame:
    time = middle_time(scene.sequence, number) if scene.moves else 0.0
    rays = _slopes(scene, time)
    placed = zip(scene.objects, poses_at(scene, time), strict=True)
    w = np.array([predict_inverse_depth(item, place(item, pose), *rays) for item, pose in placed])
    front = np.where(w.max(axis=0) > 0.0, w.argmax(axis=0), -1)
    return _Frame(number, w.max(axis=0), front, w > 0.0)


def _flow(scene: Scene, frame: _Frame, interval: float) -> Array:
    """Length of flow over an interval in s: (RAYS, RAYS), px; 0 without a surface, or if it moves behind the lens."""
    time = middle_time(scene.sequence, frame.number)
    now, then = poses_at(scene, time), poses_at(scene, time + interval)
    x, y = _slopes(scene, time)
    here, there = (camera_at(scene, when) for when in (time, time + interval))
    length = np.zeros(frame.w.shape)
    for number, item in enumerate(scene.objects):
        own = frame.front == number
        if item.is_background or not own.any():
            continue
        rays = np.stack([x[own], y[own], np.ones(int(own.sum()))])
        point = moved_points((rays / frame.w[own]).T, rest_center(item), now[number], then[number]).T
        ahead = point[2] > 0.0
        flow = np.subtract(places_of(there, *(point[:2] / np.where(ahead, point[2], 1.0))), places_of(here, *rays[:2]))
        length[own] = np.where(ahead, np.sqrt((flow * flow).sum(axis=0)), 0.0)
    return length


def _measure_frames(scene: Scene, frames: Sequence[_Frame]) -> Look:
    backgrounds = [number for number, item in enumerate(scene.objects) if item.is_background]
    bodies = _bodies(scene)
    valid, visible = 1.0, 1.0
    depths, radii, flows = list[Array](), list[Array](), list[Array]()
    for frame in frames:
        hit = (frame.front >= 0) & ~np.isin(frame.front, backgrounds)
        valid = min(valid, float(hit.mean()))
        for body in bodies:
            alone, in_front = frame.hits[body].any(axis=0), np.isin(frame.front, body)
            visible = min(visible, float(in_front.sum() / max(1, alone.sum())))
        depths.append(frame.w[hit])
        flows.append(_flow(scene, frame, scene.sequence.interval)[hit] if scene.moves else np.zeros(hit.sum()))
        time, hit = middle_time(scene.sequence, frame.number), frame.front >= 0
        x, y = _slopes(scene, time)
        radii += [np.abs(lens.image_radius(frame.w[hit], x[hit], y[hit])) for lens in lenses_at(scene, time)]
    return Look(np.concatenate(depths), np.concatenate(radii), np.concatenate(flows), valid, visible)


def _bodies(scene: Scene) -> list[list[int]]:
    """For each object in the scene file except backgrounds: its numbers in the scene, where a box is six rectangles."""
    bodies: dict[Any, list[int]] = {}
    for number, item in enumerate(scene.objects):
        name, _, side = item.name.rpartition(" ")
        of_a_box = isinstance(item, Rectangle) and side in ("front", "back", "left", "right", "top", "bottom")
        if not item.is_background:
            bodies.setdefault((name, rest_center(item).tobytes()) if of_a_box else number, []).append(number)
    return list(bodies.values())


Bounds = tuple[tuple[str, float, float], ...]


def bounds_of(table: Any) -> tuple[Bounds, list[str]]:
    """The measures in the table [accept] with their lower and upper bounds, and messages on faults of the table."""
    if not isinstance(table, Mapping):
        return (), [f"accept: must be a table; got {shown(table)}"]
    bounds, faults = [], list[str]()
    for name, value in table.items():
        if name not in MEASURES:
            faults.append(f"accept.{name[:64]}: unknown key; must be {', '.join(MEASURES)}; got {shown(value)}")
            continue
        ends = value if isinstance(value, Mapping) else {"max": value} if name.startswith("max") else {"min": value}
        if not ends or ends.keys() - {"min", "max"} or not all(map(_is_number, ends.values())):
            faults.append(f"accept.{name}: must be a number, or {{ min = number, max = number }}; got {shown(value)}")
            continue
        low, high = (float(ends.get(end, default)) for end, default in (("min", -np.inf), ("max", np.inf)))
        if low > high:
            faults.append(f"accept.{name}: min must be at most max; got {shown(low)} and {shown(high)}")
        bounds.append((name, low, high))
    return tuple(bounds), faults


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, int | float) and 0.0 <= value <= 1e9


def refusal(bounds: Bounds, scenes: Sequence[Scene]) -> str | None:
    """Reason why a sample is rejected, `measure must be ...; got value`, or None."""
    if not bounds:
        return None
    for look in looks_of(scenes):
        for name, low, high in bounds:
            value = look.measure(name)
            if not low <= value <= high:
                end = f"at least {low:g}" if value < low else f"at most {high:g}"
                return f"{name} must be {end}; got {value:.4g}"
    return None


def derive_value(key: tuple[str, ...], target: float, scenes: Sequence[Scene]) -> float:
    """Value of a key of DERIVED, rounded to DIGITS digits, with which the variants of a sample meet a target.

    target: value of the quantity that DERIVED names for the key. Raises UnfitError if no value of the key meets it.
    """
    name = ".".join(key)
    if key == ("sequence", "shutter"):
        return _rounded(target * scenes[0].sequence.interval)
    if key == ("sequence", "interval"):
        return _interval(target, scenes)
    looks = looks_of(scenes)
    if key == ("camera", "focus_distance"):
        w = np.sort(np.concatenate([look.inverse_depth for look in looks]))[::-1]
        if not len(w):
            raise UnfitError(f"derive.{name}: a surface must be in the frame; got none")
        return _rounded(1.0 / float(w[int(target * (len(w) - 1))]))
    blurs = [look.measure("max_blur_px") for look in looks]
    largest, scene = max(blurs), scenes[blurs.index(max(blurs))]
    if not largest > 0.0:
        raise UnfitError(f"derive.{name}: something must be out of focus; got a largest blur radius of 0")
    return _rounded(scene.camera.focal_length / scene.camera.aperture_diameter * largest / target)


def _interval(target: float, scenes: Sequence[Scene]) -> float:
    """Time in s in which the fastest visible point of the first variant moves by `target` px, from t = 0 on."""
    scene = scenes[0]
    if not scene.moves:
        raise UnfitError("derive.sequence.interval: something must move in the frame; got none that does")
    # Flow starts at the middle of the exposure, which may depend on the interval; so the reference pose replaces it.
    still = scene.model_copy(update={"sequence": scene.sequence.model_copy(update={"shutter": 0.0})})
    frame = _cast_rays(still, 0)
    low, high, time, flow = 0.0, math.inf, MOMENT, 0.0
    for _ in range(STEPS):
        flow = float(_flow(still, frame, time).max())
        low, high = (low, time) if flow >= target else (time, high)
        if abs(flow - target) <= 1e-9 * target:
            return _rounded(time)
        if not flow > 0.0 or time > LONGEST:
            break
        guess = time * target / flow  # exact where the flow grows with the time
        time = guess if low < guess < high else 0.5 * (low + high) if high < math.inf else 2.0 * time
    rule = f"derive.sequence.interval: something in the frame must move by {target:g} px"
    raise UnfitError(f"{rule}; got {flow:.3g} px in {time:.3g} s")


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def parse_target(key: tuple[str, str], value: Any) -> Any:
    """Value of a key of [derive]: a number, or a distribution. Raises RefusedError."""
    form = DERIVED[key]
    if not isinstance(value, Mapping) or set(value) != {form}:
        raise RefusedError(f"must be {{ {form} = value }}")
    target = value[form]
    if isinstance(target, Mapping):
        return target
    most = 1.0 if form in ("depth_quantile", "share_of_interval") else LARGEST_BLUR
    if not _is_number(target) or not (target > 0.0 or form == "depth_quantile") or target > most:
        raise RefusedError(f"{form} must be a number up to {most:g}", shown(target))
    return target
