"""The lens at a time: paths of what the blur radius is proportional to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.optics.exposure import sequence_times
from clsco.optics.image_motion import lens_samples
from clsco.optics.lens import Lens, blur_radius
from clsco.optics.lens_path import camera_at, widest_camera
from clsco.scene.model import Scene


def scene(*keys: dict[str, Any], frames: int = 1, **lens: Any) -> Scene:
    camera = {"resolution": [48, 36], "pixel_pitch": 0.1, "focus_distance": 400.0, "f_number": 1.0}
    sections = {"camera": camera, "sequence": {"frames": frames}, "lens": {"keyframe": list(keys), **lens}}
    return clsco.parse_scene(sections | {"object": [{"shape": "plane", "distance": 300.0}]})


PULL = {"time": 0.0, "focus_distance": 200.0}, {"time": 1.0, "focus_distance": 400.0}
OPEN = {"time": 0.0, "f_number": 1.0}, {"time": 1.0, "f_number": 4.0}


def test_at_its_keys_it_is_the_lens_of_a_camera_with_these() -> None:
    wanted = scene(*(one | other for one, other in zip(PULL, OPEN, strict=True)))
    for time, u, n in ((0.0, 200.0, 1.0), (1.0, 400.0, 4.0), (7.0, 400.0, 4.0)):
        plain = wanted.camera.model_dump(exclude_unset=True) | {"focus_distance": u, "f_number": n}
        expected, found = Lens.of(clsco.Camera(**plain)), Lens.of(camera_at(wanted, time))
        for name in ("blur_scale", "focus_power", "radius"):
            assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-13)
        assert camera_at(wanted, time).focused_distance == pytest.approx(u, rel=1e-14)
        assert camera_at(wanted, time).opening == pytest.approx(n, rel=1e-14)


def test_lines_change_the_blur_radius_evenly() -> None:
    focus, opening = scene(*PULL, interpolation="linear"), scene(*OPEN, interpolation="linear")
    for wanted in (focus, opening):
        radii = [float(blur_radius(camera_at(wanted, t), 1.0 / 300.0)) for t in np.linspace(0.0, 1.0, 9)]
        np.testing.assert_allclose(np.diff(radii), (radii[-1] - radii[0]) / 8, rtol=1e-9)
        assert abs(radii[-1] - radii[0]) > 1.0
    # What no keyframe has stays the camera's.
    assert camera_at(focus, 0.3).aperture_diameter == 20.0
    assert camera_at(opening, 0.3).focused_distance == 400.0


def test_a_scene_without_keys_has_its_own_camera() -> None:
    plain = clsco.Scene(objects=(clsco.Plane(),))
    assert camera_at(plain, 3.0) is plain.camera
    assert widest_camera(plain) is plain.camera
    assert lens_samples(plain, (None,)) == 1


def test_keyframes_may_leave_out_either() -> None:
    wanted = scene(PULL[0], {"time": 0.5, "f_number": 2.0}, PULL[1], interpolation="linear")
    assert camera_at(wanted, 0.0).f_number == camera_at(wanted, 0.9).f_number == 2.0
    assert camera_at(wanted, 0.5).focused_distance == pytest.approx(1.0 / (0.5 / 200.0 + 0.5 / 400.0))


def test_steps() -> None:
    wanted = scene(*PULL, interpolation="step")
    assert [camera_at(wanted, t).focused_distance for t in (0.0, 0.999, 1.0)] == pytest.approx([200.0, 200.0, 400.0])


def test_a_path_that_no_lens_can_have_is_refused() -> None:
    def cubic(keys: list[dict[str, float]]) -> list[clsco.Camera]:
        return [camera_at(scene(*keys, interpolation="cubic"), t) for t in np.linspace(0.0, 1.0, 99)]

    keys = [{"time": t, "f_number": n} for t, n in ((0.0, 1e3), (0.4, 1e3), (0.5, 1.0), (0.6, 1e3), (1.0, 1e3))]
    rule = 'f_number must stay above 0, as with interpolation = "linear"; got'
    with pytest.raises(SceneError, match=f"lens.keyframe: {rule}"):
        cubic(keys)
    near = [{"time": t, "focus_distance": u} for t, u in ((0.0, 1e3), (0.3, 1e3), (0.4, 20.5), (0.8, 20.5))]
    rule = "focus_distance must stay greater than the focal length, 20 mm"
    with pytest.raises(SceneError, match=f"lens.keyframe: {rule}"):
        cubic(near)
    # Beyond infinity a focus may be, as where the detector is within the focal length.
    far = [{"time": t, "focus_distance": u} for t, u in ((0.0, 1e6), (0.4, 1e6), (0.5, 200.0), (0.6, 1e6), (1.0, 1e6))]
    assert min(Lens.of(camera).focus_power for camera in cubic(far)) < 0.0


def test_the_widest_aperture_of_the_sequence() -> None:
    keys = [{"time": t, "f_number": n} for t, n in ((0.0, 2.0), (0.1, 2.0), (0.2, 1.0), (0.3, 2.0))]
    for kind in ("linear", "cubic", "step"):
        wanted = scene(*keys, frames=50, interpolation=kind)
        assert max(camera_at(wanted, t).aperture_diameter for t in sequence_times(wanted)) < 14.0
        dense = max(camera_at(wanted, t).aperture_diameter for t in np.linspace(0.0, 0.5, 4001))
        assert dense <= widest_camera(wanted).aperture_diameter < 1.1 * dense


def test_samples_follow_the_blur_radius() -> None:
    still, pulled = scene(PULL[0], frames=2), scene(*PULL, frames=2)
    assert lens_samples(still, (None,)) == 1
    way = abs(float(blur_radius(camera_at(pulled, 1.0), 1 / 300.0) - blur_radius(camera_at(pulled, 0.0), 1 / 300.0)))
    assert lens_samples(pulled, (None,)) in (int(np.ceil(way)), int(np.ceil(way)) + 1)
    assert lens_samples(pulled, (None,)) % 2 == 1
