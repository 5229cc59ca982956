"""Host side of the image sensor, which converts the irradiance of a frame or a strip to codes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import SENSED_PIXELS
from clsco.frame.strips import Strip
from clsco.opencl.buffers import download, empty, upload_cached
from clsco.opencl.program import Events, Target
from clsco.opencl.session import Session
from clsco.optics.sensor import SensorModel, reciprocals_of_counts, sensor_values
from clsco.passes.blur import Plane
from clsco.plan.buffers import Sizes, padded_columns
from clsco.records import filled

RECIPROCALS = reciprocals_of_counts()


@dataclass(frozen=True)
class Codes:
    """Codes of a sensor on the device.

    code: ushort of `shape`; saturated: uchar of `shape`, 1 for saturated pixels; shape: planes, rows, and columns with
    padding to whole vectors; columns: number of columns without padding.
    """

    code: cl.Buffer
    saturated: cl.Buffer
    shape: tuple[int, int, int]
    columns: int

    def read(self, session: Session, code: NDArray[np.uint16], saturated: NDArray[np.bool_]) -> None:
        """Copy codes and saturation to arrays (rows, columns, planes) on the host; waits for the device."""
        for buffer, out, dtype in ((self.code, code, np.uint16), (self.saturated, saturated, np.uint8)):
            out[...] = np.moveaxis(download(session, buffer, self.shape, dtype)[..., : self.columns], 0, -1)


class FrameSensor:
    """The sensor of a scene on the device; reads out a frame or its strips.

    Validated against `clsco.reference.sensor.sensor.sense`, with equal bits (tests/kernels/test_sensor.py).
    """

    def __init__(self, session: Session, sensor_model: SensorModel, sizes: Sizes) -> None:
        features = {"FIXED_PATTERN": sensor_model.has_pattern}
        self.target = Target(session, ["sensor/sensor.cl"], features, "float")
        self.planes = len(sensor_model.filters)
        self.code, self.saturated = (empty(session, sizes[name]) for name in ("code", "saturated"))
        self.struct = filled("sensor_t", "float", sensor_values(sensor_model))

    def expose(self, strip: Strip, plane: Plane, camera: int, events: Events) -> Codes:
        """Enqueue the conversion of a strip's irradiance to codes; camera: `clsco.optics.sensor.camera_word`."""
        padded = padded_columns(plane.columns)
        counts = upload_cached(self.target.session, RECIPROCALS, "reciprocals of counts")
        head = (np.int32(n) for n in (plane.rows, plane.columns, strip.top, padded))
        args: tuple[Any, ...] = (*head, np.uint32(camera), *plane.layout, self.struct, counts)
        size = (-(-plane.columns // SENSED_PIXELS), plane.rows, self.planes)
        self.target.run("sense", size, (1, 1, 1), events, *args, self.code, self.saturated)
        return Codes(self.code, self.saturated, (self.planes, plane.rows, padded), plane.columns)
