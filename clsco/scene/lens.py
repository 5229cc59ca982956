"""A real lens: section [lens] of a scene file, with its changes over time and its differences from a thin lens."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator

from clsco.scene.motions import NONE, Interpolation, LensKeyframes, Outside, check_interpolation, default_of_keyframes
from clsco.scene.quantities import MAX_LENGTH_MM, Pair, Strict, Triple, Within, as_python, fault, raise_faults

if TYPE_CHECKING:
    from clsco.scene.spread import Psf

MOST_VIGNETTING = 10.0
MOST_DISTORTION = 10.0
Coefficient = Annotated[float, Within(-MOST_DISTORTION, MOST_DISTORTION)]
Magnification = Annotated[float, Within(0.9, 1.1)]
Shift = Annotated[float, Within(-MAX_LENGTH_MM, MAX_LENGTH_MM, "mm")]


def _vignetting(value: Any) -> Any:
    """Reject any value but a name, or three coefficients of a function that is at least 0 in the whole frame."""
    value = as_python(value)
    if type(value) is str and value in ("none", "natural"):
        return value
    numbers = tuple(value) if isinstance(value, list | tuple) else ()
    if len(numbers) != 3 or any(type(each) not in (int, float) or not abs(each) <= MOST_VIGNETTING for each in numbers):
        raise fault(
            f"must be none, natural, or a list of 3 numbers between -{MOST_VIGNETTING:g} and {MOST_VIGNETTING:g}"
        )
    a1, a2, a3 = map(float, numbers)
    turns = [square for square in _roots(3.0 * a3, 2.0 * a2, a1) if 0.0 < square < 1.0]
    if min(1.0 + r * (a1 + r * (a2 + r * a3)) for r in (*turns, 1.0)) < 0.0:
        raise fault("must leave 1 + a1 r^2 + a2 r^4 + a3 r^6 at least 0 up to the corner, r = 1")
    return a1, a2, a3


def _roots(a: float, b: float, c: float) -> list[float]:
    """Real x with a x^2 + b x + c = 0; empty if every x is a solution."""
    if a == 0.0:
        return [] if b == 0.0 else [-c / b]
    inside = b * b - 4.0 * a * c
    return [] if inside < 0.0 else [(-b + sign * math.sqrt(inside)) / (2.0 * a) for sign in (-1.0, 1.0)]


Share = Annotated[float, Within(-MOST_VIGNETTING, MOST_VIGNETTING)]
Vignetting = Annotated[Literal["none", "natural"] | tuple[Share, Share, Share], BeforeValidator(_vignetting)]


class Lens(Strict):
    """Differences of the camera's lens from a thin lens, and keyframes of its zoom, focus and aperture."""

    keyframe: LensKeyframes | None = None
    """Lenses at 1 to 256 times, instead of the focal length, the focus distance or the f-number of the camera; none if
    not given."""
    interpolation: Interpolation | None = default_of_keyframes("linear")
    """Path of focal_length, to which the image is proportional, and of 1 / focus_distance and 1 / f_number, to which
    the blur radius is, as between keyframes of a motion. Default: linear."""
    outside: Outside | None = default_of_keyframes("hold")
    """Path before the first and after the last keyframe, as of a motion. Default: hold."""
    field_curvature: Annotated[float, Within(-1.0, 1.0, "1/mm")] = 0.0
    """Curvature of the image of a plane, 1 / radius, 1/mm; negative bends it towards the lens, so that nearer points
    are in focus in the corners."""
    focus_surface: Literal["plane", "sphere"] = "plane"
    """Surface in focus: a plane of the same depth, or a sphere of the same distance around the lens."""
    vignetting: Vignetting = "none"
    """Darkening towards the corners: none; natural, cos^4 of the angle from the axis; or a1, a2, a3 of
    1 + a1 r^2 + a2 r^4 + a3 r^6, r = 1 in the corner of the frame."""
    axial: Annotated[tuple[Shift, Shift, Shift], Triple] = NONE
    """Longitudinal chromatic aberration: focal lengths of red, green and blue less camera.focal_length, mm."""

    lateral: Annotated[tuple[Magnification, Magnification, Magnification], Triple] = (1.0, 1.0, 1.0)
    """Lateral chromatic aberration: magnification of red, green and blue, in that of the camera."""
    distortion: Annotated[tuple[Coefficient, Coefficient, Coefficient], Triple] = NONE
    """Radial distortion k1, k2, k3 in the direction of OpenCV: slopes X / Z and Y / Z of a point at distance r from the
    axis are seen as if they were 1 + k1 r^2 + k2 r^4 + k3 r^6 times as large."""
    tangential: Annotated[tuple[Coefficient, Coefficient], Pair] = (0.0, 0.0)
    """Tangential distortion p1, p2 in the direction and with the axes of OpenCV, x right and y down: x is seen by
    2 p1 x y + p2 (r^2 + 2 x^2) farther right, y by p1 (r^2 + 2 y^2) + 2 p2 x y farther down."""

    _of_keyframes = field_validator("interpolation", "outside")(check_interpolation)

    @property
    def at_rest(self) -> Self:
        """The lens without keyframes."""
        return self.model_copy(update=dict.fromkeys(("keyframe", "interpolation", "outside")))

    @property
    def moves(self) -> bool:
        """True if the lens changes over time."""
        return self.keyframe is not None

    @property
    def zooms(self) -> bool:
        """True if the focal length has keyframes."""
        return any(key.focal_length is not None for key in self.keyframe or ())

    @property
    def blurs_unevenly(self) -> bool:
        """True if points at the same depth are blurred differently in different parts of the frame."""
        return self.field_curvature != 0.0 or self.focus_surface == "sphere" or self.distorts

    @property
    def radial(self) -> tuple[float, float, float]:
        """Radial distortion k1, k2, k3; k1 includes the distortion of the wavefront."""
        return self.distortion

    @property
    def distorts(self) -> bool:
        """True if straight lines become curved in the image."""
        return any(self.radial) or any(self.tangential)

    @property
    def darkens(self) -> bool:
        """True if the lens darkens parts of the frame, as by vignetting."""
        return self.vignetting != "none"

    @property
    def separates_colors(self) -> bool:
        """True if blur or magnification differs between colors."""
        return any(self.axial) or self.shifts_colors

    @property
    def shifts_colors(self) -> bool:
        """True if the magnification differs between colors."""
        return any(size != 1.0 for size in self.lateral)


