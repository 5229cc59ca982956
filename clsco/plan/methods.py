"""Choices with their reasons; the choice of the blur method, and the specification of a blur."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from clsco.errors import SceneError
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_reach
from clsco.plan.device import DeviceFacts

T = TypeVar("T")
Blur = Literal["gather", "scatter", "tiles", "convolve", "none"]
Occlusion = Literal["visibility", "layered", "none"]

# px: |R| times number of channels up to which "scatter", by atomics, is faster than "tiles", which tests the sources
# around a pixel (`python -m benchmarks.speed.gpu`).
FEW_TAPS = 6.0
WIDE_BLUR = 6.0  # px, largest |R| up to which layered occlusion has one cell of the lens by default

MANY_RADII: tuple[Blur, ...] = ("gather", "scatter", "tiles")  # methods for sources with different radii
HOW: dict[Blur, str] = {
    "gather": "many radii",
    "scatter": "atomic, fixed point",
    "tiles": "many radii, a work-item per pixel",
    "convolve": "one PSF for the whole frame",
    "none": "in focus",
}


@dataclass(frozen=True)
class Choice(Generic[T]):
    """A value that a plan decided on, the reason in reports, and the keys of the scene that have no effect because of
    it.

    value: False, 0, empty or "none" if a part of the pipeline is left out.
    """

    value: T
    reason: str = ""
    unused: tuple[str, ...] = ()

    @property
    def left_out(self) -> bool:
        """True if the scene does not need this part of the pipeline."""
        return not self.value or self.value == "none"


TESTED_SCATTER: Choice[Blur] = Choice("scatter", f"{HOW['scatter']}, as tiles do not test what is in the way")


@dataclass(frozen=True)
class BlurSpec:
    """Specification of a blur, which determines its programs and buffers.

    Radii outside of the range are clamped, except by "convolve", which uses the radius of the sources.
    """

    psf: PointSpread
    method: Blur
    smallest: float  # range of |R|, px
    largest: float
    subpixels: int = 0  # sub-pixel sources per axis at silhouettes, 0 for none
    tilt: bool = False  # True if sources store the gradient of R
    occluders: int = 0  # largest number of occluders of one source, rounded by `occluder_room`
    # True if any occluder has bounds, is one nappe of a double cone or hyperboloid, or is a disc.
    limited: bool = False
    brightest: float = 1.0  # largest |radiance|, which determines the unit of integer sums
    border: Literal["lose", "renormalize"] = "lose"  # light beyond the frame is lost, or returned to the frame
    layered: bool = False  # True if sources are in depth layers, with nearer ones hiding farther ones
    cells: int = 1  # cells of the lens along each axis that depth layers hide one by one, 1 or 2
    images: int = 0  # number of images with alpha that lie over each other, 0 for one image without alpha
    curved: int = 0  # feature CURVED of the lens if visibility tests or ellipses need it, else 0
    shared: bool = False  # True if sub-pixel sources of fine textures may share the visibility test of their pixel
    small: bool = False  # True if small surfaces have their own slots of sub-pixel sources

    @property
    def marked(self) -> bool:
        """True if sources are marked as whole, as split into sub-pixel sources, or as partly occluded."""
        return self.subpixels > 0 or self.occluders > 0

    @property
    def by_quadrants(self) -> bool:
        """True if light through each quadrant of the lens is added apart, as in the sheets of depth layers."""
        return self.cells > 1 and not self.layered

    @property
    def reach(self) -> int:
        """Largest half-width of a row of weights in the tables, px."""
        return max(table_reach(self.psf, self.largest, fine) for fine in {False, self.subpixels > 0})


def lens_cells(psf: PointSpread, method: Blur, border: str, largest: float, cells: int | None = None) -> int:
    """Cells of the lens along each axis for layered occlusion: `cells`, or by default 2 if blur is wide.

    largest: largest |R|, px. Small discs have too few taps for quadrants. Rims, ellipses, and light that is returned to
    the frame need one cell. Raises SceneError.
    """
    separable = not psf.rims and psf.stretched == 0.0 and border == "lose"
    if cells is not None and (type(cells) is not int or cells not in ((1, 2) if separable else (1,))):
        raise SceneError(f'cells: must be 1 or 2, and 1 with aperture.rim or psf.border = "renormalize"; got {cells!r}')
    return cells or (2 if largest > WIDE_BLUR and separable and method in MANY_RADII else 1)


def occluder_room(occluders: int) -> int:
    """Number of occluders that a program is compiled for: 0, 4, 16 or 64, so that few programs serve all scenes. A
    program for 4 takes no more time than one for 1.
    """
    room = 4
    while room < occluders:
        room *= 4
    return room if occluders else 0


def check_method(method: str) -> None:
    """Raise SceneError for an unknown blur method."""
    names = ("auto", *MANY_RADII, "convolve")
    if method not in names:
        raise SceneError(f"method: must be one of {', '.join(names)}; got {method}")


def choose_blur(
    method: str, psf: PointSpread, device: DeviceFacts, largest: float, channels: int, one_radius: bool,
    whole_pixels: bool = True, occluded: bool = False,
) -> Choice[Blur]:  # fmt: skip
    """Choose the method of a blur: `method` unless it is "auto". Raises SceneError for a method that does not exist or
    does not support this blur.

    largest: largest |R|, px; one_radius: True if all pixels have one radius, and light beyond the border is lost;
    whole_pixels: True if no pixel has sub-pixel sources; occluded: True if objects may hide sources.
    """
    check_method(method)
    gpu = device.kind == "gpu"
    if method == "convolve" and psf.signed:
        raise SceneError(f"method: convolve needs an aperture that blurs alike for R and -R; got {psf.pupil.name}")
    if method == "convolve" and psf.rims:
        raise SceneError(f"method: convolve needs an aperture without rims; got {len(psf.rims)}")
    if method == "gather" and gpu:
        raise SceneError("method: gather needs a processor, as its kernels are made for one; got a graphics card")
    one_stencil = one_radius and whole_pixels and not psf.signed and not psf.rims
    if method == "convolve" and not one_stencil:
        raise SceneError('method: convolve needs one blur radius for all pixels and border = "lose"; got many radii')
    tested = occluded or bool(psf.rims) or psf.stretched > 0.0
    if method == "tiles" and tested:
        rule = "needs sources with nothing in their way"
        raise SceneError(f"method: tiles {rule}; got objects that hide each other, rims of the lens, or ellipses")
    blur: Blur = "convolve" if one_stencil else "tiles" if gpu else "gather"
    if method in MANY_RADII:
        blur = method
    elif whole_pixels and psf.is_sharp(largest):
        blur = "none"
    elif blur == "tiles" and tested:
        return TESTED_SCATTER
    elif blur == "tiles" and device.has_int64_atomics and largest * channels <= FEW_TAPS:
        return Choice("scatter", f"{HOW['scatter']}, as taps are few")
    return Choice(blur, HOW[blur])
