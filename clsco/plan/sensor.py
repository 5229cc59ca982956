"""The pass of a sensor, which reads out a frame after all of its time samples have been added up."""

from __future__ import annotations

from clsco.frame.strips import Grid
from clsco.optics.sensor import GRAY, LEAST_DARK_NOISE, SensorModel
from clsco.plan.buffers import sensor_buffers
from clsco.plan.image import prefix_names
from clsco.plan.passes import Parameters, Pass


def sensor_pass(model: SensorModel, grid: Grid, takes: str) -> Pass:
    """The sensor pass; takes: name of the output with the frame's irradiance, "frame" or "plane"."""
    sensor = model.sensor
    electrons = f"{model.scale[GRAY]:.6g} e- of white, full well {sensor.full_well:.6g} e-"
    codes = f"{model.gain:.4g} DN/e- from {sensor.black_level}, {sensor.bits} bits"
    noise = f"{model.dark_noise:.3g} DN rms in the dark"
    if model.dark_noise < LEAST_DARK_NOISE:
        noise += f": posterized, as below {LEAST_DARK_NOISE} DN means of many frames follow the steps of the codes"
    parameters: Parameters = (("electrons", electrons), ("codes", codes), ("noise", noise))
    if sensor.mosaic != "none":
        parameters += (("mosaic", f"{sensor.mosaic}, demosaic {sensor.demosaic}"),)
    return Pass("sensor", parameters, prefix_names("sensor", sensor_buffers(model, grid)), (takes,), ("codes",))
