"""Scenes with a sensor: codes of whole frames on the device and in the reference, their files, and what does not change
without one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from PIL import Image

import clsco
from clsco.constants import BAND
from clsco.data.distribution import load_distribution, scripted
from clsco.engine.response import response
from clsco.errors import SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, SENSOR_NAMES
from clsco.frame.provenance import record
from clsco.optics.sensor import camera_word, sensor_model
from clsco.plan.prepare import prepare, with_resolution
from clsco.plan.request import Request
from clsco.reference.sensor.sensor import sense
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene
from clsco.scene.sweep import parse_sweep
from clsco.scene.toml import toml_text
from tests.command import clsco_, done
from tests.pipeline.common import PLAIN, assert_strips_agree, printed_with_threads
from tests.slow import mostly_slow

BALL: dict[str, Any] = {"shape": "sphere", "center": [0, 0, 260], "radius": 10, "texture": "bricks"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 330.0, "texture": "#4060a0"}
CAMERA = {"resolution": [39, 2 * BAND + 9], "pixel_pitch": 0.08}
MOVING = BALL | {"motion": {"velocity": [6.0, 0.0, 0.0]}}
ALONE = PLAIN | {"occlusion": "none"}
SCENES: dict[str, dict[str, Any]] = {
    "still": {"object": [BALL, WALL]},
    "moving": {"object": [MOVING, WALL], "sequence": {"samples": 3, "frames": 2}},
    "mosaic": {"object": [BALL, WALL], "sensor": {"mosaic": "rggb", "quantum_efficiency": [0.3, 0.6, 0.4]}},
    "pair": {"object": [BALL, WALL], "stereo": {"baseline": 5.0}},
    "gray, in focus": {"object": [{"shape": "plane", "distance": 250.0}], "camera": {"focus_distance": 250.0}},
    "forward": {"object": [MOVING], "sequence": {"samples": 2}, "motion": {"warp": "forward"}},
}


def named(name: str) -> Scene:
    data = SCENES[name]
    sensor = {"dark_current": 5.0, "hot_pixels": 0.01} | data.get("sensor", {})
    return parse_scene(data | {"camera": CAMERA | data.get("camera", {}), "sensor": sensor, "psf": ALONE})


def light_of(scene: Scene, **options: Any) -> list[Frame]:
    return list(clsco.render(scene.replace("sensor", None), truth=(), **options))


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["still", "mosaic", "gray, in focus"]))
def test_codes_are_those_of_the_light(name: str) -> None:
    scene = named(name)
    for frame, plain in zip(clsco.render(scene), light_of(scene), strict=True):
        light = np.atleast_3d(plain.color)
        known = sensor_model(scene, light.shape[2])
        raw, saturated = sense(known, light, camera_word(frame.index, frame.eye or "left"))  # type: ignore[arg-type]
        found = frame.arrays()
        np.testing.assert_array_equal(found["raw"].reshape(raw.shape), raw)
        np.testing.assert_array_equal(found["saturated"].reshape(saturated.shape), saturated)
        assert frame.color.shape == plain.color.shape
        assert 1e-3 < np.abs(frame.color - plain.color).mean() < 0.5


def test_a_sweep_over_a_sensor_casts_its_rays_once() -> None:
    scenes = [named("still").replace("sensor.seed", seed) for seed in (1, 2)]
    found = [frame for _, frame in clsco.render_sweep(scenes, truth=("raw",))]
    assert ["cast" in frame.metadata["seconds"] for frame in found] == [True, False]
    for scene, frame in zip(scenes, found, strict=True):
        np.testing.assert_array_equal(frame.raw, clsco.render_frame(scene, truth=("raw",)).raw)
    assert np.any(found[0].raw != found[1].raw)


@pytest.mark.parametrize("name", mostly_slow(["still", "moving", "mosaic", "pair"], ["mosaic"]))
def test_the_reference_agrees(name: str) -> None:
    """But for codes that the last digits of the light decide."""
    scene = named(name)
    for frame, exact in zip(clsco.render(scene), clsco.reference.render(scene), strict=True):
        found, wanted = frame.arrays(), exact.arrays()
        assert (found["raw"] != wanted["raw"]).mean() < 2e-3
        assert np.abs(found["raw"].astype(int) - wanted["raw"]).max() <= 1
        np.testing.assert_allclose(found["electrons"], wanted["electrons"], atol=0.1)
        np.testing.assert_allclose(found["noise_sigma"], wanted["noise_sigma"], atol=0.01)
        assert found["electrons"].dtype == found["noise_sigma"].dtype == np.float32


@pytest.mark.parametrize("name", ["moving", "mosaic"])
def test_strips_have_the_bits_of_the_whole(name: str) -> None:
    assert_strips_agree(named(name), SENSOR_NAMES)


@pytest.mark.slow
@pytest.mark.processor
@pytest.mark.parametrize("threads", ["1", "3"])
def test_with_other_threads(threads: str) -> None:
    code = "from tests.pipeline.test_sensor import codes_sum; print(codes_sum())"
    assert printed_with_threads(threads, code).strip() == codes_sum()


def codes_sum() -> str:
    raw = clsco.render_frame(named("still"), truth="raw").arrays()["raw"]
    return str(raw.astype(np.int64).cumsum().sum())


def test_a_frame_by_itself_has_the_noise_that_it_has_in_the_sequence() -> None:
    scene = named("moving")
    _, second = clsco.render(scene, truth="raw")
    (alone,) = clsco.render(scene, truth="raw", frames=[1])
    np.testing.assert_array_equal(alone.raw, second.raw)


CARD: dict[str, Any] = {
    "camera": {"resolution": [64, 48], "pixel_pitch": 0.08, "focus_distance": 250.0},
    "sensor": {"prnu": 0.05, "dsnu": 20.0},
    "object": [{"shape": "plane", "distance": 250.0, "texture": "#a0a0a0"}],
}
SWEPT = parse_sweep(CARD | {"camera": CARD["camera"] | {"f_number": [2.0, 4.0, 8.0]}}).scenes


def drawn(rng: np.random.Generator, sample: int) -> Any:
    return parse_scene(CARD)


def sample_of(seed: int, number: int, function: bool = False) -> Scene:
    """The last scene of a sample of a data set, of a file with two variants or of a function."""
    if function:
        return scripted(drawn).draw(seed, number).scenes[-1]
    with TemporaryDirectory() as folder:
        file = Path(folder) / "set.toml"
        file.write_text(toml_text(CARD) + "[vary.camera]\nf_number = { choice = [[2.0, 4.0]] }\n")
        return load_distribution(file).draw(seed, number).scenes[-1]


PAIRS: dict[str, tuple[Callable[[], list[Frame]], bool, bool]] = {
    "a scene rendered twice": (lambda: exposures(parse_scene(CARD), parse_scene(CARD)), True, True),
    "a scene and the first variant of its sweep": (lambda: exposures(parse_scene(CARD), SWEPT[0]), True, True),
    "a variant, and from what its file says": (lambda: exposures(SWEPT[2], again(SWEPT[2])), True, True),
    "a sample, and from what its file says": (lambda: exposures(sample_of(1, 4), again(sample_of(1, 4))), True, True),
    "variants of a sweep": (lambda: exposures(*SWEPT[:2]), False, True),
    "variants that are farther apart": (lambda: exposures(*SWEPT[::2]), False, True),
    "frames": (lambda: list(clsco.render(parse_scene(CARD | {"sequence": {"frames": 2}}))), False, True),
    "views of a stereo pair": (
        lambda: list(clsco.render(parse_scene(CARD | {"stereo": {"baseline": 1.0}}))),
        False,
        False,
    ),
    "samples of a data set": (lambda: exposures(sample_of(1, 4), sample_of(1, 5)), False, True),
    "data sets of other seeds": (lambda: exposures(sample_of(1, 4), sample_of(2, 4)), False, True),
    "samples of a function": (lambda: exposures(sample_of(1, 4, True), sample_of(1, 5, True)), False, True),
    "another noise_seed": (lambda: exposures(SWEPT[0], SWEPT[0].replace("sensor.noise_seed", 9)), False, True),
    "another seed": (lambda: exposures(SWEPT[0], SWEPT[0].replace("sensor.seed", 9)), False, False),
}
"""Two exposures, and whether they share the noise that is new in each exposure, and the pattern: docs/sensor.md."""


def again(scene: Scene) -> Scene:
    return parse_scene(json.loads(json.dumps(record(with_resolution(scene))["scene"])))


def exposures(*scenes: Scene) -> list[Frame]:
    return [clsco.render_frame(scene) for scene in scenes]


@pytest.mark.parametrize("pair", PAIRS)
def test_what_exposures_share(pair: str) -> None:
    """The variance of their difference is twice that of all that is new in each."""
    frames, noise, pattern = PAIRS[pair]
    one, other = frames()
    sensor = parse_scene(CARD).sensor
    assert sensor is not None
    gain = (4095 - 64) / sensor.full_well
    light = float(one.arrays()["electrons"].mean())
    temporal, fixed = light + sensor.read_noise**2 + 1 / (12 * gain**2), (sensor.prnu * light) ** 2 + sensor.dsnu**2
    variance = 2 * (temporal * (not noise) + fixed * (not pattern))
    difference = (one.arrays()["raw"].astype(float) - other.arrays()["raw"]) / gain
    assert difference.var() == pytest.approx(variance, rel=0.12)  # 4.7 standard errors of 3072 pixels
    assert abs(difference.mean()) < 5 * np.sqrt(variance / difference.size) + 1e-9


@pytest.mark.parametrize(
    ("changes", "factor"),
    [
        ({}, 1.0),
        ({"camera.f_number": 4.0}, 1 / 4),
        ({"sequence.shutter": 0.001}, 1 / 100),
        ({"sequence.shutter": 0.2}, 2.0),
        ({"object.0.texture": np.full((1, 1), 0.1, np.float32)}, 0.1 / 0.2),
        ({"sensor.reference_f_number": 4.0}, 4.0),
        ({"sensor.reference_shutter": 0.2}, 1 / 2),
        ({"sensor.iso": 400.0}, 1.0),
        ({"camera.normalization_distance": "sensor"}, (1 - 20 / 250) ** 2),  # 1 / (1 + m)^2
        ({"aperture.shape": "ring", "aperture.obstruction": 0.5, "aperture.exposure": "area"}, 3 / 4),
    ],
)
def test_a_physical_exposure(changes: dict[str, Any], factor: float) -> None:
    """f/2, 0.1 s and light 0.2 make 2000 electrons; by default all but the light changes nothing."""
    scene = parse_scene(
        CARD | {"sensor": {"exposure": "physical", "reference_f_number": 2.0, "reference_shutter": 0.1}}
    )
    usual = {"camera.f_number": 2.0, "sequence.shutter": 0.1, "object.0.texture": np.full((1, 1), 0.2, np.float32)}
    for key, value in (usual | changes).items():
        scene = scene.replace(key, value)
    frame = clsco.render_frame(scene, truth=("raw", "electrons")).arrays()
    assert frame["electrons"].mean() == pytest.approx(2000 * factor, rel=1e-4)
    gain = (4095 - 64) / 12000 * (4.0 if "sensor.iso" in changes else 1.0)
    assert ((frame["raw"].astype(float) - 64) / gain).mean() == pytest.approx(2000 * factor, rel=0.01)
    assert frame["color"].mean() == pytest.approx(0.2 * factor * (4.0 if "sensor.iso" in changes else 1.0), rel=0.01)
    if not any(key.startswith(("object", "sensor", "aperture")) for key in changes):
        electrons = clsco.render_frame(scene.replace("sensor", {}), truth="electrons").arrays()["electrons"]
        assert electrons.mean() == pytest.approx(2000, rel=1e-4)


def test_outputs_are_those_that_are_wanted() -> None:
    scene = named("still")
    for names in ((), ("raw",), ("electrons", "depth"), ("saturated",)):
        frame = clsco.render_frame(scene, truth=names)
        assert tuple(name for name in ALL_TRUTH if getattr(frame, name) is not None) == tuple(
            name for name in ALL_TRUTH if name in names
        )
    plain = clsco.render_frame(scene.replace("sensor", None))
    assert all(getattr(plain, name) is None for name in SENSOR_NAMES)
    with_alpha = clsco.render_frame(scene, truth=("alpha", "raw")).arrays()
    np.testing.assert_array_equal(with_alpha["raw"], clsco.render_frame(scene, truth="raw").raw)
    assert with_alpha["alpha"].shape == with_alpha["color"].shape[:2]
    light = clsco.render_frame(scene, truth=("subframes", "electrons")).arrays()
    np.testing.assert_allclose(light["subframes"][0] * 1e4 + 5.0, light["electrons"], rtol=1e-5)


def test_without_an_image_there_are_no_codes() -> None:
    scene = named("still")
    frame = clsco.render_frame(scene, truth=("raw", "depth"), color=False)
    assert frame.raw is None
    assert frame.depth is not None
    with pytest.raises(SceneError, match="color: must be True"):
        clsco.render_frame(scene, truth=("raw", "electrons"), color=False)


def test_a_scene_without_a_sensor_has_nothing_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError

    scene = named("still").replace("sensor", None)
    monkeypatch.setattr("clsco.passes.sensor.FrameSensor", never)
    monkeypatch.setattr("clsco.frame.development.develop", never)
    frame = clsco.render_frame(scene)
    assert "sense" not in frame.metadata["seconds"]
    plan = prepare(scene, Request(ALL_TRUTH)).plan
    assert plan.sensor_model is None
    assert plan.needs_light
    assert "sensor" not in {each.kind for each in plan.passes}
    with_sensor = prepare(named("still"), Request(ALL_TRUTH)).plan
    assert [each.kind for each in with_sensor.passes if each.kind != "sensor"] == [each.kind for each in plan.passes]
    assert plan.features() == with_sensor.features()


def test_a_response_is_that_of_the_lens_alone() -> None:
    scene = named("still")
    np.testing.assert_array_equal(response(scene, 20, 60), response(scene.replace("sensor", None), 20, 60))


@pytest.mark.parametrize(("gain", "told"), [(0.1, True), (0.3, False)])
def test_the_plan_tells_of_codes_that_are_too_few(gain: float, told: bool) -> None:
    scene = named("gray, in focus").replace("sensor.gain", gain)
    (sensor,) = (each for each in prepare(scene, Request()).plan.passes if each.kind == "sensor")
    assert ("posterized" in dict(sensor.parameters)["noise"]) == told


SCENE = """
[camera]
resolution = [20, 14]
pixel_pitch = 0.2
[psf]
edge = "sampled"
tilt = false
silhouette_samples = 1
occlusion = "none"
[sensor]
mosaic = "rggb"
bits = 14
[[object]]
shape = "sphere"
texture = "#e08020"
[[object]]
shape = "plane"
distance = 330.0
"""


def test_files(tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    tifffile = pytest.importorskip("tifffile")
    scene = tmp_path / "s.toml"
    scene.write_text(SCENE)
    done("render", scene, "-o", tmp_path, "--format", "npz,exr,png,tiff", "--quiet")
    arrays = np.load(tmp_path / "frame_0000.npz")
    frame = clsco.render_frame(str(scene))
    for name in ("color", *SENSOR_NAMES):
        np.testing.assert_array_equal(arrays[name], getattr(frame, name))
    raw = arrays["raw"]
    assert raw.dtype == np.uint16
    assert raw.max() < 2**14
    np.testing.assert_array_equal(np.array(Image.open(tmp_path / "frame_0000_raw.png")), raw)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "frame_0000_raw.tif"), raw)
    channels = exr.File(str(tmp_path / "frame_0000.exr"), separate_channels=True).channels()
    assert channels["raw.Y"].pixels.dtype == np.uint32
    np.testing.assert_array_equal(channels["raw.Y"].pixels, raw)
    np.testing.assert_array_equal(channels["noise_sigma.Y"].pixels, arrays["noise_sigma"])
    about = json.loads((tmp_path / "frame_0000.json").read_text())
    assert about["scene"]["sensor"]["mosaic"] == "rggb"
    assert about["units"]["sensor.read_noise"] == "e-"
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    done("render", scene, "-o", tmp_path, "--format", "npz,exr,png,tiff", "--quiet", "--resume")
    assert before == {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert "raw" in done("check", scene, "--rays", "0").output


def test_codes_of_a_scene_without_a_sensor_are_refused(tmp_path: Path) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text('[[object]]\nshape = "sphere"\n')
    found = clsco_("render", scene, "-o", tmp_path / "out", "--format", "png")
    assert found.exit_code == 1
    assert "truth: the scene must have raw; got png" in found.output


@pytest.mark.parametrize("scan", mostly_slow(["top_to_bottom", "left_to_right"], ["left_to_right"]))
def test_a_rolling_shutter_is_read_out_once(scan: str) -> None:
    """Each line has its own light, which the sensor counts when all time samples are added."""
    sequence = {"samples": 7, "interval": 2.0, "shutter": 0.5, "readout": 0.5, "scan": scan}
    data = {"object": [MOVING, WALL], "camera": CAMERA, "sequence": sequence, "sensor": {}, "psf": ALONE}
    scene = parse_scene(data)
    (plain,) = light_of(scene)
    raw, _ = sense(sensor_model(scene, 3), plain.color, camera_word(0, "left"))
    np.testing.assert_array_equal(assert_strips_agree(scene, ("raw",)).raw, raw)
