"""Defocus against plain sums, conservation of light and a thin lens."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.optics.point_spread import point_spread
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.blur.blur import prepare_sources, renormalize, scatter, tilt_factor
from clsco.reference.common.geometry import tilt_slope
from clsco.reference.trace.trace import Sources, SubpixelSources, trace, view_at
from clsco.scene.model import Plane, Psf, Scene
from tests.scenes import scene_of
from tests.slow import combined
from tests.spreads import PSFS, name_of, random_sources, random_subpixels, spec_of

Array = NDArray[np.float64]
ALONE = OcclusionGroup(1, 0)  # one object, and nothing in its way


def in_the_middle(sources: Sources, margin: int) -> Sources:
    """The same with empty pixels around, as wide as `margin`."""
    padded: dict[str, Any] = {
        name: np.pad(value, [(margin, margin)] * 2 + [(0, 0)] * (value.ndim - 2))
        for name, value in vars(sources).items()
        if value is not None
    }
    return Sources(**padded)


def plain_scatter(psf: Psf, sources: Sources, sub: SubpixelSources | None, shape: tuple[int, int], guard: int) -> Array:
    """The definition, source by source: radiance x share of light / (share within the frame, if asked)."""
    m, n = shape
    color = np.zeros((m, n, sources.radiance.shape[2]))
    row, column = np.arange(m)[:, None] + guard, np.arange(n)[None, :] + guard

    def add(i: int, j: int, light: Array, share: Array, weight: float) -> None:
        inside = guard <= i < guard + m and guard <= j < guard + n
        if psf.border == "renormalize":
            share = share / share.sum() if inside else np.zeros_like(share)
        color[...] += weight * share[..., None] * light

    for i, j in np.ndindex(sources.lit.shape):
        if not sources.lit[i, j] or (sub is not None and ((sub.row == i) & (sub.column == j)).any()):
            continue
        radius = sources.radius[i, j]
        dx, dy = (column - j).astype(float), (row - i).astype(float)
        share = point_spread(psf).weights(dx, dy, radius)
        if psf.tilt:
            share = share * tilt_factor(dx, dy, tilt_slope(sources.gradient[i, j], radius))
        add(i, j, sources.radiance[i, j], share, 1.0)
    if sub is not None:
        samples = sub.hit.shape[1]
        for k, u, v in zip(*np.nonzero(sub.hit), strict=True):
            i, j = int(sub.row[k]), int(sub.column[k])
            dx = column - (j + (v + 0.5) / samples - 0.5)
            dy = row - (i + (u + 0.5) / samples - 0.5)
            radius = sub.radius[k, u, v]
            share = point_spread(psf).subpixel_weights(dx, dy, radius)
            if psf.tilt:
                limb = sub.limb is not None and sub.limb[k, u, v]
                share = share * tilt_factor(dx, dy, tilt_slope(sub.gradient[k, u, v], radius), limb)
            add(i, j, sub.radiance[k, u, v], share, 1.0 / samples**2)
    return color


GAUSSIAN, SAMPLED = Psf(model="gaussian"), Psf(edge="sampled")


KEPT = [(Psf(), True, "renormalize"), (GAUSSIAN, True, "lose"), (SAMPLED, False, "lose")]


@pytest.mark.parametrize(
    ("psf", "tilt", "border"),
    combined([Psf(), GAUSSIAN, SAMPLED], [True, False], ["lose", "renormalize"], kept=KEPT),
    ids=lambda value: name_of(value) if isinstance(value, Psf) else str(value),
)
def test_scatter_is_the_plain_sum(psf: Psf, tilt: bool, border: str) -> None:
    psf = psf.model_copy(update={"tilt": tilt, "border": border})
    sources = random_sources((12, 13), 0.0, 3.0, 1.5, 2)
    sub = random_subpixels(sources, 2, 20, 0.0, 3.0)
    for some in (None, sub):
        found = scatter(spec_of(psf), sources, some, (6, 7), 3)
        expected = plain_scatter(psf, sources, some, (6, 7), 3)
        assert expected.max() > 0.3
        # A few hundred terms below 1 each, added in another order.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("tilt", [True, False])
@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_light_is_conserved(psf: Psf, tilt: bool) -> None:
    """While no factor is clamped at 0 the tilt takes on one side what it gives on the other.

    The farthest pixel that is lit is 4.5 radii away, in the corner of a Gaussian cut at 3 sigma.
    """
    sources = in_the_middle(random_sources((12, 14), 0.0, 4.0, 1 / 4.5, 3), 14)
    assert point_spread(psf).reach(4.0) <= 14
    color = scatter(spec_of(psf.model_copy(update={"tilt": tilt})), sources, None, sources.lit.shape, 0)
    light = sources.radiance.sum(axis=(0, 1))
    assert light.min() > 10
    np.testing.assert_allclose(color.sum(axis=(0, 1)), light, rtol=1e-12)  # the weights' own sum is 1 to 1e-12
    assert (color >= 0).all()


def test_renormalizing_gives_all_light_back_to_the_frame() -> None:
    psf = Psf(border="renormalize")
    sources = random_sources((20, 24), 0.0, 4.0, 1.8, 1)
    sub = random_subpixels(sources, 3, 30, 0.0, 3.0)
    color = scatter(spec_of(psf), sources, sub, (12, 16), 4)
    frame = (slice(4, 16), slice(4, 20))
    own = sources.radiance.copy()
    own[sub.row, sub.column] = 0.0
    there = (sub.row >= 4) & (sub.row < 16) & (sub.column >= 4) & (sub.column < 20)
    lit = sub.radiance[there][sub.hit[there]].sum() / 9
    assert lit > 1
    np.testing.assert_allclose(color.sum(), own[frame].sum() + lit, rtol=1e-12)
    scaled, _ = renormalize(spec_of(psf), sources, sub, (12, 16), 4)
    assert not scaled.lit[:4].any()
    assert scaled.lit[frame].any()


@pytest.mark.parametrize("offset", [(0, 0), (3, 1)])
def test_a_subpixel_source_lights_its_disc(offset: tuple[int, int]) -> None:
    i, j = offset
    hit = np.zeros((1, 4, 4), dtype=bool)
    hit[0, i, j] = True
    empty = np.zeros((13, 13))
    none = np.zeros((13, 13), dtype=bool)
    sources = Sources(empty[..., None], empty, empty.astype(np.uint8), empty, np.zeros((13, 13, 2)), none)
    sub = SubpixelSources(
        np.array([6]), np.array([6]), hit, np.full(hit.shape, -2.3), np.zeros((*hit.shape, 2)), np.ones((*hit.shape, 1))
    )
    color = scatter(spec_of(Psf()), sources, sub, (13, 13), 0)[..., 0]
    # The disc by counting points of a 1/40 px lattice: its rim crosses each pixel along at most 2 px.
    fine = (np.arange(13 * 40) + 0.5) / 40 - 0.5
    y, x = fine[:, None] - (6 + (i + 0.5) / 4 - 0.5), fine[None, :] - (6 + (j + 0.5) / 4 - 0.5)
    counted = (x * x + y * y <= 2.3**2).reshape(13, 40, 13, 40).mean(axis=(1, 3)) / (np.pi * 2.3**2) / 16
    assert np.abs(color - counted).max() < 2 / 40 / (np.pi * 2.3**2) / 16
    np.testing.assert_allclose(color.sum(), 1 / 16, rtol=1e-12)


def test_tilt_weights_by_the_lens_offset_and_is_never_negative() -> None:
    dx, dy = np.meshgrid(np.arange(-4.0, 5), np.arange(-4.0, 5))
    for gx, gy in ((0.3, -0.2), (3.0, 1.0), (0.0, 0.0)):
        for radius in (2.5, -2.5, 1e-9, -1e-9, 0.0):
            factor = tilt_factor(dx, dy, tilt_slope(np.array([gx, gy]), radius))
            assert factor.min() >= 0.0
            assert factor[4, 4] == 1.0
    assert tilt_factor(1.0, 0.0, tilt_slope(np.array([0.4, 0.0]), 2.0)) == 1.2
    assert tilt_factor(1.0, 0.0, tilt_slope(np.array([0.4, 0.0]), -2.0)) == 0.8
    assert tilt_factor(0.0, 1.0, tilt_slope(np.array([0.4, -0.4]), 2.0)) == 0.8
    assert tilt_factor(1.0, 0.0, tilt_slope(np.array([0.4, 0.0]), 0.25)) == 1.4


def test_prepared_gradient_of_a_ramp_is_its_slope() -> None:
    i, j = np.meshgrid(np.arange(9.0), np.arange(11.0), indexing="ij")
    coc, valid = 0.25 * j - 0.5 * i, np.ones((9, 11), dtype=bool)
    valid[4, 5] = False
    valid[0, 1] = valid[1, 0] = False
    gradient = prepare_sources(np.where(valid, coc, 1e6), valid)
    expected = np.where(valid[..., None], np.array([0.25, -0.5]), 0.0)
    expected[0, 0] = 0.0  # no valid neighbor in either direction
    np.testing.assert_array_equal(gradient, expected)
    square = prepare_sources(j * j, np.ones((9, 11), dtype=bool))[..., 0]
    assert square[0].tolist() == [1.0, *(2 * j[0, 1:-1]).tolist(), 19.0]  # one-sided, central, one-sided
    assert not prepare_sources(np.full((1, 1), 3.0), np.ones((1, 1), dtype=bool)).any()


def thin_lens(scene: Scene, sources: Sources, texture: Array, guard: int) -> Array:
    """Image of a plane on a detector behind a thin lens: mean over detector pixel and lens of f(x).

    x' = x + R(x) l, where R is linear in x for a plane: x = (I + l g^T)^-1 (x' - R(0) l) in closed form.
    """
    m, n = texture.shape[:2]
    gx, gy = sources.gradient[guard, guard]
    r0 = sources.radius[guard, guard]  # at pixel (0, 0)
    k = np.arange(600) + 0.5
    length, angle = np.sqrt(k / 600), k * np.pi * (3 - np.sqrt(5))
    lx, ly = length * np.cos(angle), length * np.sin(angle)
    fine = (np.arange(6) + 0.5) / 6 - 0.5
    color = np.zeros((m, n))
    for u in fine:
        for v in fine:
            x = (np.arange(n) + v)[None, :, None] - r0 * lx
            y = (np.arange(m) + u)[:, None, None] - r0 * ly
            along = (gx * x + gy * y) / (1 + gx * lx + gy * ly)
            row, column = (np.floor(p + 0.5).astype(int) for p in (y - ly * along, x - lx * along))
            color += sources.radiance[row + guard, column + guard, 0].mean(axis=-1)
    return color / 36


def test_tilted_plane_agrees_with_a_thin_lens() -> None:
    item = Plane(distance=256.0, slope_x=2.0, slope_y=-1.0)
    scene = scene_of(item, size=(24, 24), camera={"aperture_diameter": 40.0})
    texture = np.random.default_rng(47).random((24, 24, 1))
    sources = trace(view_at(scene, (texture,), 0.0, "left", False), ALONE, 10)
    assert np.hypot(*sources.gradient[10, 10]) > 0.1
    assert 2 < np.abs(sources.radius).max() < 10
    expected = thin_lens(scene, sources, texture, 10)

    def error(sources: Sources, tilt: bool = True) -> float:
        color = scatter(spec_of(Psf(tilt=tilt)), sources, None, (24, 24), 10)
        return float(np.sqrt(np.mean((color[..., 0] - expected) ** 2)))

    # 600 lens points by 36 of the detector leave noise of about 0.3 / sqrt(21600) = 0.002; less, being even.
    assert error(sources) < 0.002
    assert error(sources, tilt=False) > 2 * error(sources)
    assert error(replace(sources, gradient=-sources.gradient)) > 2 * error(sources, tilt=False) * 0.8
