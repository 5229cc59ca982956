"""Blurs of the PSFs that tests are written for."""

from __future__ import annotations

from typing import Any

from clsco.inputs.pupils import load_point_spread
from clsco.plan.methods import Blur, BlurSpec
from clsco.scene.model import Aperture, Psf


def spec_of(
    psf: Psf, largest: float = 0.0, method: Blur = "gather", aperture: Aperture | None = None, **others: Any
) -> BlurSpec:
    """Blur by the keys of [psf] and [aperture]; `largest`: |R| in px."""
    given = {"smallest": 0.0, "tilt": psf.tilt, "border": psf.border} | others
    return BlurSpec(load_point_spread(psf, aperture or Aperture()), method, largest=largest, **given)
