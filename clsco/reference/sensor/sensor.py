"""Image sensor in NumPy float32: codes from irradiance, with the bits of kernels/sensor/sensor.cl."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import PATTERN_STREAM, SHOT_STREAM, STREAMS
from clsco.frame.development import develop, sensor_truth
from clsco.optics.sensor import SensorModel, reciprocals_of_counts, sensor_values
from clsco.records import filled
from clsco.reference.sensor.noise import Floats, normal_of, philox, poisson, uniform_of


def sensor_outputs(
    sensor_model: SensorModel, light: NDArray[np.floating], camera: int, names: Collection[str]
) -> dict[str, Any]:
    """Image and outputs of a sensor, named as in `Frame`, for the irradiance (m, n, C) of a frame.

    names: names of the outputs besides the image; other arguments as for `sense`.
    """
    raw, saturated = sense(sensor_model, light, camera)
    return {"color": develop(raw, sensor_model)} | sensor_truth(names, raw, saturated, light, sensor_model)


def sense(
    sensor_model: SensorModel, light: NDArray[np.floating], camera: int
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Codes (m, n, planes) of a frame for its irradiance (m, n, C), and a mask of saturated pixels.

    A pixel is saturated if it is at the full well or at the largest code. light: rounded to float32 at the beginning;
    camera: `clsco.optics.sensor.camera_word` of the frame.
    """
    sensor = filled("sensor_t", "float", sensor_values(sensor_model))
    rows, columns = light.shape[:2]
    y, x = np.mgrid[:rows, :columns]
    site = 2 * (y & 1) + (x & 1)
    key, noise = (int(sensor["seed_low"]), int(sensor["seed_high"])), int(sensor["noise_low"])
    planes = []
    for k in range(len(sensor_model.filters)):
        channel, scale = (sensor[name].reshape(-1, 4)[k][site] for name in ("channel", "scale"))
        dark, added, pixel = sensor["dark"], np.zeros((rows, columns), np.float32), y * columns + x
        with np.errstate(over="ignore", invalid="ignore"):  # pixels whose light overflows are full
            mean = light[y, x, channel].astype(np.float32)
            mean = np.where(mean > 0, mean * scale, np.float32(0.0))  # neither negative light nor NaN
            if sensor_model.has_pattern:
                word = philox(pixel, 0, camera & 1, PATTERN_STREAM + STREAMS * k, key)
                response: Floats = np.float32(1.0) + sensor["prnu"] * normal_of(word[0])
                mean = np.where(response > 0, mean * response, np.float32(0.0))
                dark = np.where(word[2] < sensor["hot"], dark + sensor["leak"] * uniform_of(word[3]), dark)
                added = sensor["dsnu"] * normal_of(word[1])
            mean = np.minimum(mean + dark, sensor["most"])
        word = philox(pixel, noise, camera, int(sensor["noise_high"]) | (SHOT_STREAM + STREAMS * k), key)
        count = poisson(mean, word[0], reciprocals_of_counts()).astype(np.float32)
        full = count >= sensor["full_well"]
        added = added + sensor["read_noise"] * normal_of(word[1])
        level = sensor["gain"] * (np.where(full, sensor["full_well"], count) + added)
        level = level + (sensor["black"] + np.float32(0.5))
        code = np.clip(level, np.float32(0.0), sensor["largest"]).astype(np.int64)
        planes.append((code.astype(np.uint16), full | (code >= sensor["maximum"])))
    codes, saturated = (np.stack(planes_, axis=-1) for planes_ in zip(*planes, strict=True))
    return codes, saturated
