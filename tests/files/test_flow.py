"""Flow in the files of Middlebury and KITTI, read by the field's readers, and values that do not fit."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from clsco.errors import FileError
from clsco.files.atomic import atomic_write_bytes
from clsco.files.flow import flo_bytes, kitti_flow_codes
from tests.files.readers import torchvision_flo

RNG = np.random.default_rng(11)
FLOW = RNG.uniform(-500, 500, (13, 7, 2)).astype(np.float32)
VALID = RNG.random((13, 7)) < 0.7
LARGEST = 511 + 63 / 64


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


@pytest.mark.parametrize("value", [-512.0, -512 - 1 / 128, LARGEST, LARGEST + 0.0078, 0.0, -0.0, 1e-30])
def test_the_ends_of_kittis_range_are_held(value: float) -> None:
    flow = np.full((1, 1, 2), value)
    codes = kitti_flow_codes(flow)
    assert codes[0, 0, 2] == 1
    assert np.abs((codes[0, 0, :2].astype(float) - 32768) / 64 - value).max() <= 1 / 128


@pytest.mark.parametrize("value", [-512.01, LARGEST + 0.0079, 512.0, -1e9, 3e38])
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
    with pytest.raises(
        FileError, match=r"flow: sizes must be below 1e9 px, .*; got -1e\+09, 5 at row 3, column 2 \(1 "
    ):
        flo_bytes(flow)
    flow[3, 2] = -9.99e8, 1e300
    with pytest.raises(FileError, match=r"; got -9.99e\+08, 1e\+300 at row 3"):
        flo_bytes(flow)
    assert flo_bytes(np.where(np.abs(flow) > 1e9, 0, flow))


def test_other_shapes_are_refused() -> None:
    for encode in (flo_bytes, kitti_flow_codes):
        for shape in ((4, 5), (4, 5, 3)):
            with pytest.raises(FileError, match=r"flow: shape must be \(rows, columns, 2\); got \(4, 5"):
                encode(np.zeros(shape))
