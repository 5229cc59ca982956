"""Request: what a user asks for besides the scene."""

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
        Method of the blur: "auto", or the name of a method (`clsco.plan.methods.check_method`).
    tolerance : float, optional
        Largest RMS error (1 = white) that fewer samples may cause; None for all samples.
    precision : {"single", "double"}, optional
        Precision of the geometry; by default double if the device has it.
    memory : int or str, optional
        Limit of the buffers on the device; by default as in `clsco.plan.memory.limit_of`.
    color : bool
        True if the image is requested.
    """

    truth: tuple[str, ...] = ()
    method: str = "auto"
    tolerance: float | None = None
    precision: str | None = None
    memory: str | int | None = None
    color: bool = True
