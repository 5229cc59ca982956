"""Aberrated point spreads against hcipy and Marechal's formula: python -m benchmarks.truth.aberrations

Strehl ratios are of light in the middle of the spot, of that without aberrations. hcipy, where it is installed, makes
its own pupil, 8 times supersampled, its own Zernike polynomials and a matrix Fourier transform: errors are the largest
difference of light anywhere within 8 Q of the middle, as part of the largest light of either.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.fourier import FEWEST, image_parts, spot_light
from clsco.optics.pupils.wavefront import Wavefront

Array = NDArray[np.float64]
TERMS = {
    "defocus": (2, 0), "astigmatism": (2, 2), "oblique astigmatism": (2, -2), "coma": (3, 1), "vertical coma": (3, -1),
    "trefoil": (3, 3), "spherical": (4, 0),
}  # fmt: skip
UNIT, WIDTH = 0.5, 16  # Q and width of the spot, px
SAMPLES, SUPERSAMPLED = 512, 8  # of hcipy's pupil


def spot(wavefront: Wavefront, radius: float = 0.0, samples: float = FEWEST) -> Array:
    """Light per Q^2 / 64 of a spot, up to 8 px from its middle."""
    return spot_light(Circle(), wavefront, UNIT, radius, samples, image_parts(UNIT, 1.0), WIDTH)


def strehl(name: str, waves: float) -> float:
    """Strehl ratio with so many waves rms of a polynomial."""
    middle = WIDTH * image_parts(UNIT, 1.0) // 2
    found = spot(Wavefront(((*TERMS[name], waves * UNIT),)))[middle, middle]
    return float(found / spot(Wavefront())[middle, middle])


def by_hcipy(term: tuple[int, int] | None, waves: float, defocus: float) -> Array:
    """The same spot by hcipy; defocus: waves at the rim."""
    hcipy: Any = import_module("hcipy")
    pupil_grid = hcipy.make_pupil_grid(SAMPLES, 1.0)
    aperture = hcipy.evaluate_supersampled(hcipy.make_circular_aperture(1.0), pupil_grid, SUPERSAMPLED)
    square = 4.0 * (pupil_grid.x**2 + pupil_grid.y**2)
    phase = 2.0 * np.pi * defocus * square
    if term is not None:
        n, m = term
        phase = phase + 2.0 * np.pi * waves * hcipy.zernike(n, m, 1.0, pupil_grid, radial_cutoff=False)
    parts = image_parts(UNIT, 1.0)
    at = (np.arange(WIDTH * parts) - WIDTH * parts // 2) / parts / UNIT  # in lambda / D
    focal_grid = hcipy.CartesianGrid(hcipy.SeparatedCoords((at, at)))
    front = hcipy.Wavefront(hcipy.Field(aperture * np.exp(1j * phase), pupil_grid))
    power = hcipy.FraunhoferPropagator(pupil_grid, focal_grid)(front).intensity.shaped
    whole = np.pi / 4.0 * (1.0 / parts / UNIT) ** 2  # light of a cell in the middle of the Airy spot, of all light
    flat = hcipy.FraunhoferPropagator(pupil_grid, focal_grid)(hcipy.Wavefront(hcipy.Field(aperture, pupil_grid)))
    peak = float(np.asarray(flat.intensity.shaped).max())
    return np.asarray(power)[::-1] * (whole / peak)  # its y axis points up


def main() -> None:
    """Print Strehl ratios, and hcipy's differences where it is there."""
    print("Strehl ratio at 0.05 waves rms; exp(-(2 pi 0.05)^2) is", round(float(np.exp(-((0.1 * np.pi) ** 2))), 5))
    for name in TERMS:
        print(f"  {name:20} {strehl(name, 0.05):.5f}")
    if find_spec("hcipy") is None:
        print("hcipy is not installed: pip install hcipy")
        return
    print("largest difference from hcipy, in 1e-4 of the peak")
    cases: list[tuple[str, tuple[int, int] | None, float, float]] = [("Airy spot", None, 0.0, 0.0)]
    cases += [("3 waves of defocus", None, 0.0, 3.0)]
    cases += [(f"0.2 waves of {name}", term, 0.2, 0.0) for name, term in TERMS.items()]
    cases += [("0.2 waves of coma, 2 of defocus", (3, 1), 0.2, 2.0)]
    for name, term, waves, defocus in cases:
        wavefront = Wavefront(() if term is None else ((*term, waves * UNIT),))
        exact = by_hcipy(term, waves, defocus)
        found = spot(wavefront, 4.0 * UNIT * defocus)
        inner = slice(1, None)  # the first row would be turned over to one that is not there
        error = np.abs(found[inner, :] - np.roll(exact, 1, axis=0)[inner, :]).max() / exact.max()
        print(f"  {name:34} {1e4 * error:5.2f}")


if __name__ == "__main__":
    main()
