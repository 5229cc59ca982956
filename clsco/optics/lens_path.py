"""The lens as a function of time (float64, pure)."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import chain, pairwise
from typing import Any

import numpy as np

from clsco.errors import SceneError
from clsco.optics.distortion import with_distortion
from clsco.optics.exposure import sequence_times
from clsco.optics.keyframes import Path, path_through
from clsco.optics.lens import Lens
from clsco.scene.camera import FollowedDistance
from clsco.scene.model import Camera, Scene
from clsco.scene.model import Lens as SceneLens

DENSE = 33  # number of times between two keyframes at which the widest aperture is searched
WIDER = 1.01  # factor that covers apertures between these times


def reference_camera(scene: Scene) -> Camera:
    """The camera of the reference pose, which defines the pixels of textures and depth maps."""
    return with_distortion(scene.camera, scene.lens)


def camera_at(scene: Scene, time: float) -> Camera:
    """The camera with its lens at a time in s; `reference_camera` if the lens does not change.

    With a zoom, the image scale s0 is proportional to the focal length; but if the scene does not give s0, it is equal
    to the sensor distance, which focusing changes as well. Focus distance and f-number without keyframes stay constant:
    a zoom changes sensor distance and aperture. Raises SceneError if a path between keyframes has values that no lens
    can have.
    """
    if scene.lens is None or not scene.lens.moves:
        return reference_camera(scene)
    camera, scale, changed = scene.camera, scene.camera.normalization_distance, dict[str, Any]()
    zoom, focus, opening = _paths(scene.lens)
    f, power, share = camera.focal_length, 1.0 / camera.focused_distance, 1.0 / camera.opening
    if zoom is not None:
        f = float(zoom.at(time)[0])
        if not f > 0.0:
            raise SceneError(_rule("focal_length", "above 0 mm", f, time))
        changed |= {"focal_length": f, "normalization_distance": scale * f / camera.focal_length}
    if focus is not None:
        power = float(focus.at(time)[0])
    if focus is not None or zoom is not None:
        if not power < 1.0 / f:
            raise SceneError(_rule("focus_distance", f"greater than the focal length, {f:g} mm", 1.0 / power, time))
        finite = power > 0.0  # else the focus is beyond infinity
        changed |= {"focus_distance": 1.0 / power if finite else None, "sensor_distance": 1.0 / (1.0 / f - power)}
        if isinstance(scale, FollowedDistance):
            changed["normalization_distance"] = FollowedDistance(changed["sensor_distance"])
    if opening is not None:
        share = float(opening.at(time)[0])
        if not share > 0.0:
            raise SceneError(_rule("f_number", "above 0", share and 1.0 / share, time))
        changed |= {"f_number": 1.0 / share}
    if opening is not None or zoom is not None:
        changed |= {"aperture_diameter": f * share}
    return with_distortion(camera.model_copy(update=changed), scene.lens)


def _rule(key: str, rule: str, value: float, time: float) -> str:
    return f'lens.keyframe: {key} must stay {rule}, as with interpolation = "linear"; got {value:.6g} at {time:.6g} s'


def colored(camera: Camera, lens: SceneLens | None, color: int | None) -> Camera:
    """The camera for light of one color, with its magnification; unchanged if `color` is None."""
    if lens is None or color is None or lens.lateral[color] == 1.0:
        return camera
    return camera.model_copy(update={"normalization_distance": camera.normalization_distance * lens.lateral[color]})


def lens_at(scene: Scene, time: float, color: int | None = None) -> Lens:
    """The lens at a time in s; color: as for `clsco.optics.lens.Lens.of`. Raises SceneError as `camera_at` does."""
    return Lens.of(colored(camera_at(scene, time), scene.lens, color), scene.lens, color)


def lenses_at(scene: Scene, time: float) -> tuple[Lens, ...]:
    """The lenses of red, green and blue if they differ, else one for all colors, on the rays of the camera; time in s.

    A color with another magnification shows a surface at another position, with a proportional blur radius.
    """
    camera, lens = camera_at(scene, time), scene.lens
    if lens is None or not scene.separates_colors:
        return (Lens.of(camera, lens),)
    lenses = zip((Lens.of(camera, lens, color) for color in range(3)), lens.lateral, strict=True)
    return tuple(replace(color_lens, blur_scale=color_lens.blur_scale * size) for color_lens, size in lenses)


@lru_cache(maxsize=64)
def _paths(lens: SceneLens) -> tuple[Path | None, Path | None, Path | None]:
    """Paths of the focal length in mm, of the inverse focus distance in 1/mm, and of the aperture's diameter divided by
    the focal length; None without keyframes.
    """

    def path(name: str, power: int) -> Path | None:
        keys = [(key.time, getattr(key, name)) for key in lens.keyframe or () if getattr(key, name) is not None]
        times, values = [time for time, _ in keys], [[value**power] for _, value in keys]
        return path_through(times, values, lens.interpolation or "linear", lens.outside or "hold") if keys else None

    return path("focal_length", 1), path("focus_distance", -1), path("f_number", -1)


def widest_camera(scene: Scene) -> Camera:
    """The camera with an aperture at least as wide as at any time of the sequence."""
    zoom, _, opening = (None, None, None) if scene.lens is None else _paths(scene.lens)
    keyed = [path.times for path in (zoom, opening) if path is not None]
    if not keyed:
        return scene.camera
    times = sequence_times(scene)
    ends = np.unique([*times, *(time for time in np.concatenate(keyed) if times[0] < time < times[-1])])
    places = (np.linspace(*pair, DENSE).tolist() for pair in pairwise(ends))
    widest = max(camera_at(scene, time).aperture_diameter for time in [times[0], *chain.from_iterable(places)])
    return scene.camera.model_copy(update={"aperture_diameter": WIDER * widest})
