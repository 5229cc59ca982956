"""blur.cl against its twin: every method, PSF, border and kind of source, and against itself in another order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.constants import ITEMS_BYTES, ROW_TILE, WIDE_LANES
from clsco.frame import strips
from clsco.frame.strips import Grid, frame_struct
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.optics import psf as psf_weights
from clsco.optics.psf import reach
from clsco.optics.psf_tables import psf_table
from clsco.passes import blur as spread
from clsco.passes.blur import FILES_OF, PIXELS, FrameSum, TableBlur
from clsco.passes.frame_blur import make_blur
from clsco.passes.pack import psf_struct
from clsco.plan.buffers import source_bytes
from clsco.plan.methods import Blur, BlurSpec
from clsco.records import Struct, flat, structs
from clsco.reference.blur import blur as twin
from clsco.reference.common.geometry import table_coordinate, tilt_slope
from clsco.reference.trace.trace import Sources, SubpixelSources
from clsco.scene.model import Psf
from tests.kernels.conftest import download_sources, source_planes
from tests.slow import combined, mostly_slow

Array = NDArray[Any]
RNG = np.random.default_rng
STRUCTS = structs("double")
PSFS = [Psf(model=model, edge=edge) for model in ("pillbox", "gaussian") for edge in ("sampled", "area", "integrated")]
# Float32 adds some 200 terms, each rounded by 2^-24 of a sum of about 1: at worst 1e-5, as a random walk below 1e-6.
ROUNDING = 1.5e-6
# The weights of a table are off by 1e-5 in sum with `integrated` and 1e-4 where they have kinks (test_psf.py), to
# both sides and not for most radii; over sources of many radii, a twentieth of that is left in a pixel.
FIGURE = {"sampled": ROUNDING, "area": 6e-6, "integrated": 2e-6}


def name_of(psf: Psf) -> str:
    return f"{psf.model}-{psf.edge}"


def random_sources(shape: tuple[int, int], smallest: float, largest: float, steepest: float, channels: int) -> Sources:
    """Sources of either sign and any gradient up to `steepest` px per px, a tenth of the pixels empty."""
    rng = RNG(41)
    label = (rng.random(shape) < 0.9).astype(np.uint8)
    there = label > 0
    angle, length = rng.uniform(0, 2 * np.pi, shape), rng.uniform(0, steepest, shape)
    gradient = np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)
    radius = np.where(there, rng.choice([-1, 1], shape) * rng.uniform(smallest, largest, shape), 0.0)
    radiance = np.where(there[..., None], rng.random((*shape, channels)), 0.0)
    return Sources(radiance, np.ones(shape), label, radius, gradient, there)


def random_subpixels(sources: Sources, samples: int, count: int, smallest: float, largest: float) -> SubpixelSources:
    """Sub-pixel sources in `count` random pixels, whether those have a source of their own or not."""
    rng = RNG(43)
    height, width, channels = sources.radiance.shape
    pixel = rng.choice(height * width, count, replace=False)
    shape = (count, samples, samples)
    return SubpixelSources(
        row=pixel // width,
        column=pixel % width,
        hit=rng.random(shape) < 0.7,
        radius=rng.choice([-1, 1], shape) * rng.uniform(smallest, largest, shape),
        gradient=rng.uniform(-0.6, 0.6, (*shape, 2)),
        radiance=rng.random((*shape, channels)),
    )


@dataclass(frozen=True)
class Light:
    """Sources of a frame and their blur: all that the host hands to the kernels."""

    psf: Psf
    sources: Sources
    shape: tuple[int, int]
    guard: int
    smallest: float
    largest: float
    sub: SubpixelSources | None = None

    @property
    def channels(self) -> int:
        return int(self.sources.radiance.shape[2])

    @property
    def samples(self) -> int:
        return 0 if self.sub is None else int(self.sub.hit.shape[1])

    def camera(self) -> Struct:
        return frame_struct(*self.shape, self.guard, "double")

    def expected(self) -> Array:
        """By the twin, (rows, columns, channels)."""
        return twin.scatter(self.psf, self.sources, self.sub, self.shape, self.guard)

    def constant(self, radius: float) -> Light:
        """The same with one radius and no gradient."""
        there = self.sources.lit
        alike = replace(self.sources, radius=np.where(there, radius, 0.0), gradient=0 * self.sources.gradient)
        return replace(self, sources=alike, sub=None, smallest=abs(radius), largest=abs(radius))


def light(
    psf: Psf, shape: tuple[int, int] = (37, 45), guard: int = 5, largest: float = 4.0, smallest: float = 0.0,
    steepest: float = 1.5, channels: int = 1, samples: int = 0,
) -> Light:  # fmt: skip
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    sources = random_sources(size, smallest, largest, steepest, channels)
    sub = random_subpixels(sources, samples, size[0] * size[1] // 6, smallest, largest) if samples else None
    return Light(psf, sources, shape, guard, smallest, largest, sub)


def records(given: Light, radius: Array, gradient: Array, there: Array, subpixel: bool) -> Array:
    """Sources (..., 4) as trace.cl writes them, slots left out."""
    table = psf_table(given.psf, given.smallest, given.largest, given.samples if subpixel else 0)
    out = np.zeros((*radius.shape, 4), np.float32)
    coordinate = table_coordinate(given.psf, radius, subpixel, table.low, table.end - table.low, table.count)
    out[..., 0] = np.where(there, coordinate, np.float32(-1))
    out[..., 1:3] = np.where(there[..., None], tilt_slope(gradient, radius), 0.0)
    return out


def on_device(session: Session, given: Light, weight: float) -> spread.Sources:
    """The sources in the layout of trace.cl; values are written to by `renormalize`."""
    sources, sub = given.sources, given.sub
    source = records(given, sources.radius, sources.gradient, sources.lit, False)
    source[..., 3].view(np.int32)[...] = -1
    held = (empty(session, 0), empty(session, 0), 0)
    if sub is not None:
        capacity = len(sub.row) + 3  # some slots stay empty
        slots = RNG(44).permutation(len(sub.row)).astype(np.int32)
        source[..., 3].view(np.int32)[sub.row, sub.column] = slots
        records_by_slot = np.full((capacity, given.samples, given.samples, 4), np.nan, np.float32)
        records_by_slot[slots] = records(given, sub.radius, sub.gradient, sub.hit, True)
        value = np.zeros((given.channels, capacity, given.samples, given.samples), np.float32)
        value[:, slots] = (
            np.moveaxis(np.where(sub.hit[..., None], sub.radiance, 0.0), -1, 0) / given.samples**2 * weight
        )
        held = (upload(session, records_by_slot), copied(session, value), capacity)
    value = copied(session, flat(sources.radiance * weight, np.float32))
    planes = source_planes(source, given.psf.tilt, given.samples > 0)
    return spread.Sources(upload(session, planes), value, *held)


def copied(session: Session, array: Array) -> Any:
    """A buffer of its own, for kernels to write to."""
    buffer = empty(session, array.nbytes)
    cl.enqueue_copy(session.queue, buffer, array)
    return buffer


def features(psf: Psf, channels: int, samples: int, largest: float = 0.0) -> dict[str, int]:
    """All kernels in one program, so that few have to be compiled; tests/architecture builds them one by one."""
    spec = BlurSpec(psf, "gather", 0.0, largest, samples, psf.tilt)
    kernels = spread.blur_features(spec, channels, True, "wide")
    return kernels | dict.fromkeys(("GATHER", "SCATTER", "RENORMALIZE", "PREPARE"), 1)


def blur_of(session: Session, given: Light, method: Blur) -> FrameSum:
    psf, ends = given.psf, (given.smallest, given.largest)
    spec = BlurSpec(psf, method, *ends, given.samples, psf.tilt)
    chosen = features(psf, given.channels, given.samples, given.largest)
    if method == "tiles":  # in a file of its own
        chosen |= spread.blur_features(spec, given.channels, True, "none") | {"RENORMALIZE": 1}
    program = build(session, spread.FILES_OF[method], chosen, STRUCTS, "double")
    grid = Grid.whole(*given.shape, given.guard, given.channels)
    return make_blur(spread.Target(session, program, "double"), spec, grid, given.camera())


def blurred(session: Session, given: Light, method: Blur, moments: int = 1) -> Array:
    """Frame (rows, columns, channels) of a method; moments: that many equal shares of the light."""
    owner = blur_of(session, given, method)
    owner.clear()
    sources = on_device(session, given, 1.0 / moments)
    for _ in range(moments):
        owner.add(replace(sources, radius=given.largest), [])
    image = owner.image([])
    return image if given.channels > 1 else image[..., None]


def assert_close(found: Array, expected: Array, limit: float) -> None:
    error = np.abs(found - expected)
    worst = np.unravel_index(int(error.argmax()), error.shape)
    assert error.max() < limit, (
        f"{error.max():.2e} at {worst}: {found[worst]} for {expected[worst]}, {(error >= limit).sum()} pixels"
    )


@pytest.mark.parametrize("method", ["gather", "scatter"])
@pytest.mark.parametrize("tilt", mostly_slow([True, False], [True]))
@pytest.mark.parametrize("psf", mostly_slow(PSFS, [PSFS[0], PSFS[2], PSFS[5]]), ids=name_of)
def test_every_psf(session: Session, psf: Psf, tilt: bool, method: Blur) -> None:
    given = light(psf.model_copy(update={"tilt": tilt}))
    expected = given.expected()
    assert np.ptp(expected) > 0.3
    assert_close(blurred(session, given, method), expected, FIGURE[psf.edge])


@pytest.mark.parametrize(
    ("psf", "channels"),
    [
        pytest.param(Psf(), 3, marks=pytest.mark.slow),
        (Psf(edge="sampled", tilt=False), 1),
        (Psf(), 1),
        pytest.param(Psf(edge="area"), 1, marks=pytest.mark.slow),
    ],
    ids=["colors", "sampled", "gray", "area"],
)
def test_wide_discs(session: Session, psf: Psf, channels: int) -> None:
    """Radii of one interval side by side, and none such; steep tilts, of which weights end at 0; several bands."""
    shape = (3 * strips.BAND // 2, 61)
    largest = 44.0 if psf.edge == "sampled" else 26.0
    given = light(psf, shape=shape, guard=3, largest=largest, steepest=0.2, channels=channels, samples=2)
    assert features(psf, channels, 2, largest)["BY_ROWS" if psf.edge == "sampled" else "BY_COLUMNS"]
    rows, columns = np.indices(given.sources.lit.shape)
    alone = (columns > 40) | (RNG(45).random(rows.shape) < 0.02)
    radius = np.where(alone, given.sources.radius, 0.55 * largest + 0.11 * rows + 0.02 * columns)
    steep = np.where((rows % 9 == 0)[..., None], 20.0, 1.0) * given.sources.gradient
    sources = replace(given.sources, radius=np.where(given.sources.lit, radius, 0.0), gradient=steep)
    given = replace(given, sources=sources)
    found = blurred(session, given, "gather", moments=2)
    assert_close(found, blurred(session, given, "scatter"), ROUNDING)
    # Of single wide discs the tables know that much; those of `area` have kinks.
    assert_close(found, given.expected(), 1e-4 if psf.edge == "area" else 2e-5)
    assert (found == blurred(session, given, "gather", moments=2)).all()


def test_rows_of_any_length(session: Session) -> None:
    """Sources of a row that are left when it is taken in vectors, each once; neighbors in several intervals."""
    for columns in range(7, 7 + 16):
        given = light(Psf(), shape=(9, columns), guard=5, largest=26.0, steepest=0.02)
        rows, places = np.indices(given.sources.lit.shape)
        sources = replace(given.sources, radius=np.where(given.sources.lit, 25.0 + 0.03 * places - 0.01 * rows, 0.0))
        given = replace(given, sources=sources)
        assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


SMOOTH = Psf(model="gaussian", sigma_ratio=0.3)


@pytest.mark.parametrize("tilt", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_more_rows_of_wide_gaussians_than_are_kept_at_a_time(session: Session, tilt: bool) -> None:
    """Rows that reach a band are more than the items of ITEMS_BYTES, so that they come in several parts."""
    psf, shape, guard = SMOOTH.model_copy(update={"tilt": tilt}), (strips.BAND + 30, 20), 3
    given = light(psf, shape=shape, guard=guard, largest=60.0, steepest=0.01)
    rows, columns = np.indices(given.sources.lit.shape)
    radius = np.where(given.sources.lit, 55.0 + 0.05 * rows - 0.1 * columns, 0.0)
    given = replace(given, sources=replace(given.sources, radius=radius))
    item = 4 * WIDE_LANES * reach(psf, 55.0)
    assert item * min(strips.BAND + reach(psf, 55.0), shape[0] + 2 * guard) > ITEMS_BYTES
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize(
    ("psf", "tilt", "channels"),
    mostly_slow(
        [(psf, *each) for psf in (PSFS[0], SMOOTH, Psf()) for each in ((False, 1), (False, 3), (True, 2))],
        [(PSFS[0], False, 1), (PSFS[0], True, 2), (SMOOTH, True, 2), (Psf(), True, 2)],
    ),
)
def test_rows_of_several_tiles(session: Session, psf: Psf, tilt: bool, channels: int) -> None:
    """Level, steep, jumping, thin and single places in several tiles and bands; much brighter ones among them."""
    psf, shape = psf.model_copy(update={"tilt": tilt}), (strips.BAND + 7, 2 * ROW_TILE + 45)
    given = light(psf, shape=shape, guard=5, largest=21.0, steepest=0.05, channels=channels)
    rows, columns = np.indices(given.sources.lit.shape)
    radius = 0.02 * columns + 0.05 * rows + np.where(columns > 300, 5.0, 0.0)
    radius = np.where((columns % 100 == 50) | (rows == 40) | (RNG(46).random(rows.shape) < 0.003), 20.0, radius)
    bright = RNG(47).random(rows.shape) < 0.001
    radiance = np.where(bright[..., None], 1e4, given.sources.radiance)
    sources = replace(given.sources, radius=np.where(given.sources.lit, radius, 0.0), radiance=radiance)
    given = replace(given, sources=sources)
    found, expected = blurred(session, given, "gather", moments=3), blurred(session, given, "scatter")
    dim = expected < 2.0
    assert 0.2 < dim.mean() < 0.9
    assert_close(found[dim], expected[dim], 3 * ROUNDING)  # of sums of up to 2
    assert (np.abs(found - expected) < 1e-6 * expected.max()).all()


@pytest.mark.parametrize(
    ("method", "samples"), combined(("gather", "scatter"), (2, 3, 4), kept=[("gather", 3), ("scatter", 3)])
)
def test_subpixel_sources(session: Session, method: Blur, samples: int) -> None:
    # The tables of point sources have the kinks of `area`.
    given = light(Psf(), samples=samples, channels=3 if samples == 3 else 1)
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
    assert given.shape[0] > 2 * strips.BAND
    assert_close(blurred(session, given, "gather"), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize("radius", [0.0, 0.4, 1.0, -2.7, 6.3])
@pytest.mark.parametrize("psf", mostly_slow(PSFS, [PSFS[0], PSFS[2], PSFS[5]]), ids=name_of)
def test_one_radius(session: Session, psf: Psf, radius: float) -> None:
    guard = psf_weights.reach(psf, abs(radius))
    given = light(psf.model_copy(update={"tilt": False}), guard=guard, channels=3).constant(radius)
    expected = given.expected()
    for method in ("gather", "scatter"):
        assert_close(blurred(session, given, method), expected, FIGURE[psf.edge])


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (29, 1), (2, 3), (65, 9), (64, 8), (63, 7)])
def test_small_and_odd_frames(session: Session, shape: tuple[int, int]) -> None:
    """Also frames that are smaller than the PSF, and bands of one row."""
    given = light(Psf(), shape=shape, guard=9, largest=6.5, channels=3)
    for method in ("gather", "scatter"):
        assert_close(blurred(session, given, method), given.expected(), FIGURE["integrated"])


@pytest.mark.parametrize("method", ["gather", "scatter"])
@pytest.mark.parametrize("samples", [0, 3])
def test_renormalized_borders(session: Session, samples: int, method: Blur) -> None:
    psf = Psf(border="renormalize")
    given = light(psf, shape=(24, 31), guard=0, channels=3, samples=samples)
    expected = given.expected()
    lost = replace(given, psf=Psf()).expected()
    assert expected.sum() > 1.02 * lost.sum()
    # A source in a corner keeps a quarter of its light: its error grows as its light does.
    assert_close(blurred(session, given, method), expected, 4 * FIGURE["area" if samples else "integrated"])


def test_renormalize_divides_by_what_stays(session: Session) -> None:
    """The kernel itself: values after it against the twin's radiance."""
    given = light(Psf(border="renormalize"), shape=(24, 31), guard=0, channels=3, samples=2)
    owner = blur_of(session, given, "gather")
    sources = on_device(session, given, 1.0)
    assert sources.source is not None
    assert sources.sub_source is not None
    assert sources.sub_value is not None
    assert isinstance(owner, TableBlur)
    head = (given.camera(), owner.struct, sources.source, sources.value, *owner.tables[0])
    tail = (sources.sub_source, sources.sub_value, np.int32(sources.capacity), *owner.tables[1])
    launch(session, kernel(owner.target.program, "renormalize"), (31, 24), PIXELS, *head, *tail)
    value = download(session, sources.value, (3, 24, 31), np.float32)
    scaled, _ = twin.renormalize(given.psf, given.sources, given.sub, given.shape, 0)
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
    given = light(Psf(tilt=False), guard=14).constant(3.3)
    # Three thirds: three times as many roundings.
    assert_close(blurred(session, given, method, 3), blurred(session, given, method), ROUNDING)


