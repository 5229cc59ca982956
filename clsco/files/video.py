"""Video files by PyAV: frames of codes or linear radiance, with exact rates and explicit color tags."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from numbers import Rational
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ArgumentError, import_extra
from clsco.files.atomic import atomic_write, raise_file_error
from clsco.files.decoders import check_limits
from clsco.files.ranges import first_of
from clsco.files.transfer import encode
from clsco.resources import remove_left

SLOWEST, FASTEST = 1, 240  # lowest and highest rate that an interval may give, frames per second
MOST = 2**20  # largest rate, numerator and denominator of a rate; containers can store far larger numbers
STANDARD_RATES = 1001 * 120  # largest denominator of an interval, which is enough to find 1001 / 120000 s from a float
_TRANSFER_TAGS = {"srgb": 13, "linear": 8}  # codes of ITU-T H.273
_BT709_PRIMARIES, _RGB_MATRIX, _BT709_MATRIX, _LIMITED, _FULL = 1, 0, 1, 1, 2
RED, BLUE = 0.2126, 0.0722  # shares of luma
_GREEN = 1 - RED - BLUE
# Rows: Y, Cb, Cr. In 8 bits, luma from 0 to 1 has 219 steps, and a color difference from -1/2 to 1/2 has 224 steps.
_MATRIX = np.array(
    [
        [219 * RED, 219 * _GREEN, 219 * BLUE],
        [-112 * RED / (1 - BLUE), -112 * _GREEN / (1 - BLUE), 112],
        [112, -112 * _GREEN / (1 - RED), -112 * BLUE / (1 - RED)],
    ]
)
_OFFSETS = np.array([16, 128, 128])


@dataclass(frozen=True)
class VideoPreset:
    """Encoding of a clip: FFmpeg's names of container, codec and pixel format, and options of the encoder.

    gray: pixel format of gray frames; "" to store them in color. least: fewest columns and rows that it can encode.
    """

    suffix: str
    container: str
    codec: str
    pixels: str
    bits: int
    options: dict[str, str] = field(default_factory=dict)
    gray: str = ""
    least: int = 1

    @property
    def is_yuv(self) -> bool:
        """True if the preset stores luma and color differences; False if it stores RGB or gray without loss."""
        return self.pixels.startswith("yuv")

    @property
    def blocks(self) -> tuple[int, int]:
        """Rows and columns of pixels that share a color sample."""
        return {"yuv420": (2, 2), "yuv422": (1, 2)}.get(self.pixels[:6], (1, 1))


_FFV1 = {"level": "3", "slicecrc": "1", "slices": "4", "g": "1"}
_X264 = {"crf": "16", "x264-params": "mbtree=0"}  # mbtree reads uninitialized memory: bits differ from run to run
# One row for each preset. Every encoder has a single thread, because the bits of most depend on the number of threads.
PRESETS = {
    "mp4": VideoPreset(".mp4", "mp4", "libx264", "yuv420p", 8, _X264),
    "mp4-444": VideoPreset(".mp4", "mp4", "libx264", "yuv444p", 8, _X264),
    "hevc10": VideoPreset(
        ".mp4", "mp4", "libx265", "yuv420p10le", 10,
        {"crf": "16", "x265-params": "log-level=none:pools=none:frame-threads=1"}, least=66,
    ),  # if a frame has only one block of 64 columns, x265 reads and writes beyond its memory
    "av1": VideoPreset(
        ".mp4", "mp4", "libsvtav1", "yuv420p10le", 10, {"crf": "20", "preset": "8", "svtav1-params": "lp=1"}, least=4
    ),
    "webm": VideoPreset(".webm", "webm", "libvpx-vp9", "yuv444p", 8, {"crf": "20", "b": "0"}),
    "h264-lossless": VideoPreset(".mp4", "mp4", "libx264rgb", "bgr0", 8, {"qp": "0"}),
    "ffv1": VideoPreset(".mkv", "matroska", "ffv1", "bgr0", 8, _FFV1, gray="gray"),
    "ffv1-16": VideoPreset(".mkv", "matroska", "ffv1", "gbrp16le", 16, _FFV1, gray="gray16le"),
    "prores": VideoPreset(".mov", "mov", "prores_ks", "yuv444p10le", 10, {"profile": "4444", "vendor": "apl0"}),
    "prores-hq": VideoPreset(".mov", "mov", "prores_ks", "yuv422p10le", 10, {"profile": "hq", "vendor": "apl0"}),
    "y4m": VideoPreset(".y4m", "yuv4mpegpipe", "wrapped_avframe", "yuv444p", 8),
}  # fmt: skip


def preset_for(path: Path, name: str | None = None) -> str:
    """Name of the preset for a file: `name`, or the first one with its extension. Raises ArgumentError, FileError."""
    suffix = path.suffix.lower()
    if name is None:
        suffixes = dict.fromkeys(preset.suffix for preset in PRESETS.values())
        if suffix not in suffixes:
            raise_file_error(path, f"the extension must be one of {' '.join(suffixes)}", repr(path.suffix))
        return next(known for known, preset in PRESETS.items() if preset.suffix == suffix)
    if name not in PRESETS:
        raise ArgumentError(f"preset: must be one of {', '.join(PRESETS)}; got {name}")
    if suffix != PRESETS[name].suffix:
        raise_file_error(path, f"the extension must be {PRESETS[name].suffix} for {name}", repr(path.suffix))
    return name


def require_video(path: Path) -> Any:
    """Import PyAV. Settings of its library GnuTLS are not read, because anybody could put them in a shared folder."""
    os.environ.setdefault("GNUTLS_SYSTEM_PRIORITY_FILE", os.devnull)
    return import_extra(path, "av", "video")


def require_size(path: Path, name: str, columns: int, rows: int) -> None:
    """Raise FileError for frames that a preset does not accept."""
    check_limits(path, columns, rows)
    preset = PRESETS[name]
    if min(columns, rows) < preset.least:
        smaller = ", ".join(known for known, other in PRESETS.items() if other.least <= min(columns, rows))
        rule = f"{name} needs {preset.least} columns and rows or more; these take less: {smaller}"
        raise_file_error(path, rule, f"{columns} x {rows} px")


def parse_rate(value: Fraction | int | str, where: str = "rate") -> Fraction:
    """Exact frames per second from a Fraction, an integer, or text like 23.976 or 24000/1001. Raises ArgumentError."""
    text = value.strip() if isinstance(value, str) else ""
    if text and len(text) <= 32 and re.fullmatch(r"\d+(\.\d+)?|\d+/0*[1-9]\d*", text, re.ASCII):
        rate = Fraction(text)
    elif isinstance(value, Rational) and not isinstance(value, bool):
        rate = Fraction(value)
    else:
        rule = "must be exact: a Fraction, a whole number, or text like 24 or 30000/1001"
        raise ArgumentError(f"{where}: {rule}; got {value!r}")
    if not (0 < rate <= MOST and rate.numerator <= MOST and rate.denominator <= MOST):
        raise ArgumentError(f"{where}: must be above 0, of numbers up to {MOST}; got {value}")
    return rate


def rate_of(interval: float, where: str, speed: Fraction = Fraction(1)) -> Fraction:
    """Frames per second of frames that are `interval` seconds apart, played `speed` times as fast.

    The float nearest to 1001 / 30000 s gives 30000/1001. Raises ArgumentError for a rate below 1 or above 240.
    """
    rate = Fraction(0)
    if 1e-9 < interval < 1e9:
        period = Fraction(interval).limit_denominator(STANDARD_RATES)
        rate = speed / period if period else Fraction(0)
    if not SLOWEST <= rate <= FASTEST:
        rule = f"must give {SLOWEST} to {FASTEST} frames per second; otherwise a rate must be given"
        faster = "" if speed == 1 else f" at {float(speed):g} times its speed"
        raise ArgumentError(f"{where}: sequence.interval {rule}; got {interval:g} s{faster}")
    return parse_rate(rate, where)


def write_clip(
    target: Path, frames: Iterable[NDArray[Any]], rate: Fraction, preset: str, transfer: str = "srgb", comment: str = ""
) -> tuple[str, ...]:
    """Write frames as a video file, atomically.

    frames: (rows, columns[, 3]) of one shape and type: codes (uint8, uint16) or linear radiance (floats, 1 = white),
    which is clipped. transfer: curve of the codes, "srgb" or "linear", by which floats are encoded. comment: text for
    the file's metadata, if the container has metadata.

    Returns notes on changes: 16 bits rounded to fewer, padded sizes, a rate that Matroska rounds. Raises
    MissingDependencyError and FileError; errors raised by `frames` propagate unchanged. After any error no file is
    left. Equal frames give equal bytes with the same PyAV.
    """
    require_video(target)
    source = _showable(target, frames)
    first = next(source, None)
    if first is None:
        raise_file_error(target, "a clip must hold a frame", "none")
    require_size(target, preset, first.shape[1], first.shape[0])
    clip = _Clip(target, PRESETS[preset], rate, transfer, comment, first)
    try:
        remove_left(target.parent)
        with atomic_write(target) as file:  # PyAV opens it by name, as it moves the index of an mp4 to the beginning
            clip.encode(str(Path(file.name).absolute()), _check_kinds(target, first, source))
    except _FromFramesError as error:
        raise error.error from None
    with require_video(target).open(str(target.absolute())) as container:
        seen = container.streams.video[0].average_rate  # another one from Matroska, which stores the interval in ns
    rounded = () if seen == rate else (f"FFmpeg reads a rate of {seen} from it, near {rate}; mp4 keeps it",)
    return (*clip.changes(preset), *rounded)


class _FromFramesError(Exception):
    """Wraps an error raised by the iterator of frames, so that it is not turned into a FileError."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error))
        self.error = error


