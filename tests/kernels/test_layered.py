"""layered.cl against its twin: each kernel where it is whole numbers, whole frames, and that no bit changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import LAYER_TILE
from clsco.frame.strips import Grid, Strip
from clsco.opencl.buffers import download, upload
from clsco.opencl.session import Session
from clsco.optics.depth_layers import level_count, most_deep, reaches_of
from clsco.passes.blur import Image, blur_target
from clsco.passes.blur import Sources as Light
from clsco.passes.clusters import Clusters, layered_program
from clsco.passes.frame_blur import make_blur
from clsco.passes.job import Job
from clsco.passes.layered import DepthLayers
from clsco.passes.pack import grid_struct
from clsco.plan.methods import Blur, BlurSpec
from clsco.records import REAL, Real, flat
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.layered import layered as twin
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Aperture, Psf
from tests.kernels.sources import assert_close
from tests.slow import mostly_slow
from tests.spreads import spec_of

Array = NDArray[Any]
RNG = np.random.default_rng
# Float32 rounds some 200 terms, and the tables of weights are off by a little (tests/kernels/test_blur.py: together
# 2e-6); the share of a layer doubles that where its coverage is divided by itself, once per layer that was before.
FIGURE = 1e-5


class View:
    """Image of a pinhole, on the padded grid, and its blur."""

    def __init__(
        self, radii: tuple[float, ...], shape: tuple[int, int] = (47, 69), guard: int = 6, channels: int = 1,
        psf: Psf | None = None, holes: bool = False, slope: float = 0.02, cells: int = 1,
        aperture: Aperture | None = None,
    ) -> None:  # fmt: skip
        self.cells, self.aperture = cells, aperture
        self.psf, self.shape, self.guard = Psf() if psf is None else psf, shape, guard
        size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
        y, x = np.indices(size)
        rng = RNG(11)
        self.coc = np.full(size, radii[-1]) + slope * (x - size[1] / 2)
        for radius in radii[-2::-1]:  # each before those after it
            row, column, wide = rng.uniform(0, size[0]), rng.uniform(0, size[1]), rng.uniform(6, 14)
            inside = np.hypot(y - row, x - column) < wide
            self.coc = np.where(inside, radius + slope * (y - row), self.coc)
        self.valid = np.ones(size, dtype=bool)
        if holes:
            self.valid = (rng.random(size) < 0.9) & (np.hypot(y - 30, x - 50) > 9)
        self.coc = np.where(self.valid, self.coc, 0.0)
        self.radiance = np.where(self.valid[..., None], rng.random((*size, channels)), 0.0)

    @property
    def largest(self) -> float:
        return float(np.abs(self.coc).max())

    def spec(self, method: Blur = "gather") -> BlurSpec:
        return spec_of(self.psf, self.largest, method, self.aperture, layered=True, cells=self.cells)

    def expected(self) -> tuple[Array, int]:
        return twin.layered(self.spec(), self.radiance, self.coc, self.valid, self.shape, self.guard)

    def plain(self) -> Array:
        """Without occlusion."""
        gradient = prepare_sources(self.coc, self.valid)
        ones = np.ones(self.coc.shape)
        sources = Sources(self.radiance, ones, self.valid.astype(np.uint8), self.coc, gradient, self.valid)
        return scatter(spec_of(self.psf, aperture=self.aperture), sources, None, self.shape, self.guard)


class Device:
    """The view on a device."""

    def __init__(self, session: Session, view: View, method: Blur = "gather", real: Real = "double") -> None:
        spec, channels = view.spec(method), view.radiance.shape[2]
        target = blur_target(session, spec, channels, real)
        grid = grid_struct(*view.shape, view.guard, real)
        self.session, self.view, guard = session, view, view.guard
        tallest = Grid.whole(*view.shape, guard, channels)
        self.blur = make_blur(target, spec, tallest, grid)
        self.clusters = Clusters(layered_program(session, channels, real, cells=view.cells), spec, tallest)
        self.layers = DepthLayers(self.blur, self.clusters, tallest)
        self.job = Job(strip=Strip(0, view.shape[0], guard, guard), grid=grid, events=[])
        self.maps = upload(session, view.coc.astype(REAL[real])), upload(session, view.valid.astype(np.uint8))

    def image(self) -> tuple[Array, int]:
        """The frame (rows, columns, channels), and its number of layers."""
        image = Image(upload(self.session, flat(self.view.radiance, np.float32)), self.maps)
        self.blur.clear()
        self.clusters.find(self.job, [image])
        layers = self.clusters.divide(self.job, [image], self.clusters.read_bounds())
        plane = self.layers.add(self.job, layers).read(self.session)
        return plane.reshape(*self.view.shape, -1), layers.count

    def read(self, name: str, dtype: Any, shape: tuple[int, ...] = ()) -> Array:
        return download(
            self.session, (self.clusters.buffers | self.clusters.labels[0])[name], shape or self.view.coc.shape, dtype
        )


VIEWS = {
    "near and far": View((-3.5, 4.2), channels=3),
    "one side": View((1.5, 4.5)),
    "four": View((-4.2, -1.4, 1.2, 3.9), channels=3),
    "holes": View((-3.5, 0.8, 4.2), holes=True),
    "no guard": View((-3.5, 4.2), guard=0),
    "renormalized": View((-3.5, 4.2), shape=(110, 90), guard=0, psf=Psf(border="renormalize")),
    "gaussian": View((-2.5, 2.2), psf=Psf(model="gaussian")),
    "no tilt": View((-3.5, 4.2), psf=Psf(tilt=False)),
    "steep": View((-1.5, 2.2), slope=0.12),
    "quadrants": View((-3.5, 4.2), channels=3, cells=2),
    "quadrants, four": View((-8.2, -3.4, 1.2, 7.9), guard=12, cells=2),
    "quadrants, holes": View((-3.5, 0.8, 4.2), holes=True, cells=2),
    "quadrants, gaussian": View((-4.5, 3.2), psf=Psf(model="gaussian"), cells=2),
    "quadrants, no tilt": View((-5.5, 4.2), psf=Psf(tilt=False), cells=2),
    "quadrants, sampled": View((-5.5, 4.2), psf=Psf(edge="sampled"), cells=2),
    "quadrants, steep": View((-5.5, 3.2), slope=0.12, cells=2),
    "quadrants, ring": View((-8.5, 6.2), guard=10, aperture=Aperture(shape="ring"), cells=2),
    "quadrants, polygon": View((-8.5, 6.2), guard=10, aperture=Aperture(shape="polygon", blades=5), cells=2),
    "a row": View((-3.5, 4.2), shape=(1, 90), guard=0),
}


@pytest.mark.parametrize("name", mostly_slow(VIEWS, ["near and far", "quadrants"]))
def test_frames(session: Session, name: str) -> None:
    view = VIEWS[name]
    expected, count = view.expected()
    assert count > 1
    assert np.abs(expected - view.plain()).max() > 0.05
    found, layers = Device(session, view).image()
    assert layers == count
    # A source in a corner keeps a quarter of its light: its error grows as its light does.
    assert_close(found, expected, FIGURE * (4 if name == "renormalized" else 1))


def test_edges_and_tiles_are_those_of_the_twin(session: Session) -> None:
    view = View((-4.2, -1.4, 1.2, 3.9), shape=(150, 140), guard=9, channels=3, holes=True)
    view.coc[:60, 80:] = 4.0  # without an edge
    view.valid[:60, 80:] = True
    device = Device(session, view)
    _, count = device.image()
    spec = spec_of(view.psf, view.largest)
    layer = twin.cluster(spec, view.coc, view.valid)
    near, far, edge = twin.find_edges(view.coc, layer)
    marked = twin.mark_tiles(np.where(layer > 0, reaches_of(spec.psf, view.coc), -1), edge)
    assert count == layer.max() > 3
    assert marked.any()
    assert not marked.all()
    np.testing.assert_array_equal(device.read("layer", np.uint8), layer)
    np.testing.assert_array_equal(device.read("sides", np.uint8), 16 * near + far)
    tiles = device.read("marked", np.int32, tuple(-(-n // LAYER_TILE) for n in layer.shape))
    np.testing.assert_array_equal(tiles, marked[::LAYER_TILE, ::LAYER_TILE])


def test_the_last_sheet_is_that_of_the_twin(session: Session) -> None:
    view = View((-4.2, 3.9), shape=(37, 52), channels=3)
    device = Device(session, view)
    device.image()
    spec = spec_of(view.psf, view.largest)
    layer = twin.cluster(spec, view.coc, view.valid)
    near, far, _ = twin.find_edges(view.coc, layer)
    parts = twin.unmix(view.radiance, layer, near, far)
    levels = level_count(most_deep(spec.psf, view.largest))
    pixels = view.radiance, np.ones(layer.shape), view.coc, layer
    sheet, radius = twin.take_sheet(*pixels, (near, far), parts, int(layer.max()), levels)
    found = np.moveaxis(device.read("value", np.float32, (5, *view.coc.shape)), 0, -1)
    assert device.read("valid", np.bool_).all()
    # Means of means: a few roundings of 2^-24 of values up to 4; shares of mixed pixels divide by small differences.
    np.testing.assert_allclose(found, sheet, rtol=0, atol=1e-5)
    np.testing.assert_allclose(device.read("coc", np.float64), radius, rtol=0, atol=2e-6)


def test_tiles_without_an_edge_in_reach_are_plain_to_the_bit(session: Session) -> None:
    view = View((-3.5, 4.2), shape=(90, 120), channels=3)
    device = Device(session, view)
    layered, _ = device.image()
    plain = Device(session, view)
    plain.clusters.read_bounds = lambda: ()  # type: ignore[method-assign]
    alone, count = plain.image()
    tiles = device.read("marked", np.int32, tuple(-(-n // LAYER_TILE) for n in view.coc.shape)) > 0
    guard = view.guard
    marked = tiles.repeat(LAYER_TILE, 0).repeat(LAYER_TILE, 1)[guard : guard + 90, guard : guard + 120]
    assert count == 1
    assert (~marked).any()
    np.testing.assert_array_equal(layered[~marked], alone[~marked])
    assert np.abs(layered - alone)[marked].max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("cells", [1, 2])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("method", ["scatter", "tiles"])
def test_other_methods_are_gather(session: Session, method: Blur, channels: int, cells: int) -> None:
    """In fixed point, or in another order, from the same tables."""
    view = View((-3.5, 1.0, 4.2), channels=channels, cells=cells)
    (first, count), (second, same) = (Device(session, view, each).image() for each in ("gather", method))
    assert count == same
    assert_close(second, first, 4e-6)


@pytest.mark.slow
def test_single_precision(session: Session) -> None:
    # Radii of 4 px rounded by 2e-7, in a table whose weights change by all of themselves over 1 px at the rim.
    view = VIEWS["four"]
    assert_close(Device(session, view, real="float").image()[0], view.expected()[0], 2 * FIGURE)


@pytest.mark.parametrize("name", ["four", "quadrants, four"])
def test_the_same_bits_every_time(session: Session, name: str) -> None:
    view = VIEWS[name]
    device = Device(session, view)
    first, _ = device.image()
    for _ in range(3):
        assert device.image()[0].tobytes() == first.tobytes()
    assert Device(session, view).image()[0].tobytes() == first.tobytes()


@pytest.mark.parametrize(("method", "cells"), [("gather", 1), ("gather", 2), ("scatter", 1)])
def test_one_layer_is_plain_scattering_to_the_bit(session: Session, method: Blur, cells: int) -> None:
    view = View((2.0,), channels=3, slope=0.05, cells=cells)
    device = Device(session, view, method)
    found, count = device.image()
    assert count == 1
    assert_close(found, view.expected()[0], FIGURE)
    plain = Device(session, view, method).blur
    plain.clear()
    value = upload(session, flat(view.radiance, np.float32))
    plain.add(Light(device.layers.source, value), [])
    assert plain.plane([]).read(session).tobytes() == found.tobytes()
