"""Video: pixels, rates and color tags as a decoder finds them, and a file that is whole or not there."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.errors import ArgumentError, FileError
from clsco.files import video
from clsco.files.transfer import encode
from clsco.files.video import PRESETS, parse_rate, preset_for, rate_of, write_clip, yuv_planes

NTSC = Fraction(30000, 1001)
YUV = [name for name, preset in PRESETS.items() if preset.is_yuv]
Codes = NDArray[Any]


def smooth(columns: int = 80, rows: int = 72, count: int = 4, kind: str = "u1") -> list[Codes]:
    """Waves of colors that move."""
    y, x = np.mgrid[:rows, :columns]
    waves = [0.5 + 0.4 * np.sin(x / 17 + y / 23 + c + np.arange(count)[:, None, None] / 9) for c in range(3)]
    top = np.iinfo(kind).max
    return list((np.stack(waves, axis=-1) * top + 0.5).astype(kind))


def noise(kind: str, gray: bool, columns: int = 48, rows: int = 32) -> list[Codes]:
    shape = (3, rows, columns) if gray else (3, rows, columns, 3)
    return list(np.random.default_rng(5).integers(0, np.iinfo(kind).max, shape, kind, endpoint=True))


def write(path: Path, frames: Any, preset: str, rate: Fraction = NTSC, **options: Any) -> Path:
    path = path.with_suffix(PRESETS[preset].suffix)
    write_clip(path, frames, rate, preset, **options)
    return path


def read(path: Path) -> tuple[Any, list[Any]]:
    """The stream, closed, and its frames."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return stream, list(container.decode(stream))


