"""Settings and tables of frequency-selective extrapolation, shared by device and reference."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clsco.constants import FSE_SIDE

# Values chosen on the cases of benchmarks/inpainting: around each, results vary by less than 0.1 dB.
DECAY = 0.65  # factor of a pixel's weight per px of distance from the block's center
STEP = 0.7  # fraction of a wave's amplitude subtracted at a time; below 1, as waves are not orthogonal
WAVES_PER_CONTRAST = 400.0  # number of waves per standard deviation of the window, for known values from 0 to 1
FEWEST_WAVES, MOST_WAVES = 5, 40
TRUST = 0.5  # weight of a filled pixel in the windows of later blocks, relative to a known pixel
GUESS = 0.01  # weight of a pixel whose value is known only from the coarser image


class Tables(NamedTuple):
    """Float32 tables of the kernel `extrapolate_blocks`, by argument name."""

    window: NDArray[np.float32]
    preference: NDArray[np.float32]
    cosines: NDArray[np.float32]
    sines: NDArray[np.float32]


@cache
def tables() -> Tables:
    """Make the tables.

    window (FSE_SIDE, FSE_SIDE): DECAY to the power of the distance in px from the block's center. preference (FSE_SIDE,
    FSE_SIDE / 2): (1 - |frequency| / highest frequency)^2 (Genser et al. 2018); 0 for negative frequencies in the first
    column, which mirror the positive ones there. cosines, sines (FSE_SIDE, FSE_SIDE / 2): cosine and sine of 2 pi a v /
    FSE_SIDE for row a and column v.
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
