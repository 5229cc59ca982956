"""Filling of missing pixels beside what others offer, in one run: python -m benchmarks.inpainting

PSNR and SSIM in the holes, and process CPU time (median of three where it takes less than a second), on 8-bit images
of scikit-image with five kinds of holes. Ours (auto, texture, biharmonic, and the thesis' mean/median with all its
stages) on the OpenCL device, kernels compiled before; OpenCV's Telea and NS (radius 3), xphoto's FSR and SHIFTMAP;
scikit-image's biharmonic. python -m benchmarks.inpainting.speed times the thesis' method and NS in turns.
FSR best takes 10 to 40 times as long as FSR fast, SHIFTMAP up to 15 times: they fill the cases of --slow only, with
--slow all every one, which takes most of an hour. Figures go to the terminal and, as NAME.json
and NAME.md, to benchmarks/results. --images takes any picture of skimage.data by name.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from skimage.metrics import structural_similarity
from skimage.restoration import inpaint_biharmonic

import clsco
from benchmarks.inpainting.cases import IMAGES, MASKS, Case, cases
from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.inpainting.choice import choose_method
from clsco.inpainting.fse import fill_texture
from clsco.opencl.device import choose
from clsco.opencl.session import Session

Image = NDArray[Any]
Mask = NDArray[np.bool_]
Fill = Callable[[Image, Mask], Image]
RESULTS = Path(__file__).parents[1] / "results"
REPETITIONS = 3
QUICK = 1.0  # s, of process CPU time: what takes less is repeated
SLOW = ("FSR best", "SHIFTMAP")
OURS = {"texture": fill_texture, "biharmonic": fill_biharmonic}


def on_device(session: Session, method: str, image: Image, missing: Mask) -> Image:
    """One of ours, 8 bits in and out."""
    values = image.reshape(*missing.shape, -1).astype(np.float32) / np.float32(255)
    chosen = choose_method(session, values, missing) if method == "auto" else method
    values[missing] = OURS[chosen](session, values, missing)
    return quantized(255 * values).reshape(image.shape)


def thesis(image: Image, missing: Mask) -> Image:
    """Chapter 5, with all stages."""
    return np.asarray(clsco.inpaint(image, missing, method="mean-median"))


def opencv(flag: int, image: Image, missing: Mask) -> Image:
    """Telea or NS."""
    return np.asarray(cv2.inpaint(image, missing.astype(np.uint8) * 255, 3, flag))


def xphoto(flag: int, image: Image, missing: Mask) -> Image:
    """FSR wants BGR or gray, SHIFTMAP Lab; of their mask 0 is missing."""
    shiftmap = flag == cv2.xphoto.INPAINT_SHIFTMAP
    color = image if image.ndim == 3 or not shiftmap else cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    there, back = (cv2.COLOR_RGB2Lab, cv2.COLOR_Lab2RGB) if shiftmap else (cv2.COLOR_RGB2BGR, cv2.COLOR_BGR2RGB)
    source = cv2.cvtColor(color, there) if color.ndim == 3 else color
    result = np.zeros_like(source)
    cv2.xphoto.inpaint(source, (~missing).astype(np.uint8) * 255, result, flag)
    found = cv2.cvtColor(result, back) if result.ndim == 3 else result
    if found.ndim > image.ndim:
        found = cv2.cvtColor(found, cv2.COLOR_RGB2GRAY)
    return np.where(missing if image.ndim == 2 else missing[..., None], found, image)


def scikit_image(image: Image, missing: Mask) -> Image:
    """The direct solution of the biharmonic equation."""
    return quantized(255 * inpaint_biharmonic(image, missing, channel_axis=-1 if image.ndim == 3 else None))


def quantized(values: Image) -> Image:
    """Nearest 8-bit codes."""
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)


def methods(session: Session) -> dict[str, Fill]:
    """All of them by name, ours first."""
    ours: dict[str, Fill] = {name: partial(on_device, session, name) for name in ("auto", *OURS)}
    return ours | {
        "thesis": thesis,
        "Telea": partial(opencv, cv2.INPAINT_TELEA),
        "NS": partial(opencv, cv2.INPAINT_NS),
        "scikit-image": scikit_image,
        "FSR fast": partial(xphoto, cv2.xphoto.INPAINT_FSR_FAST),
        "FSR best": partial(xphoto, cv2.xphoto.INPAINT_FSR_BEST),
        "SHIFTMAP": partial(xphoto, cv2.xphoto.INPAINT_SHIFTMAP),
    }


def judge(case: Case, fill: Fill) -> dict[str, float]:
    """PSNR in dB (peak 255) and mean SSIM in the holes, and seconds of process CPU time."""
    damaged = case.image.copy()
    damaged[case.missing] = 0
    spent: list[float] = []
    while not spent or (len(spent) < REPETITIONS and spent[0] < QUICK):
        start = time.process_time()
        found = fill(damaged, case.missing)
        spent.append(time.process_time() - start)
    seconds = float(np.median(spent))
    error = np.square(found[case.missing].astype(float) - case.image[case.missing]).mean()
    axis = -1 if case.image.ndim == 3 else None
    _, similar = structural_similarity(case.image, found, full=True, channel_axis=axis, data_range=255)
    psnr = float(10 * np.log10(255**2 / max(error, 1e-10)))
    return {"psnr": psnr, "ssim": float(similar[case.missing].mean()), "seconds": seconds}


@cache
def table() -> dict[str, Fill]:
    """The methods of this process, with its own session."""
    return methods(Session(choose()))


def judge_methods(case: Case, wanted: Collection[str], slow: set[str]) -> dict[str, Any]:
    """The row of a case: what it is, and the figures of each wanted method; of SLOW ones for the cases `slow`."""
    cv2.setNumThreads(1)
    row = {}
    for name, fill in table().items():
        too_slow = name in SLOW and not slow & {"all", f"{case.image_name}/{case.mask_name}"}
        if too_slow or (wanted and name not in wanted):
            continue
        if name in ("auto", "thesis", *OURS):
            fill(case.image, case.missing)  # each kind of launch is compiled when it first comes
        row[name] = judge(case, fill)
    entry = {"image": case.image_name, "mask": case.mask_name, "missing": float(case.missing.mean())}
    return {**entry, "methods": row}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Means of the methods that filled every case, and what `auto` is to reach."""
    names = [name for name in rows[0]["methods"] if all(name in row["methods"] for row in rows)]
    means = {
        name: {key: float(np.mean([row["methods"][name][key] for row in rows])) for key in ("psnr", "ssim", "seconds")}
        for name in names
    }
    result: dict[str, Any] = {"means": means}
    if "auto" not in means:
        return result
    for other in ("scikit-image", "FSR fast", *SLOW):
        both = [(r["methods"]["auto"], r["methods"][other]) for r in rows if other in r["methods"]]
        if both:
            gains = [ours["psnr"] - theirs["psnr"] for ours, theirs in both]
            times = [sum(pair[k]["seconds"] for pair in both) for k in (0, 1)]
            result[f"auto - {other}"] = {
                "cases": len(both),
                "mean_db": float(np.mean(gains)),
                "least_db": min(gains),
                "times_faster": times[1] / times[0],
            }
    return result


