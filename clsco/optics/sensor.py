"""Image sensor: electrons, codes and noise of an exposure, by the linear model of EMVA 1288 (float64, pure).

Formulas with random numbers are in `clsco.reference.sensor` and the kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import FEW_ELECTRONS
from clsco.optics.motion import Eye
from clsco.scene.model import Scene
from clsco.scene.sensor import MOSAICS, Sensor

GRAY = 1  # gray light is taken for green
PLANES = 3
STREAM_BITS = 8  # number of lower bits of a word that hold a plane's stream; the others are upper bits of noise_seed
LEAST_DARK_NOISE = 0.4  # DN rms, below which rounding no longer adds 1/12 DN^2 (EMVA 1288)
MOST_MEAN = 2.0**24  # electrons of a pixel, beyond any full well
MOST_SCALE = 1e30  # electrons of white, within float32
MOST_DOUBLINGS = 100.0  # doublings of the dark current: any pixel is full


@dataclass(frozen=True)
class SensorModel:
    """Numbers of a sensor that convert the irradiance of an exposure to codes.

    scale: electrons for irradiance 1 in red, green, blue; white: electrons that correspond to 1 in the developed image;
    dark: mean dark electrons; leak: largest mean of a hot pixel's additional electrons; gain: DN/e-; largest: largest
    code, DN; channels: number of channels of the light; filters: for each plane of codes, the colors that pixels (0,
    0), (0, 1), (1, 0), (1, 1) measure; a mosaic has one plane; sensor: the scene's section, for the other parameters.
    """

    scale: tuple[float, float, float]
    white: tuple[float, float, float]
    dark: float
    leak: float
    gain: float
    largest: int
    channels: int
    filters: tuple[tuple[int, ...], ...]
    sensor: Sensor

    @property
    def has_pattern(self) -> bool:
        """True if pixels differ from each other."""
        sensor = self.sensor
        return sensor.prnu > 0 or sensor.dsnu > 0 or (sensor.hot_pixels > 0 and self.leak > 0)

    @property
    def dark_noise(self) -> float:
        """Noise of a pixel without light, DN rms."""
        return self.gain * float(np.hypot(self.sensor.read_noise, np.sqrt(self.dark)))


def sensor_model(scene: Scene, channels: int) -> SensorModel:
    """Numbers of the sensor of a scene that has one, for light of `channels` channels, 1 or 3.

    Order and notation are those of EMVA 1288. The mean number of electrons is e = white_electrons qe light + i t, with
    the dark current i = dark_current 2^((temperature - temperature_reference) / temperature_doubling) over the time t
    that the shutter is open. The code is gain e + black_level. With iso, irradiance 1 gives iso_base / iso times as
    many electrons. A physical exposure instead gives t / reference_shutter (reference_f_number / N)^2 times as many,
    with N = s0 / D, for any iso.
    """
    sensor = scene.sensor
    assert sensor is not None
    gain_factor = sensor.iso_base / sensor.iso if sensor.iso is not None else 1.0
    doublings = (sensor.temperature - sensor.temperature_reference) / sensor.temperature_doubling
    time = scene.sequence.shutter * 2.0 ** min(doublings, MOST_DOUBLINGS)
    largest = 2**sensor.bits - 1
    gain = sensor.gain or (largest - sensor.black_level) / sensor.full_well / gain_factor
    red, green, blue = (sensor.white_electrons * gain_factor * efficiency for efficiency in sensor.quantum_efficiency)
    white = scale = red, green, blue
    if sensor.exposure == "physical":
        opening = scene.camera.aperture_diameter / scene.camera.normalization_distance * sensor.reference_f_number
        passed = scene.sequence.shutter / sensor.reference_shutter * opening**2 / gain_factor
        scale = (min(red * passed, MOST_SCALE), min(green * passed, MOST_SCALE), min(blue * passed, MOST_SCALE))
    if sensor.mosaic != "none":
        filters: tuple[tuple[int, ...], ...] = (MOSAICS[sensor.mosaic],)
    else:
        filters = tuple((k,) * 4 for k in (range(PLANES) if channels > 1 else (GRAY,)))
    dark, leak = sensor.dark_current * time, sensor.full_well * time if sensor.hot_pixels else 0.0
    return SensorModel(scale, white, dark, leak, gain, largest, channels, filters, sensor)


def sensor_values(model: SensorModel) -> dict[str, Any]:
    """Numbers of a read-out for kernels and reference: fields of sensor_t."""
    sensor, filters = model.sensor, np.zeros((PLANES, 4), np.int64)
    filters[: len(model.filters)] = model.filters
    return {
        "planes": len(model.filters),
        "channel": np.minimum(filters, model.channels - 1).ravel(),
        "scale": np.array(model.scale)[filters].ravel(),
        "maximum": model.largest,
        "largest": model.largest,
        "seed_low": sensor.seed & 0xFFFFFFFF,
        "seed_high": sensor.seed >> 32,
        "noise_low": sensor.noise_seed & 0xFFFFFFFF,
        "noise_high": sensor.noise_seed >> 32 << STREAM_BITS,
        "hot": min(round(sensor.hot_pixels * 2**32), 2**32 - 1),
        "prnu": sensor.prnu,
        "dsnu": sensor.dsnu,
        "dark": min(model.dark, MOST_MEAN),
        "leak": min(model.leak, MOST_MEAN),
        "most": MOST_MEAN,
        "full_well": sensor.full_well,
        "read_noise": sensor.read_noise,
        "gain": model.gain,
        "black": sensor.black_level,
    }


def camera_word(frame: int, eye: Eye) -> int:
    """Word of the random numbers' counters for a frame and view: the views of a stereo pair differ."""
    return 2 * frame + int(eye == "right")


def reciprocals_of_counts() -> NDArray[np.float32]:
    """1 / k for k = 0, 1, ..., float32 (FEW_ELECTRONS,); the entry for 0 is unused."""
    return (1.0 / np.maximum(np.arange(FEW_ELECTRONS), 1)).astype(np.float32)


def noise_variance(model: SensorModel, photoelectrons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance in e-^2 of a pixel's reading over exposures and sensors, without clipping; photoelectrons: mean number.

    The sum of shot noise of light and dark current, PRNU, DSNU, read noise, and 1/12 DN^2 of rounding, without hot
    pixels.
    """
    sensor = model.sensor
    still = model.dark + sensor.dsnu**2 + sensor.read_noise**2 + 1.0 / (12.0 * model.gain**2)
    return np.asarray(photoelectrons + (sensor.prnu * photoelectrons) ** 2 + still)
