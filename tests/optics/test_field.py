"""Point spreads that vary over the field: directions, mirrored places, and what blending adds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from clsco.errors import SceneError
from clsco.optics.field import SeidelField
from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.psf_tables import PsfTable, psf_table, table_bytes, table_weights
from clsco.optics.pupils.fourier import FourierDiffracted
from clsco.optics.pupils.wavefront import Wavefront
from clsco.reference.spreads import spread_weights
from clsco.scene.model import Aperture, Camera, Psf
from tests.optics.grids import square

CAMERA = Camera(resolution=(65, 49), f_number=2.0, focal_length=20.0, pixel_pitch=0.01)
LONG = {"model": "wave", "wavelengths": [2500.0] * 3, "tail": 0.05}  # Q = 0.5 px


@cache
def lens(
    w131: float = 0.0, w222: float = 0.0, w220: float = 0.0, w040: float = 0.0, by_rays: bool = False
) -> PointSpread:
    model = {"model": "pillbox", "wavelengths": LONG["wavelengths"]} if by_rays else LONG
    seidel = {"W131": w131, "W222": w222, "W220": w220, "W040": w040}
    return point_spread(Psf.model_validate({**model, "seidel": seidel}), Aperture(), camera=CAMERA)


def test_a_lens_that_varies_has_places_on_the_frame() -> None:
    field = lens(0.25).varying
    assert field is not None
    assert field.cells == (4, 4)
    assert len(field.nodes) == 25 == len(lens(0.25).places)
    assert field.nodes[0] == (-0.8, -0.6)
    assert field.nodes[12] == (0.0, 0.0)
    assert field.nodes[14] == (0.8, 0.0)
    assert lens().varying is None
    assert lens(0.1).varying != lens(0.2).varying
    several = [lens(w131=waves).varying for waves in (0.5, 1.0, 3.0)]
    assert [each.cells for each in several if each is not None] == [(8, 6), (14, 10), (26, 20)]
    blending = [each.blending for each in several if each is not None]
    assert blending == pytest.approx([6e-3, 6e-3, 6e-3 * 1.5**2])


def test_the_steepest_wavefront_has_all_terms_at_one_position() -> None:
    axis = Wavefront(((3, 1, -0.3),))  # a coma that Seidel's adds to on one side of the frame only
    field = SeidelField(0.5, 0.0, 0.0, 1.0, (65, 49))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    steepest = max(
        np.hypot(*field.wavefront(axis, *node).gradient(np.cos(angle), np.sin(angle))).max() for node in field.nodes
    )
    assert field.slope(axis) >= 0.999 * steepest


def test_parts_of_places_add_up_between_them_and_end_at_the_border() -> None:
    field = SeidelField(0.1, 0.0, 0.0, 0.1, (65, 49))
    numbers, shares = field.blend([0.0, 8.0, 64.0, -5.0, 70.0], [0.0, 9.0, 48.0, 30.0, 6.0])
    assert numbers[:, 0].tolist() == [0, 1, 5, 6]
    assert shares.sum(axis=0) == pytest.approx(1.0)
    assert shares[:, 1] == pytest.approx([0.125, 0.125, 0.375, 0.375])
    assert numbers[3, 2] == 24
    assert shares[:, 2] == pytest.approx([0.0, 0.0, 0.0, 1.0])
    assert shares[:, 3] == pytest.approx([0.5, 0.0, 0.5, 0.0])
    assert shares[:, 4] == pytest.approx([0.0, 0.5, 0.0, 0.5])
    x, y = field.at([0.0, 32.0, 99.0], [48.0, 24.0, -9.0])
    assert x == pytest.approx([-0.8, 0.0, 0.8])
    assert y == pytest.approx([0.6, 0.0, -0.6])


def test_the_field_curves_as_another_blur_radius() -> None:
    """W220 h^2 waves are 4 Q W220 h^2 px of R."""
    psf = lens(w220=0.5)
    found, flat = square(psf.at(0.8, 0.6), 2.0, 14), square(lens(w040=1e-9), 3.0, 14)
    assert np.abs(found - flat).sum() < 2e-3
    assert np.abs(square(psf.at(0.0, 0.0), 2.0, 14) - flat).sum() > 0.1


@pytest.mark.parametrize("place", [(0.8, 0.0), (-0.8, 0.6), (0.0, -0.6)])
def test_tails_of_coma_point_away_from_the_middle(place: tuple[float, float]) -> None:
    """Light is 2 Q W131 h px farther out on average, as by rays, less what the tail leaves out."""
    span, weights = np.arange(-14, 15.0), square(lens(0.4).at(*place), 0.0, 14)
    center = np.array([(weights * span).sum(), (weights * span[:, None]).sum()]) / weights.sum()
    assert center == pytest.approx(0.894 * 2.0 * 0.5 * 0.4 * np.array(place), abs=0.004)


def test_rays_pass_occluders_at_finite_places_where_the_image_folds() -> None:
    folding = Wavefront(coma=(-4.0, 0.0), change=(-0.5, 0.0, 0.0, 0.0, 0.0))
    at = np.linspace(-1.0, 1.0, 41)
    x, y = np.meshgrid(at, at)
    assert folding.grown(x, y).min() == 0.0
    assert np.isfinite(folding.crossings(x, y)).all()


def test_astigmatism_blurs_along_the_way_from_the_middle() -> None:
    span, weights = np.arange(-14, 15.0), square(lens(w222=0.6).at(0.0, 1.0), 0.0, 14)
    across, along = (weights * span**2).sum(), (weights * span[:, None] ** 2).sum()
    assert along > 1.3 * across
    turned = square(lens(w222=0.6).at(1.0, 0.0), 0.0, 14)
    assert np.abs(turned - weights.T).max() < 1e-9


def test_short_waves_come_near_to_rays() -> None:
    """The same path in px as some waves of Q = 0.5, and as 8 times as many of Q = 1 / 16."""
    waves = np.array([0.4, 0.3, -0.1])
    rays, off = square(lens(*waves, by_rays=True).at(0.8, 0.6), 2.0, 14), []
    for times in (1.0, 8.0):
        seidel = dict(zip(("W131", "W222", "W220"), times * waves, strict=True))
        psf = Psf.model_validate({**LONG, "wavelengths": [2500.0 / times] * 3, "tail": 0.02, "seidel": seidel})
        off.append(np.abs(square(point_spread(psf, Aperture(), camera=CAMERA).at(0.8, 0.6), 2.0, 14) - rays).sum())
    assert off[1] < 0.4 * off[0]
    assert off[1] < 0.1


@pytest.mark.parametrize("tent", [True, False])
@pytest.mark.parametrize("place", [(-0.5, 0.25), (0.5, -0.25), (-0.5, -0.25), (0.0, -0.25)])
def test_mirrored_places_have_weights_of_their_own_wavefronts(place: tuple[float, float], tent: bool) -> None:
    psf = lens(0.3, 0.2, 0.1, 0.1).at(*place)
    pupil = psf.pupil
    assert isinstance(pupil, FourierDiffracted)
    across, down = pupil.wavefront.mirrored
    upright = pupil.wavefront.upright
    span = np.arange(-6, 7.0)
    dx, dy = (0.125, -0.375) if not tent else (0.0, 0.0)
    found = pupil.rows(np.array([1.3, 2.4]), span + dx, span + dy, tent)
    other = lens(0.3, 0.2, 0.1, 0.1).at(abs(place[0]), abs(place[1])).pupil
    assert isinstance(other, FourierDiffracted)
    assert other.wavefront == upright
    signs = [-1.0 if turned else 1.0 for turned in (across, down)]
    x, y = signs[0] * (span + dx), signs[1] * (span + dy)
    expected = other.share(x, y[:, None], np.array([1.3, 2.4])[:, None, None], tent)
    assert np.abs(found - expected).max() < 1e-9


@pytest.mark.parametrize(("waves", "radius", "by_rays"), [((0.6, 0.3, 0.0), 0.0, False), ((1.0, 0.5, 0.1), 2.0, True)])
def test_blending_is_as_far_off_as_the_plan_says(
    waves: tuple[float, float, float], radius: float, by_rays: bool
) -> None:
    psf = lens(*waves, by_rays=by_rays)
    field = psf.varying
    assert field is not None
    (across, down), (columns, rows) = field.cells, field.frame
    place = (columns - 1) * (1.0 - 0.5 / across), (rows - 1) * (1.0 - 0.5 / down)
    hx, hy = field.at(*place)
    exact = square(psf.at(float(hx), float(hy)), radius, 14)
    numbers, shares = field.blend(*place)
    blended = sum(share * square(psf.places[n], radius, 14) for n, share in zip(numbers, shares, strict=True))
    off = float(np.abs(blended - exact).sum())
    assert 0.1 * field.blending < off < 1.2 * field.blending
    table = spread_weights(psf, radius, place)
    middle = slice(14 - table.shape[0] // 2, 15 + table.shape[0] // 2)
    assert np.abs(table - np.asarray(blended)[middle, middle]).sum() < 2e-4


def table_of_last(table: PsfTable) -> PsfTable:
    """The table of the last place of a field."""
    return replace(table, coefficients=table.coefficients[-table.stride :])


@pytest.mark.parametrize("side", [1, -1])
def test_tables_of_radii_of_one_sign_have_no_others(side: int) -> None:
    radius = 0.3 * side
    psf = lens(0.25).between(radius, radius)
    table, both = psf_table(psf, 0.3, 0.3), psf_table(lens(0.25), 0.3, 0.3)
    assert table.coefficients.size * 2 == both.coefficients.size == 25 * both.stride
    assert not (both.coefficients[: both.stride] == both.coefficients[-both.stride :]).all()
    assert table_bytes(lens(0.25), 0.3, 0.3) == both.coefficients.nbytes + both.intervals.nbytes
    assert table_bytes(psf, 0.3, 0.3) == table.coefficients.nbytes + table.intervals.nbytes
    one, other = (table_weights(table_of_last(each), psf.places[-1], radius) for each in (table, both))
    assert (one == other).all()


def test_images_without_a_size_have_no_field() -> None:
    with pytest.raises(SceneError, match=r"camera\.resolution: must be known"):
        point_spread(Psf.model_validate({**LONG, "seidel": {"W131": 0.1}}), Aperture(), camera=Camera())
