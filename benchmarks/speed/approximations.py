"""Approximations of the blur that clsco does not offer, beside one that it does.

    python -m benchmarks.speed.approximations

Layered convolution: an image split by radius into levels, each blurred by one PSF, linear in between. Stacked
pillboxes: a Gaussian as discs of equal energy. Rao transform: the blur as moments of its PSFs up to the second and the
fourth order (Subbarao), here of the scattered radiance: g = sum of (-1)^n / n! d^n (m_n f). Errors are RMS of white
against `gather`, without the borders; times process CPU time of whole passes, ns per pixel. The Rao transform is NumPy,
for its error only.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.cli.bench.cases import PSFS, picture, radius_map
from clsco.cli.bench.passes import Pass
from clsco.opencl.device import choose
from clsco.opencl.session import Session
from clsco.optics.multigrid import coarse_radii
from clsco.optics.psf import reach, weights
from clsco.plan.approximation import METHODS
from clsco.scene.model import Psf

Array = NDArray[Any]
DISCS = (4, 8)
LEVELS = (8, 16)
LARGEST_EXPANDED = 6.0  # px; beyond, the expansion is of no use


def blurred(session: Session, image: Array, radii: Array, psf: Psf, method: str) -> tuple[Array, float]:
    """The frame, and the least ns per pixel of three passes."""
    call = Pass(session, np.ascontiguousarray(image, np.float32), radii, psf, method, "double")
    call([])
    spent = []
    for _ in range(3):
        start = time.process_time()
        frame = call([])
        spent.append(time.process_time() - start)
    return frame.astype(np.float64), 1e9 * min(spent) / image.size


def layered(session: Session, image: Array, radii: Array, psf: Psf, count: int) -> tuple[Array, float]:
    """By `count` levels of radius."""
    levels = np.linspace(0.0, float(radii.max()), count)
    frame, spent = np.clip(1.0 - radii / levels[1], 0.0, 1.0) * image, 0.0
    for level in levels[1:].tolist():
        share = np.clip(1.0 - np.abs(radii - level) / levels[1], 0.0, 1.0)
        part, cost = blurred(session, share * image, np.full(radii.shape, level), psf, "convolve")
        frame, spent = frame + part, spent + cost
    return frame, spent


def disc_ratios(psf: Psf, count: int) -> list[float]:
    """Radii over R of discs with the same energy each that add up to a Gaussian's profile, with its second moments."""
    sigma, r = psf.sigma_ratio, np.linspace(0.0, psf.truncation * psf.sigma_ratio * 1.15, 4001)
    energy = r**3 / (2.0 * sigma**4) * np.exp(-(r**2) / (2.0 * sigma**2))  # of discs of radius r in a Gaussian
    share = np.cumsum(energy) / energy.sum()
    which = np.minimum((share * count).astype(int), count - 1)
    return [float(np.sqrt(np.average(r[which == k] ** 2, weights=energy[which == k]))) for k in range(count)]


def stacked(session: Session, image: Array, radii: Array, psf: Psf, count: int) -> tuple[Array, float]:
    """A Gaussian by `count` discs."""
    parts = [blurred(session, image / count, radii * k, Psf(), "gather") for k in disc_ratios(psf, count)]
    return np.sum([frame for frame, _ in parts], axis=0), sum(cost for _, cost in parts)


def rao(image: Array, radii: Array, psf: Psf, order: int) -> Array:
    """The local expansion of the forward blur to the second or the fourth order, with the tilt of the surface."""
    far = reach(psf, float(radii.max()))
    x, known = np.arange(-far, far + 1.0), np.linspace(0.0, float(radii.max()), 200)
    table = weights(psf, x[None, None, :], x[None, :, None], known[:, None, None])

    def moment(i: int, j: int) -> Array:
        return np.interp(radii, known, np.einsum("kyx,x,y->k", table, x**i, x**j))

    def second(plane: Array, axis: int) -> Array:
        return np.roll(plane, 1, axis) + np.roll(plane, -1, axis) - 2.0 * plane

    def first(plane: Array, axis: int) -> Array:
        return 0.5 * (np.roll(plane, -1, axis) - np.roll(plane, 1, axis))

    slope = [each / np.maximum(radii, 1.0) * psf.tilt for each in np.gradient(radii)]
    m2, m22, m4 = moment(2, 0), moment(2, 2), moment(4, 0)
    found = image + sum(0.5 * second(m2 * image, a) - first(slope[a] * m2 * image, a) for a in (0, 1))
    if order == 2:
        return np.asarray(found)
    for a, b in ((0, 1), (1, 0)):  # m4 - m2: what second differences of the second moment have of the fourth already
        found += second(second((m4 - m2) / 24.0 * image, a), a) - first(
            second(slope[a] * (m4 - m2) / 6.0 * image, a) + second(slope[a] * m22 / 2.0 * image, b), a
        )
    return np.asarray(found + second(second(0.25 * m22 * image, 0), 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--radius", type=float, nargs="+", default=[0.5, 1.0, 2.0, 6.0, 20.0])
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--psf", choices=PSFS, nargs="+", default=["integrated, tilt", "gaussian"])
    parser.add_argument("--offered", action="store_true", help="only what clsco offers")
    parser.add_argument("--device", default=None)
    asked = parser.parse_args()
    image = picture(asked.size)[..., 0].astype(np.float64)
    with Session(choose(asked.device)) as session:
        for name in asked.psf:
            psf = PSFS[name]
            for radius in asked.radius:
                radii = radius_map(asked.size, radius)
                exact, cost = blurred(session, image, radii, psf, "gather")
                inside = slice(int(radius) + 6, -int(radius) - 6)
                print(f"{name}, R to {radius:g} px: gather {cost:.1f} ns")
                rows: list[tuple[str, Array, float]] = []
                if not asked.offered:
                    rows += [(f"layered convolution, {n}", *layered(session, image, radii, psf, n)) for n in LEVELS]
                if psf.model == "gaussian" and not asked.offered:
                    rows += [(f"stacked pillboxes, {n}", *stacked(session, image, radii, psf, n)) for n in DISCS]
                if radius <= LARGEST_EXPANDED and not asked.offered:
                    rows += [(f"Rao transform, order {n}", rao(image, radii, psf, n), np.nan) for n in (2, 4)]
                rows += [
                    (method, *blurred(session, image, radii, psf, method))
                    for method, least in METHODS.items()
                    if coarse_radii(psf, radius, least)
                ]
                for label, frame, spent in rows:
                    error = float(np.sqrt(np.mean((frame - exact)[inside, inside] ** 2)))
                    time_of = "" if np.isnan(spent) else f"{spent:.1f} ns, "
                    print(f"  {label}: {time_of}RMS error {error:.1e}", flush=True)


if __name__ == "__main__":
    main()