def planes(picture: Any) -> list[Codes]:
    """Samples of each plane, of pixel formats with one component per plane."""
    kind = np.uint16 if picture.format.components[0].bits > 8 else np.uint8
    return [
        np.frombuffer(plane, kind).reshape(plane.height, plane.line_size // np.dtype(kind).itemsize)[:, : plane.width]
        for plane in picture.planes
    ]


def codes_of(picture: Any) -> Codes:
    """Codes of a picture that is gray or RGB."""
    if picture.format.name == "bgr0":
        plane = picture.planes[0]
        return np.frombuffer(plane, np.uint8).reshape(plane.height, -1, 4)[:, : plane.width, 2::-1]
    decoded = planes(picture)
    return decoded[0] if len(decoded) == 1 else np.stack([decoded[2], decoded[0], decoded[1]], axis=-1)


def rgb_of(picture: Any) -> NDArray[np.float64]:
    """Red, green and blue from 0 to 255, by the formula of BT.709 with limited range."""
    bits = picture.format.components[0].bits
    y, cb, cr = (plane / 2.0 ** (bits - 8) for plane in planes(picture))
    wide = [np.repeat(np.repeat(c, y.shape[0] // c.shape[0], 0), y.shape[1] // c.shape[1], 1) for c in (cb, cr)]
    luma, blue, red = (y - 16) / 219, (wide[0] - 128) / 224, (wide[1] - 128) / 224
    r, b = luma + 2 * (1 - 0.2126) * red, luma + 2 * (1 - 0.0722) * blue
    return 255 * np.stack([r, (luma - 0.2126 * r - 0.0722 * b) / 0.7152, b], axis=-1)


@pytest.mark.parametrize("gray", [False, True])
@pytest.mark.parametrize(("preset", "kind"), [("ffv1", "u1"), ("h264-lossless", "u1"), ("ffv1-16", "u2")])
def test_lossless_presets_give_the_codes_back(tmp_path: Path, preset: str, kind: str, gray: bool) -> None:
    frames = noise(kind, gray, 33, 17)
    path = write(tmp_path / "clip", frames, preset)
    stream, decoded = read(path)
    assert stream.average_rate == NTSC
    for picture, frame in zip(decoded, frames, strict=True):
        got = codes_of(picture)
        expected = frame if got.ndim == frame.ndim else np.repeat(frame[..., None], 3, axis=2)
        np.testing.assert_array_equal(got, expected, strict=True)
    assert write(tmp_path / "again", frames, preset).read_bytes() == path.read_bytes()
    assert decoded[0].format.name == {("ffv1", True): "gray", ("ffv1-16", True): "gray16le"}.get(
        (preset, gray), {"ffv1": "bgr0", "h264-lossless": "gbrp", "ffv1-16": "gbrp16le"}[preset]
    )


# Of a smooth clip, in codes of 8 bits; docs/video.md has those of a rendered one.
LARGEST = {"mp4": 16, "mp4-444": 9, "hevc10": 18, "av1": 19, "webm": 11, "prores": 1.5, "prores-hq": 8, "y4m": 2}


@pytest.mark.parametrize("preset", YUV)
def test_lossy_presets_keep_colors_rate_and_tags(tmp_path: Path, preset: str) -> None:
    frames = smooth()
    path = write(tmp_path / "clip", frames, preset)
    stream, decoded = read(path)
    assert (stream.average_rate, len(decoded)) == (NTSC, len(frames))
    assert [round(picture.pts * stream.time_base * NTSC) for picture in decoded] == list(range(len(frames)))
    error = max(float(abs(rgb_of(p) - f).max()) for p, f in zip(decoded, frames, strict=True))
    assert error <= LARGEST[preset]
    expected = (2, 2, 2, 1) if preset == "y4m" else (1, 13, 1, 1)  # y4m has a place for the range alone
    for one in (stream.codec_context, decoded[0]):
        assert (one.color_primaries, one.color_trc, int(one.colorspace), int(one.color_range)) == expected
    assert write(tmp_path / "again", frames, preset).read_bytes() == path.read_bytes()


@pytest.mark.parametrize(("preset", "gray", "matrix"), [("ffv1", 0, 0), ("ffv1", 1, 1), ("ffv1-16", 0, 0),
                                                        ("ffv1-16", 1, 1), ("h264-lossless", 1, 0)])  # fmt: skip
@pytest.mark.parametrize(("transfer", "code"), [("srgb", 13), ("linear", 8)])
def test_tags_of_lossless_presets(
    tmp_path: Path, preset: str, gray: int, matrix: int, transfer: str, code: int
) -> None:
    stream, (first, *_) = read(write(tmp_path / "clip", noise("u1", bool(gray)), preset, NTSC, transfer=transfer))
    for one in (stream.codec_context, first):
        tags = (one.color_primaries, one.color_trc, int(one.colorspace), int(one.color_range))
        assert tags == (1, code, matrix, 2)


@pytest.mark.parametrize("blocks", [(1, 1), (1, 2), (2, 2)])
@pytest.mark.parametrize(("kind", "bits"), [("u1", 8), ("u2", 8), ("u2", 10)])
def test_planes_are_those_of_the_formula(kind: str, bits: int, blocks: tuple[int, int]) -> None:
    codes = noise(kind, False)[0]
    r, g, b = np.moveaxis(codes / np.iinfo(kind).max, 2, 0)
    y = 0.2126 * r + 0.7152 * g + 0.0722 * b
    expected = [16 + 219 * y, 128 + 224 * (b - y) / (2 - 2 * 0.0722), 128 + 224 * (r - y) / (2 - 2 * 0.2126)]
    for number in (1, 2):
        if blocks[1] == 2:
            left, right = (np.roll(expected[number], shift, axis=1) for shift in (1, -1))
            left[:, 0] = expected[number][:, 0]
            expected[number] = (0.25 * left + 0.5 * expected[number] + 0.25 * right)[:, ::2]
        if blocks[0] == 2:
            expected[number] = (expected[number][::2] + expected[number][1::2]) / 2
    for plane, exact in zip(yuv_planes(codes, bits, blocks), expected, strict=True):
        assert abs(plane - exact * 2 ** (bits - 8)).max() < 0.501
        assert plane.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert [int(plane[0, 0]) for plane in yuv_planes(np.full((2, 2), 255, "u1"), 8, (2, 2))] == [235, 128, 128]


@pytest.mark.parametrize("preset", ["mp4", "av1", "prores-hq"])
def test_odd_sizes_are_padded_where_they_must_be(tmp_path: Path, preset: str) -> None:
    path = (tmp_path / "clip").with_suffix(PRESETS[preset].suffix)
    (change,) = write_clip(path, smooth(65, 67), NTSC, preset)
    assert change.startswith(f"65 x 67 px stored as 66 x {67 if preset == 'prores-hq' else 68} px, with the last")
    assert f"as {preset} needs even sizes; these keep odd ones: mp4-444, " in change
    picture = read(path)[1][0]
    assert (picture.width, picture.height) == (66, 67 if preset == "prores-hq" else 68)
    luma = planes(picture)[0].astype(int)
    assert abs(luma[:67, 65] - luma[:67, 64]).max() <= 4 * 2 ** (picture.format.components[0].bits - 8)


def test_bits_are_rounded_or_widened(tmp_path: Path) -> None:
    frames = noise("u2", False)
    path = tmp_path / "clip.mkv"
    assert write_clip(path, frames, NTSC, "ffv1") == ("codes of 16 bits rounded to 8; ffv1-16 keeps them",)
    np.testing.assert_array_equal(codes_of(read(path)[1][0]), np.floor(frames[0] / 257 + 0.5))
    assert write_clip(path, noise("u1", True), NTSC, "ffv1-16") == ()
    np.testing.assert_array_equal(codes_of(read(path)[1][0]), noise("u1", True)[0] * np.uint16(257))


@pytest.mark.parametrize(("preset", "bits"), [("ffv1", 8), ("ffv1-16", 16)])
@pytest.mark.parametrize("kind", ["f2", "f4", "f8"])
def test_linear_floats_become_codes(tmp_path: Path, preset: str, bits: int, kind: str) -> None:
    linear = (np.random.default_rng(1).random((9, 12, 3)) * 1.4 - 0.2).astype(kind)
    picture = read(write(tmp_path / "clip", [linear], preset))[1][0]
    wide = linear.astype("f4") if kind == "f2" else linear
    np.testing.assert_array_equal(codes_of(picture), encode(wide, bits, "srgb"))


@pytest.mark.parametrize("rate", [Fraction(24000, 1001), Fraction(25), Fraction(29999, 1001), Fraction(120000, 1001)])
def test_rates_come_back_exactly(tmp_path: Path, rate: Fraction) -> None:
    frames = noise("u1", True)
    for preset in ("h264-lossless", "ffv1"):
        path = (tmp_path / "clip").with_suffix(PRESETS[preset].suffix)
        said = write_clip(path, frames, rate, preset)
        exact = read(path)[0].average_rate == rate
        assert exact == (preset == "h264-lossless" or rate in (25, Fraction(24000, 1001)))
        change = f"FFmpeg reads a rate of {read(path)[0].average_rate} from it, near {rate}; mp4 keeps it"
        assert said == (() if exact else (change,))


def test_the_rate_of_an_interval() -> None:
    for rate in (NTSC, Fraction(24000, 1001), Fraction(60000, 1001), Fraction(120000, 1001), 24, 25, 240, 1):
        assert rate_of(float(1 / Fraction(rate)), "DIR") == rate
    assert rate_of(0.0333667, "DIR") != NTSC
    assert rate_of(0.04, "DIR", Fraction(1, 4)) == Fraction(25, 4)
    for interval in (1.01, 1 / 241, 1e-300, 1e300):
        with pytest.raises(ArgumentError, match=r"^DIR: sequence.interval must give 1 to 240 frames per second; oth"):
            rate_of(interval, "DIR")
    with pytest.raises(ArgumentError, match=r"a rate must be given; got 1 s at 0\.25 times its speed$"):
        rate_of(1.0, "DIR", Fraction(1, 4))


def test_rates_are_exact_numbers() -> None:
    assert parse_rate("24000/1001") == Fraction(24000, 1001)
    assert parse_rate(" 23.976 ") == Fraction(2997, 125)
    assert parse_rate(25) == 25
    inexact: tuple[Any, ...] = (29.97, "", "24/0", "-1", "nan", "1e3", "1/", "24000 / 1001", True, "٣")
    for wrong in inexact:
        with pytest.raises(ArgumentError, match=r"^rate: must be exact: a Fraction"):
            parse_rate(wrong)
    beyond: tuple[Any, ...] = (0, "0", Fraction(-1), 2**20 + 1, Fraction(1, 2**21), "9" * 30)
    for wrong in beyond:
        with pytest.raises(ArgumentError, match=r"^rate: must be above 0, of numbers up to 1048576; got"):
            parse_rate(wrong)


def test_presets_by_extension() -> None:
    assert {suffix: preset_for(Path(f"a{suffix}")) for suffix in (".mp4", ".MKV", ".webm", ".mov", ".y4m")} == {
        ".mp4": "mp4", ".MKV": "ffv1", ".webm": "webm", ".mov": "prores", ".y4m": "y4m",
    }  # fmt: skip
    assert preset_for(Path("a.mkv"), "ffv1-16") == "ffv1-16"


def test_the_index_is_in_front(tmp_path: Path) -> None:
    content = write(tmp_path / "clip", smooth(), "mp4", comment="about").read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")
    assert b"about" in content


BAD = [
    ([], r"a clip must hold a frame; got none"),
    ([np.zeros((2, 2, 4), "u1")], r"frame 0: shape must be \(rows, columns\) or .*; got \(2, 2, 4\)"),
    ([np.zeros((0, 2), "u1")], r"frame 0: shape must be .*; got \(0, 2\)"),
    ([np.zeros((2, 2), "i4")], r"frame 0: values must be uint8 or uint16 codes, or floats; got int32"),
    ([np.full((2, 2), np.nan)], r"frame 0: values must be finite; got nan at row 0, column 0 \(4 in all\)"),
    ([np.zeros((2, 2)), np.full((2, 2), np.inf)], r"frame 1: values must be finite; got inf at row 0, column 0"),
    ([np.zeros((2, 2), "u1"), np.zeros((2, 4), "u1")], r"frame 1: size and type .* 2 x 2 px, gray, uint8; got 4 x 2"),
    ([np.zeros((2, 2), "u1"), np.zeros((2, 2), "u2")], r"frame 1: size and type .*; got 2 x 2 px, gray, uint16"),
    ([np.zeros((2, 2), "u1"), np.zeros((2, 2, 3), "u1")], r"frame 1: size and type .*; got 2 x 2 px, color, uint8"),
    ([np.broadcast_to(np.uint8(0), (1, 70000))], r"columns and rows must be from 1 to 65536"),
]


@pytest.mark.parametrize(("frames", "message"), BAD, ids=range(len(BAD)))
def test_frames_that_cannot_be_are_refused(tmp_path: Path, frames: Any, message: str) -> None:
    with pytest.raises(FileError, match=message):
        write(tmp_path / "clip", frames, "ffv1")
    assert list(tmp_path.iterdir()) == []


def test_sizes_that_an_encoder_does_not_take(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"hevc10 needs 66 columns and rows or more; these take"):
        write(tmp_path / "clip", smooth(48, 32), "hevc10")
    with pytest.raises(FileError, match=r"must be encodable and writable, by libx264 at 30000 x 2 px, 25 frames"):
        write(tmp_path / "clip", [np.zeros((2, 30000), "u1")], "mp4", Fraction(25))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt, clsco.CanceledError])
def test_errors_of_the_frames_pass_and_leave_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    def frames() -> Iterator[Codes]:
        yield from smooth()
        raise error("stop")

    for preset in ("mp4", "ffv1", "av1"):
        old = (tmp_path / "clip").with_suffix(PRESETS[preset].suffix)
        old.write_bytes(b"older")
        with pytest.raises(error, match="stop"):
            write(tmp_path / "clip", frames(), preset)
        assert old.read_bytes() == b"older"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip.mkv", "clip.mp4"]


@pytest.mark.parametrize("preset", ["mp4", "ffv1", "y4m"])
def test_a_full_disk_leaves_nothing(tmp_path: Path, preset: str) -> None:
    frames = np.random.default_rng(2).integers(0, 256, (9, 64, 64, 3), "u1")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(FileError, match=r"clip\.\w+: must be .*writable.*; got File too large$"):
            write(tmp_path / "clip", frames, preset)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


KILLED = """
import sys, numpy as np
from fractions import Fraction
from pathlib import Path
from clsco.files.video import write_clip
def frames():
    for number in range(10**6):
        yield np.full((64, 64), number % 256, "u1")
        if number == 50:
            print("writing", flush=True)
write_clip(Path(sys.argv[1]), frames(), Fraction(25), "mp4")
"""


def test_what_a_killed_writer_leaves_the_next_one_removes(tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"writing\n"
        time.sleep(0.02)
        writer.kill()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".clip.mp4.")
    write(path, smooth(), "mp4")
    assert list(tmp_path.iterdir()) == [path]


def test_names_are_never_addresses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FFmpeg opens http://..., pipe:1 and the like; a path is a path."""
    monkeypatch.chdir(tmp_path)
    for name in ("pipe:1.mp4", "file:a%d.mp4", "concat:a|b.mp4"):
        video.write_clip(Path(name), smooth(), NTSC, "mp4")
        assert read(tmp_path / name)[0].average_rate == NTSC


def test_settings_of_gnutls_are_not_read_from_the_temporary_folder() -> None:
    """Its constructor opens them, and would wait for a pipe; GnuTLS takes them from this variable if it is set."""
    code = "import os; from pathlib import Path; from clsco.files.video import require_video; "
    code += "require_video(Path('clip')); "
    code += "print(os.environ['GNUTLS_SYSTEM_PRIORITY_FILE'])"
    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert printed.stdout == f"{os.devnull}\n"
