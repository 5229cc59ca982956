"""Pictures that the page shows: time samples alone, the exposure on the time line, and the views of a sensor."""

from __future__ import annotations

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.files.transfer import encode
from clsco.scene.model import Scene
from clsco.studio.forms import panels
from clsco.studio.pictures import EXACT, FLOAT32, exposure_of, moment_of, picture_of, truth_of
from clsco.studio.session import Document
from tests.studio.browser import EXAMPLES


def scene_of(warp: str = "inverse") -> Scene:
    scene = clsco.load_scene(EXAMPLES / "sphere_turning.toml").replace("camera.resolution", [64, 64])
    scene = scene.replace("camera.pixel_pitch", 0.08).replace("object.0.motion.velocity", [5.0, 3.0, 0.0])
    scene = scene.replace("sequence", {"frames": 3, "interval": 0.5, "shutter": 0.4})
    return scene.replace("object.0.texture_mapping", "projected").replace("motion.warp", warp)


@pytest.mark.parametrize("warp", ["inverse", "forward"])
def test_a_moment_is_the_subframe(warp: str) -> None:
    scene = scene_of(warp)
    frame = clsco.render_frame(scene, 2, truth=("subframes",))
    assert frame.subframes is not None
    times = [sample["time"] for sample in frame.metadata["intermediate"]]
    assert len(times) > 2
    for time, image in ((times[0], frame.subframes[0]), (times[-1], frame.subframes[-1])):
        alone = clsco.render_frame(moment_of(scene, 2, time), 2, truth=())
        codes = [encode(each, 8, "srgb").astype(int) for each in (alone.color, image)]
        assert np.abs(codes[0] - codes[1]).max() <= 1
    assert np.abs(frame.subframes[0] - frame.subframes[-1]).max() > 0.1


def test_a_moment_before_the_frame_is_the_subframe() -> None:
    scene = scene_of().replace("sequence.shutter_start", -0.2).replace("sequence.shutter_curve", "triangle")
    frame = clsco.render_frame(scene, 1, truth=("subframes",))
    time = frame.metadata["intermediate"][0]["time"]
    assert frame.subframes is not None
    assert 0.3 < time < 0.5
    alone = clsco.render_frame(moment_of(scene, 1, time), 1, truth=())
    np.testing.assert_allclose(alone.color, frame.subframes[0], atol=1e-5)


def test_times_beyond_the_interval_are_taken_to_be_within() -> None:
    scene = scene_of()
    for time in (-7.0, 0.0, 99.0, 1e9):
        assert 0 < moment_of(scene, 1, time).sequence.shutter <= 2 * scene.sequence.interval


def test_the_exposure_is_that_of_the_frame() -> None:
    scene = scene_of()
    frame = clsco.render_frame(scene, 1, truth=())
    samples = [sample["time"] for sample in frame.metadata["intermediate"]]
    found = exposure_of(frame, scene, len(samples))
    assert found["times"] == samples
    assert found["shutter"] == pytest.approx([0.5, 0.9])
    assert all(0.5 < time < 0.9 for time in found["times"])
    assert len(found["times"]) == frame.metadata["samples"]
    (arrow,) = found["arrows"]
    step = scene.camera.pixel_pitch / scene.camera.normalization_distance
    assert arrow[2] - arrow[0] == pytest.approx(5.0 * 0.4 / 280.0 / step, rel=1e-6)  # its center stays at its depth
    assert arrow[3] - arrow[1] == pytest.approx(-3.0 * 0.4 / 280.0 / step, rel=1e-6)
    assert arrow[4] == 0.0


@pytest.mark.parametrize("speed", [20.0, -20.0])
def test_what_comes_nearer_or_goes_away_is_marked(speed: float) -> None:
    """Also where it stays at its place in the frame."""
    scene = scene_of().replace("object.0.motion.velocity", [0.0, 0.0, speed])
    (arrow,) = exposure_of(clsco.render_frame(scene, 1, truth=()), scene, 1)["arrows"]
    assert arrow[4] == pytest.approx(-speed * 0.4)


def test_what_does_not_move_has_no_exposure() -> None:
    scene = clsco.load_scene(EXAMPLES / "sphere.toml").replace("camera.resolution", [32, 32])
    assert exposure_of(clsco.render_frame(scene, truth=()), scene, 1) == {"times": [], "shutter": None, "arrows": []}


SCENE = clsco.Scene(
    camera=clsco.Camera(resolution=(12, 8), pixel_pitch=0.2), objects=(clsco.Sphere(texture="#c08040"),),
    sensor=clsco.Sensor(bits=16),
)  # fmt: skip


def test_the_panel_has_all_keys(session: Document) -> None:
    (panel,) = (panel for panel in panels(session) if panel.title == "Sensor")
    assert [field.path for field in panel.fields] == [f"sensor.{key}" for key in clsco.Sensor.model_fields]
    labels = {field.path: field.label for field in panel.fields}
    assert labels["sensor.iso"] == "ISO"
    assert (labels["sensor.seed"], labels["sensor.noise_seed"]) == ("Seed of the sensor", "Seed of the noise")


@pytest.mark.parametrize("mosaic", ["none", "rggb"])
def test_views(mosaic: str) -> None:
    scene = SCENE.replace("sensor.mosaic", mosaic)
    frame = clsco.render_frame(scene, truth=(*truth_of("raw"), *truth_of("noise")))
    for view, name in (("raw", "raw"), ("noise", "noise_sigma")):
        data = frame.arrays()[name]
        exact = picture_of(frame, scene, view, EXACT, (12, 8), 0.0)
        assert (exact.encoding, exact.size) == (FLOAT32, (12, 8))
        np.testing.assert_array_equal(np.frombuffer(exact.payload, "<f4").reshape(data.shape), data)


def test_without_a_sensor_a_view_says_so() -> None:
    scene = SCENE.replace("sensor", None)
    frame = clsco.render_frame(scene, truth=(*truth_of("raw"), *truth_of("noise")))
    for view in ("raw", "noise"):
        with pytest.raises(SceneError) as caught:
            picture_of(frame, scene, view, EXACT, (12, 8), 0.0)
        assert str(caught.value) == f"view: {view} belongs to scenes with a sensor, which has a panel; got none"
