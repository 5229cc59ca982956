"""Point spread functions of a lens: exact weights for any pupil (float64, pure).

A weight is the fraction of a source's light that one detector pixel receives. Devices read tables of these weights, as
piecewise cubics in the blur radius.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil, floor, inf, log2, sqrt
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LENS_CELLS
from clsco.errors import SceneError
from clsco.optics.pupils import FORMULAS
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.pupil import Array, Pupil
from clsco.scene.aberrations import zernike_terms
from clsco.scene.model import Aperture, Camera, Psf

if TYPE_CHECKING:  # imported where a scene has them
    from clsco.optics.field import SeidelField
    from clsco.optics.pupils.diffracted import Diffracted
    from clsco.optics.pupils.traced import Traced
    from clsco.optics.pupils.wavefront import Wavefront

MINIMUM_BLUR = 0.5  # px; sampled PSFs do not blur with smaller radii (thesis, 2.2)
GREEN = 1  # color of gray images
POINT = 1e-9  # px; smaller radii are 0
MOST_MARGIN = 256.0  # px outside of the blur's rim that light may reach
LEAST_UNIT, MOST_UNIT = 0.02, 8.0  # px, limits of Q: below, diffraction is not visible; above, no image is left
UNIT_RULE = f"must make wavelength s0 / (D pixel_pitch) {LEAST_UNIT:g} to {MOST_UNIT:g} px"
PIXEL_MOMENT = {"sampled": 0.0, "area": 1 / 12, "integrated": 1 / 6}  # px^2: variance per axis that `edge` adds

Edge = Literal["integrated", "area", "sampled"]
Layout = Literal["disc", "separable", "symmetric", "general"]


@dataclass(frozen=True)
class Rim:
    """Circle that light must pass through; distance: from the aperture, positive towards the scene, mm; radius: mm."""

    distance: float
    radius: float


@dataclass(frozen=True)
class PointSpread:
    """Point spread function (PSF) of a lens: the pupil, and the evaluation on pixels. Made by `point_spread`.

    Instances are the keys of cached tables: equal ones have equal weights, which do not include the effect of rims.
    edge: "integrated": weights are integrals over the source's and the detector's pixel; "area": over the detector's
    pixel only; "sampled": values at pixel centers. alignment: if not 0, weights have corners where the blur ends at
    multiples of 1 / alignment px, so that intervals of tables must begin there. rims: circles that cut off light from
    some directions. varying: change of the wavefront over the frame; `pupil` then has the wavefront on the axis.
    stretched: in a distorted image, the fraction of R by which ellipses reach beyond discs; 0 for discs only. most: for
    a wave or aberration PSF, the largest |R| in px for which tables are needed: of negative radii, and of other radii;
    -1 if there are none.
    """

    pupil: Pupil
    edge: Edge = "integrated"
    alignment: int = 0
    rims: tuple[Rim, ...] = field(default=(), repr=False)
    varying: SeidelField | None = None
    stretched: float = 0.0
    most: tuple[float, float] = (inf, inf)

    @cached_property
    def layout(self) -> Layout:
        """Layout of the tables.

        "disc": all covered pixels have one weight (the sampled pillbox). "separable": a weight is the product of two
        weights, one per axis. "symmetric": the eight octants are equal. "general": tables hold whole rows, for both
        signs of the radius.
        """
        if self.sampled and self.pupil.uniform:
            return "disc"
        if self.pupil.separable:
            return "separable"
        return "general" if self.signed else "symmetric"

    def between(self, lowest: float, highest: float) -> PointSpread:
        """The PSF with `most` for signed radii from `lowest` to `highest` px, rounded up to powers of 2.

        Rounding makes tables fewer. Unchanged unless the PSF is `diffracted` with the layout "general".
        """
        if not (self.diffracted and self.layout == "general"):
            return self
        sizes = -lowest if lowest < 0.0 else -1.0, highest if highest >= 0.0 else -1.0
        negative, others = (2.0 ** ceil(log2(size)) if 0.0 < size < inf else size for size in sizes)
        return replace(self, most=(negative, others))

    @cached_property
    def places(self) -> tuple[PointSpread, ...]:
        """PSFs that have tables: at the positions `SeidelField.nodes`, or only this one if it does not vary."""
        return (self,) if self.varying is None else tuple(self.at(*node) for node in self.varying.nodes)

    @property
    def blended(self) -> int:
        """Number of tables from which a weight is blended."""
        return 1 if self.varying is None else 4

    def at(self, hx: float, hy: float) -> PointSpread:
        """The PSF at a position (hx, hy) of `SeidelField`, as a PSF that is constant over the frame."""
        if self.varying is None:
            return self
        from clsco.optics.pupils.fourier import FourierDiffracted

        assert isinstance(self.pupil, FourierDiffracted)
        wavefront = self.varying.wavefront(self.pupil.wavefront, hx, hy)
        return replace(self, pupil=replace(self.pupil, wavefront=wavefront), varying=None)

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"{self.pupil.name}, {self.edge}"

    @property
    def sampled(self) -> bool:
        """True if weights are taken at pixel centers, so that they jump where the blur's edge passes one."""
        return self.edge == "sampled"

    @property
    def signed(self) -> bool:
        """True if weights for -R differ from those for R."""
        return self.pupil.signed

    @property
    def diffracted(self) -> bool:
        """True if light spreads beyond the geometric blur, by waves or aberrations, and a point in focus is a spot."""
        return self.pupil.steps > 0

    @property
    def uniform(self) -> bool:
        """True if weights are constant inside the blur's outline."""
        return self.pupil.uniform

    @property
    def cut_by_chords(self) -> bool:
        """True if rims cut the lens, and weights are integrals over the opening that they leave
        (`clsco.optics.chords`).

        If it is False and there are rims, each tap's weight is multiplied by the fraction of the lens that the tap
        sees.
        """
        round_lens = type(self.pupil) is Circle
        return bool(self.rims) and self.varying is None and (round_lens or self.pupil.borders is not None)

    @property
    def shares_lens(self) -> bool:
        """True if the sub-pixels of a pixel may share one visibility test of the lens (kernels/trace/detail.clh)."""
        return not (self.rims or self.diffracted)

    @property
    def has_runs(self) -> bool:
        """True for a general shape whose fully covered taps have one weight: columns have runs of this weight."""
        return self.layout == "general" and not self.diffracted

    @property
    def extent(self) -> float:
        """Largest distance from the lens center at which light passes, in lens radii: for R = 1 px, the extent of the
        blur in px. Waves spread light beyond it, see `reach`.
        """
        return self.pupil.extent

    def second_moment(self, radius: float) -> float:
        """Mean square distance of light from its source along one axis, px^2, for blur radii of several px."""
        return self.pupil.second_moment * radius * radius + PIXEL_MOMENT[self.edge]

    def is_sharp(self, largest: float) -> bool:
        """True if a source with |blur radius| up to `largest` px keeps all of its light in its own pixel."""
        if self.rims or self.diffracted:
            return False
        if self.sampled:
            return largest < MINIMUM_BLUR or self.extent * largest < 1.0
        return largest == 0.0 or (self.edge == "area" and self.extent * largest <= 0.5)

    def reach(self, radius: float, subpixel: bool = False) -> int:
        """Largest |dx| or |dy| in px of a pixel lit by a source of |blur radius| `radius` px.

        subpixel: True for a sub-pixel source anywhere in its pixel.
        """
        return int(self.reaches(np.array([radius]), subpixel)[0])

    def reaches(self, radii: Array, subpixel: bool = False) -> NDArray[np.int64]:
        """`reach` for several radii."""
        extent = radii * (1.0 + self.stretched) * self.extent + self.pupil.margin
        if self.sampled and not subpixel:
            reaches = np.where(radii >= MINIMUM_BLUR, np.floor(extent), 0.0)
        else:
            beyond = 1.0 if subpixel or self.edge == "integrated" else 0.5
            reaches = np.maximum(np.ceil(extent + beyond) - 1.0, 0.0)
        return reaches.astype(np.int64)

    def weights(self, dx: Array, dy: Array, radius: Array) -> Array:
        """Fraction of a source's light at integer offsets (dx, dy) px for a blur radius in px; the arrays broadcast.

        Weights sum to 1 within 1e-12, or in a field to the mean of `Wavefront.grown` over the lens. The sign of the
        radius matters if the PSF is `signed`. Equations are (2.26) for a pillbox, (2.27) for a Gaussian. At radius 0,
        all light stays in the source's pixel unless the PSF is `diffracted`.
        """
        tent = self.edge == "integrated"
        if self.signed or self.diffracted:
            return self.pupil.share(dx, dy, np.asarray(radius, np.float64), tent)
        dx, dy, r = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(dx, dy, np.abs(radius)))
        if self.sampled:
            return self._sampled_weights(dx, dy, r)
        center = ((dx == 0) & (dy == 0)).astype(np.float64)
        point = r < POINT
        return np.where(point, center, self.pupil.share(dx, dy, np.where(point, 1.0, r), tent))

    def subpixel_weights(self, dx: Array, dy: Array, radius: Array) -> Array:
        """Fraction of a point source's light in the whole area of the pixel at (dx, dy) px, which may be non-integer.

        Used for sub-pixel sources at silhouettes, for every `edge`; arguments as for `weights`.
        """
        if self.signed or self.diffracted:
            return self.pupil.share(dx, dy, np.asarray(radius, np.float64), tent=False)
        dx, dy, r = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(dx, dy, np.abs(radius)))
        return self.pupil.share(dx, dy, np.maximum(r, POINT), tent=False)

    def axis_weights(self, offset: Array, radius: Array) -> Array:
        """Weights along one axis, only for the layout "separable": `weights` are products of one for x, one for y."""
        from clsco.optics.pupils.gaussian import Gaussian

        assert isinstance(self.pupil, Gaussian)
        point = np.asarray(radius) < POINT
        share = self.pupil.axis_share(offset, np.where(point, 1.0, radius), self.edge == "integrated")
        return np.where(point, offset == 0.0, share)

    def lens_cells(self) -> Array:
        """Light through the cells (2 LENS_CELLS, 2 LENS_CELLS) of a square around the lens, up to a factor.

        Cells are oriented as in the image of a positive blur radius; a negative one mirrors them if `signed`.
        """
        return self.pupil.cells(LENS_CELLS)

    @property
    def key(self) -> float:
        """Squared `extent`; a sampled PSF covers pixel centers with dx^2 + dy^2 <= key R^2, the index of its tables."""
        return self.extent**2

    def _sampled_weights(self, dx: Array, dy: Array, r: Array) -> Array:
        """Weights of pixel centers inside the circle, equal or Gaussian, as in the thesis; no blur below half a px."""
        square = dx * dx + dy * dy
        key = np.where(r < MINIMUM_BLUR, 0.0, self.key * r * r)
        value = (square <= key).astype(np.float64)
        limit = floor(sqrt(float(key.max(initial=0.0))))
        span = np.arange(-limit, limit + 1)
        lattice = np.sort((span[:, None] ** 2 + span[None, :] ** 2).ravel())
        if not self.pupil.soft:
            return value / np.searchsorted(lattice, key, side="right")
        sigma = self.pupil.lengths["sigma"] * np.maximum(r, MINIMUM_BLUR)
        # Sum over the lattice, once per shell of equal distance.
        shells, counts = np.unique(lattice, return_counts=True)
        total = np.zeros_like(r)
        for shell, count in zip(shells, counts, strict=True):
            total += np.where(shell <= key, count * np.exp(-shell / (2.0 * sigma * sigma)), 0.0)
        return value * np.exp(-square / (2.0 * sigma * sigma)) / total


