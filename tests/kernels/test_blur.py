"""blur.cl against its twin: every method, PSF, border and kind of source, and against itself in another order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clsco.constants import BAND, ITEMS_BYTES, WIDE_LANES
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.passes import blur as spread
from clsco.passes.blur import FILES_OF
from clsco.passes.pack import psf_struct
from clsco.plan.buffers import source_bytes
from clsco.plan.methods import Blur
from clsco.records import flat
from clsco.reference.blur import blur as twin
from clsco.scene.model import Psf
from tests.kernels import sources as light_sources
from tests.kernels.conftest import download_sources
from tests.kernels.sources import FIGURE, RNG, ROUNDING, SMOOTH, assert_close, blurred, features, light
from tests.slow import combined, mostly_slow
from tests.spreads import PSFS, name_of, spec_of


@pytest.mark.parametrize("method", ["gather", "scatter"])
@pytest.mark.parametrize("tilt", mostly_slow([True, False], [True]))
@pytest.mark.parametrize("psf", mostly_slow(PSFS, [PSFS[0], PSFS[2], PSFS[5]]), ids=name_of)
def test_every_psf(session: Session, psf: Psf, tilt: bool, method: Blur) -> None:
    given = light(psf.model_copy(update={"tilt": tilt}))
    expected = given.expected()
    assert np.ptp(expected) > 0.3
    assert_close(blurred(session, given, method), expected, FIGURE[psf.edge])


DISCS = [(Psf(edge="sampled", tilt=False), 1), (Psf(), 3), (Psf(), 1), (Psf(edge="area"), 1)]


@pytest.mark.parametrize(("psf", "channels"), mostly_slow(DISCS, DISCS[:1]), ids=["sampled", "colors", "gray", "area"])
def test_wide_discs(session: Session, psf: Psf, channels: int) -> None:
    """Radii of one interval side by side, and none such; steep tilts, of which weights end at 0; several bands."""
    shape = (3 * BAND // 2, 61)
    largest = 44.0 if psf.edge == "sampled" else 26.0
    samples = 0 if psf.edge == "sampled" else 2
    given = light(psf, shape=shape, guard=3, largest=largest, steepest=0.2, channels=channels, samples=samples)
    assert features(psf, channels, samples, largest)["BY_COLUMNS"]
    rows, columns = np.indices(given.sources.lit.shape)
    alone = (columns > 40) | (RNG(45).random(rows.shape) < 0.02)
    radius = np.where(alone, given.sources.radius, 0.55 * largest + 0.11 * rows + 0.02 * columns)
    steep = np.where((rows % 9 == 0)[..., None], 20.0, 1.0) * given.sources.gradient
    sources = replace(given.sources, radius=np.where(given.sources.lit, radius, 0.0), gradient=steep)
    given = replace(given, sources=sources)
    found = blurred(session, given, "gather", moments=2)
    assert_close(found, blurred(session, given, "scatter"), ROUNDING)
    assert (found == blurred(session, given, "gather", moments=2)).all()


def test_rows_of_any_length(session: Session) -> None:
    """Sources of a row that are left when it is taken in vectors, each once; neighbors in several intervals."""
    for columns in range(7, 7 + 16):
        given = light(Psf(), shape=(9, columns), guard=5, largest=26.0, steepest=0.02)
        rows, places = np.indices(given.sources.lit.shape)
        sources = replace(given.sources, radius=np.where(given.sources.lit, 25.0 + 0.03 * places - 0.01 * rows, 0.0))
        given = replace(given, sources=sources)
        assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize("tilt", mostly_slow([False, True], [True]))
def test_more_rows_of_wide_gaussians_than_are_kept_at_a_time(session: Session, tilt: bool) -> None:
    """Rows that reach a band are more than the items of ITEMS_BYTES, so that they come in several parts."""
    psf, shape, guard = SMOOTH.model_copy(update={"tilt": tilt}), (BAND + 30, 20), 3
    given = light(psf, shape=shape, guard=guard, largest=60.0, steepest=0.01)
    rows, columns = np.indices(given.sources.lit.shape)
    radius = np.where(given.sources.lit, 55.0 + 0.05 * rows - 0.1 * columns, 0.0)
    given = replace(given, sources=replace(given.sources, radius=radius))
    item = 4 * WIDE_LANES * point_spread(psf).reach(55.0)
    assert item * min(BAND + point_spread(psf).reach(55.0), shape[0] + 2 * guard) > ITEMS_BYTES
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize(
    ("psf", "tilt", "channels"),
    mostly_slow(
        [(psf, *each) for psf in (PSFS[0], SMOOTH, Psf()) for each in ((False, 1), (False, 3), (True, 1), (True, 2))],
        [(PSFS[0], True, 1), (Psf(), True, 1)],
    ),
)
def test_rows_of_several_tiles(session: Session, psf: Psf, tilt: bool, channels: int) -> None:
    """Level, steep, jumping, thin and single places in several tiles and bands; much brighter ones among them."""
    psf, shape = psf.model_copy(update={"tilt": tilt}), (BAND + 7, 345)
    given = light(psf, shape=shape, guard=5, largest=21.0, steepest=0.05, channels=channels)
    rows, columns = np.indices(given.sources.lit.shape)
    radius = 0.02 * columns + 0.05 * rows + np.where(columns > 300, 5.0, 0.0)
    radius = np.where((columns % 100 == 50) | (rows == 40) | (RNG(46).random(rows.shape) < 0.003), 20.0, radius)
    bright = RNG(47).random(rows.shape) < 0.002
    radiance = np.where(bright[..., None], 1e4, given.sources.radiance)
    sources = replace(given.sources, radius=np.where(given.sources.lit, radius, 0.0), radiance=radiance)
    given = replace(given, sources=sources)
    found, expected = blurred(session, given, "gather", moments=3), blurred(session, given, "scatter")
    dim = expected < 2.0
    assert 0.2 < dim.mean() < 0.9
    assert_close(found[dim], expected[dim], 3 * ROUNDING)  # of sums of up to 2
    assert (np.abs(found - expected) < 1e-6 * expected.max()).all()


@pytest.mark.parametrize(
    ("method", "samples"), combined(("gather", "scatter"), (2, 3, 4), kept=[("gather", 2), ("scatter", 2)])
)
def test_subpixel_sources(session: Session, method: Blur, samples: int) -> None:
    # The tables of point sources have the kinks of `area`.
    given = light(Psf(), samples=samples, channels=3)
    expected = given.expected()
    alone = replace(given, sub=None).expected()
    assert np.abs(expected - alone).max() > 0.1
    assert_close(blurred(session, given, method), expected, FIGURE["area"])


@pytest.mark.slow
def test_subpixel_sources_of_a_sampled_psf_and_without_tilt(session: Session) -> None:
    for psf in (Psf(edge="sampled"), Psf(model="gaussian", tilt=False)):
        given = light(psf, samples=2)
        for method in ("gather", "scatter"):
            assert_close(blurred(session, given, method), given.expected(), FIGURE["area"])


@pytest.mark.parametrize(("channels", "samples"), combined((1, 3), (0, 2), kept=[(3, 2)]))
def test_gather_is_scatter(session: Session, channels: int, samples: int) -> None:
    """The same weights from the same tables, in another order and in fixed point: only float32 rounding is left."""
    given = light(Psf(), shape=(150, 70), largest=7.0, channels=channels, samples=samples)
    assert given.shape[0] > 2 * BAND
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize("radius", [0.0, 0.4, 1.0, -2.7, 6.3])
@pytest.mark.parametrize("psf", mostly_slow(PSFS, [PSFS[0], PSFS[2], PSFS[5]]), ids=name_of)
def test_one_radius(session: Session, psf: Psf, radius: float) -> None:
    guard = point_spread(psf).reach(abs(radius))
    given = light(psf, guard=guard).constant(radius)
    expected = given.expected()
    for method in ("gather", "scatter"):
        assert_close(blurred(session, given, method), expected, FIGURE[psf.edge])


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (29, 1), (2, 3), (65, 9), (64, 8), (63, 7)])
def test_small_and_odd_frames(session: Session, shape: tuple[int, int]) -> None:
    """Also frames that are smaller than the PSF, and bands of one row."""
    given = light(Psf(), shape=shape, guard=9, largest=6.5)
    for method in ("gather", "scatter"):
        assert_close(blurred(session, given, method), given.expected(), FIGURE["integrated"])


@pytest.mark.parametrize("method", ["gather", "scatter"])
@pytest.mark.parametrize("samples", [0, 2])
def test_renormalized_borders(session: Session, samples: int, method: Blur) -> None:
    psf = Psf(border="renormalize")
    given = light(psf, shape=(24, 31), guard=0, channels=3 if samples else 1, samples=samples)
    expected = given.expected()
    lost = replace(given, psf=Psf()).expected()
    assert expected.sum() > 1.02 * lost.sum()
    # A source in a corner keeps a quarter of its light: its error grows as its light does.
    assert_close(blurred(session, given, method), expected, 4 * FIGURE["area" if samples else "integrated"])


def test_renormalize_divides_by_what_stays(session: Session) -> None:
    """The kernel itself: values after it against the twin's radiance."""
    given = light(Psf(border="renormalize"), shape=(24, 31), guard=0, channels=3, samples=2)
    value = download(session, light_sources.renormalized(session, given, "gather").value, (3, 24, 31), np.float32)
    scaled, _ = twin.renormalize(spec_of(given.psf), given.sources, given.sub, given.shape, 0)
    assert given.sub is not None
    own = given.sources.lit.copy()
    own[given.sub.row, given.sub.column] = False
    expected = np.moveaxis(scaled.radiance, -1, 0)
    assert (expected / np.moveaxis(np.maximum(given.sources.radiance, 1e-9), -1, 0))[:, own].max() > 1.5
    # The share that stays is a sum of weights, good to the table's L1 error over the share itself, 1/8 at least.
    np.testing.assert_allclose(value[:, own], expected[:, own], rtol=1e-4)
    kept = ~own & given.sources.lit
    assert (value[:, kept] == flat(given.sources.radiance, np.float32)[:, kept]).all()  # others are not touched