def _showable(where: Path, frames: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """The frames, after checks that they are images of codes or of finite floats; where: file that FileError names."""
    for number, image in enumerate(frames):
        frame, name = np.asarray(image), f"frame {number}"
        if frame.ndim not in (2, 3) or frame.shape[2:] not in ((), (3,)) or 0 in frame.shape:
            raise_file_error(where, f"{name}: shape must be (rows, columns) or (rows, columns, 3)", frame.shape)
        if frame.dtype.kind != "f" and frame.dtype not in (np.uint8, np.uint16):
            raise_file_error(where, f"{name}: values must be uint8 or uint16 codes, or floats", frame.dtype)
        if frame.dtype.kind == "f" and not (finite := np.isfinite(frame)).all():
            raise_file_error(where, f"{name}: values must be finite", first_of(frame, ~finite))
        yield frame


def _check_kinds(where: Path, first: NDArray[Any], others: Iterator[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """All frames, each checked to match the first one; raises _FromFramesError."""

    def kind(frame: NDArray[Any]) -> str:
        channels = "gray" if frame.ndim == 2 else "color"
        return f"{frame.shape[1]} x {frame.shape[0]} px, {channels}, {frame.dtype}"

    try:
        for number, frame in enumerate(chain((first,), others)):
            if kind(frame) != kind(first):
                raise_file_error(
                    where, f"frame {number}: size and type must be those of frame 0, {kind(first)}", kind(frame)
                )
            yield frame
    except Exception as error:
        raise _FromFramesError(error) from error


@dataclass(frozen=True)
class _Clip:
    """Arguments of `write_clip`, with the first frame."""

    where: Path
    preset: VideoPreset
    rate: Fraction
    transfer: str
    comment: str
    first: NDArray[Any]

    @property
    def pixels(self) -> str:
        gray = self.first.ndim == 2 and self.preset.gray
        return gray or self.preset.pixels

    @property
    def size(self) -> tuple[int, int]:
        """Stored columns and rows, rounded up to whole blocks."""
        (rows, columns), (down, right) = self.first.shape[:2], self.preset.blocks
        return -(-columns // right) * right, -(-rows // down) * down

    @property
    def tags(self) -> dict[str, int]:
        """Color tags, as attributes of a codec context and of each frame."""
        is_rgb = not self.preset.is_yuv and self.pixels == self.preset.pixels  # gray is a luma without color
        return {
            "color_primaries": _BT709_PRIMARIES,
            "color_trc": _TRANSFER_TAGS[self.transfer],
            "colorspace": _RGB_MATRIX if is_rgb else _BT709_MATRIX,
            "color_range": _LIMITED if self.preset.is_yuv else _FULL,
        }

    def encode(self, target: str, frames: Iterator[NDArray[Any]]) -> None:
        """Write all frames. Raises FileError; OSError if the disk fails."""
        av, preset = require_video(self.where), self.preset
        os.environ.setdefault("SVT_LOG", "1")  # errors only: otherwise SVT-AV1 writes two dozen lines to stderr
        files = {"fflags": "+bitexact"} | ({"movflags": "+faststart"} if preset.container in ("mp4", "mov") else {})
        try:
            with av.open(target, "w", format=preset.container, options=files) as container:
                options = preset.options | {"threads": "1", "flags": "+bitexact"}
                stream = container.add_stream(preset.codec, rate=self.rate, options=options)
                (stream.width, stream.height), stream.pix_fmt = self.size, self.pixels
                stream.codec_context.time_base = 1 / self.rate
                for name, value in self.tags.items():
                    setattr(stream.codec_context, name, value)
                container.metadata["comment"] = self.comment
                for number, frame in enumerate(frames):
                    container.mux(stream.encode(self._picture(av, number, frame)))
                container.mux(stream.encode(None))
        except av.FFmpegError as error:
            what = f"{preset.codec} at {self.size[0]} x {self.size[1]} px, {self.rate} frames per second"
            raise_file_error(self.where, f"must be encodable and writable, by {what}", error, error)

    def _picture(self, av: Any, number: int, frame: NDArray[Any]) -> Any:
        columns, rows = self.size
        around = ((0, rows - frame.shape[0]), (0, columns - frame.shape[1]), (0, 0))[: frame.ndim]
        picture = av.VideoFrame(columns, rows, self.pixels)
        for plane, samples in zip(picture.planes, self._planes(np.pad(frame, around, mode="edge")), strict=True):
            lines = np.zeros((samples.shape[0], plane.line_size), np.uint8)
            content = np.ascontiguousarray(samples, samples.dtype.newbyteorder("<")).view(np.uint8)
            lines[:, : content[0].size] = content.reshape(len(lines), -1)
            plane.update(lines)
        for name, value in self.tags.items():
            setattr(picture, name, value)
        picture.pts, picture.time_base = number, 1 / self.rate
        return picture

    def _planes(self, frame: NDArray[Any]) -> list[NDArray[Any]]:
        """The values of a frame as the planes of its pixel format."""
        preset = self.preset
        if frame.dtype.kind == "f":
            linear = frame if frame.dtype.itemsize > 2 else frame.astype(np.float32)
            frame = encode(linear, 8 if preset.bits == 8 and not preset.is_yuv else 16, self.transfer)
        if preset.is_yuv:
            return yuv_planes(frame, preset.bits, preset.blocks)
        codes = _with_bits(frame, preset.bits)
        if self.pixels == preset.gray:
            return [codes]
        red, green, blue = (codes, codes, codes) if codes.ndim == 2 else np.moveaxis(codes, 2, 0)
        if preset.bits == 16:
            return [green, blue, red]
        return [np.stack([blue, green, red, np.zeros_like(red)], axis=-1)]

    def changes(self, name: str) -> tuple[str, ...]:
        """Notes on how stored frames differ from the originals."""
        rows, columns = self.first.shape[:2]
        notes = []
        if self.first.dtype == np.uint16 and self.preset.bits < 16:
            notes.append(f"codes of 16 bits rounded to {self.preset.bits}; ffv1-16 keeps them")
        if self.size != (columns, rows):
            whole = ", ".join(known for known, preset in PRESETS.items() if preset.blocks == (1, 1))
            stored = f"{self.size[0]} x {self.size[1]} px, with the last row or column again"
            notes.append(
                f"{columns} x {rows} px stored as {stored}, as {name} needs even sizes; these keep odd ones: {whole}"
            )
        return tuple(notes)


def _with_bits(codes: NDArray[Any], bits: int) -> NDArray[Any]:
    """Convert codes to 8 or 16 bits: they are rounded half up, or widened so that white stays white."""
    if codes.dtype.itemsize * 8 == bits:
        return codes
    return codes * np.uint16(257) if bits == 16 else ((codes.astype(np.uint32) + 128) // 257).astype("u1")


def yuv_planes(codes: NDArray[Any], bits: int, blocks: tuple[int, int] = (1, 1)) -> list[NDArray[Any]]:
    """Luma and color differences of an image: Y (rows, columns), and Cb and Cr, smaller by `blocks`, rounded once.

    codes: uint8 or uint16 (rows, columns[, 3]), in the transfer curve that the video states. bits: bits of the planes,
    8 (uint8) or 10 (uint16). blocks: rows and columns of pixels that share a color difference, (2, 2) for 4:2:0, (1, 2)
    for 4:2:2; the image consists of whole blocks.

    Color differences are sited as in MPEG-2: at the left one of two columns, where they are averaged with weights
    1 2 1, and midway between two rows. libswscale gives the same from 8-bit codes; from 16-bit codes its 10-bit luma is
    too large, by 1.7 codes on average and 3.8 at most.
    """
    top, scale = np.iinfo(codes.dtype).max, 2 ** (bits - 8)
    if codes.ndim == 2:
        luma = codes.astype(np.float32) * np.float32(219 * scale / top)
        planes = np.stack([luma, np.zeros_like(luma), np.zeros_like(luma)])
    else:
        values = codes.reshape(-1, 3).T.astype(np.float32)
        planes = ((_MATRIX * (scale / top)).astype(np.float32) @ values).reshape(3, *codes.shape[:2])
    down, right = blocks
    smaller = [_halved(plane, down, right) for plane in planes[1:]]
    kind = np.uint8 if bits == 8 else np.uint16
    pairs = zip((planes[0], *smaller), _OFFSETS, strict=True)
    return [(plane + np.float32(offset * scale + 0.5)).astype(kind) for plane, offset in pairs]


def _halved(plane: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """Sample a plane at every second column if `right` is 2, and between every two rows if `down` is 2."""
    if right == 2:
        padded = np.pad(plane, ((0, 0), (1, 0)), mode="edge")
        plane = (
            0.25 * padded[:, :-1:2]
            + 0.5 * padded[:, 1::2]
            + 0.25 * np.pad(plane, ((0, 0), (0, 1)), mode="edge")[:, 1::2]
        )
    return 0.5 * (plane[::2] + plane[1::2]) if down == 2 else plane