def point_spread(
    psf: Psf, aperture: Aperture | None = None, image: Pupil | None = None, camera: Camera | None = None
) -> PointSpread:
    """The PSF that sections of a scene define; for waves, the PSF of a gray image.

    aperture: by default a circle; image: pupil of aperture.shape = "image"; camera: needed for psf.model = "wave" and
    for aberrations. Raises SceneError if it is needed and None, if diffraction is far finer or far coarser than pixels,
    or if light would spread too far.
    """
    aperture = aperture or Aperture()
    rims = tuple(Rim(rim.distance, 0.5 * rim.diameter) for rim in aperture.rim)
    if psf.model == "gaussian":
        from clsco.optics.pupils.gaussian import Gaussian

        gaussian = Gaussian(psf.sigma_ratio, psf.truncation, round=psf.edge == "sampled")
        return PointSpread(gaussian, psf.edge, 2 * psf.silhouette_samples, rims)
    pupil = image or FORMULAS[aperture.shape](aperture)
    if psf.model == "wave" or psf.aberrated:
        if camera is None:
            rule = 'must be given with psf.model = "wave" or aberrations, for its aperture and pixels'
            raise SceneError(f"camera: {rule}; got None")
        varying = _field(psf, camera)
        make_pupil = _diffract if psf.model == "wave" else _trace_rays
        return PointSpread(make_pupil(pupil, psf, camera, varying), psf.edge, rims=rims, varying=varying)
    return PointSpread(pupil, psf.edge, rims=rims)


