"""Time of an image sensor alone, ns of processor time per code: python -m benchmarks.speed.sensor

Codes of a gray frame of 1024 x 1024 px from light that is uniformly random from 0 to a largest value, 1 = white =
10,000 electrons: shot and read noise alone, and fixed patterns as well. Medians of interleaved repetitions.
"""

from __future__ import annotations

import time
from statistics import median

import numpy as np

from clsco.frame.strips import Strip
from clsco.opencl.buffers import upload
from clsco.opencl.session import session_for
from clsco.optics.sensor import sensor_model
from clsco.passes.blur import Plane
from clsco.passes.sensor import FrameSensor
from clsco.scene.model import Plane as Card
from clsco.scene.model import Scene, Sensor

SIDE, REPETITIONS = 1024, 9
LARGEST = (1.0, 0.004, 0.002, 0.0002)  # of white: below 0.003 all pixels have fewer than 30 electrons


def main() -> None:
    """Measure, and print a line for each case."""
    session = session_for(None)
    random = np.random.default_rng(1).random((1, SIDE, SIDE), np.float32)
    spent: dict[tuple[float, bool], list[float]] = {}
    for turn in range(REPETITIONS + 1):
        for largest in LARGEST:
            for pattern in (False, True):
                sensor = Sensor() if pattern else Sensor(prnu=0.0, dsnu=0.0)
                known = sensor_model(Scene(objects=(Card(distance=300),), sensor=sensor), 1)
                taken = FrameSensor(session, known, {"code": 2 * SIDE * SIDE, "saturated": SIDE * SIDE})
                plane = Plane(upload(session, random * np.float32(largest)), (1, SIDE, SIDE), SIDE, SIDE)
                session.queue.finish()
                before = time.process_time()
                taken.expose(Strip(0, SIDE, 0, 0), plane, 0, [])
                session.queue.finish()
                if turn:  # the first one compiles
                    spent.setdefault((largest, pattern), []).append(time.process_time() - before)
    for (largest, pattern), times in spent.items():
        noise = "shot and read noise, fixed pattern" if pattern else "shot and read noise"
        print(f"light up to {largest:g}, {noise}: {1e9 * median(times) / SIDE**2:.1f} ns per code")


if __name__ == "__main__":
    main()
