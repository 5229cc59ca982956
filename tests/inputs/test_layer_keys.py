"""Layers of EXR files that scenes name: read as by the options of `clsco defocus`, and kept apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import clsco
from clsco.errors import SceneError
from clsco.files.images import write_png
from clsco.inputs.files import InputFiles
from clsco.plan.prepare import prepare
from clsco.scene.model import DepthMap, Scene
from tests.scenes import refusals

RNG = np.random.default_rng(6)
BEAUTY, ALBEDO = RNG.random((2, 12, 16, 3), np.float32)
NEAR, FAR = (np.linspace(z, z + 20, 12 * 16, dtype=np.float32).reshape(12, 16) for z in (240, 300))
CAMERA = "camera.pixel_pitch = 0.1\n"
BOTH = """[[object]]
shape = "depth_map"
texture = "render.exr"
texture_layer = "{}"
depth = "render.exr"
depth_layer = "{}"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    channels = {
        f"{name}.{own}": np.ascontiguousarray(image[..., number])
        for name, image in (("View.Beauty", BEAUTY), ("View.Albedo", ALBEDO))
        for number, own in enumerate("RGB")
    }
    channels |= {"near.Z": NEAR, "far.Z": FAR}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(tmp_path / "render.exr"))
    return tmp_path


def scene_of(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(CAMERA + text)
    return clsco.load_scene(folder / "scene.toml")


def test_layers_are_what_arrays_of_them_are(folder: Path) -> None:
    for image, name in ((BEAUTY, "View.Beauty"), (ALBEDO, "albedo")):
        for depth, of_depth in ((NEAR, "near"), (FAR, "far.Z")):
            scene = scene_of(folder, BOTH.format(name, of_depth))
            item = DepthMap(texture=image, depth=depth)
            expected = clsco.render_frame(scene.model_copy(update={"objects": (item,)}))
            frame = clsco.render_frame(scene)
            np.testing.assert_array_equal(frame.color, expected.color)
            np.testing.assert_array_equal(frame.depth, expected.depth)
    (reference,) = clsco.reference.render(scene)
    np.testing.assert_allclose(frame.color, reference.color, atol=1e-5)


def test_layers_of_one_file_are_kept_apart(folder: Path) -> None:
    """By content and layer: each is read once, and a copy of the file elsewhere is the same."""
    files = InputFiles()
    text = "".join(
        f'[[object]]\nname = "{name}"\nshape = "plane"\ntexture = "render.exr"\ntexture_layer = "{name}"\n'
        for name in ("Beauty", "Albedo")
    )
    beauty, albedo = files.textures(scene_of(folder, text))
    np.testing.assert_array_equal(beauty.radiance, BEAUTY)
    np.testing.assert_array_equal(albedo.radiance, ALBEDO)
    assert beauty.content != albedo.content
    (folder / "copy").mkdir()
    (folder / "copy" / "render.exr").write_bytes((folder / "render.exr").read_bytes())
    again = files.textures(scene_of(folder / "copy", text))
    assert [each.content for each in again] == [beauty.content, albedo.content]
    assert again[1].radiance is albedo.radiance


def test_all_sides_of_an_object_have_the_layer(folder: Path) -> None:
    box = 'shape = "box"\ntexture = "render.exr"\ntexture_back = "#ff0000"\ntexture_left = "render.exr"\n'
    scene = scene_of(folder, f'[[object]]\n{box}texture_layer = "Albedo"\ntexture_mapping = "surface"\n')
    for item, texture in zip(scene.objects, InputFiles().textures(scene), strict=True):
        if item.name == "box back":
            assert texture.radiance.shape[:2] == (1, 1)
        else:
            np.testing.assert_array_equal(texture.radiance, ALBEDO)


def test_scenes_come_back(folder: Path) -> None:
    scene = scene_of(folder, BOTH.format("Albedo", "far"))
    assert clsco.parse_scene(clsco.dump_scene(scene)) == scene
    clsco.dump_scene(scene, folder / "other.toml")
    assert clsco.load_scene(folder / "other.toml") == scene
    record = prepare(scene).scene.model_dump(mode="json", by_alias=True)["object"][0]
    assert (record["texture_layer"], record["depth_layer"]) == ("Albedo", "far")
    schema = clsco.Scene.model_json_schema()["$defs"]
    assert "texture_layer" in schema["Sphere"]["properties"]
    assert "depth_layer" in schema["DepthMap"]["properties"]


def test_what_is_wrong_is_said_as_by_the_commands(folder: Path) -> None:
    write_png(folder / "a.png", np.zeros((12, 16), np.uint8))
    render = folder / "render.exr"
    listed = "View.Albedo.B View.Albedo.G View.Albedo.R View.Beauty.B View.Beauty.G View.Beauty.R far.Z near.Z"
    in_layer = f"{render}: an EXR must hold the channels R G B or Y in a layer sky; got {listed}"
    of_depth = f"{render}: an EXR must hold one depth: a channel Z, V, R or Y, or Z or V of a layer sky; got {listed}"
    no_exr = f"{folder / 'a.png'}: only an EXR has layers, such as near; got PNG"
    cases = {
        BOTH.format("sky", "sky"): [f"object[0].texture: {in_layer}", f"object[0].depth: {of_depth}"],
        BOTH.format("Beauty", "near").replace("render.exr", "a.png").replace('texture_layer = "Beauty"\n', ""): [
            f"object[0].depth: {no_exr}"
        ],
        '[[object]]\nshape = "plane"\ntexture = "a.png"\ntexture_layer = "near"\n': [f"object[0].texture: {no_exr}"],
    }
    for text, expected in cases.items():
        assert list(refusals(prepare, scene_of(folder, text))) == expected


def test_arrays_have_no_layers() -> None:
    with pytest.raises(SceneError, match="texture_layer: belongs to images in EXR files"):
        Scene(objects=(clsco.Plane(texture=BEAUTY, texture_layer="a"),))
    with pytest.raises(SceneError, match="depth_layer: belongs to depths in EXR files"):
        clsco.DepthMap(depth=NEAR, depth_layer="a")
