"""The report of inpainting: its figures, as in the thesis (chapter 5)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from clsco.inpainting.rules import COUNTS, MeanMedian

if TYPE_CHECKING:
    from clsco.inpainting.mean_median import Stages


@dataclass(frozen=True, eq=False)
class Report:
    """Report on filling an image.

    method: method used; device: name of the device; shape, dtype: shape and type of the image; missing_pixels: number
    of missing pixels; seconds: total time; stages: results of the stages of mean-median, None for other methods or
    without missing pixels; constants: options of mean-median.
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
        in the square of that unit; these lists are empty if no pixel has eight known neighbors.
        """
        figures: dict[str, Any] = {
            "method": self.method, "device": self.device, "shape": list(self.shape), "dtype": self.dtype,
            "missing_pixels": self.missing_pixels, "seconds": self.seconds,
        }  # fmt: skip
        if (stages := self.stages) is None:
            return figures
        figures |= {"border_pixels": stages.border.size, "sweeps": stages.sweeps, "constants": asdict(self.constants)}
        if (histogram := stages.histogram) is not None:
            figures["gradient_range"] = [histogram.least, histogram.most]
            figures |= {"threshold": histogram.threshold, "blended_pixels": int(stages.is_blended.sum())}
        if stages.score is not None:
            mean, median = stages.score.mean_square_errors()
            wins = ["median" if win else "mean" for win in stages.score.median_wins()[COUNTS.start :]]
            figures["mse"] = {"neighbors": list(COUNTS), "mean": mean, "median": median, "chosen": wins}
        return figures | {"seconds_by_stage": stages.seconds}
