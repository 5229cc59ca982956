"""Processor time of the operations of passes on one core, on PoCL; `python -m benchmarks.speed.prediction --write`
measures both numbers anew."""

from __future__ import annotations

RATES: dict[str, float] = {
    "ray": 1.1e-08,
    "moved": 3.9e-08,
    "mapped": 4.1e-07,
    "lit": 7.8e-07,
    "test": 1.1e-07,
    "cut test": 2.3e-07,
    "marked": 4.1e-09,
    "sub-pixel ray": 3.3e-08,
    "sub-pixel mapped": 1.7e-06,
    "sub-pixel test": 1.3e-07,
    "detail": 3.5e-07,
    "sent": 5.8e-10,
    "reprojected": 5.6e-09,
    "filled": 2.7e-09,
    "accumulated": 5e-10,
    "sensed": 1e-08,
    "patterned": 7e-09,
    "walked": 3.2e-09,
    "disc row": 9.6e-10,
    "disc taps": 1.8e-10,
    "symmetric row": 6.3e-10,
    "symmetric taps": 1.3e-10,
    "separable row": 0,
    "separable taps": 4.8e-10,
    "general row": 0,
    "general taps": 2.2e-09,
    "shape row": 1.3e-09,
    "shape taps": 1.7e-10,
    "ellipse row": 6e-09,
    "ellipse taps": 1e-10,
    "sub-pixel source": 1.6e-08,
    "sub-pixel taps": 2.5e-09,
    "rim row": 1.2e-08,
    "rim taps": 6e-10,
    "hidden source": 7.5e-07,
    "edge row": 8e-09,
    "cut edge row": 8.5e-08,
    "edge taps": 1.3e-09,
    "narrow edge": 8.9e-07,
    "narrow cut edge": 1.2e-06,
    "convolved row": 2e-10,
    "layer pixel": 5.9e-09,
    "truth ray": 7e-08,
    "truth image": 4.9e-07,
    "frame": 0.0018,
    "read back": 1e-08,
    "reference pose": 8.2e-08,
}
"""Operation -> seconds: rays and what they meet, sub-pixel rays, the forward warp, taps in vectors of 8 and rows of
them by layout of weights (`PointSpread.layout`; "shape" of general ones without waves, "ellipse" of distorted
discs), what rims alone cut, what tests
what hides a source, and what is done per pixel."""

CORE_SECONDS = 0.000143
"""Seconds of `clsco.cost.predict.core_seconds` on the core that the rates are of."""
