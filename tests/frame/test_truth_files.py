"""Files of ground truth by name: which arrays they hold, in 16 bits, compressed; and that resuming knows them."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from clsco.errors import FileError, SceneError
from clsco.frame.files import files_of, holds_truth, needed_truth, write_frame
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH
from clsco.frame.truth_files import TruthFile

SHAPE = (5, 7)
RNG = np.random.default_rng(5)
DEPTH = np.where(RNG.random(SHAPE) < 0.2, np.inf, 2000 * RNG.random(SHAPE)).astype(np.float32)
FRAME = Frame(
    0,
    RNG.random((*SHAPE, 3), np.float32),
    depth=DEPTH,
    blur_radius=RNG.random(SHAPE, np.float32),
    mask=np.isfinite(DEPTH),
    object_id=np.full(SHAPE, 40000, np.int32),
    flow=RNG.random((*SHAPE, 2), np.float32),
)


def test_files_need_attributes_of_a_frame() -> None:
    assert needed_truth(files_of("coc,depth", "npz,exr")) == ("depth", "blur_radius")
    assert needed_truth(files_of("", "npz,exr")) == needed_truth(files_of("", "npy")) == ALL_TRUTH
    assert needed_truth(files_of("color")) == ()
    assert needed_truth(files_of("alpha,color,depth")) == ("depth", "alpha")
    assert needed_truth(files_of("", "flo,kitti_depth,colmap")) == (
        "depth", "mask", "object_id", "flow", "flow_backward",
    )  # fmt: skip


def test_arrays_go_to_the_formats_that_can_hold_them() -> None:
    assert files_of("", "", "") == ()
    assert files_of("depth,blur_radius") == (TruthFile("npz", ("depth", "coc")),)
    assert files_of("all") == files_of("", "npz") == (TruthFile("npz"),)
    assert files_of("", "npz,exr,npz") == (TruthFile("npz"), TruthFile("exr"))
    loaded = files_of("flow,depth", "npz+compressed,flo,colmap,exr", "depth=float16")
    assert list(map(str, loaded[:2])) == ["npz+depth=float16+compressed:depth,flow", "flo:flow"]
    assert list(map(str, loaded[2:])) == ["colmap", "exr+depth=float16:depth,flow"]
    assert files_of("", "npy", "all=float16,depth=float32")[0].float16[:3] == ("color", "sharp", "coc")
    assert files_of("coc", "exr", "all=float16") == (TruthFile("exr", ("coc",), ("all",)),)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("npz",), "truth: must be \"all\" or some of color, sharp, .*; got 'npz'"),
        (("depth", "flo"), "format: flo must hold some of depth; got flow,flow_backward"),
        (("depth,flow", "flo"), "format: must be one that holds depth; got flo"),
        (("depth", "npz,tif"), "format: must be some of npz,exr,.*; got tif"),
        (("depth", "npz+float16"), r"format: must be npz, with types all=float16; got npz\+float16"),
        (("", "npz+zip"), r"must be npz or npz\+compressed; got npz\+zip"),
        (("", "exr+compressed"), r"must be exr without options; got exr\+compressed"),
        (("mask", "pfm"), "format: pfm must hold some of mask; got color,.*"),
        (("depth", "npz,npz+compressed"), "format: must name each format once; got npz,npz"),
        (("depth", "", "depth=uint8"), "types: depth must be one of float32, float16; got depth=uint8"),
        (("", "", "depth=float16"), "types: are those of arrays in files, .*; got depth=float16 alone"),
    ],
)
def test_arrays_that_no_format_can_hold_are_refused(words: tuple[str, ...], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        files_of(*words)


def arrays(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as loaded:
        return dict(loaded)


def test_a_file_holds_what_is_named(tmp_path: Path) -> None:
    content = write_frame(
        tmp_path, (FRAME,), 8, "srgb", (TruthFile("npz", ("depth", "coc")), TruthFile("exr", ("mask", "flow")))
    )
    loaded = arrays(tmp_path / "frame_0000.npz")
    assert loaded.keys() == {"depth", "coc"}
    np.testing.assert_array_equal(loaded["depth"], DEPTH, strict=True)
    channels = OpenEXR.File(str(tmp_path / "frame_0000.exr"), separate_channels=True).channels()
    assert channels.keys() == {"flow.u", "flow.v", "mask"}
    assert content["truth"] == ["npz:depth,coc", "exr:mask,flow"]
    assert "truth" not in write_frame(tmp_path, (FRAME,), 8, "srgb", files_of("", "npz,exr"))


def test_floats_in_16_bits(tmp_path: Path) -> None:
    write_frame(tmp_path, (FRAME,), 8, "srgb", files_of("", "npz,exr", "all=float16"))
    loaded = arrays(tmp_path / "frame_0000.npz")
    for name in ("color", "depth", "coc", "flow"):
        exact = getattr(FRAME, "blur_radius" if name == "coc" else name)
        assert loaded[name].dtype == np.float16
        np.testing.assert_allclose(loaded[name], exact, rtol=2.0**-11, atol=2.0**-25)  # half of the 11th bit
    assert np.isinf(loaded["depth"]).any()
    assert (loaded["object_id"].dtype, loaded["mask"].dtype) == (np.int32, np.bool_)
    channels = OpenEXR.File(str(tmp_path / "frame_0000.exr"), separate_channels=True).channels()
    np.testing.assert_array_equal(channels["Z"].pixels, loaded["depth"], strict=True)
    assert channels["A"].pixels.dtype == np.float16
    assert channels["id"].pixels.dtype == np.float32
    assert (channels["id"].pixels == 40000).all()


@pytest.mark.parametrize(("size", "fits"), [(65519.0, True), (65520.0, False), (-1e6, False)])
def test_what_float16_cannot_hold_is_refused(tmp_path: Path, size: float, fits: bool) -> None:
    depth = np.full(SHAPE, 1.0, np.float32)
    depth[3, 2] = size
    for files in (files_of("", "npz", "all=float16"), files_of("depth", "exr", "all=float16")):
        if fits:
            write_frame(tmp_path, (Frame(4, FRAME.color, depth=depth),), 8, "srgb", files)
            continue
        message = "frame 4: depth: sizes must be at most 65504 in float16; got .* at row 3, column 2 "
        with pytest.raises(FileError, match=message):
            write_frame(tmp_path, (Frame(4, FRAME.color, depth=depth),), 8, "srgb", files)
        assert list(tmp_path.iterdir()) == []


def test_floats_are_compressed_where_that_is_wanted(tmp_path: Path) -> None:
    even = Frame(0, np.zeros((64, 64), np.float32))
    sizes = []
    for text in ("npz", "npz+compressed"):
        write_frame(tmp_path, (even,), 8, "srgb", files_of("", text))
        sizes.append((tmp_path / "frame_0000.npz").stat().st_size)
        np.testing.assert_array_equal(arrays(tmp_path / "frame_0000.npz")["color"], even.color, strict=True)
    assert sizes[1] < sizes[0] / 10
    with zipfile.ZipFile(tmp_path / "frame_0000.npz") as archive:
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_DEFLATED}


def test_what_files_hold_is_known_from_their_record() -> None:
    named, halves = {"truth": ["npz+float16:depth"]}, ("all",)
    assert holds_truth({}, files_of("", "npz,exr"))
    assert holds_truth(named, (TruthFile("npz", ("depth",), halves), TruthFile("exr")))
    for names, float16 in (((), ()), (("depth",), ()), ((), halves), (("depth", "coc"), halves)):
        assert not holds_truth(named, [TruthFile("npz", names, float16)])
    for odd in ("npz", 3, [4], None):
        assert holds_truth({"truth": odd}, files_of("", "npz"))
