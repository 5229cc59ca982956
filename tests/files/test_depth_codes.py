"""Depth and disparity in files of KITTI and PFM, read by the field's readers, and values that do not fit."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from clsco.errors import FileError
from clsco.files.atomic import atomic_write_bytes
from clsco.files.depth_codes import kitti_depth_codes, kitti_disparity_codes, pfm_bytes
from clsco.files.images import read_image
from tests.files.readers import torchvision_pfm

RNG = np.random.default_rng(12)
NOTHING = RNG.random((13, 7)) < 0.3
DEPTH = np.where(NOTHING, np.inf, RNG.uniform(5, 250_000, (13, 7))).astype(np.float32)  # mm
DISPARITY = RNG.uniform(0.01, 255, (13, 7)).astype(np.float32)
KITTI = "must round to 1/256 to 65535/256 {}, which KITTI's 16 bits hold besides 0 for unknown"


LARGEST = 65535 / 256


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


def test_other_shapes_are_refused() -> None:
    for encode in (kitti_depth_codes, kitti_disparity_codes):
        with pytest.raises(FileError, match=r"shape must be \(rows, columns\); got \(4, 5, 1\)"):
            encode(np.ones((4, 5, 1)))
    for shape in ((4,), (4, 5, 4), (2, 4, 5, 3)):
        with pytest.raises(FileError, match=r"shape must be \(rows, columns\[, 2 or 3\]\); got \(\d"):
            pfm_bytes(np.ones(shape))
