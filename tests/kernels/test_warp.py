"""The whole forward warp on a device against its twin, and by what every rigid motion has to do with pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from clsco.inputs.textures import Texture
from clsco.opencl.buffers import download
from clsco.opencl.session import Session
from clsco.optics.motion import Pose, rest_center
from clsco.passes.placed import PlacedScene
from clsco.passes.warp import ForwardWarp
from clsco.reference.common.geometry import Array, pixel_ray, solve_quadric
from clsco.reference.inpainting.fill import Method, fill_objects
from clsco.reference.inpainting.neighbors import Mask
from clsco.reference.trace.trace import padded_grid
from clsco.reference.warp.warp import extend_border, fill_entered, nearest_pixel, reproject_rest
from clsco.scene.model import DepthMap, Object, ObjectMotion, Sphere
from tests.kernels.conftest import gray

pytestmark = pytest.mark.slow  # whole frames of it are looked at in tests/pipeline
Maker = Callable[..., Any]
Warp = tuple[tuple[Object, ...], tuple[int, int]]
Warps = dict[str, Warp]
MOTION = ObjectMotion(velocity=(0.11, 0.07, 3.0), angular_velocity=(3.0, -2.0, 5.0))


def bordered(case: Any, values: Array, valid: Mask) -> tuple[Array, Mask]:
    """Values and validity after the last step, which scenes with a depth map have: the mirror image around them."""
    mapped = any(item.shape == "depth_map" for item in case.items)
    return extend_border(values, valid, case.guard) if mapped else (values, valid)


@pytest.mark.parametrize(
    ("name", "domain", "method"),
    [
        ("two balls", "span", "mean_median"),
        ("near and far", "surface", "ait"),
        ("map and ball", "span", "ait"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("two balls", "surface", "ait"),
                ("near and far", "surface", "mean_median"),
                ("map and ball", "surface", "mean_median"),
            )
        ),
    ],
)
def test_filled_warp_is_its_twin(
    session: Session, make_case: Maker, warps: Warps, name: str, domain: str, method: Method
) -> None:
    items, shape = warps[name]
    case = make_case(items, shape, channels=3, method=method, domain=domain)
    new, allowed, placed = case.twin(), None, case.placed(case.poses)
    if domain == "surface" and not any(item.shape == "depth_map" for item in items):
        rays = pixel_ray(case.plan.scene.camera, *padded_grid(case.plan.scene.camera, case.guard))
        allowed = np.zeros(case.shape, dtype=bool)
        for item, surface in zip(items, placed, strict=True):
            assert surface is not None
            allowed |= solve_quadric(surface, item.bounds, rays)[1] > 0
    values = np.concatenate([new.radiance, new.inverse_depth[..., None]], axis=-1)
    filled, objects, status, report = fill_objects(values, new.object, new.known, allowed, method, case.guard)
    assert (status == 1).sum() > 50
    warp = case.forward(session)
    done = warp.warp(warp.scene.posed(case.poses), [])
    assert done.object is not None
    valid = new.known | (status == 1)
    filled, objects, known = fill_entered(filled, objects, valid, new.entered, case.guard)
    status, valid = np.where(known & ~valid, 1, status), known
    filled, valid = bordered(case, filled, valid)
    assert (download(session, done.valid, case.shape, np.bool_) == valid).all()
    assert done.counters == asdict(report)
    assert (download(session, done.status, case.shape, np.uint8) == status).all()
    assert (download(session, done.object, case.shape, np.uint8) == objects).all()
    value = np.moveaxis(download(session, done.value, (3, *case.shape), np.float32), 0, -1)
    # A rounding to float32 of values up to 1 in each sweep.
    np.testing.assert_allclose(value, filled[..., :3], rtol=0, atol=1e-7 * (report.sweeps + 1))
    np.testing.assert_allclose(download(session, done.w, case.shape, np.float64), filled[..., 3], rtol=1e-12)


def test_objects_may_share_textures(session: Session, make_case: Maker, warps: Warps) -> None:
    case = make_case(*warps["near and far"])
    shared = replace(case, textures=np.stack([case.textures[0], case.textures[0]]))
    texture = Texture(gray(case.textures[0]), 8, "both")
    placed = PlacedScene(session, case.plan.scene, case.plan.psf, [texture, texture], "double")
    done = ForwardWarp(case.plan, placed, case.maps).warp(placed.posed(case.poses), [])
    value = download(session, done.value, case.shape, np.float32)
    assert (value == shared.warp(session)["value"][..., 0]).all()
    assert (value != case.warp(session)["value"][..., 0]).any()


def test_any_rigid_motion_is_that_of_its_points(session: Session, make_case: Maker, warps: Warps) -> None:
    """As seen from a moving camera: a turn about any axis and a shift that has nothing to do with the center."""
    case = make_case(*warps["map before map"], guard=20)
    rng = np.random.default_rng(47)
    poses = []
    for item in case.items:
        turn, _ = np.linalg.qr(np.eye(3) + 0.01 * rng.standard_normal((3, 3)))
        turn *= np.sign(np.diag(turn))
        poses.append(Pose(turn, (turn - np.eye(3)) @ rest_center(item) + rng.uniform(-1.0, 1.0, 3)))
    forward = case.forward(session)
    done = forward.warp(forward.scene.posed(poses), [])
    assert done.object is not None
    seen = download(session, done.object, case.shape, np.uint8)
    w, value = download(session, done.w, case.shape, np.float64), download(session, done.value, case.shape, np.float32)
    rest, whose = reproject_rest(case.plan.scene, case.rest, case.maps)
    step, (rows, columns) = case.grid["step"], rest.shape
    best: dict[tuple[int, int], tuple[float, int, float]] = {}
    for i, j in np.argwhere(rest > 0):
        k = int(whose[i, j])
        center, z = rest_center(case.items[k]), 1 / rest[i, j]
        point = np.array([step * (j - (columns - 1) / 2) * z, step * ((rows - 1) / 2 - i) * z, z])
        x, y, z = poses[k].rotation @ (point - center) + center + poses[k].shift
        place_px = np.array([(rows - 1) / 2 - y / z / step, (columns - 1) / 2 + x / z / step])
        target = tuple((nearest_pixel(place_px) + 20).tolist())
        inside = 0 <= target[0] < case.shape[0] and 0 <= target[1] < case.shape[1]
        if z > 0 and inside and 1 / z > best.get(target, (0.0,))[0]:
            best[target] = (1 / z, k, float(case.textures[k, i, j, 0]))
    assert {k for _, k, _ in best.values()} == {0, 1, 2, 3}
    assert (seen != 255).sum() == len(best)
    for target, (nearness, k, texel) in best.items():
        assert (seen[target], value[target]) == (k, np.float32(texel))
        assert abs(w[target] / nearness - 1) < 1e-12  # the same few operations in another order


@pytest.mark.parametrize("name", ["map alone", "map and ball"])
def test_truth_of_a_depth_map(session: Session, make_case: Maker, warps: Warps, name: str) -> None:
    """Depth, radius, mask and object are those of the planes; nothing is given that is not asked for."""
    names = ("sharp", "filled", "depth", "blur_radius", "mask", "object_id", "normal")
    case = make_case(*warps[name], guard=4, channels=3, method="ait")
    warp = case.forward(session)
    sample = warp.scene.posed(case.poses)
    truth, found = warp.truth(sample, names, []), case.warp(session)
    assert set(truth) == set(names) - {"normal"}
    frame = (slice(4, -4), slice(4, -4))
    mask = found["valid"][frame]
    assert 0 < mask.mean() < 1
    assert (truth["mask"] == mask).all()
    assert (truth["sharp"] == found["value"][frame]).all()
    assert (truth["depth"][~mask] == np.inf).all()
    assert (truth["depth"][mask] == 1 / found["w"][frame][mask]).all()
    assert (truth["blur_radius"] == found["coc"][frame].astype(np.float32)).all()
    seen = found.get("object", np.zeros(case.shape))[frame].astype(np.int32)
    assert (truth["object_id"] == np.where(mask, seen, -1)).all()
    assert truth["object_id"].dtype == np.int32
    assert warp.truth(sample, ("mask",), []).keys() == {"mask"}
    assert not warp.truth(sample, ("normal",), [])


def test_a_map_of_a_surface_moves_as_the_surface(session: Session, make_case: Maker) -> None:
    item = Sphere(center=(0.0, 0.0, 280.0), radius=4.0, motion=MOTION)
    case = make_case((item,), (64, 64))
    depth = reproject_rest(case.plan.scene, case.rest, case.maps)[0]
    mapped = make_case((DepthMap(depth="ball.npy", center=item.center, motion=MOTION),), (64, 64))
    placed = PlacedScene(
        session, mapped.plan.scene, mapped.plan.psf, [Texture(gray(case.textures[0]), 8, "ball")], "double"
    )
    warp = ForwardWarp(replace(mapped.plan, guard_px=case.guard), placed, [depth])
    done, expected = warp.warp(placed.posed(case.poses), []), case.warp(session)
    assert 100 < expected["valid"].sum() < 4000
    frame = (slice(case.guard, -case.guard), slice(case.guard, -case.guard))
    assert (download(session, done.valid, case.shape, np.bool_) == expected["valid"])[frame].all()
    assert (download(session, done.value, case.shape, np.float32) == expected["value"][..., 0])[frame].all()
