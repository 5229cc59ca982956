"""Opening of the lens and point spread function: sections [aperture] and [psf] of a scene file."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self, cast

from pydantic import Field, ValidationInfo, field_validator, model_validator

from clsco.errors import SceneError
from clsco.records import MOST_RIMS
from clsco.scene.aberrations import Seidel, Zernike, zernike_terms
from clsco.scene.arrays import HasInputs, Input, TextureInput
from clsco.scene.quantities import Flag, Strict, Triple, Within, array_of_tables, fault, only_with, raise_faults

NEEDS_RAYS = '"visibility" needs analytic surfaces, which rays can be cast at; use "layered" or "none"'


ApertureShape = Literal["circle", "polygon", "ring", "image"]
APERTURE_KEYS: dict[str, tuple[ApertureShape, ...]] = {
    "blades": ("polygon",),
    "blade_curvature": ("polygon",),
    "rotation": ("polygon", "image"),
    "obstruction": ("ring",),
    "image": ("image",),
}
"""Keys of [aperture] that are allowed only with some shapes, and these shapes."""


MOST_CONCAVE_TRIANGLE = -math.tan(math.radians(15.0)) / math.tan(math.radians(30.0))


class Rim(Strict):
    """Circle before or behind the aperture that light must pass through, such as the end of a lens barrel."""

    distance: Annotated[float, Within(-1000.0, 1000.0, "mm")]
    """Distance from the aperture, mm, positive towards the scene."""
    diameter: Annotated[float, Within(0.01, 1000.0, "mm")]
    """Diameter, mm."""


_RIMS = array_of_tables("aperture.rim", "rims", MOST_RIMS)
Rims = Annotated[tuple[Rim, ...], Field(json_schema_extra={"maxItems": MOST_RIMS}), _RIMS]


class Aperture(HasInputs, Strict):
    """Opening of the lens: a circle, or a polygon, ring or image inscribed in it."""

    shape: ApertureShape = "circle"
    """A circle, a polygon of blades, a circle whose middle is covered, or an image of transmissions."""
    blades: Annotated[int, Within(3, 32)] = 6
    """Number of blades; only with shape = "polygon"."""
    blade_curvature: Annotated[float, Within(-1.0, 1.0)] = 0.0
    """Bulge of the blades: 0 straight, 1 the circle through the corners, negative concave; only with
    shape = "polygon"."""
    rotation: Annotated[float, Within(-360.0, 360.0, "deg")] = 0.0
    """Turn, counter-clockwise in the image of a far light, deg; at 0 an edge of a polygon faces right; only with
    shape = "polygon" or "image"."""
    obstruction: Annotated[float, Within(0.01, 0.99)] = 0.5
    """Radius of the covered middle, in radii of the aperture; only with shape = "ring"."""
    image: TextureInput | None = None
    """Square gray image of the transmission, as a far light's blur shows it; the circle in it is the rim of the lens;
    only with shape = "image"."""
    squeeze: Annotated[float, Within(0.25, 4.0)] = 1.0
    """Height over width of the blur, as of an anamorphic lens: the height stays."""
    exposure: Literal["normalized", "area"] = "normalized"
    """Frames are as bright as with the open circle, or darker by the area and transmission of the shape."""
    rim: Rims = ()
    """Up to 4 rims that cut light besides the aperture, which gives cat-eyes outside the middle of a picture."""

    _of_its_shape = only_with("aperture.shape", APERTURE_KEYS)

    @field_validator("blade_curvature")
    @classmethod
    def _blades_meet_at_corners(cls, value: float, info: ValidationInfo) -> float:
        """Reject three blades that are so concave that they cross.

        At a corner, the angle between the arc of a blade of curvature c and its chord is 2 atan(c tan 30 deg), and the
        angle between the chord and the line to the center is 30 deg.
        """
        if info.data.get("blades") == 3 and value < MOST_CONCAVE_TRIANGLE:
            raise fault(f"must be at least {MOST_CONCAVE_TRIANGLE:.3f} with 3 blades, which would cross one another")
        return value

    @model_validator(mode="after")
    def _has_an_image(self) -> Self:
        if self.shape == "image" and self.image is None:
            raise_faults((("image",), fault('is needed by aperture.shape = "image"', got="none"), None))
        return self

    def inputs(self) -> dict[str, Input]:
        return {} if self.image is None else {"image": cast("Input", self.image)}


Wavelength = Annotated[float, Within(100.0, 20000.0, "nm")]
Wavelengths = Annotated[tuple[Wavelength, Wavelength, Wavelength], Triple]
SpreadModel = Literal["pillbox", "gaussian", "wave"]
MODEL_KEYS: dict[str, tuple[SpreadModel, ...]] = {
    "sigma_ratio": ("gaussian",), "truncation": ("gaussian",), "seidel": ("wave", "pillbox"),
    "zernike": ("wave", "pillbox"), "wavelengths": ("wave", "pillbox"),
    **dict.fromkeys(("bandwidth", "tail", "rest"), ("wave",)),
}  # fmt: skip
"""Keys of [psf] that are allowed only with some models, and these models."""


class Psf(Strict):
    """Point spread function, and how exactly it is evaluated."""

    model: SpreadModel = "pillbox"
    """The opening at the size of |R|, a Gaussian of standard deviation sigma_ratio |R|, or the opening with the
    diffraction of light at its rim."""
    edge: Literal["integrated", "area", "sampled"] = "integrated"
    """Integrated over source and detector pixel, over the detector pixel only, or taken at pixel centers."""
    tilt: Flag = True
    """Weight by the gradient of the blur radius."""
    silhouette_samples: Annotated[int, Within(1, 16)] = 4
    """Sources per pixel and axis near silhouettes; 1: off."""
    occlusion: Literal["visibility", "layered", "none"] = "visibility"
    """Occlusion by nearer surfaces: visibility tests towards the lens, depth layers of the image, or none. Default,
    where surfaces are not analytic (depth maps, forward warp): layered."""
    sigma_ratio: Annotated[float, Within(1e-6, 10.0)] = math.sqrt(0.5)
    """sigma / |R|; only with model = "gaussian"."""
    truncation: Annotated[float, Within(1.0, 6.0)] = Field(
        default_factory=lambda data: 2.0 if data["edge"] == "sampled" else 3.0
    )
    """Cut of the Gaussian, in sigma; only with model = "gaussian". Default 3, with edge = "sampled" 2."""
    wavelengths: Wavelengths = (610.0, 540.0, 465.0)
    """Wavelengths of red, green and blue, nm, of which gray images take the one in the middle; only with
    model = "wave", or with seidel or zernike, whose waves are those of green."""
    bandwidth: Annotated[float, Within(0.0, 1000.0, "nm")] = 0.0
    """Width of a band around each of them that has as much light everywhere, nm; only with model = "wave"."""
    seidel: Seidel = Seidel.model_construct()
    """Errors of the wavefront by Seidel's terms, in waves of green light; with model = "wave", or by rays, without
    diffraction, with "pillbox"."""
    zernike: Zernike = Zernike.model_construct()
    """Errors of the wavefront by Zernike polynomials, the same on every point of the field; as `seidel`."""
    tail: Annotated[float, Within(1e-4, 0.2)] = 0.01
    """Share of the light of a point that is left out at most, far beyond the rim of its blur; only with
    model = "wave"."""
    rest: Literal["renormalize", "lose"] = "renormalize"
    """The light that is left out is given back to the rest of the blur, or lost; only with model = "wave"."""
    border: Literal["lose", "renormalize"] = "lose"
    """Irradiance outside the image is lost, or returned to the pixels inside."""

    @field_validator("edge")
    @classmethod
    def _smooth(cls, value: str, info: ValidationInfo) -> str:
        if value != "integrated" and info.data.get("model") == "wave":
            raise fault('must be "integrated" with psf.model = "wave"')
        return value

    _of_its_model = only_with("psf.model", MODEL_KEYS)

    @model_validator(mode="after")
    def _band_of_light(self) -> Self:
        if self.bandwidth >= min(self.wavelengths):
            rule = f"must be less than each of the wavelengths, of which one is {min(self.wavelengths):g} nm"
            raise_faults((("bandwidth",), rule, self.bandwidth))
        unused = self.model == "pillbox" and not (self.aberrated or self.seidel.W311)
        if unused and self.wavelengths != type(self).model_fields["wavelengths"].default:
            rule = 'belongs to psf.model = "wave" or to aberrations'
            raise_faults((("wavelengths",), rule, list(self.wavelengths)))
        if self.aberrated and self.edge != "integrated":
            raise_faults((("edge",), 'must be "integrated" with psf.seidel or psf.zernike', self.edge))
        return self

    @property
    def aberrated(self) -> bool:
        """True if the wavefront has errors other than distortion (W311)."""
        return self.seidel.W040 != 0.0 or self.seidel.varies or bool(zernike_terms(self.zernike))

    @property
    def is_colored(self) -> bool:
        """True if diffraction differs between colors."""
        return self.model == "wave" and len(set(self.wavelengths)) > 1

    @property
    def asks_for_rays(self) -> bool:
        """True if the scene sets `occlusion = "visibility"` explicitly; False if that is only the default."""
        return self.occlusion == "visibility" and "occlusion" in self.model_fields_set

    def of_images(self) -> Self:
        """Copy for images and depth maps, at which no rays can be cast: occlusion is "layered" unless it is set.

        Raises SceneError if it is set to "visibility".
        """
        if self.asks_for_rays:
            raise SceneError(f"psf.occlusion: {NEEDS_RAYS}; got {self.occlusion}")
        return self.model_copy(update={"occlusion": "layered"}) if self.occlusion == "visibility" else self


def misfit(psf: Psf, aperture: Aperture) -> tuple[str, str, Any] | None:
    """Key of [aperture] that is incompatible with the PSF, the rule, and the value that breaks it; None if all fit."""
    shape, squeeze, rim = aperture.shape, aperture.squeeze, bool(aperture.rim)
    gaussian, sampled = psf.model == "gaussian", psf.edge == "sampled"
    by_waves, by_area = 'needs psf.model = "pillbox" or "wave"', 'needs psf.edge = "integrated" or "area"'
    least = "must be at least 1 with psf.seidel or psf.zernike, which are of a circle"
    rules: tuple[tuple[bool, str, str, Any], ...] = (
        (rim and sampled, "rim", by_area, psf.edge),
        (rim and psf.model == "wave", "rim", 'needs psf.model = "pillbox" or "gaussian"', psf.model),
        (rim and psf.aberrated, "rim", "must be absent with psf.seidel or psf.zernike", "some"),
        (psf.aberrated and squeeze < 1.0, "squeeze", least, squeeze),
        (shape != "circle" and gaussian, "shape", f'"{shape}" {by_waves}', shape),
        (shape != "circle" and sampled, "shape", f'"{shape}" {by_area}', shape),
        (squeeze != 1.0 and gaussian, "squeeze", f"an aperture that is squeezed {by_waves}", squeeze),
        (squeeze != 1.0 and sampled, "squeeze", f"an aperture that is squeezed {by_area}", squeeze),
    )
    return next(((key, rule, value) for broken, key, rule, value in rules if broken), None)
