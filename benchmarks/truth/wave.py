"""Point spreads by waves against Hopkins' transfer function, and discs beside them: python -m benchmarks.truth.wave

Hopkins (1955) gives the transfer function of a defocused circle as one integral; weights over source and detector
pixel follow by a quadrature over frequencies, in polar coordinates. The package goes by distances instead: a Hankel
transform, then shares of pixels in rings. L1 is of weights up to 2 px beyond the rim, of the light of a point.

The second table has the PSNR of a disc in the place of waves, in an image of black and white squares of 20 px, where
the 0.05 of the light of waves that goes farthest, or 0.01 of it, is spread over the blur: the least over blur radii of
1 px and more is about 29.3 - 20.5 log10(Q) with 0.01, which `clsco plan` prints, and 1 to 4 dB more with 0.05.
"""

from __future__ import annotations

from functools import cache
from math import log10

import numpy as np
from numpy.typing import NDArray

from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.hankel import HankelDiffracted
from clsco.optics.waves import disc_psnr

Array = NDArray[np.float64]
SIDE, SQUARE = 160, 20  # px
RADII = (1.0, 2.0, 4.0)


def nodes(low: float, high: float, count: int) -> tuple[Array, Array]:
    """Places and weights of a Gauss-Legendre quadrature."""
    x, weight = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (high - low) * (x + 1.0), 0.5 * (high - low) * weight


def transfer(s: Array, waves: float) -> Array:
    """Transfer function of a circle at s = 0..2, with so many waves of defocus at its rim."""
    angle, weight = nodes(0.0, 0.5 * np.pi, 64 + int(16 * waves))
    half = np.sqrt(np.maximum(1.0 - 0.25 * s * s, 0.0))[:, None]
    y, a = half * np.sin(angle), 4.0 * np.pi * waves * s[:, None]
    g = np.sqrt(1.0 - y * y) - 0.5 * s[:, None]
    return np.asarray(4.0 / np.pi * (g * np.sinc(a * g / np.pi) * half * np.cos(angle) * weight).sum(axis=1))


@cache
def hopkins(unit: float, radius: float, reach: int, tent: bool = True) -> Array:
    """Weights (dy, dx), 0 to `reach` px each, of blur radius `radius` px where Q is `unit` px."""
    far = 1.5 * (reach + 2) / unit
    f, weight = nodes(0.0, 1.0 / unit, int(200 + 8 * far))
    angle, of_angle = nodes(0.0, 0.5 * np.pi, int(100 + 8 * far))
    value = 4.0 * (transfer(2.0 * f * unit, radius / (4.0 * unit)) * f * weight)[:, None] * of_angle
    fx, fy = f[:, None] * np.cos(angle), f[:, None] * np.sin(angle)
    value *= (np.sinc(fx) * np.sinc(fy)) ** (2 if tent else 1)
    across = [np.cos(2.0 * np.pi * fx * n) for n in range(reach + 1)]
    return np.array([[(value * np.cos(2.0 * np.pi * fy * n) * x).sum() for x in across] for n in range(reach + 1)])


def difference(unit: float, radius: float, tent: bool = True) -> float:
    """L1 of the package's weights less Hopkins', up to 2 px beyond the rim."""
    lens, reach = HankelDiffracted(Circle(), ((unit, 1.0),), 0.002, keeps=False), int(radius) + 2
    span = np.arange(reach + 1.0)
    fold = np.where(span > 0, 2.0, 1.0)
    found = lens.share(span, span[:, None], np.asarray(radius), tent)
    return float((np.abs(found - hopkins(unit, radius, reach, tent)) * fold * fold[:, None]).sum())


def psnr_of_disc(unit: float, radius: float, tail: float) -> float:
    """PSNR of black and white squares blurred by a disc instead of waves with such a tail, dB."""
    waves, disc = PointSpread(HankelDiffracted(Circle(), ((unit, 1.0),), tail)), PointSpread(Circle())
    far = waves.reach(radius)
    span = np.arange(-far, far + 1.0)
    kernel = np.zeros((SIDE, SIDE))
    change = disc.weights(span, span[:, None], np.asarray(radius)) - waves.weights(
        span, span[:, None], np.asarray(radius)
    )
    at = span.astype(np.intp) % SIDE
    np.add.at(kernel, np.ix_(at, at), change)
    squares = (np.indices((SIDE, SIDE)) // SQUARE).sum(axis=0) % 2
    error = np.fft.irfft2(np.fft.rfft2(squares) * np.fft.rfft2(kernel), (SIDE, SIDE))
    return -10.0 * log10(float(np.square(error).mean()))


def main() -> None:
    """Print both tables."""
    print("L1 against Hopkins, in 1e-6 of the light of a point: square source, then a point source")
    for unit in (0.11, 0.5, 1.0):
        found = [1e6 * difference(unit, radius, tent) for tent in (True, False) for radius in (0.0, 1.0, 4.5)]
        print(f"  Q {unit:4.2f}  R 0, 1, 4.5:", "  ".join(f"{value:6.2f}" for value in found))
    print("PSNR of a disc instead of waves, dB, at R 1, 2, 4, with tails of 0.05 and 0.01; and 29.3 - 20.5 log10(Q)")
    for unit in (0.05, 0.11, 0.25, 0.5, 1.0):
        found = [psnr_of_disc(unit, radius, tail) for tail in (0.05, 0.01) for radius in RADII]
        print(f"  Q {unit:4.2f} ", "  ".join(f"{value:5.1f}" for value in found), f" {disc_psnr(unit):5.1f}")


if __name__ == "__main__":
    main()
