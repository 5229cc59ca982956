"""Limits and descriptions of wave-optics point spread functions."""

from __future__ import annotations

from functools import lru_cache
from math import ceil, log10

from clsco.errors import SceneError
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_tables import table_bytes
from clsco.optics.pupils.diffracted import Diffracted
from clsco.optics.pupils.fourier import FourierDiffracted
from clsco.optics.pupils.traced import Traced

MOST_WAVES = 512.0  # of defocus at the lens's edge: beyond, the transform of each radius would take seconds
ADEQUATE, PER_DECADE = 29.3, 20.5  # dB: PSNR of a disc instead of waves is about ADEQUATE - PER_DECADE log10(Q)


def disc_psnr(unit: float) -> float:
    """PSNR in dB, within 1.5 dB, of black and white squares blurred by a disc instead of by waves; unit: Q in px."""
    return ADEQUATE - PER_DECADE * log10(unit)


def check_waves(psf: PointSpread, largest: float) -> None:
    """Raise SceneError if a blur radius of `largest` px has too many waves of defocus, or if defocus and aberrations
    change the phase too fast for the samples of the pupil.
    """
    pupil = psf.pupil
    if isinstance(pupil, FourierDiffracted):
        pupil.samples(largest)
    if not isinstance(pupil, Diffracted) or isinstance(pupil, Traced) or pupil.waves(largest) <= MOST_WAVES:
        return
    rule = f'"wave" takes at most {MOST_WAVES:g} waves of defocus at the rim'
    hint = f'R {largest:.3g} px; "pillbox" has about {disc_psnr(pupil.widest):.0f} dB against it'
    raise SceneError(f"psf.model: {rule}; got {pupil.waves(largest):.4g} ({hint})")


@lru_cache(maxsize=64)
def light_cut(psf: PointSpread, smallest: float, largest: float) -> float:
    """Largest fraction of light that waves cut off for |blur radii| from smallest to largest px; 0 for other PSFs."""
    pupils = [place.pupil for place in (*psf.places[:1], psf)]  # for a field: in a corner, and on the axis
    fractions = (
        pupil.left_out(r) for pupil in pupils if isinstance(pupil, Diffracted) for r in {smallest, largest, -largest}
    )
    return max(fractions, default=0.0)


def table_seconds(psf: PointSpread, smallest: float, largest: float, silhouettes: int) -> float:
    """CPU seconds to compute tables for |blur radii| from smallest to largest px, which are then cached; 0 for PSFs
    without Fourier transforms or rays.

    silhouettes: n for n x n sub-pixel sources, 0 for none.
    """
    pupils = {p.upright for place in psf.places if isinstance(p := place.pupil, FourierDiffracted)}
    seconds = 0.0
    for pupil in pupils:
        for radius in range(int(smallest), int(largest) + 1):
            signs = 1 if pupil.wavefront.is_flat else sum(radius <= most for most in psf.most)
            seconds += signs * pupil.NODES / pupil.panel * pupil.seconds(radius + 1.0, 1 + silhouettes**2)
    return seconds


def wave_words(psf: PointSpread, smallest: float, largest: float, silhouettes: int) -> tuple[tuple[str, str], ...]:
    """Names and values of wave-optics parameters, for reports; empty for other PSFs. Arguments: see `table_seconds`."""
    pupil = psf.pupil
    if not isinstance(pupil, Diffracted):
        return ()
    cut = light_cut(psf, smallest, largest)
    size = sum(table_bytes(psf, smallest, largest, subpixel) for subpixel in {0, silhouettes})
    rest = "given to the rest" if pupil.keeps else "lost"
    seconds = table_seconds(psf, smallest, largest, silhouettes)
    once = f", made once in about {ceil(seconds)} s" if seconds >= 0.5 else ""
    words = [("tables", f"{size / 2**20:.2g} MiB{once}")]
    if isinstance(pupil, Traced):
        count = pupil.samples(largest)
        words += [("rays", f"bent by up to {pupil.margin:.3g} px, {count:.0f} of them over the diameter")]
    else:
        words += [
            ("waves", f"Q = {pupil.widest:.3g} px, {pupil.waves(largest):.3g} waves of defocus at the largest R"),
            ("tail", f"{100.0 * cut:.2g} % of the light, beyond {pupil.margin:.3g} px from the rim, is {rest}"),
            ("disc", f"would have about {disc_psnr(pupil.widest):.0f} dB against waves"),
        ]
        if isinstance(pupil, FourierDiffracted):
            words += [("pupil", f"{pupil.samples(largest):.0f} samples over the diameter, by Fourier transforms")]
    if psf.varying is not None:
        (across, down), off = psf.varying.cells, psf.varying.blending
        words += [("field", f"{across} x {down} cells, between whose corners weights are blended, {off:.1g} off (L1)")]
    return tuple(words)
