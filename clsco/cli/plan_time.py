"""Predicted time of a scene's frames and of cheaper settings, with the errors that the documentation lists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from clsco.engine.probe import SECONDS, FrameTime, measure_frame
from clsco.errors import SceneError
from clsco.opencl.session import Session
from clsco.plan.prepare import Prepared, prepare

SHORT = 1.0  # s: a shorter frame is cheap as it is, and what takes less is not looked for
WORTH = 0.7  # of the time, that a setting may take at most to be named


@dataclass(frozen=True)
class Setting:
    """A cheaper value of a key.

    Attributes
    ----------
    key : str
    value : object
    error : str
        PSNR against a ray-traced lens, and of which scene.
    page : str
        Page of the documentation that has its table.
    """

    key: str
    value: Any
    error: str
    page: str

    @property
    def text(self) -> str:
        """Text of the value as in a scene file."""
        return f'{self.key} = "{self.value}"' if isinstance(self.value, str) else f"{self.key} = {self.value}"


SETTINGS = (
    Setting("psf.occlusion", "layered", "27 to 40 dB where objects overlap", "docs/occlusion.md"),
    Setting("psf.occlusion", "none", "21 to 35 dB where objects overlap", "docs/occlusion.md"),
    Setting("psf.silhouette_samples", 1, "50 to 80 dB, lowest at outlines along rows or columns", "docs/accuracy.md"),
    Setting("sequence.samples", 5, "38 to 55 dB of motions of up to 17 px", "docs/accuracy.md"),
)
"""The range of their PSNR in the tables of the page, from the better to the worse where they exclude each other."""


def cheaper_settings(session: Session, prepared: Prepared, time: FrameTime) -> list[tuple[Setting, float]]:
    """Settings that make a frame cheaper, with the seconds that it then takes.

    Parameters
    ----------
    session : Session
    prepared : Prepared
    time : FrameTime
        Time of the scene as given.

    Returns
    -------
    list of (Setting, float)
        Settings of `SETTINGS` that the scene does not have but could, and that take at most WORTH of the time; of
        several values of a key, the most accurate. Empty if a frame takes less than SHORT.
    """
    if time.seconds < SHORT:
        return []
    cheaper, least = list[tuple[Setting, float]](), dict[str, float]()
    for setting in SETTINGS:
        if setting.key == "sequence.samples" and prepared.plan.samples <= setting.value:
            continue
        try:
            changed = prepared.scene.replace(setting.key, setting.value)
            other = prepare(changed, prepared.request, session.device, prepared.files)
        except SceneError:  # what excludes it
            continue
        seconds = measure_frame(session, other, SECONDS / 2).seconds
        if seconds <= WORTH * least.get(setting.key, time.seconds):
            cheaper.append((setting, seconds))
            least[setting.key] = seconds
    return cheaper
