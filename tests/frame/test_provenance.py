"""Reports on a scene: units of its parameters, its hash, and keys that it has no use for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.errors import FileError, SceneError
from clsco.frame.provenance import file_digests, record, scene_sha256, units
from clsco.plan.notes import unused_keys
from clsco.plan.prepare import prepare, prepare_sweep
from clsco.plan.request import Request
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene
from clsco.scene.shapes import SHAPES
from clsco.scene.sweep import parse_sweep


@pytest.mark.parametrize("shape", sorted(SHAPES.keys() - {"background"}))
def test_every_number_has_a_unit_or_needs_none(shape: str) -> None:
    item: dict[str, Any] = {"shape": shape, "bounds": [[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]]}
    if shape in ("rectangle", "disc", "box"):
        del item["bounds"]
    item |= {"coefficients": [1.0] * 10} if shape == "quadric" else {}
    if shape == "depth_map":
        item = {"shape": shape, "depth": "z.npy", "unit": "disparity", "baseline": 60.0}
    stereo = {"baseline": 65.0, "toe_in": 1.0}
    sections = {"psf": {"model": "gaussian"}, "stereo": stereo}
    if shape != "depth_map":
        sections["light"] = {"position": [1.0, 2.0, 3.0]}
    sections["sensor"] = {"iso": 200.0}
    scene = parse_scene({"object": [item], **sections})
    values = units(scene)
    without = {"camera.f_number", "sequence.frames", "sequence.samples", "psf.silhouette_samples"}
    without |= {"psf.sigma_ratio", "psf.truncation", "object[0].coefficients", "object[0].axis", "object[0].scale"}
    without |= {"light.ambient", "aperture.squeeze", "aperture.rim"}
    without |= {
        f"sensor.{key}"
        for key in ("prnu", "hot_pixels", "bits", "iso", "iso_base", "quantum_efficiency", "seed", "noise_seed")
    }
    numbers: set[str] = set()

    def walk(place: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, entry in value.items():
                walk(f"{place}.{key}" if place else key, entry)
        elif place == "object":
            walk("object[0]", value[0])
        elif isinstance(value, float | int | list) and not isinstance(value, bool):
            numbers.add(place)

    walk("", dump(scene))
    assert len(numbers) > 15
    assert numbers - without <= set(values)
    assert values["camera.focal_length"] == "mm"
    assert values["object[0].motion.angular_velocity"] == values["camera.motion.angular_velocity"] == "deg/s"
    assert (values["stereo.baseline"], values["stereo.toe_in"]) == ("mm", "deg")
    assert values.get("light.position", "mm") == "mm"
    assert [values[f"sensor.{key}"] for key in ("full_well", "dark_current", "temperature")] == ["e-", "e-/s", "degC"]
    assert without & set(values) == set()


def keys(**sections: Any) -> dict[str, str]:
    item = sections.pop("item", {"shape": "plane"})
    items = item if isinstance(item, list) else [item]
    scene = parse_scene({"object": items, "camera": {"resolution": [32, 32], "pixel_pitch": 0.2}, **sections})
    return dict(unused_keys(prepare(scene).plan))


def two(*items: dict[str, Any], **motion: Any) -> Scene:
    """A scene of objects, the moving one first."""
    camera = {"resolution": [32, 32], "pixel_pitch": 0.2}
    return parse_scene({"object": list(reversed(items)), "camera": camera, "motion": motion})


def test_keys_without_use_are_those_given_and_no_others() -> None:
    assert keys() == {}
    assert keys(sequence={"samples": 7, "frames": 2}) == {
        "sequence.samples": "nothing moves: one sample, in the reference pose"
    }
    moving = {"shape": "sphere", "motion": {"velocity": [1.0, 0.0, 0.0]}}
    assert keys(item=moving, sequence={"samples": 7}, psf={"tilt": True, "silhouette_samples": 2}) == {}
    turning = {"shape": "sphere", "motion": {"angular_velocity": [1.0, 2.0, 0.0]}}
    assert keys(item=turning, motion={"rotation": "axis"}) == {}
    still = {"shape": "plane", "distance": 900.0}
    assert dict(unused_keys(prepare(two(still, turning, rotation="axis")).plan)) == {}
    one_axis = {"shape": "sphere", "motion": {"angular_velocity": [1.0, 0.0, 0.0]}}
    assert dict(unused_keys(prepare(two(still, one_axis, rotation="axis")).plan)).keys() == {"motion.rotation"}
    assert keys(motion={"texture_filter": "nearest"}) == {
        "motion.texture_filter": "nothing moves: every pixel shows its own texel"
    }
    assert keys(motion={"texture_filter": "nearest"}, stereo={"baseline": 9.0}) == {}
    forward = {"warp": "forward"}
    assert keys(motion=forward, fill={"method": "ait"}) == {
        "motion.warp": "no forward warp, as nothing moves",
        "fill.method": "only a forward warp leaves pixels missing",
    }
    values = keys(item=moving, motion=forward, fill={"method": "none", "domain": "span"})
    assert values == {"fill.domain": "fill.method is none"}
    assert keys(psf={"tilt": True, "silhouette_samples": 4}).keys() == {"psf.tilt", "psf.silhouette_samples"}
    assert keys(psf={"tilt": False, "silhouette_samples": 1}) == {}
    alone = prepare(parse_scene({"object": [still], "psf": {"tilt": True}}), Request(("depth",), color=False)).plan
    assert dict(unused_keys(alone)).keys() == {"psf.tilt"}
    # Another edge or model may spread what this one keeps in its pixel.
    sharp = {"edge": "area", "model": "pillbox", "tilt": False, "border": "lose"}
    assert keys(psf=sharp, aperture={"blades": 5, "shape": "polygon"}).keys() == {
        "psf.tilt",
        "psf.border",
        "aperture.blades",
        "aperture.shape",
    }
    assert keys(psf={"occlusion": "none"}) == {}
    near = {"shape": "rectangle", "size": [1.0, 1.0], "center": [0.0, 0.0, 200.0]}
    assert keys(item=[near, still], psf={"occlusion": "none"}) == {}


def test_depth_maps_are_filled_at_rest(tmp_path: Path) -> None:
    options = {"motion": {"warp": "forward"}, "fill": {"method": "none"}, "camera": {"resolution": [8, 8]}}
    scene = parse_scene({"object": [files_of_a_map(tmp_path)], **options})
    assert unused_keys(prepare(scene).plan) == []


def test_the_hash_is_of_what_decides_the_image(tmp_path: Path) -> None:
    def digest(folder: str, **item: Any) -> str:
        (tmp_path / folder).mkdir(exist_ok=True)
        texture = tmp_path / folder / "texture.npy"
        np.save(texture, np.full((3, 4), item.pop("value", 0.5), np.float32))
        return scene_sha256(parse_scene({"object": [{"shape": "plane", "texture": str(texture), **item}]}))

    assert digest("a") == digest("b")  # wherever the texture lies
    others = {digest("a"), digest("a", value=0.6), digest("a", distance=251.0), digest("a", texture="bricks")}
    assert len(others) == 4
    assert digest("a", distance=250.0) == digest("a")  # a default spelled out


def test_the_record_names_textures_that_are_files(tmp_path: Path) -> None:
    path = tmp_path / "texture.npy"
    np.save(path, np.zeros((3, 4), np.float32))
    scene = parse_scene({"object": [{"shape": "plane", "texture": str(path)}]})
    assert list(record(scene)["textures_sha256"]) == [str(path)]
    assert record(parse_scene({"object": [{"shape": "plane"}]}))["textures_sha256"] == {}
    path.unlink()
    with pytest.raises(FileError, match=r"texture.npy: must be a file that can be read; got No such file"):
        record(scene)


def test_a_plan_takes_size_and_channels_from_the_texture(tmp_path: Path) -> None:
    np.save(tmp_path / "texture.npy", np.zeros((30, 40, 3), np.float32))
    scene = parse_scene({"object": [{"shape": "plane", "texture": str(tmp_path / "texture.npy")}]})
    plan = prepare(scene, Request(("depth",))).plan
    assert (plan.columns, plan.rows, plan.channels, plan.truth) == (40, 30, 3, ("depth",))
    camera = scene.camera.model_copy(update={"resolution": (9, 7)})
    plan = prepare(scene.model_copy(update={"camera": camera})).plan
    assert (plan.columns, plan.rows, plan.channels) == (9, 7, 3)


def files_of_a_map(folder: Path, side: int = 8, depth: float = 300.0) -> dict[str, Any]:
    np.save(folder / "z.npy", np.full((side, side), depth, np.float32))
    return {"shape": "depth_map", "depth": str(folder / "z.npy")}


def test_the_hash_and_the_record_have_the_content_of_depths(tmp_path: Path) -> None:
    def digest(**item: Any) -> str:
        return scene_sha256(parse_scene({"object": [{**files_of_a_map(tmp_path, **item)}, {"shape": "plane"}]}))

    first = digest()
    assert digest(depth=301.0) != first
    assert digest() == first
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    assert scene_sha256(parse_scene({"object": [files_of_a_map(moved), {"shape": "plane"}]})) == first
    scene = parse_scene({"object": [files_of_a_map(tmp_path), {"shape": "plane"}]})
    values = record(scene)
    assert list(values["depths_sha256"]) == [str(tmp_path / "z.npy")]
    assert values["textures_sha256"] == {}
    assert record(scene, file_digests([scene, scene])) == values
    (tmp_path / "z.npy").unlink()
    with pytest.raises(FileError, match=r"z.npy: must be a file that can be read"):
        record(scene)


def test_a_frame_has_color_where_any_texture_has(tmp_path: Path) -> None:
    for name, shape in (("gray", (6, 5)), ("color", (6, 5, 3))):
        np.save(tmp_path / f"{name}.npy", np.ones(shape, np.float32))

    def channels(*textures: str) -> int:
        items = [{"shape": "plane", "texture": text} for text in textures]
        return prepare(parse_scene({"camera": {"pixel_pitch": 0.1}, "object": items})).plan.channels

    gray, color = str(tmp_path / "gray.npy"), str(tmp_path / "color.npy")
    assert [channels(gray, "bricks"), channels(gray, color), channels(color, gray)] == [1, 3, 3]


def test_faults_of_all_files_are_reported(tmp_path: Path) -> None:
    (tmp_path / "none.npy").touch()
    items = [
        {"shape": "plane", "texture": "brick"},
        {"shape": "depth_map", "depth": str(tmp_path / "z.exr"), "texture": "missing.png"},
        {"shape": "depth_map", "depth": str(tmp_path / "none.npy")},
    ]
    with pytest.raises(SceneError) as caught:
        prepare(parse_scene({"object": items}))
    starts = ("object[0].texture: ", "object[1].texture: ", "object[1].depth: ", "object[2].depth: ")
    assert len(caught.value.messages) == len(starts)
    for message, start in zip(caught.value.messages, starts, strict=True):
        assert message.startswith(start)


def test_depths_fit_the_frame_and_the_camera(tmp_path: Path) -> None:
    def faults(depth: float, **camera: Any) -> tuple[str, ...]:
        item = files_of_a_map(tmp_path, depth=depth)
        scene = parse_scene({"object": [{"shape": "plane"}, item], "camera": {"resolution": [8, 8], **camera}})
        with pytest.raises(SceneError) as caught:
            prepare(scene)
        return caught.value.messages

    place = f"object[1].depth: {tmp_path / 'z.npy'}: "
    (message,) = faults(300.0, resolution=[9, 8])
    assert message == f"{place}the size must be that of the frame, 9 x 8 pixels; got 8 x 8"
    (message,) = faults(0.3)
    assert message.startswith(f"{place}the blur radius must be at most 512 px; got ")
    (message,) = faults(-1.0)
    assert message == f"{place}at least one pixel must have a depth; got 64 negative"


def test_a_sweep_is_planned_with_all_its_faults() -> None:
    camera: dict[str, Any] = {"resolution": [[8, 8], [9, 7]], "f_number": [2.0, 1e-3]}
    data = {"object": [{"shape": "plane", "distance": 300.0}], "camera": camera}
    with pytest.raises(SceneError) as caught:
        prepare_sweep(parse_sweep(data))
    assert [message.split(" (with ")[1] for message in caught.value.messages] == [
        "resolution_8_8__f_number_0.001)",
        "resolution_9_7__f_number_0.001)",
    ]
    camera["f_number"] = [2.0, 4.0]
    plans = [each.plan for each in prepare_sweep(parse_sweep(data))]
    assert [(plan.columns, plan.scene.camera.f_number) for plan in plans] == [(8, 2.0), (8, 4.0), (9, 2.0), (9, 4.0)]
    assert plans[1] == prepare(plans[1].scene).plan
