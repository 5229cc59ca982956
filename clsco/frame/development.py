"""Development of sensor codes to an image, and ground truth of the sensor: electrons, noise, saturation."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.frame.demosaicing import demosaic, menon_function
from clsco.optics.sensor import SensorModel, noise_variance

LEAST_SIDE = 2  # px, smallest side of a frame that can be demosaiced


def develop(raw: NDArray[np.uint16], sensor_model: SensorModel) -> NDArray[np.float32]:
    """Irradiance from codes (rows, columns, planes): (code - black level) / (gain * electrons of white), 1 = white.

    Noise can make it negative. The result is float32 (rows, columns[, 3]), demosaiced unless the sensor's `demosaic` is
    "none": then channels that a pixel has not measured are 0. In a gray scene each pixel measures the only channel.
    Raises MissingDependencyError if `demosaic = "menon"` lacks colour-demosaicing.
    """
    electrons = (raw.astype(np.float64) - sensor_model.sensor.black_level) / sensor_model.gain
    light = electrons / values_at_sites(sensor_model.white, sensor_model, raw.shape[:2])
    if sensor_model.sensor.mosaic == "none" or sensor_model.channels == 1:
        return np.asarray(light if light.shape[2] > 1 else light[..., 0], np.float32)
    plane = light[..., 0]
    if sensor_model.sensor.demosaic == "none":
        colors = values_at_sites((0, 1, 2), sensor_model, plane.shape) == np.arange(3)
        return np.where(colors, plane[..., None], 0.0).astype(np.float32)
    return demosaic(plane, sensor_model.filters[0], sensor_model.sensor.demosaic).astype(np.float32)


def values_at_sites(values: Collection[float], sensor_model: SensorModel, size: tuple[int, ...]) -> NDArray[Any]:
    """Value of the channel that each pixel measures, (rows, columns, planes); values: one number for each channel."""
    y, x = np.ogrid[: size[0], : size[1]]
    each = np.array(tuple(values))[np.array(sensor_model.filters)]
    return np.moveaxis(each[:, 2 * (y & 1) + (x & 1)], 0, -1)


def check_development(sensor_model: SensorModel, rows: int, columns: int) -> None:
    """Raise an error if colour-demosaicing is needed but missing, or frames are too small to be demosaiced."""
    if sensor_model.sensor.demosaic != "none" and sensor_model.channels > 1:
        if min(rows, columns) < LEAST_SIDE:
            size = f"{columns} x {rows}"
            raise SceneError(f"sensor.demosaic: needs frames of {LEAST_SIDE} x {LEAST_SIDE} px at least; got {size}")
        if sensor_model.sensor.demosaic == "menon":
            menon_function()


def sensor_truth(
    names: Collection[str], raw: NDArray[np.uint16], saturated: NDArray[np.bool_],
    light: NDArray[np.floating] | None, sensor_model: SensorModel,
) -> dict[str, NDArray[Any]]:  # fmt: skip
    """The outputs in `names`, some of `clsco.frame.outputs.SENSOR_NAMES`, of a sensor, (rows, columns[, 3]).

    raw, saturated: (rows, columns, planes). light: irradiance; if it is None, `electrons` and `noise_sigma` are
    omitted.
    """
    arrays: dict[str, NDArray[Any]] = {}
    if "raw" in names:
        arrays["raw"] = raw
    if light is not None:
        channels = np.atleast_3d(light).astype(np.float64)
        channel = np.minimum(values_at_sites((0, 1, 2), sensor_model, raw.shape[:2]), sensor_model.channels - 1)
        own = np.maximum(np.take_along_axis(channels, channel, axis=2), 0.0)
        photo = own * values_at_sites(sensor_model.scale, sensor_model, raw.shape[:2])
        if "electrons" in names:
            arrays["electrons"] = (photo + sensor_model.dark).astype(np.float32)
        if "noise_sigma" in names:
            arrays["noise_sigma"] = np.sqrt(noise_variance(sensor_model, photo)).astype(np.float32)
    if "saturated" in names:
        arrays["saturated"] = saturated
    return {
        name: array if array.shape[2] > 1 else np.ascontiguousarray(array[..., 0]) for name, array in arrays.items()
    }
