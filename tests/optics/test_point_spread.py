"""PSF weights against quadrature and the thesis' own recipe, and the tables that a device reads."""

from __future__ import annotations

import time
from itertools import pairwise
from math import exp, pi, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from clsco.constants import POWERS, TAP_LANES
from clsco.optics.point_spread import PointSpread, point_spread, subpixel_offsets
from clsco.optics.psf_grid import table_coordinate, table_radius
from clsco.optics.psf_tables import PsfTable, psf_table, table_bytes, table_weights
from clsco.optics.pupils.circle import disc_coverage
from clsco.optics.pupils.gaussian import Gaussian
from clsco.optics.stencil import SUMMED, is_summed, stencils
from clsco.scene.model import Psf
from tests.optics.grids import Array, grid, square
from tests.slow import mostly_slow
from tests.spreads import table_coordinate as float32_coordinate

PSFS = [point_spread(Psf(model=m, edge=e)) for m in ("pillbox", "gaussian") for e in ("sampled", "area", "integrated")]
SMOOTH = [psf for psf in PSFS if psf.edge != "sampled"]
SAMPLED = [psf for psf in PSFS if psf.edge == "sampled"]
# Radii of every kind: none, tiny, each side of the thresholds, whole numbers, and any.
RADII = [0.0, 1e-12, 1e-9, 2e-9, 1e-6, 0.125, np.nextafter(0.5, 0.0), 0.5, 1.0, 2.0, 5.0, 13.0, 25.0, 60.0]
RADII += np.random.default_rng(1).uniform(0.0, 6.0, 20).tolist()
RADII += np.random.default_rng(2).uniform(6.0, 60.0, 4).tolist()


def name_of(psf: PointSpread) -> str:
    return f"{psf.pupil.name}-{psf.edge}"


def octant(half_width: int) -> tuple[Array, Array, Array]:
    """Offsets 0 <= a <= b of an octant and how many offsets share the weight of each."""
    a, b = np.triu_indices(half_width + 1)
    count = np.where(a == b, np.where(a == 0, 1, 4), np.where(a == 0, 4, 8))
    return a.astype(float), b.astype(float), count.astype(float)


# The closed forms


def response(offset: float, low: float, high: float, tent: bool) -> float:
    """Integral from low to high of the response of a pixel at `offset`, by the definition of that response."""
    if not tent:
        return max(0.0, min(high, offset + 0.5) - max(low, offset - 0.5))

    def rise(position: float) -> float:  # integral up to there of 1 - |u|, 0 beyond 1
        u = min(max(position - offset, -1.0), 1.0)
        return 0.5 * (1.0 + u) ** 2 if u < 0.0 else 1.0 - 0.5 * (1.0 - u) ** 2

    return rise(high) - rise(low)


def disc_by_quadrature(dx: float, dy: float, radius: float, tent: bool) -> float:
    """disc_coverage over the chords x = R sin(phi), on which the integrand has kinks but no vertical tangent."""
    knots = (-1.0, 0.0, 1.0) if tent else (-0.5, 0.5)

    def chord(phi: float) -> float:
        x, h = radius * np.sin(phi), radius * np.cos(phi)
        across = max(0.0, 1.0 - abs(x - dx)) if tent else float(abs(x - dx) < 0.5)
        return float(across * response(dy, -h, h, tent) * h)

    kinks = {float(np.arcsin((dx + k) / radius)) for k in knots if abs(dx + k) < radius}
    kinks |= {s * float(np.arccos((dy + k) / radius)) for k in knots for s in (-1, 1) if 0 < dy + k < radius}
    kinks |= {s * float(np.arccos((-dy - k) / radius)) for k in knots for s in (-1, 1) if 0 < -dy - k < radius}
    ends = [-pi / 2, *sorted(kinks), pi / 2]
    return sum(quad(chord, a, b, epsabs=1e-14, epsrel=1e-13)[0] for a, b in pairwise(ends))


