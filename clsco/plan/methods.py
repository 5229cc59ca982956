"""Choice of the blur method, and what a blur is made for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_reach
from clsco.plan.choice import Choice
from clsco.plan.device import DeviceFacts

Array = NDArray[np.float64]
Blur = Literal["gather", "scatter", "tiles", "convolve", "none"]
Occlusion = Literal["visibility", "layered", "none"]

FEW_TAPS = 6.0  # px: radius times channels up to which a card is faster by atomics (`python -m benchmarks.speed.gpu`)

MANY_RADII: tuple[Blur, ...] = ("gather", "scatter", "tiles")  # methods for sources of any radius each
HOW: dict[Blur, str] = {
    "gather": "many radii",
    "scatter": "atomic, fixed point",
    "tiles": "many radii, a work-item per pixel",
    "convolve": "one PSF for the whole frame",
    "none": "in focus",
}


@dataclass(frozen=True)
class BlurSpec:
    """A blur by the PSF of each source: what its programs are built for, and its buffers are made for.

    Attributes
    ----------
    psf : PointSpread
    method : Blur
    smallest, largest : float
        Range of |R| in px; other radii are clamped to it ("convolve" makes the PSF of its radius).
    subpixels : int
        Sub-pixel sources per axis at silhouettes, 0 for none.
    small : bool
        Small surfaces have slots of sub-pixel sources of their own.
    tilt : bool
        Sources have the gradient of R.
    occluders : int
        Objects that may stand in the way of one source, as `occluder_room` rounds their number.
    limited : bool
        Any occluder has bounds, or one nappe of two, or is a disc.
    brightest : float
        Largest |radiance|, which sets the unit of sums of whole numbers.
    border : {"lose", "renormalize"}
        Fate of irradiance outside of the frame: lost, or given back to it.
    layered : bool
        Sources are in depth layers, of which nearer ones hide farther ones.
    curved : int
        Feature CURVED, where visibility tests need radii.
    merged : float
        |R| in px from which on sources that are hidden in part may be merged; 0 for none.
    shared : bool
        Sub-pixel sources of fine textures may see the lens from the middle of their pixel.
    """

    psf: PointSpread
    method: Blur
    smallest: float
    largest: float
    subpixels: int = 0
    tilt: bool = False
    occluders: int = 0
    limited: bool = False
    brightest: float = 1.0
    border: Literal["lose", "renormalize"] = "lose"
    layered: bool = False
    curved: int = 0
    merged: float = 0.0
    shared: bool = False
    small: bool = False

    @property
    def marked(self) -> bool:
        """True if sources carry marks: whole, in sub-pixel sources, or partly occluded."""
        return self.subpixels > 0 or self.occluders > 0

    @property
    def reach(self) -> int:
        """Largest half-width of a row of weights in the tables, px."""
        return max(table_reach(self.psf, self.largest, fine) for fine in {False, self.subpixels > 0})


def can_convolve(psf: PointSpread, border: str) -> bool:
    """True if `convolve` can blur by this PSF: the same one everywhere, whole, and for -R."""
    return border == "lose" and not psf.signed and not psf.rims


def check_shape(psf: PointSpread, method: str) -> None:
    """Raise SceneError where a method cannot take the shape of the lens."""
    if method == "convolve" and psf.signed:
        raise SceneError(f"method: convolve needs an aperture that blurs alike for R and -R; got {psf.pupil.name}")
    if method == "convolve" and psf.rims:
        raise SceneError(f"method: convolve needs an aperture without rims; got {len(psf.rims)}")


def occluder_room(occluders: int) -> int:
    """So many occluders as a program has room for: 4, 16 or 64, so that few programs serve all scenes. Room for 4 takes
    no longer than room for 1."""
    room = 4
    while room < occluders:
        room *= 4
    return room if occluders else 0


def check_method(method: str) -> None:
    """Raises SceneError where no method of the blur has this name."""
    known = ("auto", *MANY_RADII, "convolve")
    if method not in known:
        raise SceneError(f"method: must be one of {', '.join(known)}; got {method}")


def has_few_taps(device: DeviceFacts, largest: float, channels: int) -> bool:
    """True on a GPU that adds so few taps by atomics in less time than work-items of tiles look at their sources;
    largest: of |R| in px."""
    return device.kind == "gpu" and device.has_int64_atomics and largest * channels <= FEW_TAPS


def choose_blur(
    method: str, sharp: bool, constant: bool, gpu: bool, occluded: bool = False, few_taps: bool = False
) -> Choice[Blur]:
    """The way a blur is computed.

    Parameters
    ----------
    method : str
        "auto", one of MANY_RADII, or "convolve".
    sharp : bool
        All light stays in its pixel (`is_sharp`).
    constant : bool
        All pixels have one radius, and `can_convolve`.
    gpu : bool
        The device is a GPU.
    occluded : bool
        Something may stand in the way of a source, or its blur is an ellipse.
    few_taps : bool
        `has_few_taps`.

    Returns
    -------
    Choice of Blur

    Raises
    ------
    SceneError
        There is no such method, or it cannot do this blur.
    """
    check_method(method)
    if method == "gather" and gpu:
        raise SceneError("method: gather needs a processor, as its kernels are made for one; got a graphics card")
    if method == "convolve" and not constant:
        raise SceneError('method: convolve needs one blur radius for all pixels and border = "lose"; got many radii')
    if method == "tiles" and occluded:
        rule = "needs sources with nothing in their way"
        raise SceneError(f"method: tiles {rule}; got objects that hide each other, rims of the lens, or ellipses")
    found: Blur = "convolve" if constant else "tiles" if gpu else "gather"
    if method in MANY_RADII:
        found = method
    elif sharp:
        found = "none"
    elif found == "tiles" and occluded:
        return Choice("scatter", f"{HOW['scatter']}, as tiles do not test what is in the way")
    elif found == "tiles" and few_taps:
        return Choice("scatter", f"{HOW['scatter']}, as taps are few")
    return Choice(found, HOW[found])
