"""Settings that make a frame cheaper, with what they take and the error that the documentation has of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from clsco.cost.predict import Cost, cost_of, duration
from clsco.cost.short import LONG_FRAME
from clsco.errors import SceneError
from clsco.plan.prepare import Prepared, prepare

SHORT = 0.1  # s: a shorter frame is cheap as it is, and what takes less is not looked for
WORTH = 0.7  # of the time, that a setting may take at most to be named


@dataclass(frozen=True)
class Setting:
    """A value of a key that costs less.

    Attributes
    ----------
    key : str
    value : object
    error : str
        PSNR against a ray-traced lens, and of what.
    page : str
        Page of the documentation that has its table.
    """

    key: str
    value: Any
    error: str
    page: str

    @property
    def text(self) -> str:
        """As a scene file has it."""
        return f'{self.key} = "{self.value}"' if isinstance(self.value, str) else f"{self.key} = {self.value}"


SETTINGS = (
    Setting("psf.occlusion", "layered", "27 to 40 dB where objects overlap", "docs/occlusion.md"),
    Setting("psf.occlusion", "none", "21 to 35 dB where objects overlap", "docs/occlusion.md"),
    Setting("psf.silhouette_samples", 1, "50 to 80 dB, lowest at outlines along rows or columns", "docs/accuracy.md"),
    Setting("sequence.samples", 5, "38 to 55 dB of motions of up to 17 px", "docs/accuracy.md"),
)
"""The range of their PSNR in the tables of the page, from the better to the worse where they exclude each other."""


def cheaper_settings(prepared: Prepared, cost: Cost) -> list[tuple[Setting, float]]:
    """Settings by which a frame takes less, with the seconds that it then takes.

    Parameters
    ----------
    prepared : Prepared
    cost : Cost
        Cost of the scene as it is.

    Returns
    -------
    list of (Setting, float)
        Settings of `SETTINGS` that the scene has not, can have, and that take at most WORTH of the time, and of another
        value of the same key that is nearer to the lens; none of a frame that is shorter than SHORT.
    """
    if cost.seconds < SHORT:
        return []
    found, most = list[tuple[Setting, float]](), dict[str, float]()
    for setting in SETTINGS:
        if setting.key == "sequence.samples" and prepared.plan.samples <= setting.value:
            continue
        try:
            changed = prepared.scene.replace(setting.key, setting.value)
            other = prepare(changed, prepared.request, prepared.plan.device, prepared.files)
        except SceneError:  # what excludes it
            continue
        less = cost_of(other, cost.cores)
        if less is not None and less.seconds <= WORTH * most.get(setting.key, cost.seconds):
            found.append((setting, less.seconds))
            most[setting.key] = less.seconds
    return found


def warning_of(prepared: Prepared) -> str | None:
    """Line on a frame that takes longer than LONG_FRAME: its time, and what would take less; None for others."""
    cost = cost_of(prepared)
    if cost is None or not cost.seconds > LONG_FRAME:
        return None
    kind, share = cost.dearest
    line = f"a frame will take about {duration(cost.seconds)} on {cores(cost)}, {share:.0%} of it in the pass {kind}"
    choices = [
        f"{setting.text}, {duration(seconds)} ({setting.error}, {setting.page})"
        for setting, seconds in cheaper_settings(prepared, cost)
    ]
    return f"{line}; cheaper: {'; '.join(choices)}" if choices else line


def cores(cost: Cost) -> str:
    """Number of cores that were reckoned with, in words."""
    return f"{cost.cores} core{'s' * (cost.cores > 1)}"
