"""Errors of the wavefront behind a lens: tables [psf.seidel] and [psf.zernike] of a scene file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, create_model

from clsco.scene.quantities import Strict, Within

MOST_ORDER = 6  # largest order n of Zernike polynomials
NAMES = {
    "2,-2": "Oblique astigmatism", "2,0": "Defocus", "2,2": "Astigmatism", "3,-3": "Oblique trefoil",
    "3,-1": "Vertical coma", "3,1": "Horizontal coma", "3,3": "Trefoil", "4,0": "Spherical aberration",
}  # fmt: skip
ABOUT = "{}, rms over the whole lens, waves."
POLYNOMIALS = {f"{n},{m}": (n, m) for n in range(2, MOST_ORDER + 1) for m in range(-n, n + 1, 2)}
"""Indices n and m of all Zernike polynomials that a scene may have, by key."""

Waves = Annotated[float, Within(-20.0, 20.0, "waves")]


class Seidel(Strict):
    """Seidel's terms of the wavefront, in waves of green light at the rim of the lens, in the corner of the frame."""

    W040: Waves = 0.0
    """Spherical aberration, with the fourth power of the distance from the middle of the lens, everywhere in the frame,
    waves."""
    W131: Waves = 0.0
    """Coma, with the distance h from the middle of the frame: tails point away from it, waves."""
    W222: Waves = 0.0
    """Astigmatism, with h^2: the focus along and across that direction differ, waves."""
    W220: Waves = 0.0
    """Field curvature, with h^2, waves."""
    W311: Waves = 0.0
    """Distortion, with h^3: the image is farther from the middle; a part of k1 of lens.distortion, waves."""

    @property
    def varying_waves(self) -> float:
        """Size of the terms that vary over the frame, as equivalent waves of coma."""
        return abs(self.W131) + 1.3 * abs(self.W222) + 1.8 * abs(self.W220)

    @property
    def varies(self) -> bool:
        """True if the wavefront varies over the frame."""
        return self.varying_waves > 0.0

    def radial_distortion(self, wavelength: float, diameter: float, corner: float) -> float:
        """Coefficient k1 of the radial distortion that W311 causes.

        wavelength: of green light, nm; diameter: D of the lens, mm; corner: slope of the ray to the corner of the
        frame. A wavefront tilted by W at the edge of the lens changes slopes by 2 W / D, which equals k1 corner^3.
        """
        return 2e-6 * wavelength * self.W311 / (diameter * corner**3)


if TYPE_CHECKING:
    Zernike = Strict
else:
    Zernike = create_model(
        "Zernike",
        __base__=Strict,
        __module__=__name__,
        __doc__="""Zernike polynomials of the wavefront, "n,m" by OSA and ANSI Z80.28, in waves of green light.""",
        **{
            key: (Waves, Field(0.0, description=ABOUT.format(NAMES.get(key, "Zernike polynomial"))))
            for key in POLYNOMIALS
        },
    )


def zernike_terms(table: Strict) -> tuple[tuple[int, int, float], ...]:
    """Indices n and m, and coefficient in waves, of each nonzero polynomial of [psf.zernike]."""
    if not table.model_fields_set:  # fast path, as each frame calls this several times
        return ()
    terms = ((n, m, float(getattr(table, key))) for key, (n, m) in POLYNOMIALS.items())
    return tuple(term for term in terms if term[2])
