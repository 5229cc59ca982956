"""Errors of the wavefront behind a lens: tables [psf.seidel] and [psf.zernike] of a scene file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, create_model, model_validator

from clsco.scene.quantities import Strict, Within, at_keys, fault

MOST_ORDER = 6  # n of Zernike polynomials
NAMES = {
    "2,-2": "Oblique astigmatism", "2,0": "Defocus", "2,2": "Astigmatism", "3,-3": "Oblique trefoil",
    "3,-1": "Vertical coma", "3,1": "Horizontal coma", "3,3": "Trefoil", "4,0": "Spherical aberration",
}  # fmt: skip
OF_THE_FIELD = ("W131", "W222", "W220", "W311")  # Seidel's terms that are 0 on the axis

Waves = Annotated[float, Within(-20.0, 20.0, "waves")]


class Seidel(Strict):
    """Seidel's terms of the wavefront that do not vary over the field, in waves of green light."""

    W040: Waves = 0.0
    """Spherical aberration, with the fourth power of the distance from the middle of the lens, at its rim, waves."""

    @model_validator(mode="before")
    @classmethod
    def _on_the_axis(cls, value: Any) -> Any:
        varying = [name for name in OF_THE_FIELD if isinstance(value, Mapping) and name in value]
        rule = "varies over the field; use W040 or psf.zernike, which do not"
        if varying:
            raise at_keys([((name,), fault(rule), value[name]) for name in varying])
        return value


def _polynomials() -> Iterator[tuple[int, int]]:
    """n and m of all Zernike polynomials that a scene may have."""
    for n in range(2, MOST_ORDER + 1):
        yield from ((n, m) for m in range(-n, n + 1, 2))


def _described(name: str) -> Any:
    """Type and default of the key of a polynomial."""
    about = f"{NAMES.get(name, 'Zernike polynomial')}, rms over the whole lens, waves."
    return Waves, Field(default=0.0, description=about)


if TYPE_CHECKING:
    Zernike = Strict
else:
    Zernike = create_model(
        "Zernike",
        __base__=Strict,
        __module__=__name__,
        __doc__="""Zernike polynomials of the wavefront, "n,m" by OSA and ANSI Z80.28, in waves of green light.""",
        **{f"{n},{m}": _described(f"{n},{m}") for n, m in _polynomials()},
    )


def zernike_terms(table: Strict) -> tuple[tuple[int, int, float], ...]:
    """n, m and waves of each polynomial of [psf.zernike] that is not 0."""
    found = ((n, m, float(getattr(table, f"{n},{m}"))) for n, m in _polynomials())
    return tuple(term for term in found if term[2])