def spreads_of_colors(spread: PointSpread, psf: Psf, camera: Camera | None) -> tuple[PointSpread, ...]:
    """PSFs of red, green and blue; equal except for waves. spread: PSF of a gray image, from `point_spread`."""
    if psf.model != "wave" or camera is None:
        return spread, spread, spread
    from clsco.optics.pupils.diffracted import Diffracted

    pupil = spread.pupil
    assert isinstance(pupil, Diffracted)
    pupils = (_diffract(pupil.opening, psf, camera, spread.varying, color) for color in range(3))
    return tuple(replace(spread, pupil=color_pupil) for color_pupil in pupils)


def _diffract(
    pupil: Pupil, psf: Psf, camera: Camera, varying: SeidelField | None, color: int = GREEN
) -> Diffracted:  # fmt: skip
    """The pupil with diffraction in one color, on the axis."""
    from clsco.optics.pupils.fourier import FourierDiffracted
    from clsco.optics.pupils.hankel import HankelDiffracted, is_round

    offset = 0.5 * psf.bandwidth / sqrt(3.0)  # the two Gauss-Legendre nodes of the band
    middle = psf.wavelengths[color]
    nodes = (middle - offset, middle + offset) if offset else (middle,)
    units = [diffraction_unit(camera, node) for node in nodes]
    if not units[0] >= LEAST_UNIT or not units[-1] <= MOST_UNIT:
        raise SceneError(f"psf.wavelengths: {UNIT_RULE}; got {units[0]:.3g} px, of {nodes[0]:.4g} nm")
    bands, keeps = tuple((unit, 1.0 / len(units)) for unit in units), psf.rest == "renormalize"
    wavefront = _wavefront(psf, camera)
    diffracted: Diffracted
    if is_round(pupil) and wavefront.is_flat and varying is None:
        diffracted = HankelDiffracted(pupil, bands, psf.tail, keeps)
    else:
        steepest = 0.0 if varying is None else varying.slope(wavefront)
        diffracted = FourierDiffracted(pupil, bands, psf.tail, keeps, wavefront, steepest)
    if diffracted.margin > MOST_MARGIN:
        rule = f"must leave at most {MOST_MARGIN:g} px of light outside of the rim of the blur"
        slope = diffracted.slope if isinstance(diffracted, FourierDiffracted) else 0.0
        bent = f", and aberrations by {2.0 * slope:.3g} px" if slope else ""
        cause = f"of {psf.tail:g} and {nodes[-1]:.4g} nm{bent}"
        raise SceneError(f"psf.tail: {rule}; got {diffracted.margin:.4g} px, {cause}")
    return diffracted


