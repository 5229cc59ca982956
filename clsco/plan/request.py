"""Request for a rendering, besides its scene."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Request:
    """Requested outputs, and how to compute them.

    Attributes
    ----------
    truth : tuple of str
        Names of the outputs besides color.
    method : str
        Method of the blur: "auto", or a method by name (`clsco.plan.methods.check_method`).
    tolerance : float, optional
        Largest RMS error, 1 = white, from taking fewer samples; None for all samples.
    precision : {"single", "double"}, optional
        Precision of the geometry; by default double if the device has it.
    memory : int or str, optional
        Limit of the buffers on the device; by default half of the free memory.
    color : bool
        True if the image is requested.
    """

    truth: tuple[str, ...] = ()
    method: str = "auto"
    tolerance: float | None = None
    precision: str | None = None
    memory: str | int | None = None
    color: bool = True
