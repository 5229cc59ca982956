"""Image sensor: section [sensor] of a scene file."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from clsco.scene.quantities import Duration, FNumber, Strict, Triple, Within, fault, instead_of, only_with, raise_faults

MOSAICS = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "grbg": (1, 0, 2, 1), "gbrg": (1, 2, 0, 1)}
"""Channels (0 red, 1 green, 2 blue) of a Bayer mosaic's pixels in (row, column) (0, 0), (0, 1), (1, 0), (1, 1)."""
EXPOSURE_KEYS = {"reference_shutter": ("physical",), "reference_f_number": ("physical",)}
"""Keys of [sensor] that are allowed only with some values of `exposure`, and these values."""
MOST_ELECTRONS = 10_000_000
NOISE_SEEDS = 2**53  # number of seeds, all of which JSON numbers represent exactly

Electrons = Annotated[float, Within(1.0, MOST_ELECTRONS, "e-")]
Noise = Annotated[float, Within(0.0, 1e6, "e-")]
Celsius = Annotated[float, Within(-273.15, 1000.0, "degC")]
Iso = Annotated[float, Within(1.0, 1e7)]
Efficiency = Annotated[float, Within(1e-6, 1.0)]


class Sensor(Strict):
    """Image sensor that counts electrons; without one frames are light."""

    white_electrons: Electrons = 10_000.0
    """Electrons that light of value 1 makes in a pixel of quantum efficiency 1, at iso = iso_base, or at the reference
    of a physical exposure; e-."""
    exposure: Literal["normalized", "physical"] = "normalized"
    """Electrons of light: normalized, the same by any lens and shutter; or physical, as many as these let through."""
    reference_shutter: Duration = 1.0
    """Exposure time at which light of value 1 makes white_electrons, s; only with exposure = "physical"."""
    reference_f_number: FNumber = 1.0
    """F-number at which light of value 1 makes white_electrons; only with exposure = "physical"."""
    full_well: Electrons = 12_000.0
    """Electrons that a pixel can hold, e-."""
    read_noise: Noise = 2.0
    """Noise of the read-out, e- rms."""
    dark_current: Annotated[float, Within(0.0, 1e9, "e-/s")] = 0.0
    """Electrons that come without light at temperature_reference, e-/s."""
    temperature: Celsius = 20.0
    """Temperature of the sensor, degC."""
    temperature_reference: Celsius = 20.0
    """Temperature that dark_current is given for, degC."""
    temperature_doubling: Annotated[float, Within(0.1, 1000.0, "degC")] = 8.0
    """Rise of the temperature that doubles the dark current, degC."""
    prnu: Annotated[float, Within(0.0, 1.0)] = 0.005
    """Photo response non-uniformity, rms share of the light."""
    dsnu: Noise = 0.5
    """Dark signal non-uniformity, e- rms."""
    hot_pixels: Annotated[float, Within(0.0, 1.0)] = 0.0
    """Share of pixels that leak as well: up to a full well in a second, at temperature_reference."""
    bits: Annotated[int, Within(1, 16)] = 12
    """Bits of a code (DN)."""
    black_level: Annotated[int, Within(0, 65535, "DN")] = Field(default_factory=lambda data: 2 ** data["bits"] // 64)
    """Code without any electrons, DN, at most 2^bits - 1. Default: 2^bits / 64."""
    iso: Iso | None = None
    """Sensitivity; instead of gain: fewer electrons for the same light, and more codes for an electron."""
    iso_base: Iso = 100.0
    """Sensitivity at which a full well has the largest code; only with iso."""
    gain: Annotated[float, Within(1e-6, 1e6, "DN/e-")] | None = None
    """Codes for an electron, DN/e-; instead of iso. Default: a full well has the largest code."""
    quantum_efficiency: Annotated[tuple[Efficiency, Efficiency, Efficiency], Triple] = (1.0, 1.0, 1.0)
    """Electrons for a photon, of red, green and blue; gray light has green's, but under a mosaic that of each pixel."""
    mosaic: Literal["none", "rggb", "bggr", "grbg", "gbrg"] = "none"
    """Color filters of the pixels, from the upper left corner on; "none": each pixel measures all channels."""
    demosaic: Literal["none", "bilinear", "malvar", "menon"] = "none"
    """Method that finds the channels that a pixel of a mosaic has not measured, for the image; "none": they are 0."""
    seed: Annotated[int, Within(0, 2**63 - 1)] = 1
    """Seed of all noise: another one is another sensor and other exposures."""
    noise_seed: Annotated[int, Within(0, NOISE_SEEDS - 1)] = 0
    """Seed of the noise that is new in each exposure: another one is another exposure by the same sensor. Variants of a
    sweep count on from it, samples of a data set have their own."""

    @field_validator("black_level")
    @classmethod
    def _is_a_code(cls, value: int, info: ValidationInfo) -> int:
        bits = info.data.get("bits")
        if bits is not None and value >= 2**bits:
            raise fault(f"must be at most {2**bits - 1} with bits = {bits}")
        return value

    _of_its_exposure = only_with("exposure", EXPOSURE_KEYS)
    _one_of_a_pair = instead_of(gain="iso")

    @field_validator("iso_base")
    @classmethod
    def _with_iso(cls, value: float, info: ValidationInfo) -> float:
        if info.data.get("iso", "refused") is None:
            raise fault("belongs to iso, which is not given")
        return value

    @field_validator("demosaic")
    @classmethod
    def _of_a_mosaic(cls, value: str, info: ValidationInfo) -> str:
        if value != "none" and info.data.get("mosaic") == "none":
            raise fault('needs a mosaic, not "none"')
        return value

    @model_validator(mode="after")
    def _has_codes_for_electrons(self) -> Self:
        most = 2**self.bits - 1
        if self.gain is None and self.black_level == most:
            rule = f"must be below {most}, or with a gain, which else follows from the codes above"
            raise_faults((("black_level",), rule, self.black_level))
        return self
