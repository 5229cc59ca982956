"""The report of inpainting: figures, plots and images of the stages, as in the thesis (chapter 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.atomic import atomic_folder, make_writable_folder
from clsco.files.images import write_json, write_png
from clsco.files.plots import require_matplotlib
from clsco.files.transfer import encode
from clsco.inpainting.rules import COUNTS, MeanMedian

if TYPE_CHECKING:
    from clsco.inpainting.mean_median import Stages

SHEET_SIDE, GAP = 1024, 8  # px of the images in a sheet, at most, and between them
MEAN, MEDIAN = "#0072b2", "#d55e00"


@dataclass(frozen=True, eq=False)
class Report:
    """Report on filling an image.

    method: method used; device: its name; shape, dtype: of the image; missing_pixels: their number; seconds: total;
    stages: of mean-median, None for other methods and if no pixel was missing; constants: of mean-median.
    """

    method: str
    device: str
    shape: tuple[int, ...]
    dtype: str
    missing_pixels: int
    seconds: float
    stages: Stages | None
    constants: MeanMedian

    def figures(self) -> dict[str, Any]:
        """The figures for JSON; for mean-median they include those of the table in figure 5.21.

        Gradients are in the image's unit; mse: mean square errors of mean and median by the number of known neighbors,
        in the square of that unit; empty if no pixel has eight known neighbors.
        """
        found: dict[str, Any] = {
            "method": self.method, "device": self.device, "shape": list(self.shape), "dtype": self.dtype,
            "missing_pixels": self.missing_pixels, "seconds": self.seconds,
        }  # fmt: skip
        stages = self.stages
        if stages is None:
            return found
        found |= {"border_pixels": stages.border.size, "sweeps": stages.sweeps, "constants": asdict(self.constants)}
        if stages.histogram is not None:
            histogram = stages.histogram
            found["gradient_range"] = [histogram.least, histogram.most]
            found |= {"threshold": histogram.threshold, "blended_pixels": int(stages.is_blended.sum())}
        if stages.score is not None:
            mean, median = stages.score.mean_square_errors()
            wins = ["median" if win else "mean" for win in stages.score.median_wins()[COUNTS.start :]]
            found["mse"] = {"neighbors": list(COUNTS), "mean": mean, "median": median, "chosen": wins}
        return found | {"seconds_by_stage": stages.seconds}


def write_report(
    folder: Path, report: Report, image: NDArray[Any], missing: NDArray[np.bool_], filled: NDArray[Any]
) -> list[str]:
    """Write report.json, images and plots, atomically; returns the names of the files.

    image, filled: (rows, columns[, K]) before and after; missing: (rows, columns). Always writes before_mask_after.png;
    for mean-median also 1_filled.png, 2_smoothed.png and 3_blended.png, the image after these stages, mse.png (figure
    5.3) and gradients.png (figure 5.6), unless a stage was turned off. Raises ClscoError without matplotlib, FileError
    if the folder is not writable.
    """
    require_matplotlib("report", "report")
    display, stages = Display(image, missing), report.stages
    mask = np.repeat(np.where(missing, 255, 0).astype(np.uint8)[..., None], 3, axis=-1)
    with atomic_folder(make_writable_folder(folder), "report") as made:
        write_json(made / "report.json", report.figures())
        sheet = [_small(display.codes(image)), _small(mask), _small(display.codes(filled))]
        write_png(made / "before_mask_after.png", beside_each_other(sheet))
        if stages is not None:
            values = {"1_filled": stages.filled}
            if report.constants.smoothing_rounds:
                values["2_smoothed"] = stages.smoothed
            for name, some in values.items():
                write_png(made / f"{name}.png", display.codes(_with(image, stages.pixels, some)))
            if stages.histogram is not None:
                write_png(made / "3_blended.png", display.codes(filled))
        for name, figure in plots(report).items():
            figure.savefig(made / name, dpi=100)
        return sorted(path.name for path in made.iterdir())


class Display:
    """Conversion of any image to 8-bit codes: codes unchanged, floats as sRGB, relative to white or the brightest
    value.
    """

    def __init__(self, image: NDArray[Any], missing: NDArray[np.bool_]) -> None:
        self.white = 1.0
        if image.dtype.kind == "f":
            self.white = max(1.0, float(image[~missing].max()))

    def codes(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Codes (rows, columns[, 3]) of an image; with 2 or over 3 channels only the first is shown."""
        shown = image if image.ndim == 2 or image.shape[2] == 3 else image[..., 0]
        if image.dtype == np.uint16:
            return (shown >> 8).astype(np.uint8)
        if image.dtype.kind == "f":
            return encode(shown.astype(np.float32) / np.float32(self.white), 8, "srgb").astype(np.uint8)
        return shown


def beside_each_other(images: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Images (rows, columns[, 3]) of one size in a row, with white gaps, in color."""
    colored = [image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=-1) for image in images]
    gap = np.full((colored[0].shape[0], GAP, 3), 255, np.uint8)
    return np.hstack([part for image in colored for part in (gap, image)][1:])


def _small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    step = -(-max(image.shape[:2]) // SHEET_SIDE)
    return image[::step, ::step]


def _with(image: NDArray[Any], pixels: NDArray[np.int64], values: NDArray[np.float32]) -> NDArray[Any]:
    """An image with some pixels replaced; values are rounded as in the result."""
    from clsco.inpainting.rules import as_stored

    result = image.copy()
    result.reshape(image.shape[0] * image.shape[1], -1)[pixels] = as_stored(values, image.dtype)
    return result


def plots(report: Report) -> Mapping[str, Any]:
    """Figures of matplotlib by file name, for the stages that ran."""
    found, stages = {}, report.stages
    if stages is not None and stages.score is not None and stages.score.samples:
        found["mse.png"] = _mse_plot(*stages.score.mean_square_errors())
    if stages is not None and stages.histogram is not None:
        found["gradients.png"] = _gradient_plot(stages, report.constants.border_share)
    return found


def _panel(x: str, y: str) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    panel: Any = figure.subplots()
    panel.set(xlabel=x, ylabel=y)
    panel.grid(alpha=0.3)
    return figure, panel


def _mse_plot(mean: list[float], median: list[float]) -> Any:
    figure, panel = _panel("known neighbors", "mean square error")
    panel.plot(COUNTS, mean, "o-", color=MEAN, label="mean")
    panel.plot(COUNTS, median, "s-", color=MEDIAN, label="median")
    panel.set_xticks(COUNTS)
    panel.set_ylim(bottom=0)
    panel.legend()
    return figure


def _gradient_plot(stages: Stages, share: float) -> Any:
    histogram = stages.histogram
    assert histogram is not None
    figure, panel = _panel("gradient magnitude of border pixels", "pixels")
    edges = histogram.step * np.arange(histogram.counts.size + 1)
    panel.stairs(histogram.counts, edges, fill=True, color=MEAN, alpha=0.7)
    label = f"threshold {histogram.threshold:.6g}: {100 * share:g} % of {stages.border.size} are above"
    panel.axvline(histogram.threshold, color=MEDIAN, label=label)
    panel.legend()
    return figure
