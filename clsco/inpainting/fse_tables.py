"""Settings and tables of frequency-selective extrapolation, shared by device and reference."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clsco.constants import FSE_SIDE

# The following were chosen on the cases of benchmarks/inpainting: each is flat within 0.1 dB around its value.
DECAY = 0.65  # by which a pixel counts less per px from the block's center
STEP = 0.7  # part of a wave's amplitude that is taken out at a time: less than all, as waves are not orthogonal
WAVES_PER_CONTRAST = 400.0  # waves per standard deviation of the window, the known range being 1
FEWEST_WAVES, MOST_WAVES = 5, 40
TRUST = 0.5  # what a filled pixel counts in the windows of later ones
GUESS = 0.01  # what a pixel counts that is known from the coarser image only


class Tables(NamedTuple):
    """Float32 tables of the kernel `extrapolate_blocks`, by argument name."""

    window: NDArray[np.float32]
    preference: NDArray[np.float32]
    cosines: NDArray[np.float32]
    sines: NDArray[np.float32]


@cache
def tables() -> Tables:
    """Make the tables. window (FSE_SIDE, FSE_SIDE): DECAY to the power of the distance from the block's center.
    preference (FSE_SIDE, FSE_SIDE / 2): squares of 1 - |frequency| / the highest (Genser et al. 2018), 0 for the
    mirrors in the first column and beyond the highest. cosines, sines: (FSE_SIDE, FSE_SIDE / 2), of 2 pi a v /
    FSE_SIDE.
    """
    place = np.arange(FSE_SIDE)
    distance = place + 0.5 - FSE_SIDE / 2
    window = DECAY ** np.hypot(distance[:, None], distance)
    frequency = np.minimum(place, FSE_SIDE - place) / (FSE_SIDE / 2)
    size = np.hypot(frequency[:, None], frequency[: FSE_SIDE // 2]) / np.sqrt(2)
    preference = (1 - size) ** 2
    preference[FSE_SIDE // 2 + 1 :, 0] = 0
    angle = 2 * np.pi / FSE_SIDE * (place[:, None] * place[: FSE_SIDE // 2] % FSE_SIDE)
    return Tables(*(np.asarray(t, np.float32) for t in (window, preference, np.cos(angle), np.sin(angle))))
