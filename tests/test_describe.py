"""What is told of a scene: units of its parameters, its hash, and keys that it has no use for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.describe import planned, record, scene_sha256, units, unused_keys
from clsco.errors import ImageError
from clsco.scenefile import dump, parse_scene


@pytest.mark.parametrize("shape", ["plane", "cylinder", "sphere", "cone", "ellipsoid", "quadric"])
def test_every_number_has_a_unit_or_needs_none(shape: str) -> None:
    item: dict[str, Any] = {"shape": shape, "bounds": [[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]]}
    item |= {"coefficients": [1.0] * 10} if shape == "quadric" else {}
    scene = parse_scene({"object": [item], "psf": {"model": "gaussian"}})
    told = units(scene)
    without = {"camera.f_number", "sequence.frames", "sequence.samples", "psf.silhouette_samples"}
    without |= {"psf.sigma_ratio", "psf.truncation", "object[0].coefficients", "object[0].axis"}
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
    assert numbers - without <= set(told)
    assert told["camera.focal_length"] == "mm"
    assert told["object[0].motion.angular_velocity"] == "deg/s"
    assert without & set(told) == set()


def keys(**sections: Any) -> dict[str, str]:
    shape = sections.pop("item", {"shape": "plane"})
    scene = parse_scene({"object": [shape], "camera": {"resolution": [32, 32], "pixel_pitch": 0.2}, **sections})
    return dict(unused_keys(planned(scene, ())))


def test_keys_without_use_are_those_given_and_no_others() -> None:
    assert keys() == {}
    assert keys(sequence={"samples": 7, "frames": 2}) == {"sequence.samples": "nothing moves"}
    moving = {"shape": "sphere", "motion": {"velocity": [1.0, 0.0, 0.0]}}
    assert keys(item=moving, sequence={"samples": 7}, psf={"tilt": True, "silhouette_samples": 2}) == {}
    turning = {"shape": "sphere", "motion": {"angular_velocity": [1.0, 2.0, 0.0]}}
    assert keys(item=turning, motion={"rotation": "axis"}) == {}
    forward = {"warp": "forward"}
    assert keys(motion=forward, fill={"method": "ait"}) == dict.fromkeys(
        ["motion.warp", "fill.method"], "nothing moves"
    )
    found = keys(item=moving, motion=forward, fill={"method": "none", "domain": "span"})
    assert found == {"fill.domain": "fill.method is none"}
    assert keys(psf={"tilt": True, "silhouette_samples": 4}).keys() == {"psf.tilt", "psf.silhouette_samples"}
    assert keys(psf={"tilt": False, "silhouette_samples": 1}) == {}
    sharp = {"edge": "area", "model": "pillbox"}
    assert keys(psf=sharp).keys() == {"psf.edge", "psf.model"}


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
    with pytest.raises(ImageError, match=r"texture.npy: must be a file that can be read; got No such file"):
        record(scene)


def test_a_plan_takes_size_and_channels_from_the_texture(tmp_path: Path) -> None:
    np.save(tmp_path / "texture.npy", np.zeros((30, 40, 3), np.float32))
    scene = parse_scene({"object": [{"shape": "plane", "texture": str(tmp_path / "texture.npy")}]})
    plan = planned(scene, ("depth",))
    assert (plan.columns, plan.rows, plan.channels, plan.truth) == (40, 30, 3, ("depth",))
    camera = scene.camera.model_copy(update={"resolution": (9, 7)})
    plan = planned(scene.model_copy(update={"camera": camera}), ())
    assert (plan.columns, plan.rows, plan.channels) == (9, 7, 3)
