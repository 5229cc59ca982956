"""Video presets: pixels, speed, size and error of each, in one run: python -m benchmarks.speed.video

The clip is examples/sphere_turning.toml, 512 x 512 px, tinted to have colors: a sharp texture on black that turns,
and its blurred limb. Codes of 16 bits go in. frames/s: elapsed, with conversion, on one thread. Errors are in codes of
8 bits, against the clip before rounding; the decoder's planes are turned to red, green and blue by the formula of
BT.709, with the color differences of 4:2:0 and 4:2:2 interpolated by swscale. Tags are primaries/transfer/matrix/range
of the first frame, as PyAV reads them: range 1 is limited, 2 full.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import clsco
from benchmarks.tables import Figures, write_table
from clsco.files.transfer import encode
from clsco.files.video import PRESETS

RESULTS = Path(__file__).parents[1] / "results"
EXAMPLE = Path(__file__).parents[2] / "examples" / "sphere_turning.toml"
TINT = np.array([1.0, 0.7, 0.35], np.float32)
RATE = Fraction(30000, 1001)


def rendered(count: int, side: int) -> list[NDArray[Any]]:
    """Codes of 16 bits of the moving scene."""
    keys = [f"camera.resolution=[{side}, {side}]", f"camera.pixel_pitch={0.01 * 512 / side}"]
    scene = clsco.load_scene(
        EXAMPLE,
        [*keys, f"sequence.frames={count}", "sequence.interval=0.033", "sequence.shutter=0.033", "sequence.samples=3"],
    )
    return [encode(frame.color[..., None] * TINT, 16, "srgb") for frame in clsco.render(scene, truth=())]


def rgb(picture: Any) -> NDArray[np.float64]:
    """Red, green and blue of a decoded frame, 0 to 255."""
    name = picture.format.name
    if not name.startswith("yuv"):
        form = "gbrp16le" if name == "gbrp16le" else "rgb24"
        codes = picture.to_ndarray(format=form).astype(np.float64)
        return np.asarray(codes / (257 if form == "gbrp16le" else 1), np.float64)
    deep = "p1" in name
    whole = picture.reformat(format="yuv444p16le" if deep else "yuv444p", interpolation="BICUBIC")
    bits, kind = (16, np.uint16) if deep else (8, np.uint8)
    planes = [
        np.frombuffer(plane, kind).reshape(plane.height, -1)[:, : plane.width].astype(np.float64) / 2 ** (bits - 8)
        for plane in whole.planes
    ]
    luma, blue, red = (planes[0] - 16) / 219, (planes[1] - 128) / 224, (planes[2] - 128) / 224
    r, b = luma + 2 * (1 - 0.2126) * red, luma + 2 * (1 - 0.0722) * blue
    return 255 * np.clip(np.stack([r, (luma - 0.2126 * r - 0.0722 * b) / 0.7152, b], axis=-1), 0, 1)


def figures(name: str, frames: list[NDArray[Any]], folder: Path) -> Figures:
    """The row of a preset."""
    preset = PRESETS[name]
    path = folder / f"{name}{preset.suffix}"
    start = time.perf_counter()
    clsco.write_video(path, frames, RATE, preset=name)
    seconds = time.perf_counter() - start
    worst, total = 0.0, 0.0
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        for number, picture in enumerate(container.decode(stream)):
            if number == 0:
                tags = (picture.color_primaries, picture.color_trc, int(picture.colorspace), int(picture.color_range))
            error = np.abs(rgb(picture) - frames[number] / 257.0)
            worst, total = max(worst, float(error.max())), total + float(np.mean(error**2))
    mean = total / len(frames)
    return {
        "preset": name,
        "file": preset.suffix,
        "codec": preset.codec,
        "pixels": preset.pixels,
        "frames/s": round(len(frames) / seconds, 1),
        "kB/frame": round(path.stat().st_size / 1000 / len(frames), 1),
        "largest error": round(worst, 2),
        "PSNR, dB": "inf" if mean == 0 else f"{10 * np.log10(255**2 / mean):.1f}",
        "tags": "/".join(map(str, tags)),
    }


def main() -> None:
    """Measure, print a table, write benchmarks/results/video.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--side", type=int, default=512)
    options = parser.parse_args()
    frames = rendered(options.frames, options.side)
    with tempfile.TemporaryDirectory() as folder:
        rows = [figures(name, frames, Path(folder)) for name in PRESETS]
    table = Table(title=f"{options.frames} frames of {options.side} x {options.side} px")
    for heading in rows[0]:
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console(width=140).print(table)
    write_table(RESULTS / "video.md", f"# Video presets, PyAV {av.__version__}", rows)


if __name__ == "__main__":
    main()
