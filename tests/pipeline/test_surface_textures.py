"""Textures on surfaces from scene to frame: the device against the reference, hard cases, and what must not change."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.reference import sequence as reference
from clsco.reference.trace import trace as reference_trace
from clsco.scene.model import Scene
from tests.pipeline.common import CAMERA, PLAIN, assert_strips_agree
from tests.scenes import assert_agree, plan_of, reference_frames, rendered, scene_from
from tests.slow import combined, mostly_slow

TWO = {"silhouette_samples": 2}
LAID: dict[str, Any] = {"texture_mapping": "surface"}
ANY = [50.0, 20.0, 10.0]
GOING = {"velocity": [6.0, -4.0, 12.0], "angular_velocity": [15.0, 120.0, -10.0]}
rng = np.random.default_rng(5)
PHOTO = rng.random((25, 40, 3)).astype(np.float32)
GRAY = rng.random((32, 32)).astype(np.float32)

BALL: dict[str, Any] = LAID | {
    "shape": "sphere",
    "center": [3.0, 0.0, 270.0],
    "radius": 16.0,
    "rotation": ANY,
    "texture": GRAY,
}
CUBE = BALL | {"texture_mapping": "cube", "texture_left": "siemens_star", "texture": "bricks"}
EGG = LAID | {"shape": "ellipsoid", "center": [0.0, 0.0, 270.0], "semi_axes": [20.0, 12.0, 15.0], "rotation": ANY}
TUBE = LAID | {"shape": "cylinder", "center": [0.0, 0.0, 270.0], "radius": 15.0, "texture": PHOTO}
CARD: dict[str, Any] = LAID | {
    "shape": "rectangle",
    "center": [0.0, 0.0, 255.0],
    "size": [30.0, 20.0],
    "texture": PHOTO,
}
CARD |= {"rotation": [20.0, 50.0, 10.0]}
# Slopes by which no pixel is on the threshold of DETAILED_LEAST, where single precision takes either side.
ROOF = LAID | {"shape": "plane", "distance": 250.0, "slope_x": 1.0, "slope_y": 0.31, "texture_size": 12.0}
HAT = LAID | {"shape": "cone", "apex": [0.0, 10.0, 250.0], "half_angle": 25.0, "rotation": [-70.0, 0.0, 0.0]}
HAT |= {"texture_size": 20.0}
CRATE = LAID | {"shape": "box", "center": [0.0, 0.0, 262.0], "size": [24.0, 18.0, 20.0], "rotation": [25.0, 35.0, 10.0]}
CRATE |= {"texture_top": "checkerboard"}
WALL = {"shape": "plane", "distance": 380.0, "texture": "checkerboard"}
WIRES = [{"shape": "cylinder", "radius": 0.35, "axis": [0.3, 1.0, 0.0], "center": [x, 0.0, 90.0]} for x in (-3.0, 1.0)]
BEHIND_WIRES = ROOF | {"slope_x": 0.21, "slope_y": 0.1, "texture": PHOTO}
NARROW = CAMERA | {"aperture_diameter": 1.0}
scene = partial(scene_from, {"camera": CAMERA})
INTO_THE_APEX = HAT | {"apex": [0.0, 0.0, 250.0], "rotation": [0.0, 0.0, 0.0], "half_angle": 60.0}
SCENES: dict[str, Scene] = {
    "card, and what it hides": scene(CARD, WALL, psf=TWO),
    "ball": scene(BALL, psf=TWO),
    "ball with its seam in front": scene(BALL | {"rotation": [0.0, 180.0, 0.0]}, psf=PLAIN),
    "cube map": scene(CUBE, psf=TWO),
    "tube": scene(TUBE, psf=TWO),
    "roof": scene(ROOF, psf=TWO),
    "roof to its horizon": scene(ROOF | {"slope_x": 0.0, "slope_y": 60.0}, psf=PLAIN, camera=NARROW),
    "apex in the middle of a pixel": scene(INTO_THE_APEX, psf=PLAIN, camera=CAMERA | {"resolution": [47, 35]}),
    "crate": scene(CRATE, WALL, psf=TWO),
    "roof behind wires": scene(BEHIND_WIRES, *WIRES, psf=TWO | {"tilt": False}),
    "roof behind wires, five blades": scene(
        BEHIND_WIRES, *WIRES, psf=TWO, aperture={"shape": "polygon", "blades": 5, "rotation": 10.0}
    ),
    "ball behind wires": scene(
        BALL | {"center": [0.0, 0.0, 262.0]}, *WIRES, WALL, psf=TWO, camera=CAMERA | {"resolution": [24, 18]}
    ),
    **{f"wrap {wrap}": scene(ROOF | {"texture_wrap": wrap, "texture": PHOTO}, psf=PLAIN)
       for wrap in ("repeat", "mirror", "clamp", "none")},
    **{f"filter {name}": scene(CARD | {"texture": GRAY, "texture_repeats": 0.4}, psf=PLAIN,
                               motion={"texture_filter": name}) for name in ("nearest", "bilinear")},
}  # fmt: skip
# The pixels in the middle are 1e-8 texels beside an edge between texels, which floats of a texel do not tell from it.
SCENES["an edge of texels"] = scene(
    CARD | {"rotation": [0.0, 0.0, 0.0], "center": [0.02, 0.02, 255.0], "texture": "checkerboard", "texture_size": 1e9},
    psf=PLAIN, motion={"texture_filter": "nearest"}, camera=CAMERA | {"resolution": [47, 35]},
)  # fmt: skip
SOME = [("wrap none", "double"), ("ball behind wires", "double")]


@pytest.mark.parametrize(("name", "precision"), combined(SCENES, ("double", "single"), kept=SOME))
def test_device_against_reference(name: str, precision: str) -> None:
    assert_agree(rendered(SCENES[name], precision=precision), reference_frames(SCENES[name]))


@pytest.mark.slow
def test_parts_of_a_pixel_see_the_lens_as_its_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Edges of what is far in front move little from part to part: to look for them once is off by 1e-3 at most."""
    wanted = SCENES["roof behind wires"]
    (shared,) = reference_frames(wanted)
    monkeypatch.setattr(reference_trace, "SHARED_PLACE", np.inf)
    (apart,) = reference.render(wanted)
    change = np.abs(shared.color - apart.color)
    assert 1e-4 < change.max() < 2e-3
    # Each looks at cells of the lens as wide as they are: a shift shows more than over whole pixels, which have 2e-4.
    assert np.sqrt(np.mean(np.square(change))) < 3.3e-4


