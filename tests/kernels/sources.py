"""Sources that tests of the blur spread, their blur by each method, and single kernels of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.strips import Grid
from clsco.inputs.pupils import load_point_spread
from clsco.opencl.buffers import copied, download, empty, upload
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_tables import PsfTable
from clsco.passes import blur as spread
from clsco.passes.blur import FILES_OF, PIXELS, BlurredPlane, TableBlur
from clsco.passes.frame_blur import make_blur
from clsco.passes.pack import grid_struct, psf_struct
from clsco.passes.tables import shared_tables
from clsco.plan.buffers import column_bytes, margin
from clsco.plan.methods import Blur
from clsco.records import Struct, flat, structs
from clsco.reference.blur import blur as twin
from clsco.reference.common.geometry import tilt_slope
from clsco.reference.trace.trace import Sources, SubpixelSources
from clsco.scene.model import Aperture, Psf
from tests.kernels.conftest import source_planes
from tests.kernels.launches import Amid, run
from tests.spreads import random_sources, random_subpixels, spec_of, table_coordinate

Array = NDArray[Any]
RNG = np.random.default_rng
STRUCTS = structs("double")
SMOOTH = Psf(model="gaussian", sigma_ratio=0.3)
# Float32 adds some 200 terms, each rounded by 2^-24 of a sum of about 1: at worst 1e-5, as a random walk below 1e-6.
ROUNDING = 1.5e-6
# The weights of a table are off by 1e-5 in sum with `integrated` and 1e-4 where they have kinks
# (test_point_spread.py), to both sides and not for most radii; over sources of many radii, a twentieth of that is
# left in a pixel.
FIGURE = {"sampled": ROUNDING, "area": 6e-6, "integrated": 2e-6}


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
    aperture: Aperture | None = None

    @property
    def spread(self) -> PointSpread:
        return load_point_spread(self.psf, self.aperture or Aperture())

    @property
    def channels(self) -> int:
        return int(self.sources.radiance.shape[2])

    @property
    def samples(self) -> int:
        return 0 if self.sub is None else int(self.sub.hit.shape[1])

    def grid(self) -> Struct:
        return grid_struct(*self.shape, self.guard, "double")

    def expected(self) -> Array:
        """By the twin, (rows, columns, channels)."""
        return twin.scatter(spec_of(self.psf, aperture=self.aperture), self.sources, self.sub, self.shape, self.guard)

    def table(self) -> PsfTable:
        """Weights of whole pixels, in the table that a blur finds."""
        return shared_tables().table(self.spread, self.smallest, self.largest)

    def constant(self, radius: float) -> Light:
        """The same with one radius and no gradient."""
        there = self.sources.lit
        alike = replace(self.sources, radius=np.where(there, radius, 0.0), gradient=0 * self.sources.gradient)
        return replace(self, sources=alike, sub=None, smallest=abs(radius), largest=abs(radius))


def light(
    psf: Psf, shape: tuple[int, int] = (37, 45), guard: int = 5, largest: float = 4.0, smallest: float = 0.0,
    steepest: float = 1.5, channels: int = 1, samples: int = 0, aperture: Aperture | None = None,
) -> Light:  # fmt: skip
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    sources = random_sources(size, smallest, largest, steepest, channels)
    sub = random_subpixels(sources, samples, size[0] * size[1] // 6, smallest, largest) if samples else None
    return Light(psf, sources, shape, guard, smallest, largest, sub, aperture)


def records(given: Light, radius: Array, gradient: Array, there: Array, subpixel: bool) -> Array:
    """Sources (..., 4) as aim.cl writes them, slots left out."""
    table = shared_tables().table(given.spread, given.smallest, given.largest, given.samples if subpixel else 0)
    out = np.zeros((*radius.shape, 4), np.float32)
    coordinate = table_coordinate(given.spread, radius, subpixel, table.low, table.end - table.low, table.count)
    out[..., 0] = np.where(there, coordinate, np.float32(-1))
    out[..., 1:3] = np.where(there[..., None], tilt_slope(gradient, radius), 0.0)
    return out


def on_device(session: Session, given: Light, weight: float) -> spread.Sources:
    """The sources in the layout of cast.cl; values are written to by `renormalize`."""
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
        marks = np.where(np.asarray(sub.limb), np.int32(-6), np.int32(-1))  # LIMB, WHOLE
        records_by_slot[slots, ..., 3] = marks.view(np.float32)
        value = np.zeros((given.channels, capacity, given.samples, given.samples), np.float32)
        value[:, slots] = (
            np.moveaxis(np.where(sub.hit[..., None], sub.radiance, 0.0), -1, 0) / given.samples**2 * weight
        )
        held = (upload(session, records_by_slot), copied(session, value), capacity)
    radiance = copied(session, flat(sources.radiance * weight, np.float32))
    planes = source_planes(source, given.psf.tilt, given.samples > 0)
    return spread.Sources(upload(session, planes), radiance, *held)


def features(
    psf: Psf, channels: int, samples: int, largest: float = 0.0, aperture: Aperture | None = None
) -> dict[str, int]:
    """All kernels in one target, so that few have to be compiled; test_programs_build.py builds them one by one."""
    spec = spec_of(psf, largest, aperture=aperture, subpixels=samples, border="lose")
    kernels = spread.blur_features(spec, channels, True, "wide")
    return kernels | dict.fromkeys(("GATHER", "SCATTER", "RENORMALIZE", "PREPARE"), 1)


def blur_of(session: Session, given: Light, method: Blur) -> BlurredPlane:
    sizes: dict[str, Any] = {"smallest": given.smallest, "subpixels": given.samples}
    spec = spec_of(given.psf, given.largest, method, given.aperture, **sizes)
    chosen = features(given.psf, given.channels, given.samples, given.largest, given.aperture)
    if method == "tiles":  # in a file of its own
        chosen |= spread.blur_features(spec, given.channels, True, "none") | {"RENORMALIZE": 1}
    target = Target(session, spread.FILES_OF[method], chosen, "double")
    grid = Grid.whole(*given.shape, given.guard, given.channels)
    return make_blur(target, spec, grid, given.grid())


def blurred(session: Session, given: Light, method: Blur, moments: int = 1) -> Array:
    """Plane (rows, columns, channels) of a method; moments: that many equal shares of the light."""
    owner = blur_of(session, given, method)
    owner.clear()
    sources = on_device(session, given, 1.0 / moments)
    for _ in range(moments):
        owner.add(replace(sources, radius=given.largest), [])
    image = owner.plane([]).read(session)
    return image if given.channels > 1 else image[..., None]


def assert_close(found: Array, expected: Array, limit: float) -> None:
    error = np.abs(found - expected)
    worst = np.unravel_index(int(error.argmax()), error.shape)
    assert error.max() < limit, (
        f"{error.max():.2e} at {worst}: {found[worst]} for {expected[worst]}, {(error >= limit).sum()} pixels"
    )


def renormalized(session: Session, given: Light, method: Blur) -> spread.Sources:
    """The sources after `renormalize`."""
    owner, sources = blur_of(session, given, method), on_device(session, given, 1.0)
    assert isinstance(owner, TableBlur)
    names = ("intervals", "coefficients", "sub_intervals", "sub_coefficients")
    tables = dict(zip(names, (*owner.tables[0], *owner.tables[1]), strict=True))
    planes = {"grid": given.grid(), "psf": owner.struct, **vars(sources), **tables}
    del planes["bends"]  # of ellipses alone
    run(session, owner.target, "renormalize", given.shape[::-1], PIXELS, **planes)
    return sources


def gather(session: Session, given: Light, items: int, kept: dict[str, int], **planes: Any) -> None:
    """Run as many work-items of `gather`; kept: features other than those of the blur."""
    chosen = features(given.psf, given.channels, 0, given.largest, given.aperture) | kept
    target, table = Target(session, FILES_OF["gather"], chosen, "double"), given.table()
    names = ("intervals", "coefficients", "taps", "outlines")
    planes |= {name: getattr(table, name) for name in names} | {"psf": psf_struct(given.spread, table, None, "double")}
    pad, pitch = margin(given.shape[1], given.guard, table.reach)
    run(session, target, "gather", (items,), (1,), grid=given.grid(), pad=pad, pitch=pitch, **planes)


class Signed(Amid):
    """A plane of zeros amid -0.0, which does not stay so where a 0 is added to it."""

    def __init__(self, session: Session, shape: tuple[int, ...]) -> None:
        super().__init__(session, np.zeros(shape, np.float32), -0.0)

    def now(self) -> Array:
        whole, found = download(self.session, self.all, self.held.shape, self.held.dtype), super().now()
        beside = (len(whole) - found.size) // 2
        assert np.signbit(whole[:beside]).all()
        assert np.signbit(whole[-beside:]).all()
        return found


def gather_alone(session: Session, given: Light, part_rows: int = 0, part: Amid | None = None) -> Array:
    """The frame (rows, columns, channels) after one work-item, of the first band; part_rows, part: of gather.cl.

    The grid's sources stand amid wide and bright ones. Nothing is written beyond the frame and the memory that the host
    gives to a work-item.
    """
    psf, (rows, columns) = given.psf, given.shape
    table = given.table()
    pad, pitch = margin(columns, given.guard, table.reach)
    source = source_planes(
        records(given, given.sources.radius, given.sources.gradient, given.sources.lit, False), psf.tilt, False
    )
    planes = Amid(session, source, float(source[0].max()))
    value = Amid(session, flat(given.sources.radiance, np.float32), 1.0)
    total = Signed(session, (given.channels, rows, pitch))
    size = column_bytes(given.spread, psf.tilt, given.channels, table.reach)
    own = np.zeros((3, -(-size // 128) * 32), np.float32)  # that of three work-items, and the one in the middle runs
    memory = Amid(session, own, 0.0)
    begin = memory.buffer.offset + own[0].nbytes
    scratch = memory.all.get_sub_region(begin, own[0].nbytes)
    gather(
        session, given, 1, {}, source=planes, value=value, total=total, part_rows=part_rows, part=part or total,
        scratch=scratch, scratch_size=own[0].nbytes // 8,
    )  # fmt: skip
    assert memory.now().view(np.uint32).any(axis=1).tolist() == [False, True, False]
    return np.moveaxis(total.now()[..., pad : pad + columns], 0, -1)
