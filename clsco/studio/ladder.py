"""Coarser renderings while something is dragged: how small they have to be to come in time, and what they leave out."""

from __future__ import annotations

from clsco.constants import BAND
from clsco.optics.exposure import subframes_of
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import Prepared
from clsco.scene.model import Scene, Sequence

BUDGET = 0.030  # s
EIGHTHS = 8  # of the full width and height
MOST_SAMPLES = 3
ROLLING_SHARES = 16  # of the readout, of which a row is open for one at least
LEAST = 5  # eighths; where fewer come in time, occlusion is left out
FIXED = 30_000.0  # pixels whose time a picture takes besides that of its own
_WEIGHT = 0.4  # of the latest measurement
_STALL = 4.0  # times the prediction: a compilation, say
_STALLS = 2  # in a row that are left out


class Ladder:
    """Chooses the largest picture whose predicted time is within the budget.

    The time is that of a pixel and time sample, as an exponential mean of what was measured, times their number and
    FIXED more.

    Attributes
    ----------
    ns : float
        Predicted time per pixel and time sample.
    """

    def __init__(self) -> None:
        self.ns = 150.0
        self._stalls = 0
        self._is_measured = False

    def eighths(self, work: float) -> int:
        """Side of the picture in eighths of the full one, whose number of pixels times time samples is `work`."""
        fitting = (size for size in range(EIGHTHS, 1, -1) if self.predicted(work, size) <= BUDGET)
        return next(fitting, 1)

    def predicted(self, work: float, eighths: int) -> float:
        """Time of a picture of this size, s."""
        return self.ns * 1e-9 * _pixels(work, eighths)

    def measured(self, work: float, eighths: int, seconds: float) -> None:
        """Learn how long a picture took; a time that is far too long is believed the third time."""
        if seconds > _STALL * max(self.predicted(work, eighths), 0.25 * BUDGET) and self._stalls < _STALLS:
            self._stalls += 1
            return
        self._stalls = 0
        ns = 1e9 * seconds / _pixels(work, eighths)
        self.ns = self.ns + _WEIGHT * (ns - self.ns) if self._is_measured else ns
        self._is_measured = True

    def bounded(self, work: float, seconds: float) -> None:
        """Learn from an exact frame, which takes longer than a preview of full size."""
        self.ns = min(self.ns, 1e9 * seconds / _pixels(work, EIGHTHS))


def _pixels(work: float, eighths: int) -> float:
    return work * (eighths / EIGHTHS) ** 2 + FIXED


class Ladders:
    """Previews of a kind of scenes, with occlusion and without, which is the most that several objects take.

    Attributes
    ----------
    whole, plain : Ladder
    """

    def __init__(self) -> None:
        self.whole, self.plain = Ladder(), Ladder()

    def choose(self, scene: Scene, work: float) -> tuple[Ladder, int]:
        """The ladder to take, `plain` only where the budget needs it, and the eighths of its picture."""
        is_plain = scene.psf.occlusion != "none" and self.whole.eighths(work) < LEAST
        ladder = self.plain if is_plain else self.whole
        return ladder, ladder.eighths(work) if scene.is_analytic else EIGHTHS


def work_of(scene: Scene, size: tuple[int, int]) -> float:
    """Pixels times time samples of a preview of full size, each in the rows that are exposed then."""
    known = _preview_sequence(scene)
    if not scene.rolls:
        return size[0] * size[1] * (int(known.samples) if scene.moves else 1)
    camera = scene.camera.model_copy(update={"resolution": size})
    subframes = subframes_of(scene.model_copy(update={"camera": camera, "sequence": known}), int(known.samples))
    rows = size[1] * known.shutter / (known.shutter + known.readout) + BAND
    return subframes * size[0] * (size[1] if known.by_columns else min(rows, size[1]))


def coarser(scene: Scene, size: tuple[int, int], eighths: int, is_plain: bool = False) -> Scene:
    """The scene with the same field of view in fewer pixels, and with what takes the most time left out.

    Parameters
    ----------
    scene : Scene
    size : (int, int)
        Its columns and rows.
    eighths : int
        Columns and rows that are left, in eighths. A scene with depth maps keeps all, as they have one value per pixel.
    is_plain : bool
        Without occlusion.

    Returns
    -------
    Scene
        With one source per pixel at silhouettes, and few time samples: with a rolling shutter one while a row is open,
        each for a part of the readout at least.
    """
    left_out = {"silhouette_samples": 1} | ({"occlusion": "none"} if is_plain else {})
    changes: dict[str, object] = {"psf": scene.psf.model_copy(update=left_out)}
    if scene.moves:
        changes["sequence"] = _preview_sequence(scene)
    if scene.is_analytic and eighths < EIGHTHS:
        columns, rows = (max(side * eighths // EIGHTHS, 1) for side in size)
        pitch = scene.camera.pixel_pitch * size[0] / columns
        changes["camera"] = scene.camera.model_copy(update={"resolution": (columns, rows), "pixel_pitch": pitch})
    return scene.model_copy(update=changes)


def unblurred(scene: Scene) -> Scene:
    """The scene with the same depth, normals and objects, and no blur: one time sample and hardly any aperture.

    Validated: the same bits as with it (tests/studio/test_renderer.py).
    """
    psf = scene.psf.model_copy(update={"silhouette_samples": 1, "occlusion": "none"})
    camera = scene.camera.model_copy(update={"aperture_diameter": 1e-9 * scene.camera.aperture_diameter})
    sequence = scene.sequence.model_copy(update={"samples": 1, "sampling": "midpoint"})
    return scene.model_copy(update={"psf": psf, "camera": camera, "sequence": sequence})


def _preview_sequence(scene: Scene) -> Sequence:
    """The sequence with few time samples."""
    known = scene.sequence
    few = min(known.samples, MOST_SAMPLES) if isinstance(known.samples, int) else MOST_SAMPLES
    rolling = {"samples": 1, "shutter": max(known.shutter, known.readout / ROLLING_SHARES)}
    return known.model_copy(update=rolling if scene.rolls else {"samples": few})


def plan_line(prepared: Prepared, seconds: float) -> str:
    """Kinds of passes, time, and memory on the device: "3 passes, 41 ms, 15 MiB".

    Parameters
    ----------
    prepared : Prepared
        As `clsco plan` has it; of a stereo pair both views count.
    seconds : float
        Time that the frame took.
    """
    count = len({step.kind for plan in prepared.plans for step in plan.passes})
    memory = device_bytes(prepared.plan, len(prepared.plans)) / 2**20
    time = f"{1000 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
    return f"{count} pass{'es' if count > 1 else ''}, {time}, {memory:.0f} MiB"