BODIES: dict[str, dict[str, Any]] = {"ball": BALL, "tube": TUBE, "card": CARD, "hat": HAT, "egg": EGG}


@pytest.mark.parametrize("shape", mostly_slow(BODIES, ("ball",)))
def test_a_full_turn_ends_where_it_began_and_hides_nothing(shape: str) -> None:
    item = BODIES[shape]
    turning = item | {"motion": {"angular_velocity": [0.0, 6.0, 0.0]}}
    sequence = {"frames": 61, "interval": 1.0, "samples": 1, "shutter": 1e-6}
    wanted = scene(turning, psf=PLAIN, sequence=sequence)
    frames = list(clsco.render(wanted, frames=[0, 14, 31, 60]))
    assert not any(frame.hidden.any() for frame in frames if frame.hidden is not None)
    np.testing.assert_allclose(frames[3].color, frames[0].color, rtol=0, atol=1e-6)
    assert np.abs(frames[1].color - frames[0].color).max() > 0.05


def interpolated(image: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float64]:
    from clsco.reference.common.geometry import sample_texture

    return sample_texture(np.asarray(image, float), np.asarray(y, float), np.asarray(x, float), "bicubic")


def test_flow_carries_a_texture_to_the_next_frame() -> None:
    """The sharp image of a frame at the places of its flow is that of the frame before, where it is visible."""
    motion = {"velocity": [1.0, -0.6, 2.0], "angular_velocity": [3.0, 5.0, -4.0]}
    smooth = np.asarray(np.kron(rng.random((6, 8)), np.ones((8, 8))), np.float32)
    items = (
        BALL | {"radius": 22.0, "texture": smooth, "motion": motion},
        ROOF | {"texture": smooth, "texture_size": 90.0},
    )
    camera = CAMERA | {"resolution": [144, 108], "pixel_pitch": 0.0333}
    wanted = scene(*items, camera=camera, psf=PLAIN, sequence={"frames": 2, "samples": 1})
    first, second = rendered(wanted, truth=("sharp", "flow", "flow_occluded", "object_id"), color=False)
    i, j = np.indices(first.sharp.shape)
    found = interpolated(second.sharp, j + first.flow[..., 0], i + first.flow[..., 1])
    edge = np.zeros(first.sharp.shape, dtype=bool)
    for shift in ((0, 1), (1, 0), (0, -1), (-1, 0), (0, 2), (2, 0), (0, -2), (-2, 0)):
        edge |= np.roll(first.object_id, shift, (0, 1)) != first.object_id
    inside = ~(edge | first.flow_occluded)
    inside[:3] = inside[-3:] = inside[:, :3] = inside[:, -3:] = False
    assert inside.mean() > 0.6
    assert np.abs(first.flow[first.object_id == 0]).max() > 1.0
    error = np.sqrt(np.mean((found - first.sharp)[inside] ** 2))
    assert -20 * np.log10(error) > 45


