"""Chooses the size of previews during a drag, and whether they show motion, so that they meet a time budget."""

from __future__ import annotations

from collections import deque

import numpy as np

from clsco.constants import BAND
from clsco.optics.exposure import subframes_of
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import Prepared
from clsco.scene.model import Scene, Sequence

BUDGET = 0.040  # s; previews with silhouettes are then half as wide as the frame on two cores
EIGHTHS = 8  # number of parts of the full width and height; sizes of pictures are counted in these
MOST_SAMPLES = 3
ROLLING_SHARES = 16  # rows of a preview are exposed for at least 1 / ROLLING_SHARES of the readout
LEAST = 4  # eighths; if only smaller pictures meet the budget, motion is omitted
SMALLEST, SLOW = 3, 0.5  # eighths of the smallest picture, unless this one takes longer than SLOW s
WORTH = 1.5  # beyond the budget, a picture may take this multiple of the time of the smallest one
CLIMB = 1.01  # eighths by which a picture may exceed the largest one measured lately: larger ones are hard to predict
MOST_FIXED = 0.9  # upper bound of the constant part of the mean time, as a fraction of it, if all pictures had one size
LEAST_SPREAD = 0.03  # least relative spread of the numbers of pixels for which a line is fitted
_WEIGHTS = 0.7 ** np.arange(5, -1, -1.0)  # weights of the latest measurements
_STALL = 4.0  # multiple of the prediction that counts as a stall, such as a compilation
_STALLS = 2  # consecutive stalls that are ignored


class Ladder:
    """Chooses the largest picture whose predicted time is within the budget.

    The predicted time is `fixed` s plus `ns` ns per pixel and time sample, a line that is fitted to the latest
    measurements. If all measurements were of one size, a change in their time changes `ns`.
    """

    def __init__(self) -> None:
        self.fixed, self.ns = 0.005, 150.0
        self._stalls = 0
        self._latest: deque[tuple[float, float]] = deque(maxlen=len(_WEIGHTS))  # pixels, s

    def eighths(self, work: float) -> int:
        """Width and height of a picture in eighths of the full ones; work: pixels times time samples at full size."""
        most = max(BUDGET, WORTH * self.predicted(work, 1))
        largest = EIGHTHS * (max((pixels for pixels, _ in self._latest), default=work) / work) ** 0.5 + CLIMB
        known = (size for size in range(EIGHTHS, 1, -1) if size <= largest)
        fitting = next((size for size in known if self.predicted(work, size) <= most), 1)
        return max(fitting, SMALLEST) if self.predicted(work, SMALLEST) <= SLOW else fitting

    def predicted(self, work: float, eighths: int) -> float:
        """Time of a picture of this size, s."""
        return self.fixed + 1e-9 * self.ns * _pixels(work, eighths)

    def measured(self, work: float, eighths: int, seconds: float) -> None:
        """Learn from the time of a picture, s. Far too long times are ignored, but at most two in a row."""
        if seconds > _STALL * max(self.predicted(work, eighths), 0.25 * BUDGET) and self._stalls < _STALLS:
            self._stalls += 1
            return
        self._stalls = 0
        self._latest.append((_pixels(work, eighths), seconds))
        weights = _WEIGHTS[-len(self._latest) :]
        pixels, times = np.array(self._latest).T
        middle, mean = np.average(pixels, weights=weights), np.average(times, weights=weights)
        spread = np.average((pixels - middle) ** 2, weights=weights)
        if spread > (LEAST_SPREAD * middle) ** 2:
            slope = np.average((pixels - middle) * (times - mean), weights=weights) / spread
            slope = min(max(slope, (mean - times.min()) / middle), mean / middle)  # every picture takes the fixed part
        else:
            slope = (mean - min(self.fixed, MOST_FIXED * mean)) / middle
        self.fixed, self.ns = float(mean - slope * middle), float(1e9 * slope)

    def bounded(self, work: float, seconds: float) -> None:
        """Learn an upper bound from an exact frame, which takes longer than a preview of full size."""
        if not self._latest or self.predicted(work, EIGHTHS) > seconds:
            self._latest.clear()
            self.fixed = min(self.fixed, 0.5 * seconds)
            self.ns = 1e9 * (seconds - self.fixed) / _pixels(work, EIGHTHS)


def _pixels(work: float, eighths: int) -> float:
    return work * (eighths / EIGHTHS) ** 2