def markdown(report: Mapping[str, Any]) -> str:
    """The report as Markdown: cases by methods, means, and `auto` beside the others."""
    rows, result = report["cases"], report["summary"]
    names = list(dict.fromkeys(name for row in rows for name in row["methods"]))
    lines = [
        "# Missing pixels filled, beside what others offer",
        "",
        "PSNR in the holes in dB / SSIM in the holes / seconds of process CPU time. `python -m benchmarks.inpainting`;",
        f"images: {report['images']}; device: {report['device']}; OpenCV {report['opencv']}.",
        *([] if set(SLOW) <= result["means"].keys() else ["The slowest methods in some cases only."]),
        "",
        f"| case | missing | {' | '.join(names)} |",
        f"|---|---|{'---|' * len(names)}",
    ]
    for row in rows:
        shown = [figures(row["methods"].get(name)) for name in names]
        lines.append(f"| {row['image']}, {row['mask']} | {100 * row['missing']:.0f} % | {' | '.join(shown)} |")
    lines.append(f"| **mean** | | {' | '.join(figures(result['means'].get(name)) for name in names)} |")
    lines += ["", "| `auto` beside | cases | mean, dB | least, dB | times faster, all cases |", "|---|---|---|---|---|"]
    for name, row in result.items():
        if name != "means":
            numbers = f"{row['mean_db']:+.2f} | {row['least_db']:+.2f} | {row['times_faster']:.1f}"
            lines.append(f"| {name.removeprefix('auto - ')} | {row['cases']} | {numbers} |")
    return "\n".join([*lines, ""])


def figures(row: Mapping[str, float] | None) -> str:
    """One entry of the table."""
    return f"{row['psnr']:.2f} / {row['ssim']:.3f} / {row['seconds']:.2f}" if row else ""


def main() -> None:
    """Fill everything, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", nargs="+", default=IMAGES)
    parser.add_argument("--masks", nargs="+", default=MASKS, choices=MASKS)
    parser.add_argument("--size", type=int, metavar="N", help="take the middle N x N px only, for a quick look")
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="some of the methods only")
    parser.add_argument("--slow", nargs="*", default=["camera/wide", "brick/wide"], metavar="IMAGE/MASK")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time, each in its own process")
    parser.add_argument("--name", default="inpainting", help="of the files with the results")
    options = parser.parse_args()
    console = Console()
    rows = []
    judging = partial(judge_methods, wanted=options.methods or (), slow=set(options.slow))
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(judging, cases(options.images, options.masks, options.size)):
            rows.append(row)
            shown = ", ".join(f"{name} {found['psnr']:.2f}" for name, found in row["methods"].items())
            console.print(f"{row['image']}, {row['mask']}: {shown}")
    size = options.size and f"{options.size} x {options.size} from the middle"
    report = {
        "images": size or "whole",
        "device": str(choose()),
        "opencv": cv2.__version__,
        "cases": rows,
        "summary": summary(rows),
    }
    text = markdown(report)
    console.print(text.rpartition("| **mean**")[2], soft_wrap=True)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{options.name}.json").write_text(json.dumps(report, indent=1) + "\n")
    (RESULTS / f"{options.name}.md").write_text(text)


if __name__ == "__main__":
    main()