@pytest.mark.parametrize("tent", [False, True])
def test_disc_coverage_is_the_integral(tent: bool) -> None:
    rng = np.random.default_rng(11)
    worst, crossed = 0.0, 0
    for _ in range(120):
        radius = float(np.exp(rng.uniform(np.log(0.05), np.log(30.0))))
        angle, length = rng.uniform(0, 2 * pi), max(0.0, radius + rng.uniform(-1.5, 1.5))
        dx, dy = length * np.cos(angle), length * np.sin(angle)
        if rng.random() < 0.5:
            dx, dy = float(np.rint(dx)), float(np.rint(dy))
        found = float(disc_coverage(np.asarray(dx), np.asarray(dy), np.asarray(radius), tent))
        crossed += 0.01 < found < 0.99
        # Quadrature gives 1e-13. The antiderivatives of the closed form reach R^4 / 4 with the tent, R^2 without, and
        # some 50 of them, each rounded by 1e-16, are subtracted: less than 1e-15 R^2 of the light of the source.
        largest = 0.25 * radius**4 if tent else radius**2
        worst = max(worst, abs(found - disc_by_quadrature(dx, dy, radius, tent)) / (1e-13 + 50e-16 * largest))
    assert crossed > 30
    assert worst < 1.0


def gaussian_by_quadrature(at: float, sigma: float, cut: float, tent: bool) -> float:
    """Weight along an axis of a pixel at `at` px, for a Gaussian that ends at `cut` px."""

    def density(u: float) -> float:
        return exp(-0.5 * (u / sigma) ** 2) / sqrt(2 * pi) / sigma

    def seen(u: float) -> float:
        return density(u) * (1.0 - abs(u - at) if tent else 1.0)

    half = 1.0 if tent else 0.5
    low, high = max(at - half, -cut), min(at + half, cut)
    ends = [low, at, high] if low < at < high else [low, high] if low < high else []
    parts = [quad(seen, a, b, epsabs=1e-15)[0] for a, b in pairwise(ends)]
    return sum(parts) / quad(density, -cut, cut, epsabs=1e-15)[0]


@pytest.mark.parametrize("psf", [psf for psf in SMOOTH if isinstance(psf.pupil, Gaussian)], ids=name_of)
def test_gaussian_is_the_integral(psf: PointSpread) -> None:
    assert isinstance(psf.pupil, Gaussian)
    rng, tent, checked = np.random.default_rng(12), psf.edge == "integrated", 0
    for _ in range(30):
        radius = float(np.exp(rng.uniform(np.log(0.1), np.log(20.0))))
        sigma, far = psf.pupil.sigma * radius, psf.extent * radius + (1.0 if tent else 0.5)
        offset = np.rint(rng.uniform(-far, far, 2))
        x, y = (gaussian_by_quadrature(float(at), sigma, psf.pupil.cut * sigma, tent) for at in offset)
        found = float(psf.weights(offset[0], offset[1], np.asarray(radius)))
        checked += x * y > 1e-6
        assert abs(found - x * y) < 1e-13, (radius, offset)  # quadrature and erf each give 1e-14
    assert checked > 10


@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_energy_is_one(psf: PointSpread) -> None:
    for radius in RADII:
        a, b, count = octant(psf.reach(radius))
        share = psf.weights(a, b, np.asarray(radius))
        assert (share >= 0.0).all()
        assert abs((share * count).sum() - 1.0) < 1e-12, radius  # what `weights` promises


@pytest.mark.parametrize("samples", [2, 5])
@pytest.mark.parametrize("model", ["pillbox", "gaussian"])
def test_energy_of_a_subpixel_source_is_one(model: str, samples: int) -> None:
    psf = point_spread(Psf.model_validate({"model": model}))
    x, y = subpixel_offsets(samples)[[0, -1]]
    for radius in (radius for radius in RADII if radius < 20.0):
        dx, dy = grid(psf.reach(radius, True) + 1)
        share = psf.subpixel_weights(dx - x, dy - y, np.asarray(radius))
        assert not share[[0, -1]].any()  # `reach` holds it all
        assert not share[:, [0, -1]].any()
        # A disc of 1e-9 px lies so near to nothing that (R - x)(R + x) keeps 7 digits; light is 1e-12 beyond.
        assert abs(share.sum() - 1.0) < (1e-12 if radius > 1e-3 else 1e-6), radius