@pytest.mark.parametrize("method", ["gather", "scatter"])
def test_moments_add_up(session: Session, method: Blur) -> None:
    given = light(Psf(), guard=14).constant(3.3)
    # Three thirds: three times as many roundings.
    assert_close(blurred(session, given, method, 3), blurred(session, given, method), ROUNDING)


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter"], ["gather"]))
def test_same_bits_again_and_in_other_groups(session: Session, method: Blur, monkeypatch: pytest.MonkeyPatch) -> None:
    given = light(Psf(), shape=(130, 61), guard=14, channels=3, samples=2)
    first = blurred(session, given, method).tobytes()
    assert blurred(session, given, method).tobytes() == first
    for local in ((1, 1), (3, 5), (16, 4)):

        def other(session: Any, kernel: Any, size: Any, usual: Any, *args: Any, local: Any = local, **how: Any) -> Any:
            return launch(session, kernel, size, local[: len(usual)], *args, **how)

        monkeypatch.setattr("clsco.opencl.program.launch", other)
        assert blurred(session, given, method).tobytes() == first, local


def test_what_is_not_there_adds_nothing(session: Session) -> None:
    given = light(Psf(), samples=2, channels=3)
    assert given.sub is not None
    nothing = replace(
        given,
        sources=replace(given.sources, lit=np.zeros_like(given.sources.lit)),
        sub=replace(given.sub, hit=np.zeros_like(given.sub.hit)),
    )
    for method in ("gather", "scatter"):
        assert not blurred(session, nothing, method).any()


