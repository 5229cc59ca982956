"""Files of ground truth by name: which arrays they hold, in 16 bits, compressed; and that resuming knows them."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner

from clsco.cli.main import main
from clsco.errors import ImageError, SceneError
from clsco.frame.files import files_of, holds_truth, needed_truth, truth_files, write_frame
from clsco.frame.frame import ALL_TRUTH, Frame
from clsco.frame.truth_files import TruthFile
from tests.scenes import PLANE, scene_file

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


def test_names_are_read() -> None:
    assert truth_files("") == ()
    assert truth_files("npz,exr,npz") == (TruthFile("npz"), TruthFile("exr"))
    assert truth_files("npz:coc,depth,exr") == (TruthFile("npz", ("depth", "coc")), TruthFile("exr"))
    assert truth_files("npz:blur_radius") == truth_files("npz:coc")
    wanted = TruthFile("npz", ("color", "flow"), float16=("all",), compressed=True)
    assert truth_files("npz+compressed+float16:flow,color") == (wanted,)
    assert truth_files(str(wanted)) == (wanted,)
    assert needed_truth(truth_files("npz:flow,color,exr:depth,coc")) == ("depth", "blur_radius", "flow")
    assert needed_truth(truth_files("npz:flow,exr")) == ALL_TRUTH
    assert needed_truth(truth_files("npz:color")) == ()
    assert needed_truth(truth_files("npz:alpha,color,depth")) == ("depth", "alpha")
    assert truth_files("npy+float16+zstd:depth,flo") == (
        TruthFile("npy", ("depth",), ("all",), zstd=True),
        TruthFile("flo"),
    )
    assert needed_truth(truth_files("flo,kitti_depth,cam,colmap")) == (
        "depth", "mask", "object_id", "flow", "flow_backward",
    )  # fmt: skip
    assert needed_truth(truth_files("npy")) == ALL_TRUTH
    assert needed_truth(truth_files("cam")) == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pdf", "must be some of npz,exr,npy,.*,colmap; got pdf"),
        ("npz,depth", "must be some of npz,exr,.*; got npz,depth"),
        ("npz:", "must name arrays after npz:, some of color, sharp, .*; got npz:$"),
        ("npz:depht", "must name arrays after npz:, .*; got depht$"),
        ("npz:depth,", "must name arrays after npz:, .*; got npz:depth,$"),
        ("npz+zip", r"must be npz or npz\+compressed; got npz\+zip"),
        ("exr+compressed", r"must be exr without options; got exr\+compressed"),
        ("flo+float16:flow", r"must be flo without options; got flo\+float16"),
        ("npz+zstd", r"must be npz or npz\+compressed; got npz\+zstd"),
        ("flo:depth", "must name arrays after flo:, some of flow, flow_backward; got depth"),
        ("pfm:mask", "must name arrays after pfm:, some of color, .*; got mask"),
        ("cam:depth", "must be cam without names, as it holds no arrays; got cam:depth"),
        ("npz:depth,npz:coc", "must name each format once; got npz:depth,npz:coc"),
    ],
)
def test_other_names_are_refused(text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        truth_files(text)


def test_arrays_go_to_the_formats_that_can_hold_them() -> None:
    assert files_of("", "", "") == ()
    assert files_of("depth,blur_radius") == (TruthFile("npz", ("depth", "coc")),)
    assert files_of("all") == files_of("", "npz") == (TruthFile("npz"),)
    found = files_of("flow,depth", "npz+compressed,flo,cam,exr", "depth=float16")
    assert list(map(str, found[:2])) == ["npz+depth=float16+compressed:depth,flow", "flo:flow"]
    assert list(map(str, found[2:])) == ["cam", "exr+depth=float16:depth,flow"]
    assert files_of("", "npy", "all=float16,depth=float32")[0].float16[:3] == ("color", "sharp", "coc")
    assert files_of("coc", "exr", "all=float16") == (TruthFile("exr", ("coc",), ("all",)),)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("npz",), "truth: must be some of color,sharp,.*; got npz"),
        (("depth", "flo"), "format: flo must hold some of depth; got flow,flow_backward"),
        (("depth,flow", "flo"), "format: must be one that holds depth; got flo"),
        (("depth", "npz,tif"), "format: must be some of npz,exr,.*; got tif"),
        (("depth", "npz+float16"), r"format: must be npz, with types all=float16; got npz\+float16"),
        (("depth", "npz,npz+compressed"), "format: must name each format once; got npz,npz"),
        (("depth", "", "depth=uint8"), "types: depth must be one of float32, float16; got depth=uint8"),
        (("", "", "depth=float16"), "types: are those of arrays in files, .*; got depth=float16 alone"),
    ],
)
def test_arrays_that_no_format_can_hold_are_refused(words: tuple[str, ...], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        files_of(*words)


def arrays(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as found:
        return dict(found)


def test_a_file_holds_what_is_named(tmp_path: Path) -> None:
    content = write_frame(tmp_path, (FRAME,), 8, "srgb", truth_files("npz:depth,coc,exr:flow,mask"))
    found = arrays(tmp_path / "frame_0000.npz")
    assert found.keys() == {"depth", "coc"}
    np.testing.assert_array_equal(found["depth"], DEPTH, strict=True)
    channels = OpenEXR.File(str(tmp_path / "frame_0000.exr"), separate_channels=True).channels()
    assert channels.keys() == {"flow.u", "flow.v", "mask"}
    assert content["truth"] == ["npz:depth,coc", "exr:mask,flow"]
    assert "truth" not in write_frame(tmp_path, (FRAME,), 8, "srgb", truth_files("npz,exr"))


def test_floats_in_16_bits(tmp_path: Path) -> None:
    write_frame(tmp_path, (FRAME,), 8, "srgb", truth_files("npz+float16,exr+float16"))
    found = arrays(tmp_path / "frame_0000.npz")
    for name in ("color", "depth", "coc", "flow"):
        exact = getattr(FRAME, "blur_radius" if name == "coc" else name)
        assert found[name].dtype == np.float16
        np.testing.assert_allclose(found[name], exact, rtol=2.0**-11, atol=2.0**-25)  # half of the 11th bit
    assert np.isinf(found["depth"]).any()
    assert (found["object_id"].dtype, found["mask"].dtype) == (np.int32, np.bool_)
    channels = OpenEXR.File(str(tmp_path / "frame_0000.exr"), separate_channels=True).channels()
    np.testing.assert_array_equal(channels["Z"].pixels, found["depth"], strict=True)
    assert channels["A"].pixels.dtype == np.float16
    assert channels["id"].pixels.dtype == np.float32
    assert (channels["id"].pixels == 40000).all()


@pytest.mark.parametrize(("size", "fits"), [(65519.0, True), (65520.0, False), (-1e6, False)])
def test_what_float16_cannot_hold_is_refused(tmp_path: Path, size: float, fits: bool) -> None:
    depth = np.full(SHAPE, 1.0, np.float32)
    depth[3, 2] = size
    for text in ("npz+float16", "exr+float16:depth"):
        if fits:
            write_frame(tmp_path, (Frame(4, FRAME.color, depth=depth),), 8, "srgb", truth_files(text))
            continue
        message = "frame 4: depth: sizes must be at most 65504 in float16; got .* at row 3, column 2 "
        with pytest.raises(ImageError, match=message):
            write_frame(tmp_path, (Frame(4, FRAME.color, depth=depth),), 8, "srgb", truth_files(text))
        assert list(tmp_path.iterdir()) == []


def test_floats_are_compressed_where_that_is_wanted(tmp_path: Path) -> None:
    even = Frame(0, np.zeros((64, 64), np.float32))
    sizes = []
    for text in ("npz", "npz+compressed"):
        write_frame(tmp_path, (even,), 8, "srgb", truth_files(text))
        sizes.append((tmp_path / "frame_0000.npz").stat().st_size)
        np.testing.assert_array_equal(arrays(tmp_path / "frame_0000.npz")["color"], even.color, strict=True)
    assert sizes[1] < sizes[0] / 10
    with zipfile.ZipFile(tmp_path / "frame_0000.npz") as archive:
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_DEFLATED}


def test_what_files_hold_is_known_from_their_record() -> None:
    named = {"truth": ["npz+float16:depth"]}
    assert holds_truth({}, truth_files("npz,exr"))
    assert holds_truth(named, truth_files("npz+float16:depth,exr"))
    for text in ("npz", "npz:depth", "npz+float16", "npz+float16:depth,coc"):
        assert not holds_truth(named, truth_files(text)), text
    for odd in ("npz", 3, [4], None):
        assert holds_truth({"truth": odd}, truth_files("npz"))


def test_render_writes_and_resumes_them(tmp_path: Path) -> None:
    out, scene = tmp_path / "out", scene_file(tmp_path / "plane.toml", PLANE)

    def render(*truth: str) -> bool:
        """True if the frame was rendered."""
        before = (out / "frame_0000.json").stat().st_mtime_ns if out.exists() else 0
        words = ["render", str(scene), "-o", str(out), "--resume", *truth]
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, result.output
        return (out / "frame_0000.json").stat().st_mtime_ns != before

    assert render("--truth", "depth,coc")
    assert arrays(out / "frame_0000.npz").keys() == {"depth", "coc"}
    recorded = json.loads((out / "frame_0000.json").read_text("utf-8"))
    assert recorded["truth"] == ["npz:depth,coc"]
    assert not render("--truth", "coc,depth", "--format", "npz")
    assert render("--truth", "coc,depth", "--types", "all=float16")
    assert render("--truth", "coc,depth", "--types", "coc=float16")
    assert json.loads((out / "frame_0000.json").read_text("utf-8"))["truth"] == ["npz+coc=float16:depth,coc"]
    found = arrays(out / "frame_0000.npz")
    assert (found["coc"].dtype, found["depth"].dtype) == (np.float16, np.float32)
    assert render("--truth", "all")
    assert not render("--format", "npz")
    assert "normal" in arrays(out / "frame_0000.npz")
    assert render("--truth", "alpha", "--format", "npz,exr")
    assert (arrays(out / "frame_0000.npz")["alpha"] > 0.9).any()
    assert OpenEXR.File(str(out / "frame_0000.exr"), separate_channels=True).channels().keys() == {"A"}
