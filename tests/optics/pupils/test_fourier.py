"""Diffraction by any opening and with aberrations: against Hopkins, Hankel transforms, closed forms and rays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import j0

from benchmarks.truth.aberrations import strehl
from benchmarks.truth.wave import hopkins
from clsco.errors import SceneError
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_tables import psf_table
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.fourier import FourierDiffracted, image_parts, pupil_samples, spot_light
from clsco.optics.pupils.hankel import HankelDiffracted, round_intensity
from clsco.optics.pupils.image import image_pupil
from clsco.optics.pupils.outline import Ellipse
from clsco.optics.pupils.polygon import Polygon
from clsco.optics.pupils.pupil import Pupil
from clsco.optics.pupils.ring import Ring
from clsco.optics.pupils.wavefront import Wavefront
from clsco.optics.waves import table_seconds
from tests.optics.grids import Array, grid, square, table_error
from tests.slow import mostly_slow

FLAT = Wavefront()
COMA = Wavefront(((3, 1, 0.1),))


def waves(
    unit: float, opening: Pupil | None = None, wavefront: Wavefront = FLAT, tail: float = 0.01, keeps: bool = True
) -> FourierDiffracted:
    return FourierDiffracted(opening or Circle(), ((unit, 1.0),), tail, keeps, wavefront)


def lit(lens: Pupil, radius: float, tent: bool = True, offset: float = 0.0, far: int = 0) -> Array:
    """Weights of all pixels that a lens lights, and of `far` more on each side."""
    x, y = grid(PointSpread(lens).reach(abs(radius), not tent) + far)
    return lens.share(x - offset, y - offset, np.asarray(radius), tent)


@pytest.mark.parametrize("tent", [True, False])
@pytest.mark.parametrize(
    ("unit", "radius", "most"),
    mostly_slow([(0.11, 0.0, 1e-4), (0.11, -3.3, 3e-4), (0.5, 4.5, 1e-4), (1.0, 1.0, 3e-5)], [(0.5, 4.5, 1e-4)]),
)
def test_of_a_circle_it_is_hopkins_transfer_function(unit: float, radius: float, most: float, tent: bool) -> None:
    reach = int(abs(radius)) + 2
    span = np.arange(reach + 1.0)
    fold = np.where(span > 0, 2.0, 1.0)
    found = waves(unit, tail=0.002, keeps=False).share(span, span[:, None], np.asarray(radius), tent)
    exact = hopkins(unit, abs(radius), reach, tent)
    assert (np.abs(found - exact) * fold * fold[:, None]).sum() < most


def test_the_error_falls_as_the_square_of_the_samples() -> None:
    exact, found = round_intensity(np.arange(24) / 4.0, np.array([2.0]), 0.5, 0.0)[:, 0], []
    for samples in (128.0, 256.0, 512.0):
        row = 16.0 * spot_light(Circle(), FLAT, 0.5, 2.0, samples, 4, 16)[32, 32:56]
        found.append(float(np.abs(row - exact).mean()))
    assert found[0] > 2.5 * found[1] > 6.0 * found[2]


@pytest.mark.parametrize("opening", [Circle(), Ring(0.4)])
def test_spherical_aberration_is_that_of_hankel_transforms(opening: Pupil) -> None:
    unit, spherical, radius = 0.5, 0.75, 1.3
    inner = opening.obstruction if isinstance(opening, Ring) else 0.0
    light = spot_light(opening, Wavefront(spherical=spherical * unit), unit, radius, 1024, 4, 24)
    row = light[48] * 16.0  # per px^2
    r = (np.arange(12 * 4)) / 4.0
    nodes, parts = np.polynomial.legendre.leggauss(200)
    t = 0.5 * (1.0 + inner**2 + (1.0 - inner**2) * nodes)
    waves = np.exp(2j * np.pi * t * (0.25 * radius / unit + spherical * t)) * parts
    exact = np.abs(j0(np.pi / unit * r[:, None] * np.sqrt(t)) @ waves) ** 2 * np.pi / unit**2 * (1.0 - inner**2) / 16.0
    assert np.abs(row[48:] - exact).max() < 2e-4 * exact.max()


@pytest.mark.parametrize("tent", mostly_slow([True, False], [True]))
@pytest.mark.parametrize(
    "lens",
    [
        waves(0.3, Polygon(5), tail=0.03),
        pytest.param(waves(0.3, Circle(), COMA, tail=0.03), marks=pytest.mark.slow),
        pytest.param(waves(0.8, Ellipse(0.5)), marks=pytest.mark.slow),
        pytest.param(waves(0.5, Ellipse(2.0), COMA), marks=pytest.mark.slow),
    ],
    ids=lambda lens: lens.name,
)
def test_light_is_kept_or_lost_by_the_tail(lens: FourierDiffracted, tent: bool) -> None:
    loses = FourierDiffracted(lens.opening, lens.bands, lens.tail, False, lens.wavefront)
    for radius in (-2.7, 0.7):
        kept, lost = lit(lens, radius, tent, far=2), lit(loses, radius, tent, far=2)
        left_out = lens.left_out(radius)
        assert abs(kept.sum() - 1.0) < 5e-6
        assert abs(lost.sum() - (1.0 - left_out)) < 5e-5  # their pupils have other samples
        assert 0.0 < left_out < 1.01 * lens.tail
        assert (kept > lost - 1e-6).all()
        edge = np.concatenate([kept[:2].ravel(), kept[-2:].ravel(), kept[:, :2].ravel(), kept[:, -2:].ravel()])
        assert edge.max() < 1e-7


@pytest.mark.parametrize("opening", [Polygon(5, 20.0), image_pupil(np.eye(7) + np.tri(7))])
@pytest.mark.parametrize("tent", [True, False])
def test_without_aberrations_it_turns_over_in_focus(opening: Pupil, tent: bool) -> None:
    lens = waves(0.4, opening)
    far = lit(lens, 2.6, tent)
    assert np.abs(lit(lens, -2.6, tent) - far[::-1, ::-1]).max() < 1e-14
    assert np.abs(far - far[::-1, ::-1]).sum() > 0.05


def test_it_is_the_opening_where_waves_are_short() -> None:
    """Also which way up it is, for either sign."""
    for opening, radius in ((Polygon(5, 10.0), 4.0), (image_pupil(np.eye(7) + np.tri(7)), -4.0)):
        found = lit(waves(0.1, opening, tail=0.06), radius)
        rays = square(PointSpread(opening), radius, len(found) // 2)
        assert np.abs(found - rays).sum() < 0.12
        assert np.abs(found - rays[::-1, ::-1]).sum() > 0.15


@pytest.mark.parametrize(
    ("opening", "round_one"), [(Ring(0.5), Ring(0.5)), pytest.param(Ellipse(1.0), Circle(), marks=pytest.mark.slow)]
)
def test_a_flat_wavefront_is_that_of_distances(opening: Pupil, round_one: Pupil) -> None:
    exact = HankelDiffracted(round_one, ((0.5, 1.0),))
    found = waves(0.5, opening)
    assert found.margin == pytest.approx(exact.margin, rel=0.01)
    for radius in (0.0, 2.2):
        x, y = grid(PointSpread(found).reach(radius))
        assert np.abs(lit(found, radius) - exact.share(x, y, np.asarray(radius), True)).sum() < 6e-4


def moment(weights: Array, power: Callable[[Array, Array], Array]) -> float:
    x, y = grid(len(weights) // 2)
    return float((weights * power(x, -y)).sum())


def test_tails_of_coma_point_along_its_angle() -> None:
    """W = c (3 r^3 - 2 r) cos: rays go 2 Q grad W, so that the mean is c 4 Q sqrt(2) to the right, beyond the peak."""
    unit, rms = 0.4, 0.25
    for m, axis in ((1, 0), (-1, 1)):
        weights = lit(waves(unit, None, Wavefront(((3, m, rms * unit),)), tail=0.005), 0.0)
        mean = [moment(weights, lambda x, y: x + 0.0 * y), moment(weights, lambda x, y: y + 0.0 * x)]
        assert mean[axis] == pytest.approx(4.0 * 2.0**0.5 * rms * unit, rel=0.1)
        assert abs(mean[1 - axis]) < 1e-6
        row, column = np.unravel_index(weights.argmax(), weights.shape)
        peak = (column - len(weights) // 2, len(weights) // 2 - row)
        assert peak[axis] <= 0


def test_astigmatism_lies_along_one_axis_before_the_focus_and_along_the_other_behind_it() -> None:
    lens = waves(0.5, None, Wavefront(((2, 2, 0.5 * 0.5),)))
    spreads = [moment(lit(lens, radius), lambda x, y: x * x - y * y) for radius in (-2.0, 2.0)]
    # W = c sqrt(6) (x^2 - y^2): R + 4 sqrt(6) c Q to the right, R - that down
    assert spreads[1] == pytest.approx(-spreads[0], rel=0.01)
    assert spreads[1] > 0.0


def test_defocus_of_a_polynomial_shifts_the_focus() -> None:
    """W = c sqrt(3) (2 r^2 - 1) is a blur radius of 8 sqrt(3) c Q."""
    unit, rms = 0.5, 0.2
    moved, still = waves(unit, None, Wavefront(((2, 0, rms * unit),))), waves(unit)
    shift = 8.0 * 3.0**0.5 * rms * unit
    x, y = grid(PointSpread(still).reach(3.0))
    at = moved.share(x, y, np.asarray(1.0 - shift), True)
    exact = still.share(x, y, np.asarray(1.0), True)
    inner = slice(len(exact) // 2 - 3, len(exact) // 2 + 4)
    assert np.abs(at / at[inner, inner].sum() - exact / exact[inner, inner].sum())[inner, inner].sum() < 1e-3


@pytest.mark.parametrize(
    ("unit", "wavefront"),
    mostly_slow(
        [(0.05, FLAT), (0.11, FLAT), (0.5, Wavefront(((3, 1, 0.02),), 0.02)), (1.6, FLAT)],
        [(0.11, FLAT), (0.5, Wavefront(((3, 1, 0.02),), 0.02))],
    ),
)
def test_tables_are_as_good_as_those_of_discs(unit: float, wavefront: Wavefront) -> None:
    psf = PointSpread(waves(unit, Polygon(5), wavefront, tail=0.1))
    table = psf_table(psf, 0.0, 0.9)
    for radius in (0.0, 0.21, 0.77, -0.77, -0.89):
        error = table_error(table, psf, radius)
        assert error.sum() < 5e-5
        assert error.max() < 1e-5


def test_a_source_beside_the_middle_of_its_pixel_moves_the_light() -> None:
    lens, offset = waves(1.1, Polygon(5), tail=0.05), 0.375  # all frequencies are less than 1 per px
    weights = lit(lens, 1.4, tent=False, offset=offset)
    centered = lit(lens, 1.4, tent=False)
    for power in (lambda x, y: x + 0.0 * y, lambda x, y: -y + 0.0 * x):
        assert moment(weights, power) - moment(centered, power) == pytest.approx(offset, abs=1e-4)


def test_a_band_is_the_mean_of_its_wavelengths() -> None:
    both = FourierDiffracted(Polygon(6), ((0.4, 0.5), (0.5, 0.5)), 0.01, False)
    each = [FourierDiffracted(Polygon(6), ((unit, 1.0),), 0.01, False) for unit in (0.4, 0.5)]
    x, y = grid(3)
    mean = np.mean([lens.share(x, y, np.asarray(2.0), True) for lens in each], axis=0)
    assert np.abs(both.share(x, y, np.asarray(2.0), True) - mean).max() < 1e-5


@pytest.mark.parametrize(
    ("opening", "rim"),
    [(Circle(), 1.0), (Ring(0.5), 2.0), (Polygon(4), 2.0**0.5), (Polygon(4, 45.0), 2.0**0.5), (Polygon(5), 1.2361)],
)
def test_length_of_the_rim(opening: Pupil, rim: float) -> None:
    assert waves(1.0, opening).rim == pytest.approx(rim, rel=0.03)


@pytest.mark.parametrize("name", ["defocus", "astigmatism", "coma", "spherical", "trefoil"])
def test_strehl_ratio_is_marechals(name: str) -> None:
    assert strehl(name, 0.05) == pytest.approx(np.exp(-((2.0 * np.pi * 0.05) ** 2)), abs=2e-3)


def test_the_guard_refuses_a_pupil_that_is_sampled_too_coarsely() -> None:
    assert pupil_samples(1.0) == 512.0
    assert pupil_samples(40.0) == 1280.0
    assert pupil_samples(256.0) == 2048.0
    with pytest.raises(SceneError) as error:
        pupil_samples(300.0)
    rule = "must turn the phase by at most 1/4 wave from one of 2048 samples of the pupil to the next"
    assert error.value.messages == (f"psf: defocus and aberrations {rule}; got 0.293 waves",)


def test_the_image_is_sampled_for_all_its_frequencies() -> None:
    assert image_parts(0.11, 1.0) == 20
    assert image_parts(2.0, 1.0) == 4
    assert image_parts(0.5, 2.0) == 8


def test_seconds_of_tables_grow_with_what_is_made() -> None:
    """By the radii, the places of sources in their pixels, and twice where -R is not +R mirrored; of distances none."""

    def seconds(pupil: Pupil, largest: float, silhouettes: int = 0) -> float:
        return table_seconds(PointSpread(pupil), 0.0, largest, silhouettes)

    bent = waves(0.5, wavefront=COMA)
    assert 0.1 < seconds(bent, 1.5) < seconds(bent, 1.5, 2) < seconds(bent, 2.5, 2) < 10.0
    assert seconds(waves(0.5), 1.5) < 0.6 * seconds(bent, 1.5)
    assert seconds(HankelDiffracted(Circle(), ((0.5, 1.0),)), 1.5) == 0.0
    upright, mirrored = (waves(0.5, wavefront=Wavefront(coma=(0.1, sign * 0.2))) for sign in (1.0, -1.0))
    assert upright.upright == mirrored.upright
