"""Keys of caches: whatever a value is made from changes its key, field by field."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from clsco.cache import V
from clsco.inputs.files import InputFiles
from clsco.opencl import program
from clsco.opencl.session import Session
from clsco.optics.field import SeidelField
from clsco.optics.motion import poses_at
from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.differences import Asymmetric
from clsco.optics.pupils.diffracted import Diffracted
from clsco.optics.pupils.fourier import FourierDiffracted
from clsco.optics.pupils.gaussian import Gaussian
from clsco.optics.pupils.hankel import HankelDiffracted
from clsco.optics.pupils.image import Image, image_pupil
from clsco.optics.pupils.outline import CurvedPolygon, Ellipse, Outline
from clsco.optics.pupils.polygon import Polygon
from clsco.optics.pupils.pupil import Pupil
from clsco.optics.pupils.ring import Ring
from clsco.optics.resolved_view import LENS_KEYS, _inverse_depths, without_lens
from clsco.passes.placed import PlacedScene
from clsco.passes.tables import _key
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.resources import code_digest
from clsco.scene.model import Camera, CameraMotion, DepthMap, Fill, ImageOptions, ObjectMotion, Plane, Scene, Sphere
from clsco.scene.motions import CameraShake
from tests.scenes import scene_of

WAVES = HankelDiffracted(Circle(), ((0.5, 1.0),)), FourierDiffracted(Circle(), ((0.5, 1.0),))
PUPILS = (
    Circle(), Gaussian(0.7, 3.0), Polygon(), Ring(0.5), image_pupil(np.eye(6)), CurvedPolygon(5, 3.0, 0.4),
    Ellipse(2.0), *WAVES,
)  # fmt: skip
OTHER_WORDS = {"integrated": "area"}


def changed(value: Any) -> Iterator[Any]:
    """A value with another one of each of its fields, in turn."""
    for field in fields(value):
        now = getattr(value, field.name)
        if is_dataclass(now):
            yield from (replace(value, **{field.name: each}) for each in changed(now))
        elif field.repr:  # else it follows from a digest
            yield replace(value, **{field.name: _other(now)})


def _other(value: Any) -> Any:
    match value:
        case bool():
            return not value
        case int():
            return value + 1
        case float():
            return 0.5 * value + 0.125
        case tuple():
            return (*value, (0.25, 1.0))
        case str():
            return OTHER_WORDS.get(value, f"{value}0")
        case None:
            return SeidelField(0.5, 0.2, 0.3, 0.4, (9, 7))
    raise TypeError(f"no other value of {type(value)} is known")


@pytest.mark.parametrize("samples", [0, 2])
def test_tables_of_weights_depend_on_each_field_of_a_point_spread(samples: int) -> None:
    known = [PointSpread(pupil) for pupil in PUPILS]
    known.append(replace(known[-1], varying=SeidelField(0.1, 0.2, 0.3, 0.4, (9, 7))))
    bases = Asymmetric, Outline, Diffracted
    kinds = {kind for base in (Pupil, *bases) for kind in base.__subclasses__()}
    assert {type(psf.pupil) for psf in known} == kinds - {*bases}
    every = [*known, *(each for psf in known for each in changed(psf))]
    assert len(every) > 4 * len(known)
    assert len({_key(psf, samples) for psf in every}) == len(set(every)) == len(every)
    assert {_key(psf, 3) for psf in every}.isdisjoint(_key(psf, samples) for psf in every)


def test_an_image_is_told_apart_by_each_cell() -> None:
    picture = 0.5 + 0.1 * np.arange(16.0).reshape(4, 4)
    found = set[Image]()
    for cell in [(0, 1), (1, 1), (2, 3)]:
        other = picture.copy()
        other[cell] += 0.01
        found.add(image_pupil(other))
    assert len({pupil.digest for pupil in found | {image_pupil(picture)}}) == 4


class Noted:
    """A cache that keeps nothing, and notes keys."""

    limit = 2**40

    def __init__(self) -> None:
        self.keys: list[Hashable] = []

    def get(self, key: Hashable, make: Callable[[], V], size: Callable[[V], int]) -> V:
        self.keys.append(key)
        return make()


DEPTH = np.linspace(300.0, 500.0, 8 * 6).reshape(6, 8)
DEPTH[2, 3] = 0.0
OTHER_KEYS: dict[str, dict[str, Any]] = {
    "depth": {"depth": 1.1 * DEPTH},
    "unit": {"unit": "m"},
    "scale": {"scale": 0.5},
    "baseline": {"unit": "disparity", "baseline": 60.0, "offset": 1.0},
    "offset": {"unit": "disparity", "baseline": 60.0, "offset": 2.0},
    "near": {"near": 250.0, "far": 600.0},
    "far": {"near": 250.0, "far": 650.0},
    "depth_kind": {"depth_kind": "ray"},
    "no_depth": {"no_depth": "far"},
    "soft_edges": {"soft_edges": "keep"},
    "texture": {"texture": "checkerboard"},
    "center": {"center": (1.0, 0.0, 300.0)},
    "motion": {"motion": ObjectMotion(velocity=(1.0, 0.0, 0.0))},
    "name": {"name": "map"},
    "group": {},  # of the poses alone
}
ELSEWHERE = {"shape", "depth_layer", "texture_layer", "bounds", "rotation"}  # of the content, or refused


def _numbers(item: DepthMap, **scene: Any) -> tuple[Hashable, bytes]:
    """Key of the inverse depths of a map, and their bits."""
    files, noted = InputFiles(), Noted()
    files.cache = noted  # type: ignore[assignment]
    camera = scene.pop("camera", {"f_number": 80.0})
    values = files.depth_values(scene_of(item, size=(8, 6), camera=camera, **scene), item)
    return next(key for key in noted.keys if isinstance(key, tuple) and key[0] == "inverse depth"), (
        values.inverse_depth.tobytes()
    )


def test_maps_with_one_key_have_the_same_depths() -> None:
    """Each key of a depth map, in turn: what leaves the key of the cache as it is leaves the numbers as they are."""
    said = {key for key in DepthMap.model_fields if not key.startswith("texture_")} - ELSEWHERE
    assert said == set(OTHER_KEYS)
    found = {_numbers(DepthMap(depth=DEPTH))}
    for keys in OTHER_KEYS.values():
        found.add(_numbers(DepthMap(**{"depth": DEPTH, **keys})))
    found.add(_numbers(DepthMap(depth=DEPTH), motion={"warp": "forward"}, fill=Fill(method="none")))
    found.add(_numbers(DepthMap(depth=DEPTH), camera={"f_number": 80.0, "pixel_pitch": 0.02}))
    found.add(_numbers(DepthMap(depth=DEPTH), image=ImageOptions(transfer="linear")))
    assert len({key for key, _ in found}) == len(found) >= 11


OTHER_CAMERAS: dict[str, dict[str, Any]] = {
    "focal_length": {"focal_length": 25.0},
    "f_number": {"f_number": 4.0},
    "focus_distance": {"focus_distance": 300.0},
    "aperture_diameter": {"aperture_diameter": 4.0},
    "sensor_distance": {"sensor_distance": 22.0},
    "normalization_distance": {"normalization_distance": 21.0},
    "pixel_pitch": {"pixel_pitch": 0.02},
    "resolution": {"resolution": (48, 48)},
    "motion": {"motion": CameraMotion(velocity=(0.0, 0.0, 1.0))},
    "shake": {"shake": CameraShake(rotation_rms=0.02)},
}


def test_rays_of_a_prediction_depend_on_the_camera_and_not_on_its_lens() -> None:
    """Scenes that are the same without their lenses share what rays hit: its keys change nothing, all others do."""
    assert set(OTHER_CAMERAS) == set(Camera.model_fields)
    items = (Sphere(), Plane(distance=400.0))

    def rays(scene: Scene) -> bytes:
        return _inverse_depths(scene, [(scene.camera, poses_at(scene, 1.0))], (None, None), 8).tobytes()

    base = scene_of(*items)
    for key, keys in OTHER_CAMERAS.items():
        other = Scene(camera=Camera(**({"resolution": (64, 48)} | keys)), objects=items)
        same = without_lens(other) == without_lens(base)
        assert same == (key in LENS_KEYS)
        assert not same or rays(other) == rays(base)


def test_textures_depend_on_content_transfer_size_and_primaries(tmp_path: Path) -> None:
    image = np.linspace(0.0, 1.0, 48, dtype=np.float32).reshape(4, 4, 3)
    for name, data in (("a", image), ("b", image[::-1])):
        np.save(tmp_path / f"{name}.npy", data)
    base = {"source": str(tmp_path / "a.npy"), "transfer": "srgb", "size": (4, 4), "to_srgb": False}
    others = {"source": str(tmp_path / "b.npy"), "transfer": "linear", "size": (5, 4), "to_srgb": True}
    every: list[dict[str, Any]] = [base, *(base | {name: other} for name, other in others.items()), base]
    files = InputFiles()
    found = [files.texture(**each) for each in every]
    assert len({texture.content for texture in found}) == len(found) - 1
    assert found[-1].radiance is found[0].radiance


def test_textures_on_a_device_depend_on_each_of_them_and_on_their_channels(session: Session) -> None:
    plane: dict[str, Any] = {"distance": 400.0}
    scenes = [
        (scene_of(Plane(**plane, texture="bricks")), Request()),
        (scene_of(Plane(**plane, texture="checkerboard")), Request()),
        (scene_of(Plane(**plane, texture="#ff0000")), Request()),
        (scene_of(Plane(**plane, texture="bricks"), Sphere(texture="#808080")), Request()),
        (scene_of(Plane(**plane, texture="bricks", texture_mapping="surface", texture_size=(40.0,))), Request()),
        (scene_of(Plane(**plane, texture="bricks")), Request(("alpha",))),
        (scene_of(Plane(**plane, texture="bricks"), size=(60, 48)), Request()),
        (scene_of(Plane(**plane, texture="bricks"), image=ImageOptions(transfer="linear")), Request()),
    ]
    found = [prepare(scene, request) for scene, request in scenes]
    keys = [PlacedScene(session, each.scene, each.plan.psf, each.textures, "float").content for each in found]
    assert None not in keys
    assert len(set(keys)) == len(keys)


def test_programs_depend_on_each_part_of_a_request(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "_compile_for_device", lambda *_: {})
    point = np.dtype([("x", "f4"), ("y", "f4")], align=True)
    base: tuple[Any, ...] = ("blur/accumulate.cl", {"CHANNELS": 1}, {"point_t": point}, "float")
    others: dict[int, list[Any]] = {
        0: ["inpainting/fill.cl"],
        1: [{"CHANNELS": 2}, {"ALPHA": 1}, {"CHANNELS": 1, "TEXTURED": 1}, {"CHANNELS": 1, "OCCLUDED": 4}],
        2: [{}, {"place_t": point}, {"point_t": np.dtype([("x", "f4"), ("y", "f8")], align=True)}],
        3: ["double"] * session.device.has_fp64,
    }
    requests = [base, *(tuple(other if k == at else each for k, each in enumerate(base))
                        for at, all_others in others.items() for other in all_others)]  # fmt: skip
    fresh = session.unwatched()
    fresh.programs, fresh.requests = {}, {}
    for source, features, structs, real in [*requests, base]:
        program.build(fresh, source, features, structs, real)
    assert len(fresh.requests) == len(requests)
    assert len(fresh.programs) == len(requests) - 4  # of one text: nothing of the file depends on these features


def test_a_package_is_told_by_all_of_its_files(tmp_path: Path) -> None:
    package = ModuleType("package")
    package.__file__ = str(tmp_path / "__init__.py")
    found = set()
    for name, text in (("__init__", ""), ("one", "a = 1\n"), ("two", "b = 1\n"), ("one", "a = 2\n")):
        (tmp_path / f"{name}.py").write_text(text)
        found.add(code_digest(package))
    assert len(found) == 4