def _trace_rays(pupil: Pupil, psf: Psf, camera: Camera, varying: SeidelField | None) -> Traced:
    """The pupil with aberrations by rays, on the axis."""
    from clsco.optics.pupils.traced import Traced

    wavefront = _wavefront(psf, camera)
    traced = Traced(pupil, wavefront=wavefront, steepest=varying.slope(wavefront) if varying else 0.0)
    if traced.margin > MOST_MARGIN:
        raise SceneError(f"psf: aberrations must bend light by at most {MOST_MARGIN:g} px; got {traced.margin:.4g} px")
    return traced


def _wavefront(psf: Psf, camera: Camera) -> Wavefront:
    """Wavefront errors as optical paths in px; waves of green light are the same lengths for all colors."""
    from clsco.optics.pupils.wavefront import Wavefront

    unit = diffraction_unit(camera, psf.wavelengths[GREEN])
    return Wavefront(tuple((n, m, waves * unit) for n, m, waves in zernike_terms(psf.zernike)), psf.seidel.W040 * unit)


def _field(psf: Psf, camera: Camera) -> SeidelField | None:
    """Seidel's terms over the frame, None if they are constant."""
    if not psf.seidel.varies:
        return None
    from clsco.optics.field import SeidelField

    unit = diffraction_unit(camera, psf.wavelengths[GREEN])
    coma, astigmatism, curvature = (unit * waves for waves in (psf.seidel.W131, psf.seidel.W222, psf.seidel.W220))
    by_rays = psf.model != "wave"  # rays, whose spots have no structure finer than pixels
    waves = psf.seidel.varying_waves * (2.0 * unit if by_rays else 1.0)
    return SeidelField(coma, astigmatism, curvature, waves, camera.frame_size, by_rays)