@pytest.mark.parametrize("psf", SMOOTH, ids=name_of)
def test_weights_are_continuous_in_the_radius(psf: PointSpread) -> None:
    for low, high, steps in ((0.0, 1.5, 3000), (1.5, 6.0, 2000), (17.0, 17.1, 40)):
        radius = np.linspace(low, high, steps)
        a, b, count = octant(psf.reach(high))
        share = psf.weights(a, b, radius[:, None])
        change = (np.abs(np.diff(share, axis=0)) * count).sum(axis=1) / (radius[1] - radius[0])
        assert change.max() > 0.04
        assert change.max() <= 4.0  # the figure to reach: L1 per px of radius
    jumps = [square(SAMPLED[0], r, 1) for r in (0.999999, 1.0)]
    assert np.abs(jumps[1] - jumps[0]).sum() > 1.5  # which the sampled form does not: five pixels instead of one


@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_no_radius_is_no_blur(psf: PointSpread) -> None:
    delta = np.zeros((5, 5))
    delta[2, 2] = 1.0
    assert (square(psf, 0.0, 2) == delta).all()
    assert np.abs(square(psf, 1e-8, 2) - delta).max() < 2e-8  # at most 2 per px of radius in one weight
    if psf.edge == "area" and psf.uniform:
        np.testing.assert_allclose(square(psf, 0.5, 2), delta, rtol=0, atol=1e-15)
    if psf.edge == "sampled":
        assert (square(psf, np.nextafter(0.5, 0.0), 2) == delta).all()


@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_weights_have_the_symmetry_of_the_lattice_and_of_the_sign(psf: PointSpread) -> None:
    for radius in (0.7, 2.3, 5.0):
        share = square(psf, radius, psf.reach(radius))
        assert (share == square(psf, -radius, psf.reach(radius))).all()
        assert (share == share[::-1]).all()
        assert (share == share[:, ::-1]).all()
        np.testing.assert_allclose(share, share.T, rtol=0, atol=1e-15)  # chords along x or along y: other roundings


def thesis(name: str, dx: int, dy: int, radius: float, k: float) -> float:
    """A PSF coefficient by 2.26 to 2.29 and the rules of section 2.4.2: pixel centers, circle or 2 sigma, 0.5 px."""
    if radius < 0.5:
        return float(dx == dy == 0)
    sigma = k * radius
    extent = radius if name == "circle" else 2.0 * sigma

    def h(x: int, y: int) -> float:
        if x * x + y * y > extent * extent:
            return 0.0
        if name == "circle":
            return 1.0 / (pi * radius * radius)
        return exp(-(x * x + y * y) / (2.0 * sigma * sigma)) / (2.0 * pi * sigma * sigma)

    limit = int(extent) + 1
    total = sum(h(x, y) for x in range(-limit, limit + 1) for y in range(-limit, limit + 1))
    return h(dx, dy) / total


@pytest.mark.parametrize("k", [sqrt(0.5), 0.65])
@pytest.mark.parametrize("psf", SAMPLED, ids=name_of)
def test_sampled_is_what_the_thesis_says(psf: PointSpread, k: float) -> None:
    if isinstance(psf.pupil, Gaussian):
        psf = point_spread(Psf(model="gaussian", edge="sampled", sigma_ratio=k))
        assert isinstance(psf.pupil, Gaussian)
        assert psf.pupil.cut == 2.0
    for radius in (0.0, 0.3, 0.5, 0.93, 1.0, 1.42, 2.0, 3.3, 5.999, 6.1):
        half = psf.reach(radius) + 1
        span = range(-half, half + 1)
        expected = [[thesis(psf.pupil.name, x, y, radius, k) for x in span] for y in span]
        np.testing.assert_allclose(square(psf, radius, half), expected, rtol=1e-12)  # a sum of some 200 terms


@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_reach_is_exact(psf: PointSpread) -> None:
    extent = psf.extent
    around = [(n + f) / extent for n in range(1, 14) for f in (-0.5, -0.499, -1e-9, 0.0, 1e-9, 0.499)]
    for radius in [*(radius for radius in RADII if radius < 14.0), *around]:
        held = psf.reach(radius)
        lit = np.argwhere(square(psf, radius, held + 2) > 0.0) - (held + 2)
        assert np.abs(lit).max() <= held <= np.abs(lit).max() + 1, radius


# The tables