def test_uv_is_where_the_texture_is_taken_from() -> None:
    ramp = np.tile((np.arange(64, dtype=np.float32) + 0.5) / 64, (64, 1))
    item = CARD | {"texture": ramp}
    (frame,) = rendered(scene(item, psf=PLAIN), truth=("uv", "sharp", "mask"), color=False)
    inside = frame.mask & (frame.uv[..., 0] > 0.1) & (frame.uv[..., 0] < 0.9)
    np.testing.assert_allclose(frame.uv[inside][:, 0], frame.sharp[inside], atol=2e-3)
    assert (frame.uv[~frame.mask] == 0).all()
    assert clsco.render_frame(scene(WALL, psf=PLAIN), color=False).uv is None  # of projected textures alone


@pytest.mark.parametrize("size", mostly_slow([1e-6, 1e-2, 0.1], [1e-2]))
def test_means_of_thousands_of_texels_of_one_color_are_that_color(size: float) -> None:
    """A pixel sees up to 10^10 texels, more than cells have room for; sums in single precision must not drift."""
    tiny = TUBE | {"texture": np.full((1, 1), 0.7, np.float32), "texture_size": size, "rotation": [20.0, 30.0, 10.0]}
    (frame,) = rendered(scene(tiny, psf=PLAIN), truth=("sharp", "depth"), color=False)
    seen = frame.sharp[np.isfinite(frame.depth)]
    assert len(seen) > 300
    np.testing.assert_allclose(seen, 0.7, rtol=3e-6)


def test_what_needs_it_alone_gets_it() -> None:
    for items, expected in (((WALL,), 0), ((CARD, WALL), 1), ((BALL, WALL), 2)):
        plan = plan_of(*items)
        assert plan.features()["TEXTURED"] == expected
        assert any("sharper" in each.buffers for each in plan.passes) == (expected > 0)


@pytest.mark.slow
def test_lenses_of_a_sweep_have_the_bits_of_each_alone() -> None:
    """Rays are cast once, and what textures need of the lens is done for each of them."""
    table: dict[str, Any] = {"camera": CAMERA | {"focus_distance": [240.0, 262.0]}, "psf": TWO, "object": [CARD, WALL]}
    together = list(clsco.render_sweep(clsco.parse_sweep(table)))
    for (_, found), focus in zip(together, (240.0, 262.0), strict=True):
        (alone,) = clsco.render(scene(CARD, WALL, psf=TWO, camera=CAMERA | {"focus_distance": focus}))
        np.testing.assert_array_equal(found.color, alone.color)
    assert np.abs(together[0][1].color - together[1][1].color).max() > 0.01


def test_strips_have_the_bits_of_the_whole() -> None:
    camera = CAMERA | {"resolution": [48, 100], "pixel_pitch": 0.1, "aperture_diameter": 5.0}
    assert_strips_agree(scene(CARD, psf=TWO | {"tilt": False}, camera=camera))


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (BALL | {"texture_size": 3.0}, 'texture_size: does not belong to "surface" on a sphere; got [3.0]'),
        (TUBE | {"texture_repeats": [2, 1]}, "texture_repeats: takes one number"),
        (CARD | {"texture_size": 3.0, "texture_repeats": 2}, "texture_repeats: stands in place of texture_size"),
        ({"shape": "plane", **LAID}, "texture_size: must be given with texture_mapping"),
        ({"shape": "sphere", "texture_wrap": "clamp"}, "texture_wrap: belongs to textures on surfaces"),
        ({"shape": "sphere", "texture_left": "bricks"}, "texture_left: belongs to boxes, and to texture_mapping"),
        (CARD | {"texture_mapping": "cube"}, "texture_mapping: on a rectangle must be"),
        (BALL | {"texture_angle": 3.0}, "texture_angle: does not belong"),
    ],
)
def test_keys_that_do_not_belong_are_refused(item: dict[str, Any], message: str) -> None:
    with pytest.raises(clsco.ClscoError, match="object") as caught:
        scene(item)
    assert message in str(caught.value)


def test_surface_textures_need_rays() -> None:
    with pytest.raises(clsco.ClscoError, match="texture_mapping: belongs to scenes of analytic surfaces"):
        scene(BALL | {"motion": GOING}, motion={"warp": "forward"})


def test_sides_of_a_cube_map_have_one_size() -> None:
    wanted = scene(CUBE | {"texture": GRAY, "texture_left": PHOTO})
    with pytest.raises(clsco.ClscoError, match="six sides of a cube map must have one size; got 32 x 32, 40 x 25 px"):
        rendered(wanted)