def test_accumulate(session: Session) -> None:
    given = light(Psf(), channels=3).constant(0.0)
    m, n = given.shape
    frame = given.sources.radiance[5 : 5 + m, 5 : 5 + n]
    assert (blurred(session, given, "none") == frame.astype(np.float32)).all()
    np.testing.assert_allclose(blurred(session, given, "none", 3), frame, rtol=4 * 2.0**-24)  # 3 divisions, 2 sums


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter"], ["gather"]))
def test_same_bits_again_and_in_other_groups(session: Session, method: Blur, monkeypatch: pytest.MonkeyPatch) -> None:
    given = light(Psf(), shape=(130, 61), guard=14, channels=3, samples=2)
    first = blurred(session, given, method).tobytes()
    assert blurred(session, given, method).tobytes() == first
    for local in ((1, 1), (3, 5), (16, 4)):

        def other(session: Any, kernel: Any, size: Any, usual: Any, *args: Any, local: Any = local) -> Any:
            return launch(session, kernel, size, local[: len(usual)], *args)

        monkeypatch.setattr(spread, "launch", other)
        assert blurred(session, given, method).tobytes() == first, local


def test_what_is_not_there_adds_nothing(session: Session) -> None:
    given = light(Psf(), samples=3, channels=3)
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
    table = psf_table(psf, 0.0, given.largest)
    program = build(session, FILES_OF["gather"], features(given.psf, 1, 0), STRUCTS, "double")
    struct, out = psf_struct(psf, table, None, "double"), empty(session, source_bytes(coc.size, tilt))
    maps = (upload(session, coc), upload(session, valid.astype(np.uint8)))
    target = spread.Target(session, program, "double")
    spread.prepare_sources(target, given.camera(), struct, maps, out, [])
    found = download_sources(session, out, coc.shape, tilt, False)
    expected = records(given, coc, twin.prepare_sources(coc, valid), valid, False)
    assert np.abs(expected[..., 1:3]).max() > 1.0
    assert (found[~valid][:, :3] == [-1, 0, 0]).all()
    np.testing.assert_allclose(found[..., 0], expected[..., 0], rtol=2.0**-23)  # rounded to the other side at most
    # Two conversions to float32, a quotient and a product.
    np.testing.assert_allclose(found[..., 1:3], expected[..., 1:3] if tilt else 0.0 * expected[..., 1:3], rtol=2.5e-7)