def read(table: PsfTable, coordinate: float, row: int) -> Array:
    """Weights (2 half-width + 1,) of a row as a kernel reads them."""
    start, half_width = (int(v) for v in table.intervals[int(coordinate) - table.first, :2])
    lanes = (2 * half_width // TAP_LANES + 1) * TAP_LANES
    t, at = coordinate - int(coordinate), start + row * POWERS * lanes
    found = table.coefficients[at : at + POWERS * lanes].reshape(POWERS, lanes).astype(np.float64)
    assert not found[:, 2 * half_width + 1 :].any()  # what a whole vector adds beyond the PSF is nothing
    return np.asarray((found * (t ** np.arange(POWERS))[:, None]).sum(axis=0)[: 2 * half_width + 1])


def subpixel_table(table: PsfTable, coordinate: float, samples: int, i: int, j: int) -> Array:
    """All weights of sub-pixel source (i, j): offsets above the center read the rows of their mirror image."""
    half_width = int(table.intervals[int(coordinate) - table.first, 1])
    stored = max(i, samples - 1 - i) - samples // 2
    middle = (stored * samples + j) * (2 * half_width + 1) + half_width
    sign = -1 if i < samples - 1 - i else 1
    return np.stack([read(table, coordinate, middle + sign * dy) for dy in range(-half_width, half_width + 1)])


def coordinate_of(table: PsfTable, psf: PointSpread, radius: float) -> float:
    """The coordinate of sub-pixel sources that a device gives a radius: rounded to float32, within the table."""
    found = float32_coordinate(psf, np.asarray(radius), True, table.first, len(table.intervals))
    assert table.first <= found < table.first + len(table.intervals)
    return float(found)


# A cubic through 4 Chebyshev points does not follow the kink of order 3/2 that a weight has where the circle first
# touches a pixel: over an interval of relative width w it leaves some 0.02 (2 w)^1.5 of the touched pixels' share. With
# w = ln 2 / 48 and 4 to 12 of the pi R^2 pixels touched at once, that is 1e-5 in sum at R = 4 for kinks that the tent
# has softened, and what is stated beyond; `area` has them in every weight, but w = ln 2 / 128.
INTERPOLATION = {
    ("circle", "sampled"): (2e-7, 2e-7),  # constant: float32 alone
    ("circle", "area"): (3e-5, 1e-4),
    ("circle", "integrated"): (1e-5, 5e-5),
    ("gaussian", "sampled"): (2e-6, 2e-6),  # smooth within an interval; the coordinate's own float32 rounding
    # An interval begins at each corner that its cut has, up to an extent of 32 px, and with half as many of 16 px.
    ("gaussian", "area"): (1e-6, 1e-4),
    ("gaussian", "integrated"): (1e-6, 3e-5),
}


@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_table_holds_the_weights(psf: PointSpread) -> None:
    rng = np.random.default_rng(13)
    for low, high, count, limit in ((0.0, 6.0, 60, 0), (6.0, 16.0, 12, 1)):
        table = psf_table(psf, low, high)
        assert table.intervals.dtype == np.int32
        assert table.coefficients.dtype == np.float32
        assert sum(a.nbytes for a in vars(table).values() if isinstance(a, np.ndarray)) == table_bytes(psf, low, high)
        radii = [low, high, low + 1e-9, 0.5, 0.500001, 1.0, np.nextafter(1.0, 0.0), *rng.uniform(low, high, count)]
        error = energy = 0.0
        for radius in [r for r in radii if low <= r <= high]:
            found = table_weights(table, psf, radius)
            half = len(found) // 2
            assert psf.reach(radius) <= half <= table.reach
            error = max(error, float(np.abs(found - square(psf, radius, half)).sum()))
            energy = max(energy, abs(found.sum(dtype=np.float64) - 1.0))
        assert error < INTERPOLATION[psf.pupil.name, psf.edge][limit]
        # Interpolation keeps sums exactly; float32 rounds hundreds of coefficients by 6e-8 of each, both ways.
        assert energy < 1e-7


@pytest.mark.parametrize("samples", mostly_slow([2, 3, 4, 5], [2, 3]))
@pytest.mark.parametrize("model", ["pillbox", "gaussian"])
def test_subpixel_table_holds_the_weights_of_every_position(model: str, samples: int) -> None:
    edge = "sampled" if samples == 3 else "integrated"
    psf = point_spread(Psf.model_validate({"model": model, "edge": edge, "silhouette_samples": samples}))
    low, high = 0.3, 3.5
    table = psf_table(psf, low, high, samples)
    assert table.coefficients.nbytes + table.intervals.nbytes == table_bytes(psf, low, high, samples)
    offset = subpixel_offsets(samples)
    radii = [low, high, *np.random.default_rng(14).uniform(low, high, 20)]
    for radius in radii:
        coordinate = coordinate_of(table, psf, radius)
        for i, j in np.ndindex(samples, samples):
            found = subpixel_table(table, coordinate, samples, i, j)
            x, y = grid(len(found) // 2)
            assert psf.reach(radius, True) <= len(found) // 2 <= table.reach
            exact = psf.subpixel_weights(x - offset[j], y - offset[i], np.asarray(radius))
            # Point sources have the kinks of `area` in intervals 128 / 64 times as wide: 2^1.5 times 3e-5. The
            # corners of Gaussians are between intervals.
            assert np.abs(found - exact).sum() < (9e-5 if model == "pillbox" else 1e-6)
            assert abs(found.sum() - 1.0) < 1e-7


@pytest.mark.parametrize("samples", [2, 4])
def test_intervals_of_subpixel_discs_begin_where_they_touch_pixel_edges(samples: int) -> None:
    """Else many sources of one radius, such as those beside a small thing before a wall, err alike at their rims."""
    psf = point_spread(Psf(silhouette_samples=samples))
    table, (offset, *_) = psf_table(psf, 11.0, 15.0, samples), subpixel_offsets(samples)
    for radius in (11.735, 12.24, 13.63, 14.26):
        found = subpixel_table(table, coordinate_of(table, psf, radius), samples, 0, 0)
        x, y = grid(len(found) // 2)
        exact = psf.subpixel_weights(x - offset, y - offset, np.asarray(radius))
        assert np.abs(found - exact).max() < 1e-3 * exact.max()  # up to 4e-3 with 48 intervals per octave


@pytest.mark.parametrize("subpixel", [False, True])
@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_coordinate_and_radius_are_inverse(psf: PointSpread, subpixel: bool) -> None:
    radius = np.concatenate([np.random.default_rng(15).uniform(0.5, 500.0, 500), [0.5, 0.875, 1.0, 512.0]])
    coordinate = table_coordinate(psf, radius, subpixel)
    assert (np.diff(table_coordinate(psf, np.sort(radius), subpixel)) >= 0.0).all()
    back = table_radius(psf, coordinate, subpixel)
    np.testing.assert_allclose(back, radius, rtol=1e-13)  # a dozen roundings, and u of some 1e5 at R = 500
    assert (table_coordinate(psf, -radius, subpixel) == coordinate).all()


@pytest.mark.parametrize("psf", SAMPLED, ids=name_of)
def test_a_sampled_interval_has_one_set_of_lit_pixels(psf: PointSpread) -> None:
    radius = np.random.default_rng(16).uniform(0.0, 8.0, 400)
    interval = np.floor(table_coordinate(psf, radius))
    seen: dict[float, NDArray[np.bool_]] = {}
    for r, number in zip(radius.tolist(), interval.tolist(), strict=True):
        lit = square(psf, r, 12) > 0.0
        assert (seen.setdefault(number, lit) == lit).all(), r
    assert len(seen) > 40


def test_tables_too_large_to_make_are_counted_at_once() -> None:
    """A sampled PSF has R^2 intervals, which a plan counts before it refuses them."""
    begun = time.process_time()
    assert table_bytes(point_spread(Psf(model="gaussian", edge="sampled")), 0.0, 500.0) > 2**40
    assert time.process_time() - begun < 2.0


@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_stencils_of_wide_discs_have_rectangles(psf: PointSpread) -> None:
    for radius in (10.0, 20.0):
        far = psf.reach(radius)
        rectangles = stencils(psf, radius)[-1].rectangles
        assert bool(rectangles) == is_summed(psf, far) == (psf.pupil.name == "circle" and far >= SUMMED)
        # Narrower and higher ones after wider ones, and most of the disc.
        assert list(rectangles) == sorted(rectangles, key=lambda rectangle: (-rectangle[0], rectangle[1]))
        if rectangles:
            assert stencils(psf, radius)[0].area > 0.8 * np.pi * (radius - 1.5) ** 2


def test_stencils_of_wide_discs_take_few_weights() -> None:
    """The weights that rectangles leave grow as the radius does, not as its square."""
    for psf, most in zip(PSFS[:3], (3.0, 6.0, 10.0), strict=True):
        for radius in (20.0, 60.0):
            assert len(stencils(psf, radius)[0].weights) < most * radius
