"""Diffraction of round openings against Hopkins' transfer function, Airy's closed form and sums."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j0, j1

from benchmarks.truth.wave import difference, transfer
from clsco.errors import SceneError
from clsco.optics.point_spread import PointSpread, diffraction_unit, point_spread, spreads_of_colors
from clsco.optics.psf_tables import psf_table
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.diffracted import Diffracted
from clsco.optics.pupils.hankel import DIRECT, HankelDiffracted, bessel_j0, round_intensity
from clsco.optics.pupils.pupil import Pupil
from clsco.optics.pupils.ring import Ring
from clsco.scene.model import Aperture, Camera, Psf
from tests.optics.grids import grid, square, table_error
from tests.slow import combined, mostly_slow

CAMERA_RULE = 'must be given with psf.model = "wave" or aberrations, for its aperture and pixels'
UNIT_RULE = "must make wavelength s0 / (D pixel_pitch) 0.02 to 8 px"
MARGIN_RULE = "must leave at most 256 px of light outside of the rim of the blur"


def waves(unit: float, opening: Pupil | None = None, tail: float = 0.01, keeps: bool = True) -> Diffracted:
    return HankelDiffracted(opening or Circle(), ((unit, 1.0),), tail, keeps)


def test_bessel_function() -> None:
    x = np.linspace(0.0, 400.0, 40001)
    assert np.abs(bessel_j0(x) - j0(x)).max() < 1e-11


@pytest.mark.parametrize("unit", [0.11, 0.5, 1.0])
def test_in_focus_it_is_the_airy_spot(unit: float) -> None:
    r = np.linspace(1e-9, 30.0 * unit, 901)
    found = round_intensity(r, np.zeros(1), unit, 0.0)[:, 0]
    v = np.pi * r / unit
    peak = np.pi / (4.0 * unit**2)
    assert np.abs(found / peak - (2.0 * j1(v) / v) ** 2).max() < 1e-9


@pytest.mark.parametrize("inner", [0.0, 0.4])
def test_on_axis_it_is_a_squared_sinc(inner: float) -> None:
    radii, unit = np.linspace(-20.0, 20.0, 81), 0.5
    found = round_intensity(np.zeros(1), radii, unit, inner)[0]
    area = 1.0 - inner**2
    expected = area * np.sinc(area * radii / (4.0 * unit)) ** 2
    assert np.abs(found * 4.0 * unit**2 / np.pi - expected).max() < 1e-9


@pytest.mark.parametrize("tent", [True, False])
@pytest.mark.parametrize(
    ("unit", "radius"),
    mostly_slow([(0.11, 0.0), (0.11, 1.0), (0.25, 3.3), (0.5, 0.0), (0.5, 4.5), (1.0, 1.0)], [(1.0, 1.0)]),
)
def test_weights_are_those_of_hopkins_transfer_function(unit: float, radius: float, tent: bool) -> None:
    """By frequencies, where this goes by distances: nothing is shared but the definition."""
    assert difference(unit, radius, tent) < 1e-5


@pytest.mark.parametrize(
    ("unit", "tent", "opening"),
    combined([0.05, 0.5], [True, False], [Circle(), Ring(0.5)], kept=[(0.5, True, Ring(0.5)), (0.05, False, Circle())]),
)
def test_light_is_kept_or_lost_by_the_tail(unit: float, tent: bool, opening: Pupil) -> None:
    for radius in (0.0, 2.3):
        x, y = grid(int(radius + waves(unit, opening).margin) + 2)
        kept = waves(unit, opening).share(x, y, np.asarray(radius), tent)
        lost = waves(unit, opening, keeps=False).share(x, y, np.asarray(radius), tent)
        left_out = waves(unit, opening).left_out(radius)
        assert abs(kept.sum() - 1.0) < 1e-10
        assert abs(lost.sum() - (1.0 - left_out)) < 1e-8
        assert 0.0 < left_out <= 0.0101
        assert (kept >= lost).all()
    assert waves(unit, opening, tail=0.05).margin <= waves(unit, opening).margin


@pytest.mark.parametrize("radius", [0.0, 2.0])
def test_contrast_of_detail_is_that_of_hopkins_transfer_function(radius: float) -> None:
    """Light of the tail that were given to all of the blur alike would add 0.01 of the contrast."""
    unit, f = 0.5, np.array([0.12, 0.2, 0.35])[:, None, None]
    x, y = grid(int(radius + waves(unit).margin) + 2)
    found = (waves(unit).share(x, y, np.asarray(radius), True) * np.cos(2.0 * np.pi * f * x)).sum(axis=(1, 2))
    aliases = np.abs(f[:, 0] + np.arange(-2.0, 2.0))
    passed = transfer(2.0 * unit * np.minimum(aliases, 1.0 / unit).ravel(), radius / (4.0 * unit))
    right = (passed.reshape(aliases.shape) * np.sinc(aliases) ** 2).sum(axis=1)
    assert np.abs(found - right).max() < 0.0015


def test_nothing_is_beyond_the_reach() -> None:
    psf = PointSpread(waves(0.5))
    for radius in (0.0, 0.3, 2.9, 7.5):
        weights = square(psf, radius, psf.reach(radius) + 3)
        assert (weights[:3] == 0.0).all()
        assert (weights[:, -3:] == 0.0).all()


def test_signs_and_octants_are_alike() -> None:
    psf = PointSpread(waves(0.3))
    weights = square(psf, 2.3, 5)
    assert (weights == square(psf, -2.3, 5)).all()
    assert (weights == weights.T).all()
    assert (weights == weights[::-1]).all()
    assert psf.layout == "symmetric"
    assert not psf.is_sharp(0.0)


def test_many_radii_are_interpolated() -> None:
    lens, radii = waves(0.11), np.linspace(0.0, 3.0, DIRECT + 40)
    span = np.arange(4.0)
    for tent in (True, False):
        many = lens.share(span[:, None, None], span[:, None], radii, tent)[..., ::8]
        few = np.stack([lens.share(span[:, None], span, np.asarray(r), tent) for r in radii[::8]], axis=-1)
        assert np.abs(many - few).max() < 1e-7


@pytest.mark.parametrize("unit", mostly_slow([0.02, 0.05, 0.11, 0.5, 2.0], [0.11]))
def test_tables_are_as_good_as_those_of_discs(unit: float) -> None:
    psf = PointSpread(waves(unit, tail=0.1))
    table = psf_table(psf, 0.0, 4.0)
    for radius in (0.0, 0.013, 0.21, 0.77, 1.503, 2.9, 3.99):
        error = table_error(table, psf, radius)
        assert error.sum() < 5e-5
        assert error.max() < 1e-5


def test_a_band_is_the_mean_of_its_wavelengths() -> None:
    x, y = grid(6)
    both = HankelDiffracted(Circle(), ((0.4, 0.5), (0.5, 0.5)), keeps=False)
    each = [waves(unit, keeps=False) for unit in (0.4, 0.5)]
    mean = np.mean([lens.share(x, y, np.asarray(2.0), True) for lens in each], axis=0)
    found = both.share(x, y, np.asarray(2.0), True)
    assert np.abs(found - mean)[3:10, 3:10].max() < 1e-6  # where both have all of their light
    assert both.margin == each[1].margin
    assert both.waves(3.2) == 2.0


def test_it_is_the_disc_where_waves_are_short() -> None:
    disc = square(PointSpread(Circle()), 4.0, 6)
    differences = [np.abs(square(PointSpread(waves(q)), 4.0, 6) - disc).sum() for q in (0.4, 0.1, 0.02)]
    assert differences[0] > 2.0 * differences[1] > 4.0 * differences[2]
    assert differences[2] < 0.02


def test_point_spreads_of_a_camera() -> None:
    camera = Camera(f_number=4.0, focal_length=20.0, pixel_pitch=0.005)
    psf = Psf(model="wave", bandwidth=80.0)
    spread = point_spread(psf, camera=camera)
    assert isinstance(spread.pupil, Diffracted)
    middle = sum(unit * share for unit, share in spread.pupil.bands)
    assert middle == pytest.approx(diffraction_unit(camera, 540.0)) == pytest.approx(0.432)
    apart = spread.pupil.bands[1][0] - spread.pupil.bands[0][0]
    assert apart == pytest.approx(diffraction_unit(camera, 80.0 / 3.0**0.5))
    red, green, blue = spreads_of_colors(spread, psf, camera)
    assert green == spread
    assert red.pupil.margin > green.pupil.margin > blue.pupil.margin
    disc = point_spread(Psf())
    assert spreads_of_colors(disc, Psf(), camera) == (disc, disc, disc)


@pytest.mark.parametrize(
    ("psf", "camera", "message"),
    [
        ({}, None, f"camera: {CAMERA_RULE}; got None"),
        ({}, Camera(pixel_pitch=0.1), f"psf.wavelengths: {UNIT_RULE}; got 0.0108 px, of 540 nm"),
        (
            {"wavelengths": (610.0, 20000.0, 465.0)},
            Camera(f_number=8.0),
            f"psf.wavelengths: {UNIT_RULE}; got 16 px, of 2e+04 nm",
        ),
        ({"tail": 2e-4}, Camera(f_number=8.0), f"psf.tail: {MARGIN_RULE}; got 482 px, of 0.0002 and 540 nm"),
    ],
)
def test_lenses_that_cannot_be(psf: dict[str, object], camera: Camera | None, message: str) -> None:
    with pytest.raises(SceneError) as error:
        point_spread(Psf.model_validate({"model": "wave", **psf}), Aperture(), camera=camera)
    assert error.value.messages == (message,)
