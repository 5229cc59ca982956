"""Request for a rendering, besides its scene."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Request:
    """Outputs, and how they are computed.

    Attributes
    ----------
    truth : tuple of str
        Names of the outputs besides color.
    method : str
        Method of the blur: "auto", or a method by name (`clsco.plan.methods.check_method`).
    tolerance : float, optional
        RMS error of white up to which fewer samples are taken; None for all samples.
    precision : {"single", "double"}, optional
        Precision of the geometry; by default double where the device has it.
    memory : int or str, optional
        Most that buffers on the device take; by default half of what is free.
    color : bool
        The image is wanted.
    """

    truth: tuple[str, ...] = ()
    method: str = "auto"
    tolerance: float | None = None
    precision: str | None = None
    memory: str | int | None = None
    color: bool = True
