"""Depth, disparity and flow in files of KITTI and Middlebury: the field's readers, and values that do not fit."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from clsco.errors import FileError
from clsco.files.atomic import atomic_write_bytes
from clsco.files.images import read_image
from clsco.files.truth_codes import flo_bytes, kitti_depth_codes, kitti_disparity_codes, kitti_flow_codes, pfm_bytes
from tests.files.readers import torchvision_flo, torchvision_pfm

RNG = np.random.default_rng(12)
NOTHING = RNG.random((13, 7)) < 0.3
DEPTH = np.where(NOTHING, np.inf, RNG.uniform(5, 250_000, (13, 7))).astype(np.float32)  # mm
DISPARITY = RNG.uniform(0.01, 255, (13, 7)).astype(np.float32)
FLOW = RNG.uniform(-500, 500, (13, 7, 2)).astype(np.float32)
VALID = RNG.random((13, 7)) < 0.7
KITTI = "must round to 1/256 to 65535/256 {}, which KITTI's 16 bits hold besides 0 for unknown"
LARGEST, LARGEST_FLOW = 65535 / 256, 511 + 63 / 64


@pytest.mark.parametrize(("value", "code"), [
    (1 / 256, 1), (0.00196, 1), (0.0019, None), (0.0, None), (-0.0, None), (-3.0, None),
    (LARGEST, 65535), (LARGEST + 0.0019, 65535), (LARGEST + 0.002, None), (256.0, None), (3e38, None),
])  # fmt: skip
def test_kitti_holds_what_rounds_to_a_code_but_0(value: float, code: int | None) -> None:
    for encode, scale, unit in ((kitti_depth_codes, 1000.0, "m"), (kitti_disparity_codes, 1.0, "px")):
        values = np.full((3, 4), 10.0 * scale)
        values[2, 1] = values[2, 3] = value * scale
        if code is not None:
            codes = encode(values)
            assert (codes[2, 1], codes[0, 0]) == (code, 2560)
            continue
        rule = KITTI.format(unit) if unit == "px" or value > 0 else "must be greater than 0, and .inf where nothing is"
        with pytest.raises(FileError, match=rf"^a.png: {rule}; got .* at row 2, column 1 \(2 in all\)$"):
            encode(values, where="a.png")
    unseen = np.ones((3, 4), bool)
    unseen[2, 1] = False
    assert kitti_disparity_codes(np.where(unseen, 10.0, value), unseen)[2, 1] == 0


@pytest.mark.parametrize("value", [np.nan, -np.inf, 0.0, -1e-30])
def test_depth_must_be_positive(value: float) -> None:
    depth = DEPTH.copy()
    depth[1, 6] = value
    with pytest.raises(FileError, match=r"depth: must be greater than 0, and \+inf .*; got .* at row 1, column 6 \(1 "):
        kitti_depth_codes(depth)


def test_disparity_that_is_no_number_is_unknown() -> None:
    values = DISPARITY.copy()
    values[0, :3] = np.nan, np.inf, -np.inf
    np.testing.assert_array_equal(kitti_disparity_codes(values) == 0, ~np.isfinite(values))


@pytest.mark.parametrize("channels", [0, 2, 3])
def test_pfm_is_read_by_opencv_and_torchvision(tmp_path: Path, channels: int) -> None:
    shape = (13, 7, channels) if channels else (13, 7)
    array = RNG.normal(0, 1e3, shape).astype(np.float32)
    array[0, 0], array[5, 3] = np.inf, -0.0
    path = tmp_path / "a.pfm"
    atomic_write_bytes(path, pfm_bytes(array))
    np.testing.assert_array_equal(torchvision_pfm(path, max(channels, 1)).reshape(shape), array)
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    bgr = stored if channels == 0 else stored[..., ::-1]
    np.testing.assert_array_equal(bgr if channels != 2 else bgr[..., :2], array)
    if channels == 2:  # FlyingThings has a third channel of zeros
        assert not bgr[..., 2].any()
    if channels != 2:
        light = np.abs(np.where(np.isinf(array), 1, array)).astype(np.float32)
        atomic_write_bytes(path, pfm_bytes(light))
        np.testing.assert_array_equal(read_image(path).data, light)


def test_flo_is_read_by_opencv_and_torchvision(tmp_path: Path) -> None:
    path = tmp_path / "a.flo"
    atomic_write_bytes(path, flo_bytes(FLOW))
    np.testing.assert_array_equal(cv2.readOpticalFlow(str(path)), FLOW, strict=True)
    np.testing.assert_array_equal(torchvision_flo(path), FLOW)
    atomic_write_bytes(path, flo_bytes(FLOW, VALID))
    np.testing.assert_array_equal(torchvision_flo(path)[VALID], FLOW[VALID])
    assert (cv2.readOpticalFlow(str(path))[~VALID] > 1e9).all()  # what Middlebury's readers take for unknown
    cv2.writeOpticalFlow(str(path), FLOW)
    assert path.read_bytes() == flo_bytes(FLOW)


@pytest.mark.parametrize("value", [-512.0, -512 - 1 / 128, LARGEST_FLOW, LARGEST_FLOW + 0.0078, 0.0, -0.0, 1e-30])
def test_the_ends_of_kittis_range_are_held(value: float) -> None:
    flow = np.full((1, 1, 2), value)
    codes = kitti_flow_codes(flow)
    assert codes[0, 0, 2] == 1
    assert np.abs((codes[0, 0, :2].astype(float) - 32768) / 64 - value).max() <= 1 / 128


@pytest.mark.parametrize("value", [-512.01, LARGEST_FLOW + 0.0079, 512.0, -1e9, 3e38])
@pytest.mark.parametrize("channel", [0, 1])
def test_what_kitti_cannot_hold_is_refused_with_its_place(value: float, channel: int) -> None:
    flow = FLOW.copy()
    flow[4, 5, channel] = flow[9, 0, channel] = value
    vector = ", ".join(f"{part:.6g}" for part in flow[4, 5])
    with pytest.raises(FileError) as caught:
        kitti_flow_codes(flow, where="a.png")
    rule = "must lie within -512 to 511.984375 px, which KITTI's 16 bits hold in steps of 1/64 px"
    assert str(caught.value) == f"a.png: {rule}; got {vector} at row 4, column 5 (2 in all)"
    flow[9, 0] = np.nan
    valid = np.ones((13, 7), bool)
    valid[4, 5] = False
    assert kitti_flow_codes(flow, valid)[..., 2].sum() == 13 * 7 - 2


def test_flow_that_is_no_number_is_unknown(tmp_path: Path) -> None:
    flow = FLOW.copy()
    flow[0, 0, 0], flow[1, 1, 1], flow[2, 2] = np.nan, np.inf, -np.inf
    known = np.isfinite(flow).all(axis=-1)
    np.testing.assert_array_equal(kitti_flow_codes(flow)[..., 2] == 1, known)
    atomic_write_bytes(tmp_path / "a.flo", flo_bytes(flow))
    vectors = torchvision_flo(tmp_path / "a.flo")
    np.testing.assert_array_equal((vectors < 1e9).all(axis=-1), known)
    np.testing.assert_array_equal(vectors[known], flow[known])


def test_flo_refuses_what_readers_take_for_unknown() -> None:
    flow = FLOW.astype(np.float64)
    flow[3, 2] = -1e9, 5.0
    with pytest.raises(FileError, match=r"flow: sizes must be below 1e9 px, .*; got -1e\+09, 5 at row 3, column 2 \("):
        flo_bytes(flow)
    flow[3, 2] = -9.99e8, 1e300
    with pytest.raises(FileError, match=r"; got -9.99e\+08, 1e\+300 at row 3"):
        flo_bytes(flow)
    assert flo_bytes(np.where(np.abs(flow) > 1e9, 0, flow))


def test_other_shapes_are_refused() -> None:
    for encode in (kitti_depth_codes, kitti_disparity_codes):
        with pytest.raises(FileError, match=r"shape must be \(rows, columns\); got \(4, 5, 1\)"):
            encode(np.ones((4, 5, 1)))
    for shape in ((4,), (4, 5, 4), (2, 4, 5, 3)):
        with pytest.raises(FileError, match=r"shape must be \(rows, columns\[, 2 or 3\]\); got \(\d"):
            pfm_bytes(np.ones(shape))
    for write in (flo_bytes, kitti_flow_codes):
        for wrong in (np.zeros((4, 5)), np.zeros((4, 5, 3))):
            with pytest.raises(FileError, match=r"flow: shape must be \(rows, columns, 2\); got \(4, 5"):
                write(wrong)
