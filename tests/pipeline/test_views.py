"""Outputs of several objects for those who compare views: flow, disparity, depth maps, sweeps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import clsco
from clsco.engine.sequence import render_sweep
from clsco.optics.lens import Lens
from clsco.scene.model import Scene
from tests.pipeline.common import PLAIN
from tests.scenes import reference_frames, rendered, scene_from
from tests.slow import combined

SIZE = 96
CAMERA = {"resolution": [SIZE, SIZE], "pixel_pitch": 0.05, "focus_distance": 250.0}
BALL = {"shape": "sphere", "center": [-5.0, 4.0, 190.0], "radius": 14.0}
WALL = {"shape": "plane", "distance": 380.0, "slope_x": 0.2}
CARD = {"shape": "plane", "distance": 300.0, "bounds": [[2.0, 30.0], [-30.0, 1.0], [-1.0, 1.0]], "name": "card"}
# Nothing looks at the blurred image.
TRUTH_ONLY = PLAIN | {"occlusion": "none"}
# The texture's steepest second derivative, per px^2: 0.25 (2 pi / 24)^2.
BEND = 0.25 * (2 * np.pi / 24) ** 2


# Smooth waves of 24 px and more.
AT = 2 * np.pi * np.arange(SIZE)
WAVES = (0.5 + 0.25 * np.sin(AT / 24) * np.cos(AT / 31)[:, None]).astype(np.float32)


def scene(*items: dict[str, Any], **sections: Any) -> Scene:
    objects = [{"texture": WAVES, **item} for item in items]
    return scene_from({"camera": CAMERA}, *objects, **sections)


def fetched(image: NDArray[Any], row: NDArray[Any], column: NDArray[Any]) -> NDArray[Any]:
    """Bilinear interpolation of an image (rows, columns) at positions in px, clamped to it."""
    return np.asarray(ndimage.map_coordinates(np.asarray(image, float), [row, column], order=1, mode="nearest"))


def whole_cell(number: NDArray[Any], row: NDArray[Any], column: NDArray[Any], own: NDArray[Any]) -> NDArray[Any]:
    """Mask of positions around which all four pixels show the object `own`."""
    rows, columns = number.shape
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    inside = (i >= 0) & (i < rows - 1) & (j >= 0) & (j < columns - 1)
    i, j = np.clip(i, 0, rows - 2), np.clip(j, 0, columns - 2)
    same = [number[i + a, j + b] == own for a in (0, 1) for b in (0, 1)]
    return np.asarray(inside & np.logical_and.reduce(same))


def test_flow_carries_a_frame_to_the_next() -> None:
    """Away from the outlines the sharp image of a frame, fetched along the flow from the next one, is the same."""
    moving = {"velocity": [6.0, -3.0, 4.0], "angular_velocity": [0.0, 8.0, 5.0]}
    wanted = scene(
        BALL | {"motion": moving}, CARD | {"motion": {"velocity": [-5.0, 2.0, 0.0]}}, WALL,
        sequence={"frames": 2, "samples": 1}, camera={"motion": {"velocity": [1.0, 0.0, 2.0]}}, psf=TRUTH_ONLY,
    )  # fmt: skip
    now, then = rendered(wanted, color=False)
    assert then.hidden is not None
    i, j = np.indices(now.sharp.shape)
    row, column = i + now.flow[..., 1], j + now.flow[..., 0]
    seen = whole_cell(then.object_id, row, column, now.object_id) & ~now.hidden
    assert set(np.unique(now.object_id[seen])) == {0, 1, 2}
    assert seen.mean() > 0.6
    assert np.abs(now.flow[seen]).max() > 3
    error = np.abs(fetched(then.sharp, row, column) - now.sharp)[seen]
    # Bilinear interpolation errs by an eighth of the second derivative in each axis, which the turned and foreshortened
    # texture of the ball has up to three times as large; cubic sampling of the texture adds a tenth of that.
    assert np.quantile(error, 0.99) < 1.1 * 3 * BEND / 4
    assert np.median(error) < BEND / 8


@pytest.mark.parametrize("toe_in", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_stereo_views_agree_outside_of_occlusions(toe_in: float) -> None:
    pair = scene(BALL, CARD, WALL, stereo={"baseline": 6.0, "toe_in": toe_in}, psf=TRUTH_ONLY)
    left, right = rendered(pair, color=False)
    assert (left.eye, right.eye) == ("left", "right")
    for one, other, sign in ((left, right, -1.0), (right, left, 1.0)):
        assert 0.02 < one.occluded.mean() < 0.5
        if toe_in:
            continue
        exact = 6.0 * 20.0 / (0.05 * one.depth.astype(np.float64))
        np.testing.assert_allclose(one.disparity, exact, rtol=2e-7, atol=0)  # one rounding each of depth and disparity
        grid = np.indices(one.sharp.shape)
        i, j = grid[0], grid[1]
        column = j + sign * one.disparity
        seen = whole_cell(other.object_id, i, column, one.object_id)
        # What is not occluded is the same object there, but for cells that an outline cuts.
        assert (seen | one.occluded).mean() > 0.9
        assert not (seen & one.occluded & (fetched(other.depth, i, column) > 0.999 * one.depth)).any()
        error = np.abs(fetched(other.sharp, i, column) - one.sharp)[seen & ~one.occluded]
        assert np.quantile(error, 0.99) < 1.1 * 3 * BEND / 8  # as for the flow, along the rows only


def test_what_is_hidden_from_the_other_view_is_nearer_there() -> None:
    pair = scene(BALL, CARD, WALL, stereo={"baseline": 6.0}, psf=TRUTH_ONLY)
    left, right = rendered(pair, truth=("occluded", "object_id", "disparity"), color=False)
    inside = np.indices(left.occluded.shape)[1] - left.disparity >= 0
    assert (left.object_id[left.occluded & inside] > 0).all()  # card and wall, behind the ball
    assert right.occluded is not None


@pytest.mark.parametrize(("right", "up"), [(0, 0), (3, -1)])
def test_the_apex_of_a_cone_faces_the_lens(right: int, up: int) -> None:
    """A pixel is 1 mm at the apex, so that all of it is exact; its light goes into all directions alike."""
    cone = {"shape": "cone", "apex": [float(right), float(up), 256.0], "half_angle": 40.0}
    camera = {"resolution": [9, 7], "pixel_pitch": 0.078125, "focus_distance": 150.0, "aperture_diameter": 20.0}
    whole = scene(cone, camera=camera, psf={"occlusion": "none", "silhouette_samples": 1, "edge": "sampled"})
    (frame,), (twin,) = rendered(whole), reference_frames(whole)
    assert frame.depth[3 - up, 4 + right] == 256.0
    ray = np.array([right, up, 256.0])
    np.testing.assert_allclose(frame.normal[3 - up, 4 + right], -ray / np.linalg.norm(ray), rtol=1e-7)
    np.testing.assert_allclose(frame.color, twin.color, rtol=0, atol=1e-6)


def test_a_depth_map_of_a_scene_gives_its_frame() -> None:
    """Depth and focused image of an analytic scene make the frame that its layers make, up to their rounding.

    Outside of the frame the map is mirrored, where the slanted wall goes on: the light that comes from there differs.
    """
    analytic = scene(BALL, WALL, psf={"occlusion": "layered"})
    (frame,) = rendered(analytic)
    bend = 10.0 * 20.0 / (2 * 0.05)  # px mm: what a change of inverse depth does to R
    for unit, depth in (("mm", frame.depth), ("inverse_mm", 1 / frame.depth), ("coc", frame.blur_radius)):
        item = {"shape": "depth_map", "depth": depth, "unit": unit, "texture": frame.sharp}
        (mapped,) = rendered(scene(item))
        # R from float32 is off by 6e-8 of kappa / Z or of R itself, and a frame changes by less than 1 per px of R.
        within = slice(frame.metadata["guard_px"], -frame.metadata["guard_px"])
        assert np.abs(mapped.color - frame.color)[within, within].max() < 1e-5
        assert 6e-8 * bend / 176.0 < 1e-5
        np.testing.assert_allclose(mapped.depth, frame.depth, rtol=1e-5, atol=0)
    assert Lens.of(analytic.camera).focus_power > 0


@pytest.mark.parametrize(
    ("key", "method"), combined(("focus_distance", "f_number"), ("auto", "scatter"), kept=[("focus_distance", "auto")])
)
def test_sweeps_over_the_lens_have_the_bits_of_single_scenes(key: str, method: str) -> None:
    values = {"focus_distance": [200.0, 400.0], "f_number": [2.0, 8.0]}[key]
    moving = BALL | {"motion": {"velocity": [5.0, 0.0, 0.0]}}
    scenes = [scene(moving, WALL, sequence={"samples": 2}, camera={key: value}, psf=PLAIN) for value in values]
    together = [frame for _, frame in sorted(render_sweep(scenes, method=method), key=lambda found: found[0])]
    alone = [next(iter(clsco.render(one, method=method))) for one in scenes]
    assert len(together) == len(values)
    assert np.abs(together[0].color - together[-1].color).max() > 0.01
    casts = [frame.metadata["seconds"].keys() for frame in together]
    assert "cast" in casts[0]
    assert "cast" not in casts[1]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one.color, other.color)
        np.testing.assert_array_equal(one.blur_radius, other.blur_radius)


def two_discs(size: int, **sections: Any) -> Scene:
    """A photograph of two near discs, close to each other, before a far wall of another brightness."""
    i, j = np.indices((size, size))
    near = np.minimum((j - 0.38 * size) ** 2, (j - 0.62 * size) ** 2) + (i - 0.5 * size) ** 2 < (0.1 * size) ** 2
    image, depth = np.where(near, 0.9, 0.2).astype(np.float32), np.where(near, 180.0, 400.0)
    item = {"shape": "depth_map", "texture": image, "depth": depth}
    lens = {"camera": CAMERA | {"resolution": [size, size], "pixel_pitch": 4.8 / size}}
    return scene_from({k: lens.get(k, {}) | sections.get(k, {}) for k in {*lens, *sections}}, item)


MOVED: dict[str, dict[str, Any]] = {
    "stereo": {"stereo": {"baseline": 14.0}},
    "moved": {"camera": {"motion": {"velocity": [14.0, 2.0, 0.0]}}, "sequence": {"samples": 1, "sampling": "endpoint"}},
    "turned": {"camera": {"motion": {"angular_velocity": [0.0, 0.0, 20.0]}}, "sequence": {"samples": 1}},
}


@pytest.mark.parametrize(("move", "method"), combined(MOVED, ("ait", "mean_median", "none"), kept=[("moved", "ait")]))
def test_what_a_moved_camera_uncovers_is_filled_from_behind_and_from_the_image(move: str, method: str) -> None:
    """Between two near discs the wall comes to light, and at the frame's edge what was outside of it."""
    whole = two_discs(SIZE, fill={"method": method}, motion={"warp": "forward"}, **MOVED[move])
    frame, twin = rendered(whole)[-1], reference_frames(whole)[-1]
    for name in ("filled", "mask", "object_id", "missing"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(twin, name))
    np.testing.assert_allclose(frame.color, twin.color, atol=2e-6)
    edge = np.concatenate([frame.filled[[0, -1]].ravel(), frame.filled[:, [0, -1]].ravel()])
    if method == "none":
        assert set(np.unique(frame.filled)) == {0, 2}
        assert (edge == 2).sum() > 10
        return
    assert set(np.unique(frame.filled)) == {0, 1}
    assert (edge == 1).sum() > 10
    assert frame.mask.all()
    assert frame.sharp.min() > 0.15  # black nowhere
    discs = (two_discs(SIZE).objects[0].inputs()["texture"].array > 0.5).sum()  # type: ignore[union-attr]
    assert (frame.sharp > 0.55).sum() < 1.15 * discs  # which come at most a little nearer