class Ladders:
    """Predictions for previews of similar scenes: `of` has a `Ladder` for those with (False) and without motion."""

    def __init__(self) -> None:
        self.of = {False: Ladder(), True: Ladder()}

    def choose(self, scene: Scene, size: tuple[int, int]) -> tuple[bool, int]:
        """Choice of motion (True: omit it, as it needs many time samples), and eighths of a picture."""
        is_still, eighths = False, EIGHTHS
        for is_still in choices_of(scene):
            if scene.is_analytic:
                eighths = self.of[is_still].eighths(work_of(scene, size, is_still))
            if eighths >= LEAST:
                break
        return is_still, eighths


def choices_of(scene: Scene) -> tuple[bool, ...]:
    """False, and also True for a scene whose previews are simpler without motion."""
    return (False, True) if scene.moves and not scene.rolls and _samples(scene.sequence) > 1 else (False,)


def work_of(scene: Scene, size: tuple[int, int], is_still: bool = False) -> float:
    """Pixels times time samples of a preview of full size; for each sample, only the rows exposed at it count."""
    known = _preview_sequence(scene, is_still)
    if not scene.rolls:
        return size[0] * size[1] * (int(known.samples) if scene.moves else 1)
    camera = scene.camera.model_copy(update={"resolution": size})
    subframes = subframes_of(scene.model_copy(update={"camera": camera, "sequence": known}), int(known.samples))
    rows = size[1] * known.shutter / (known.shutter + known.readout) + BAND
    return subframes * size[0] * (size[1] if known.by_columns else min(rows, size[1]))


def coarser(scene: Scene, size: tuple[int, int], eighths: int, is_still: bool = False) -> Scene:
    """The scene with the same field of view in fewer pixels; is_still: True for one time sample, in the middle.

    Columns and rows become `eighths` of `size`, and sources of several objects points, which cost less and are closer
    to the smaller ones of full size, unless the scene has depth maps, which have one value per pixel. Pixels at
    silhouettes have one source, and there are at most MOST_SAMPLES time samples. With a rolling shutter, each row has
    one time sample, and is exposed for at least 1 / ROLLING_SHARES of the readout.
    """
    psf: dict[str, object] = {"silhouette_samples": 1}
    changes: dict[str, object] = {"sequence": _preview_sequence(scene, is_still)} if scene.moves else {}
    if scene.is_analytic and eighths < EIGHTHS:
        columns, rows = (max(side * eighths // EIGHTHS, 1) for side in size)
        pitch = scene.camera.pixel_pitch * size[0] / columns
        changes["camera"] = scene.camera.model_copy(update={"resolution": (columns, rows), "pixel_pitch": pitch})
        is_plain = scene.psf.edge == "integrated" and scene.psf.model != "wave" and not scene.psf.aberrated
        psf |= {"edge": "area", "tilt": False} if is_plain and len(scene.objects) > 1 else {}
    return scene.model_copy(update=changes | {"psf": scene.psf.model_copy(update=psf)})


def unblurred(scene: Scene) -> Scene:
    """The scene without blur: with one time sample and almost no aperture. Depth, normals and objects are the same."""
    psf = scene.psf.model_copy(update={"silhouette_samples": 1, "occlusion": "none"})
    camera = scene.camera.model_copy(update={"aperture_diameter": 1e-9 * scene.camera.aperture_diameter})
    sequence = scene.sequence.model_copy(update={"samples": 1, "sampling": "midpoint"})
    return scene.model_copy(update={"psf": psf, "camera": camera, "sequence": sequence})


def _samples(known: Sequence) -> int:
    return min(known.samples, MOST_SAMPLES) if isinstance(known.samples, int) else MOST_SAMPLES


def _preview_sequence(scene: Scene, is_still: bool = False) -> Sequence:
    """The sequence with few time samples; is_still: True for one in the middle."""
    known = scene.sequence
    rolling = {"samples": 1, "shutter": max(known.shutter, known.readout / ROLLING_SHARES)}
    few = {"samples": 1, "sampling": "midpoint"} if is_still else {"samples": _samples(known)}
    return known.model_copy(update=rolling if scene.rolls else few)


def plan_line(prepared: Prepared, seconds: float) -> str:
    """Text like "3 passes, 41 ms, 15 MiB": number of kinds of passes, time of the frame, and memory of all views."""
    count = len({step.kind for plan in prepared.plans for step in plan.passes})
    memory = device_bytes(prepared.plan, len(prepared.plans)) / 2**20
    time = f"{1000 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
    return f"{count} pass{'es' if count > 1 else ''}, {time}, {memory:.0f} MiB"
