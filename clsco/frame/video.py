"""Video clips of frames, or of a folder of frames."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco import __version__
from clsco.errors import ArgumentError, FileError
from clsco.files.transfer import TRANSFERS, encode
from clsco.files.video import PRESETS, parse_rate, preset_for, rate_of, write_clip
from clsco.frame.frame import GREEN, Frame
from clsco.frame.frame_folder import FrameFolder
from clsco.frame.notebook import three_channels
from clsco.frame.views import VIEWS

VIEW_NAMES = ("color", "sharp", *VIEWS, "compare")


def write_video(
    path: str | os.PathLike[str],
    frames: Iterable[Frame | NDArray[Any]],
    rate: Fraction | int | str,
    *,
    preset: str | None = None,
    transfer: str = "srgb",
    comment: str = "",
) -> tuple[str, ...]:
    """Write frames as a video file, atomically.

    Parameters
    ----------
    path : path
        .mp4, .webm, .mkv, .mov or .y4m, as the preset requires.
    frames : iterable of Frame or of ndarray, (rows, columns) or (rows, columns, 3)
        The color of frames of one view, or arrays of one shape and type: uint8 or uint16 codes, or floats of linear
        radiance, 1 = white; values below 0 become black, above 1 white.
    rate : Fraction, int or str
        Frames per second, exactly: Fraction(30000, 1001), 24, "24000/1001".
    preset : str, optional
        mp4, mp4-444, hevc10, av1, webm, h264-lossless, ffv1, ffv1-16, prores, prores-hq or y4m; by default the first
        of these with the extension.
    transfer : {"srgb", "linear"}
        Transfer curve of the codes; floats are encoded by it.
    comment : str
        Comment in the file's metadata, by default the version of clsco.

    Returns
    -------
    tuple of str
        Changes, one line each: codes of 16 bits rounded to fewer, sizes padded to even numbers, a rate that Matroska
        rounds.

    Raises
    ------
    MissingDependencyError
        The extra `video` is missing.
    ArgumentError
        The preset, rate or transfer is unknown, or the frames have two views.
    FileError
        Frames differ in size or type, or are not finite; the encoder or the disk fails. No file is left then. An error
        raised by `frames` propagates unchanged.

    Notes
    -----
    Frame k is shown from k / rate on. The same frames give the same bytes with the same version of PyAV. Validated for
    each preset by reading pixels, rate and color tags back: ffv1, ffv1-16 and h264-lossless give the codes that went
    in, bit by bit (docs/video.md has the errors of the others).

    Examples
    --------
    >>> import clsco
    >>> import numpy as np
    >>> import tempfile
    >>> pictures = [np.full((24, 32, 3), level, np.uint8) for level in (0, 128, 255)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     clsco.write_video(f"{folder}/clip.y4m", pictures, 24)
    ()
    """
    if transfer not in TRANSFERS:
        raise ArgumentError(f"transfer: must be one of {', '.join(TRANSFERS)}; got {transfer}")
    name = preset_for(Path(path), preset)
    about = comment or f"clsco {__version__}"
    return write_clip(Path(path), _colors(frames), parse_rate(rate), name, transfer, about)


def _colors(frames: Iterable[Frame | NDArray[Any]]) -> Iterator[NDArray[Any]]:
    eye = None
    for number, frame in enumerate(frames):
        if not isinstance(frame, Frame):
            yield frame
            continue
        if eye not in (None, frame.eye):
            raise ArgumentError(f"frames: must be of one view; got {frame.eye} at {number}, after {eye}")
        eye = frame.eye
        yield frame.color


@dataclass(frozen=True)
class Playing:
    """Playback speed of a clip: `fps` frames per second, or if that is None, `speed` times the speed of the scene."""

    fps: Fraction | None = None
    speed: Fraction = Fraction(1)

    def rate(self, interval: float, where: str) -> Fraction:
        """Frames per second for an interval in s between frames; where: start of messages. Raises as `rate_of`."""
        return rate_of(interval, where, self.speed) if self.fps is None else self.fps

    def about(self, interval: float, where: str) -> str:
        """Text with the rate, and how it differs from the scene's; arguments as for `rate`."""
        rate = self.rate(interval, where)
        text = f"{rate} frames per second"
        if self.fps is None and self.speed == 1:
            hint = "; clsco video --fps 24 plays it faster" if interval == 1 else ""
            return f"{text}, as sequence.interval = {interval:g} s{hint}"
        times = float(rate) * interval
        return f"{text}, {times:.6g} times the speed of the scene (sequence.interval = {interval:g} s)"


def write_folder_clip(
    target: Path, frames: FrameFolder, eye: str, view: str, preset: str, playing: Playing,
    advance: Callable[[], object] = lambda: None,
) -> list[str]:  # fmt: skip
    """Write the frames of a folder as a clip; returns notes for users: the rate, the scale of colors, changes.

    eye: one of `FrameFolder.eyes`. view: one of `VIEW_NAMES`: "color" (the PNG files), "sharp", "compare" (both side by
    side), or "depth", "coc" or "flow" as colors with one scale for the clip. advance: called after each frame. Raises
    the errors of `write_clip`, and FileError if files are missing or damaged.
    """
    where = str(frames.folder)
    facts = [f"{len(frames.numbers)} frames at {playing.about(frames.interval, where)}"]
    if len(frames.numbers) < frames.of:
        facts.append(f"frames {frames.numbers[0]} to {frames.numbers[-1]} of the {frames.of} of the scene")
    pictures: Iterator[NDArray[Any]]
    if view in VIEWS:
        shown, transfer = VIEWS[view], "srgb"
        scale = shown.scale(_measured(frames, view, eye))
        facts.append(shown.label(scale))
        pictures = (shown.paint(array, scale) for array in _measured(frames, view, eye))
    else:
        pictures, transfer = _pictures(frames, eye, view), frames.transfer
    comment = "; ".join([f"clsco {__version__}", *facts])
    rate = playing.rate(frames.interval, where)

    def counted() -> Iterator[NDArray[Any]]:
        for picture in pictures:
            yield picture
            advance()

    return [*facts, *write_clip(target, counted(), rate, preset, transfer, comment)]


def _measured(frames: FrameFolder, name: str, eye: str) -> Iterator[NDArray[Any]]:
    """The array `name` of each frame; if blur radii differ by color, those of green. Blur radii are +inf in pixels
    without a surface if the folder has the depth.
    """
    arrays = frames.arrays(name, eye)
    if name == "coc":
        arrays = (radius if radius.ndim == 2 else radius[..., GREEN] for radius in arrays)
    if name != "coc" or not frames.has("depth", eye):
        return arrays
    pairs = zip(arrays, frames.arrays("depth", eye), strict=True)
    return (np.where(np.isfinite(depth), radius, np.inf) for radius, depth in pairs)


def _pictures(frames: FrameFolder, eye: str, view: str) -> Iterator[NDArray[Any]]:
    """Color, sharp, or both side by side, of each frame."""
    if view == "color":
        return frames.images(eye)
    sharp = frames.arrays("sharp", eye)
    if view == "sharp":
        return sharp
    return (_beside(*pair, frames.transfer) for pair in zip(sharp, frames.images(eye), strict=True))


def _beside(left: NDArray[Any], right: NDArray[Any], transfer: str) -> NDArray[Any]:
    """Two images side by side: linear radiance, encoded in the bits and the curve of the codes on the right."""
    if left.shape[:2] != right.shape[:2]:
        raise FileError(f"compare: sharp and color must have one size; got {left.shape[:2]} and {right.shape[:2]}")
    left = encode(left, 8 * right.dtype.itemsize, transfer)
    if left.ndim != right.ndim:
        left, right = map(three_channels, (left, right))
    return np.concatenate([left, right], axis=1)


def clip_path(path: Path, eye: str) -> Path:
    """Path of the clip of a view; clip_left.mp4 and clip_right.mp4 for a stereo pair."""
    return path.with_name(f"{path.stem}_{eye}{path.suffix}") if eye else path


def folder_clip(folder: Path, preset: str) -> Path:
    """Path of the clip in a folder of frames."""
    return folder / f"clip{PRESETS[preset].suffix}"