class LensOfWavefront(Lens):
    """A lens with distortion from the wavefront; created by `with_distortion_of_wavefront`."""

    of_wavefront: float = Field(exclude=True)
    """Part of k1 that psf.seidel.W311 causes."""

    @property
    def radial(self) -> tuple[float, float, float]:
        k1, k2, k3 = self.distortion
        return k1 + self.of_wavefront, k2, k3


def check_opening(lens: Lens | None, psf: Psf) -> None:
    """Reject a lens whose aperture changes over time if psf.model = "wave" or aberrations need a constant one."""
    rule = 'cannot change with psf.model = "wave" or aberrations, whose blur is that of one opening'
    if lens is None or not (psf.model == "wave" or psf.aberrated or psf.seidel.W311):
        return
    for k, key in enumerate(lens.keyframe or ()):
        for name in ("focal_length", "f_number"):
            if getattr(key, name) is not None:
                raise_faults((("lens", "keyframe", k, name), rule, getattr(key, name)))


def with_distortion_of_wavefront(lens: Lens | None, psf: Psf, camera: Any) -> Lens | None:
    """The lens of a scene, including the distortion term of Seidel's aberrations; camera: must have a resolution."""
    seidel, k1 = psf.seidel, 0.0
    if seidel.W311:
        half = 0.5 * math.hypot(*(size - 1 for size in camera.resolution)) or 1.0
        corner = half * camera.pixel_pitch / camera.normalization_distance
        k1 = seidel.radial_distortion(psf.wavelengths[1], camera.aperture_diameter, corner)
    keys = {} if lens is None else {name: getattr(lens, name) for name in Lens.model_fields}
    if k1:
        return LensOfWavefront.model_construct(**keys, of_wavefront=k1)
    return Lens.model_construct(**keys) if isinstance(lens, LensOfWavefront) else lens
