"""Frames on a graphics card beside the processors of the same machine: time, time of kernels, bits of a repetition.

    python -m benchmarks.speed.gpu --device gpu --device cpu [--only PART] [--longest 20] [-o FILE]

Each case is computed once, which compiles and fills caches, and then five times, or once where that takes longer than
a second: medians of the time on the clock of a whole call, in ms; kernels are those of the last one. "same bits": every
repetition has the bits of the first. "off": largest difference from the last device, of white. A device that takes
longer than --longest s for a case is left out of further ones of the same scene.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco
from benchmarks.blur.cases import channels_of, picture, radius_map
from benchmarks.blur.passes import MeasuredPass
from benchmarks.speed import lenses
from benchmarks.tables import Figures, write_table
from clsco.frame.frame import Frame
from clsco.opencl.device import choose
from clsco.opencl.pace import event_seconds
from clsco.opencl.program import Events
from clsco.opencl.session import session_on
from clsco.scene.model import Psf, Scene

Array = NDArray[Any]
Spent = dict[str, float]
Call = Callable[[str], tuple[Array, Spent]]
"""From the name of a device to an image and the ms of each of its kernels, where they are known."""

ROOT = Path(__file__).parents[2]
SCENES = Path(__file__).parent / "scenes"
SIZES = {"512 x 512": (512, 512), "1920 x 1080": (1920, 1080), "3840 x 2160": (3840, 2160), "7680 x 4320": (7680, 4320)}
REPETITIONS, LONG = 5, 1.0  # s
FRAMES = 30  # of a drag
# Sections of scenes, beside the lenses of `benchmarks.speed.lenses`.
SEEN: dict[str, dict[str, Any]] = {
    "longitudinal color": {"lens": {"axial": [0.01, 0.0, -0.01]}},
    "sensor": {"sensor": {"white_electrons": 20000.0, "read_noise": 3.0, "bits": 12}},
}
EXAMPLES = ("lens_fast_prime", "hearts", "star_field", "night", "chromatic_ruler", "rolling_train", "dolly_zoom")


def sized(scene: Scene, columns: int, rows: int, *samples: int) -> Scene:
    """The scene on a sensor of the same width with so many pixels, with so many time samples."""
    camera = scene.camera
    pitch = camera.pixel_pitch * (camera.resolution or (512, 512))[0] / columns
    changed = scene.replace("camera.resolution", (columns, rows)).replace("camera.pixel_pitch", pitch)
    return changed.replace("sequence.samples", samples[0]) if samples else changed


def of_frame(frame: Frame) -> tuple[Array, Spent]:
    """The image, and ms of kernels."""
    return frame.color, {name: 1e3 * each for name, each in frame.metadata["seconds"].items() if name != "host"}


def rendered(scene: Scene, truth: Sequence[str] | str = ()) -> Call:
    return lambda device: of_frame(clsco.render_frame(scene, truth=truth, device=device))


def through_a_lens(sections: dict[str, Any], radius: float) -> Call:
    """A frame with three times the pixels of `benchmarks.speed.lenses` across; |R| around a radius in px."""
    return rendered(sized(lenses.scene(sections, radius / 3.0), 3 * lenses.SIDE, 3 * lenses.SIDE))


def dragged(scene: Scene, key: str, first: float, last: float) -> Call:
    """The last of the frames of a drag, with the ms of kernels of all."""

    def call(device: str) -> tuple[Array, Spent]:
        total: Spent = defaultdict(float)
        with clsco.Live(device) as live:
            for value in np.linspace(first, last, FRAMES):
                image, kernels = of_frame(live.render(scene.replace(key, value), truth=()))
                for name, each in kernels.items():
                    total[name] += each
        return image, total

    return call


def defocused(side: int, radius: float, channels: int) -> Call:
    image = channels_of(picture(side), channels)
    coc = radius_map(side, radius).astype(np.float32)
    return lambda device: (clsco.defocus(image, coc, outside="black", device=device), {})


def spread(method: str, radius: float, channels: int) -> Call:
    """The blur alone, of 2048 x 2048 px; on a processor by `gather`."""
    image, radii = channels_of(picture(2048), channels), radius_map(2048, radius)

    @cache
    def made(device: str) -> MeasuredPass:
        session = session_on(choose(device))
        return MeasuredPass(
            session, image, radii, Psf(), "gather" if session.device.kind == "cpu" else method, "double"
        )

    def call(device: str) -> tuple[Array, Spent]:
        events: Events = []
        found, total = made(device)(events), defaultdict[str, float](float)
        for name, event in events:
            total[name] += 1e3 * event_seconds(event)
        return found, total

    return call


def cases() -> Iterator[tuple[str, Callable[[], Call]]]:
    """Names of cases, shorter ones first, and what sets each up."""
    sphere, three, moving = (
        clsco.load_scene(ROOT / "examples" / f"{name}.toml") for name in ("sphere", "occlusion_three", "sphere_moving")
    )
    for name, size in SIZES.items():
        yield f"sphere, {name}", partial(rendered, sized(sphere, *size))
    yield "sphere, all truth, 1920 x 1080", partial(rendered, sized(sphere, 1920, 1080), "all")
    yield "moving sphere, 5 samples, 512 x 512", partial(rendered, sized(moving, 512, 512, 5))
    for name in ("512 x 512", "1920 x 1080"):
        yield f"three objects, visibility, {name}", partial(rendered, sized(three, *SIZES[name]))
    for name in ("512 x 512", "1920 x 1080"):
        scene = sized(sphere, *SIZES[name])
        yield f"{FRAMES} frames of a drag of focus, {name}", partial(dragged, scene, "camera.focus_distance", 240, 310)
    for radius in (2.0, 6.0, 20.0, 60.0):
        yield f"clsco.defocus with depth layers, R to {radius:g} px, 2048 x 2048", partial(defocused, 2048, radius, 1)
    yield "clsco.defocus with depth layers, R to 20 px, color, 2048 x 2048", partial(defocused, 2048, 20.0, 3)
    yield "clsco.defocus with depth layers, R to 20 px, 8192 x 8192", partial(defocused, 8192, 20.0, 1)
    for radius, channels, method in product((2.0, 6.0, 20.0, 60.0), (1, 3), ("tiles", "scatter")):
        shown = "color" if channels == 3 else "gray"
        yield f"blur by {method}, R to {radius:g} px, {shown}, 2048 x 2048", partial(spread, method, radius, channels)
    for (name, sections), radius in product((lenses.LENSES | SEEN).items(), (6.0, 20.0)):
        yield f"wall by {name}, R {radius:g} px, 1344 x 1344", partial(through_a_lens, sections, radius)
    for name in EXAMPLES:
        yield f"example {name}", partial(rendered, clsco.load_scene(ROOT / "examples" / f"{name}.toml"))
    for path in sorted(SCENES.glob("*.toml")):
        yield f"{path.stem}, one sample", partial(rendered, clsco.load_scene(path).replace("sequence.samples", 1))


def measured(call: Call, device: str) -> tuple[Array, dict[str, float | str]]:
    """The image, and figures of a case on a device."""
    began = time.perf_counter()
    image, _ = call(device)
    first = time.perf_counter() - began
    walls, same = list[float](), True
    while not walls or (len(walls) < REPETITIONS and walls[0] < LONG):
        began = time.perf_counter()
        again, kernels = call(device)
        walls.append(time.perf_counter() - began)
        same &= again.tobytes() == image.tobytes()
    figures: dict[str, float | str] = {"first, s": first, "ms": 1e3 * median(walls)}
    most = sorted(kernels.items(), key=lambda item: -item[1])[:3]
    figures["kernels, ms"] = sum(kernels.values()) or ""
    figures["of these"] = ", ".join(f"{kernel} {each:.3g}" for kernel, each in most)
    figures["same bits"] = "yes" if same else "NO"
    return image, figures


def main() -> None:
    """Measure, print a line for each case and device, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", action="append", required=True, help="as of clsco; may be given again")
    parser.add_argument("--only", default="", help="part of the names of the cases")
    parser.add_argument("--longest", type=float, default=20.0, help="s of a case on a device")
    parser.add_argument("--minutes", type=float, default=60.0, help="after which no case is begun")
    parser.add_argument("-o", dest="out", type=Path, help="Markdown file to write")
    options = parser.parse_args()
    rows: list[Figures] = []
    began, slow = time.monotonic(), set[tuple[str, str]]()
    for name, set_up in cases():
        if options.only not in name or time.monotonic() - began > 60 * options.minutes:
            continue
        call, images, scene = set_up(), dict[str, Array](), name.split(",")[0]
        for device in [one for one in reversed(options.device) if (scene, one) not in slow]:
            start = time.monotonic()
            images[device], figures = measured(call, device)
            if time.monotonic() - start > options.longest:
                slow.add((scene, device))
            base = images.get(options.device[-1], images[device])
            off = float(np.abs(images[device] - base).max()) if device != options.device[-1] and base.size else ""
            rows.append({"case": name, "device": choose(device).name, **figures, "off": off})
            print(" | ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in rows[-1].values()), flush=True)
    if options.out is not None:
        devices = ", ".join(f"{choose(one)}, driver {choose(one).driver}" for one in options.device)
        write_table(options.out, f"{devices} (`python -m benchmarks.speed.gpu`)", rows)


if __name__ == "__main__":
    main()