def test_light_is_kept_in_fixed_point(session: Session) -> None:
    """One source in an empty frame: its light is there to the last of 2^40 parts, but for the table's 1e-7."""
    given = light(Psf(), shape=(21, 21), guard=0)
    there = np.zeros((21, 21), np.bool_)
    there[10, 10] = True
    sources = replace(
        given.sources, lit=there, radiance=np.float64(0.75) * there[..., None], radius=np.float64(3.3) * there
    )
    given = replace(given, sources=replace(sources, gradient=0.2 * there[..., None] * np.ones(2)))
    for method in ("gather", "scatter"):
        image = blurred(session, given, method)
        assert image.sum(dtype=np.float64) == pytest.approx(0.75, rel=3e-7)  # and 40 roundings to float32
        assert (image >= 0).all()


def test_scatter_with_32_bits(session: Session) -> None:
    """Without 64-bit atomics, light is counted in 2^-31 of what a pixel can get at most, some ten whites."""
    given = light(Psf(), shape=(64, 64), largest=9.0, guard=10, channels=3, samples=2)
    with Session(replace(session.device, has_int64_atomics=False)) as lesser:
        found = blurred(lesser, given, "scatter")
    # A pixel adds some 400 taps, each rounded to 7e-9 up or down, and the sum to float32. Rounding is without bias, but
    # for the few taps above 2^23 units, to which float32 adds a half only at every other one: a few times 3e-9.
    expected = blurred(session, given, "scatter")
    assert_close(found, expected, ROUNDING)
    assert abs((found - expected.astype(np.float64)).mean()) < 5e-8


@pytest.mark.parametrize("tilt", [True, False])
@pytest.mark.parametrize("psf", [Psf(), Psf(edge="sampled")], ids=name_of)
def test_prepare_sources(session: Session, psf: Psf, tilt: bool) -> None:
    given = light(psf.model_copy(update={"tilt": tilt}), shape=(19, 23), guard=2)
    coc, valid = given.sources.radius, given.sources.lit
    table = psf_table(point_spread(psf), 0.0, given.largest)
    target = Target(session, FILES_OF["gather"], features(given.psf, 1, 0), "double")
    struct, out = psf_struct(point_spread(psf), table, None, "double"), empty(session, source_bytes(coc.size, tilt))
    maps = (upload(session, coc), upload(session, valid.astype(np.uint8)))
    spread.prepare_sources(target, given.grid(), struct, maps, out, [])
    found = download_sources(session, out, coc.shape, tilt, False)
    expected = light_sources.records(given, coc, twin.prepare_sources(coc, valid), valid, False)
    assert np.abs(expected[..., 1:3]).max() > 1.0
    assert (found[~valid][:, :3] == [-1, 0, 0]).all()
    np.testing.assert_allclose(found[..., 0], expected[..., 0], rtol=2.0**-23)  # rounded to the other side at most
    # Two conversions to float32, a quotient and a product.
    np.testing.assert_allclose(found[..., 1:3], expected[..., 1:3] if tilt else 0.0 * expected[..., 1:3], rtol=2.5e-7)
