"""Cameras in files: points that they take from one frame to the next, or to the other view, land where flow and
disparity say. So axes, signs, units and centers of pixels are those of each format's readers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clsco.cli.main import main
from clsco.frame.cameras import exr_attributes, frame_rate, pinhole
from clsco.scene.file import parse_scene
from tests.scenes import scene_file

Array = NDArray[Any]
# Turns about all axes, an odd number of columns, and a normalization distance that is not the focal length.
SCENE = """
[camera]
resolution = [41, 32]
focal_length = 20.0
normalization_distance = 22.0
f_number = 8.0
focus_distance = 300.0
pixel_pitch = 0.1
[camera.motion]
velocity = [3.0, -5.0, 7.0]
angular_velocity = [2.0, -1.5, 4.0]
[stereo]
baseline = 9.0
toe_in = 1.5
[sequence]
frames = 3
interval = 0.5
shutter = 0.2
samples = 2
[[object]]
shape = "sphere"
center = [4.0, -3.0, 200.0]
radius = 15.0
[[object]]
shape = "plane"
distance = 380.0
slope_x = 0.3
"""
Model = tuple[Callable[[Array, Array, Array], Array], Callable[[Array], Array]]
"""Camera model: points of the world (n, 3), mm, of columns, rows and depths; and columns and rows (2, n) of them."""


def pinhole_model(focal: Array, center: Array, rotation: Array, translation: Array) -> Model:
    """As OpenCV has it: y down, pixels by their centers."""

    def to_world(column: Array, row: Array, depth: Array) -> Array:
        rays = np.stack([(column - center[0]) / focal[0], (row - center[1]) / focal[1], np.ones_like(depth)], axis=-1)
        return (rays * depth[:, None] - translation) @ rotation

    def to_pixels(points: Array) -> Array:
        x, y, z = (points @ rotation.T + translation).T
        return np.stack([focal[0] * x / z + center[0], focal[1] * y / z + center[1]])

    return to_world, to_pixels


def colmap_models(folder: Path) -> dict[str, Model]:
    """By name of the image; COLMAP counts columns and rows from the corner of the image."""
    cameras, models = {}, {}
    for line in (folder / "cameras.txt").read_text().splitlines():
        if not line.startswith("#"):
            identity, kind, columns, rows, *numbers = line.split()
            assert (kind, columns, rows) == ("PINHOLE", "41", "32")
            cameras[identity] = np.array(numbers, float)
    for line in (folder / "images.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            _, *pose, identity, name = line.split()
            w, x, y, z, *translation = map(float, pose)
            rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
            fx, fy, cx, cy = cameras[identity]
            focal, center = np.array([fx, fy]), np.array([cx, cy]) - 0.5
            models[name] = pinhole_model(focal, center, rotation, np.array(translation))
    return models


def exr_model(header: dict[str, Any]) -> Model:
    """As OpenEXR's introduction has it: the camera looks along +z, x is left and y up; the screen window is at z = 1,
    on the whole display window; matrices have points as rows before them."""
    matrix, width = header["worldToCamera"].astype(float), header["screenWindowWidth"]
    (left, top), (right, bottom) = header["dataWindow"]
    columns, rows = right - left + 1, bottom - top + 1
    middle, step = header["screenWindowCenter"], width / columns

    def to_world(column: Array, row: Array, depth: Array) -> Array:
        across, up = (column + 0.5 - columns / 2) * step - middle[0], (rows / 2 - row - 0.5) * step + middle[1]
        points = np.stack([-across * depth, up * depth, depth, np.ones_like(depth)], axis=-1)
        return (points @ np.linalg.inv(matrix))[:, :3]

    def to_pixels(points: Array) -> Array:
        x, y, z, _ = (np.column_stack([points, np.ones(len(points))]) @ matrix).T
        return np.stack([-x / z / step + columns / 2 - 0.5, rows / 2 - 0.5 - y / z / step])

    return to_world, to_pixels


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cameras")
    scene = scene_file(folder / "scene.toml", SCENE)
    words = ["render", str(scene), "-o", str(folder), "--format", "npz,exr,colmap", "--frames", "0:2"]
    result = CliRunner().invoke(main, words)
    assert (result.exit_code, result.stderr) == (0, "")
    return folder


def model(folder: Path, stem: str, kind: str) -> Model:
    if kind == "colmap":
        return colmap_models(folder / "sparse" / "0")[f"{stem}.png"]
    parts = OpenEXR.File(str(folder / f"{stem[:10]}.exr"), header_only=True).parts
    (header,) = (part.header for part in parts if part.header["view"] == stem[11:])
    return exr_model(header)


def seen(folder: Path, stem: str) -> tuple[dict[str, Array], Array, Array, Array]:
    """Truth of a frame, and columns, rows and depths of pixels that see a surface."""
    with np.load(folder / f"{stem}.npz") as found:
        truth = dict(found)
    row, column = np.nonzero(truth["mask"])
    return truth, column.astype(float), row.astype(float), truth["depth"][truth["mask"]].astype(float)


@pytest.mark.parametrize("kind", ["colmap", "exr"])
@pytest.mark.parametrize("eye", ["left", "right"])
def test_poses_of_frames_lead_where_flow_leads(rendered: Path, eye: str, kind: str) -> None:
    truth, column, row, depth = seen(rendered, f"frame_0000_{eye}")
    points = model(rendered, f"frame_0000_{eye}", kind)[0](column, row, depth)
    right, down = model(rendered, f"frame_0001_{eye}", kind)[1](points)
    flow = truth["flow"][truth["mask"]]
    assert np.abs(flow).max(axis=0).min() > 2  # px
    np.testing.assert_allclose(np.stack([right - column, down - row], axis=-1), flow, atol=2e-3)
    # The world is the scene's, with y down: points of the sphere are as far from its center as it is large.
    sphere = truth["object_id"][truth["mask"]] == 0
    assert sphere.sum() > 20
    distance = np.linalg.norm(points[sphere] - [4.0, 3.0, 200.0], axis=-1)
    np.testing.assert_allclose(distance, 15.0, atol=2e-3)


@pytest.mark.parametrize("kind", ["colmap", "exr"])
def test_poses_of_views_lead_where_disparity_leads(rendered: Path, kind: str) -> None:
    for eye, other in (("left", "right"), ("right", "left")):
        truth, column, row, depth = seen(rendered, f"frame_0001_{eye}")
        points = model(rendered, f"frame_0001_{eye}", kind)[0](column, row, depth)
        there, _ = model(rendered, f"frame_0001_{other}", kind)[1](points)
        disparity = truth["disparity"][truth["mask"]]
        assert np.ptp(disparity) > 2  # px
        np.testing.assert_allclose(column - there if eye == "left" else there - column, disparity, atol=2e-3)


def test_colmap_has_all_frames_of_the_scene(rendered: Path) -> None:
    names = [f"frame_{index:04d}_{eye}.png" for index in range(3) for eye in ("left", "right")]
    assert list(colmap_models(rendered / "sparse/0")) == names
    assert all((rendered / name).exists() for name in names[:4])


def test_an_exr_has_the_attributes_of_its_camera(rendered: Path) -> None:
    path = rendered / "frame_0001.exr"
    left, right = (part.header for part in OpenEXR.File(str(path), header_only=True).parts)
    header = left
    assert header["aperture"] == 8.0  # f-number
    assert header["focus"] == pytest.approx(0.3)  # m
    assert header["expTime"] == pytest.approx(0.2)  # s
    assert header["framesPerSecond"] == Fraction(2)
    assert header["chromaticities"] == pytest.approx((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329))
    assert header["screenWindowWidth"] == pytest.approx(41 * 0.1 / 22)
    assert "isoSpeed" not in header
    # Types as OpenEXR's list of standard attributes has them; the fourth row of the matrix moves.
    content = path.read_bytes()
    for name, kind in (("aperture", "float"), ("framesPerSecond", "rational"), ("chromaticities", "chromaticities")):
        assert f"{name}\0{kind}\0".encode() in content
    start = content.index(b"worldToCamera\0m44f\0") + len(b"worldToCamera\0m44f\0") + 4
    numbers = np.array(struct.unpack_from("<16f", content, start)).reshape(4, 4)
    np.testing.assert_array_equal(numbers, header["worldToCamera"])
    assert numbers[:, 3].tolist() == [0, 0, 0, 1]
    assert np.abs(numbers[3, :3]).min() > 1  # mm
    assert np.abs(left["worldToCamera"] - right["worldToCamera"]).max() > 8
    assert {**left, "view": 0, "name": 0, "worldToCamera": 0}.keys() == right.keys()


@pytest.mark.parametrize(("interval", "rate"), [
    (1.0, Fraction(1)), (1 / 24, Fraction(24)), (1001 / 30000, Fraction(30000, 1001)), (0.04, Fraction(25)),
    (1001 / 24000, Fraction(24000, 1001)), (1.5e-5, Fraction(200000, 3)), (1e-9, Fraction(10**9)),
    (4.0, Fraction(1, 4)), (90.5, Fraction(2, 181)), (1e9, Fraction(1, 10**9)),
])  # fmt: skip
def test_frame_rates_are_exact(interval: float, rate: Fraction) -> None:
    assert frame_rate(interval) == rate


def test_every_frame_rate_fits_the_attribute() -> None:
    for interval in 10.0 ** np.random.default_rng(5).uniform(-9, 9, 500):
        rate = frame_rate(float(interval))
        assert 0 < rate.numerator < 2**31
        assert 0 < rate.denominator < 2**32
        assert float(rate) == pytest.approx(1 / interval, rel=1e-9)


def test_a_camera_at_rest_is_at_the_origin() -> None:
    scene = parse_scene({"camera": {"resolution": [6, 5]}, "object": [{"shape": "plane"}]})
    shown = pinhole(scene, 0)
    assert (shown.focal, shown.center, shown.columns, shown.rows) == (2000.0, (2.5, 2.0), 6, 5)
    np.testing.assert_array_equal(shown.rotation, np.eye(3))
    np.testing.assert_array_equal(shown.translation, np.zeros(3))
    attributes = exr_attributes(scene, 0)
    np.testing.assert_array_equal(attributes["worldToCamera"], np.diag([-1, -1, 1, 1]))
    assert not attributes.keys() & {"expTime", "framesPerSecond"}  # nobody has said how long a still image takes


def test_an_exr_focused_at_infinity_says_so() -> None:
    camera = {"resolution": [6, 5], "focal_length": 20.0, "sensor_distance": 20.0}
    scene = parse_scene({"camera": camera, "object": [{"shape": "plane"}]})
    assert exr_attributes(scene, 0)["focus"] == np.inf