def diffraction_unit(camera: Camera, wavelength: float) -> float:
    """Unit of diffraction Q = wavelength s0 / (D pitch), px; wavelength in nm."""
    f_number = camera.normalization_distance / camera.aperture_diameter
    return 1e-6 * wavelength * f_number / camera.pixel_pitch


def spread_of_wavelength(spread: PointSpread, camera: Camera, wavelength: float) -> PointSpread:
    """The PSF for light of one wavelength in nm, through the same lens.

    Raises SceneError if the PSF is not by waves, or if diffraction is far finer or far coarser than pixels.
    """
    from clsco.optics.pupils.diffracted import Diffracted
    from clsco.optics.pupils.traced import Traced

    if not isinstance(spread.pupil, Diffracted) or isinstance(spread.pupil, Traced):
        raise SceneError(f'psf: wavelengths need psf.model = "wave"; got {spread.pupil.name}')
    unit = diffraction_unit(camera, wavelength)
    if not LEAST_UNIT <= unit <= MOST_UNIT:
        raise SceneError(f"psf: wavelengths {UNIT_RULE}; got {unit:.3g} px, of {wavelength:.4g} nm")
    return replace(spread, pupil=replace(spread.pupil, bands=((unit, 1.0),)))


def exposure_factor(aperture: Aperture, psf: PointSpread) -> float:
    """Irradiance of a frame relative to an open circular aperture: the ratio of areas if exposure = "area", else 1."""
    return psf.pupil.light if aperture.exposure == "area" else 1.0


def subpixel_offsets(samples: int) -> Array:
    """Positions (samples,) of sub-pixel sources along one axis, in px from the pixel's center."""
    return (np.arange(samples) + 0.5) / samples - 0.5
