"""layered.cl against its twin: each kernel where it is whole numbers, whole frames, and that no bit changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.constants import NO_SEED
from clsco.frame.strips import Grid, Strip
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.session import Session
from clsco.optics import depth_layers
from clsco.optics.point_spread import point_spread
from clsco.passes.blur import Image, blur_target
from clsco.passes.blur import Sources as Light
from clsco.passes.clusters import Clusters, layered_program
from clsco.passes.frame_blur import make_blur
from clsco.passes.job import Job
from clsco.passes.layered import DepthLayers
from clsco.passes.pack import grid_struct
from clsco.plan.methods import Blur
from clsco.records import REAL, Real, flat
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.layered import layered as twin
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Psf
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
        psf: Psf | None = None, holes: bool = False, slope: float = 0.02,
    ) -> None:  # fmt: skip
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

    def expected(self) -> tuple[Array, int]:
        return twin.layered(
            spec_of(self.psf, self.largest), self.radiance, self.coc, self.valid, self.shape, self.guard
        )

    def plain(self) -> Array:
        """Without occlusion."""
        gradient = prepare_sources(self.coc, self.valid)
        ones = np.ones(self.coc.shape)
        sources = Sources(self.radiance, ones, self.valid.astype(np.uint8), self.coc, gradient, self.valid)
        return scatter(spec_of(self.psf), sources, None, self.shape, self.guard)


class Device:
    """The view on a device."""

    def __init__(self, session: Session, view: View, method: Blur = "gather", real: Real = "double") -> None:
        psf, channels = view.psf, view.radiance.shape[2]
        spec = spec_of(psf, view.largest, method)
        target = blur_target(session, spec, channels, real)
        grid = grid_struct(*view.shape, view.guard, real)
        self.session, self.view, guard = session, view, view.guard
        tallest = Grid.whole(*view.shape, guard, channels)
        self.blur = make_blur(target, spec, tallest, grid)
        kernels = layered_program(session, spec, channels, real)
        self.clusters, self.layers = Clusters(kernels, spec, tallest), DepthLayers(self.blur, kernels, tallest)
        self.job = Job(strip=Strip(0, view.shape[0], guard, guard), grid=grid, events=[])
        self.maps = upload(session, view.coc.astype(REAL[real])), upload(session, view.valid.astype(np.uint8))

    def image(self, moments: int = 1) -> tuple[Array, int]:
        """The frame (rows, columns, channels) of equal moments, and the number of layers of each."""
        light = flat(self.view.radiance / moments, np.float32)
        image = Image(empty(self.session, light.nbytes), self.maps)
        self.blur.clear()
        for _ in range(moments):
            cl.enqueue_copy(self.session.queue, image.value, light)  # "renormalize" writes to it
            self.clusters.find(self.job, image)
            layers = self.clusters.divide(self.job, image, self.clusters.read_bounds())
            self.layers.add(self.job, layers)
        plane = self.blur.plane(self.job.events).read(self.session)
        return plane.reshape(*self.view.shape, -1), layers.count

    def read(self, name: str, dtype: Any) -> Array:
        return download(self.session, self.clusters.buffers[name], self.view.coc.shape, dtype)


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
    "a row": View((-3.5, 4.2), shape=(1, 90), guard=0),
}


@pytest.mark.parametrize("name", mostly_slow(VIEWS, ["near and far"]))
def test_frames(session: Session, name: str) -> None:
    view = VIEWS[name]
    expected, count = view.expected()
    assert count > 1
    assert np.abs(expected - view.plain()).max() > 0.05
    found, layers = Device(session, view).image()
    assert layers == count
    # A source in a corner keeps a quarter of its light: its error grows as its light does.
    assert_close(found, expected, FIGURE * (4 if name == "renormalized" else 1))


def test_labels_are_those_of_the_twin(session: Session) -> None:
    view = View((-4.2, -1.4, 1.2, 3.9), shape=(150, 140), guard=9, channels=3, holes=True)
    device = Device(session, view)
    _, count = device.image()
    low, bins = depth_layers.bins_of(view.largest)
    assert (device.clusters.low, device.clusters.bins) == (low, bins)
    latest, largest_sum = twin.find_discontinuities(
        view.coc, view.valid, low, bins, 2 * point_spread(view.psf).reach(view.largest) + 1
    )
    device.clusters.find(device.job, Image(empty(session, 1), device.maps))
    found = download(session, device.clusters.buffers["latest"], (latest.size + 1,), np.int32)
    np.testing.assert_array_equal(found, [*latest.ravel(), largest_sum])
    layer = twin.label_depth_layers(view.coc, view.valid, low, bins, depth_layers.layer_bounds(latest.astype(np.int32)))
    seed = twin.seed_hidden(view.coc, layer)
    offset = twin.column_seeds(seed)
    hidden, edge = twin.reach_hidden(
        layer, seed, offset, depth_layers.depth_of_hidden(point_spread(view.psf), largest_sum)
    )
    assert count == layer.max() > 3
    assert (hidden > 0).any()
    assert not edge.all()
    for name, dtype, expected in (
        ("layer", np.uint8, layer), ("seed", np.uint8, seed), ("offset", np.int32, offset),
        ("hidden", np.uint8, hidden), ("edge", np.bool_, edge),
    ):  # fmt: skip
        np.testing.assert_array_equal(device.read(name, dtype), expected, err_msg=name)


def test_seeds_of_frames_taller_than_any_blur(session: Session) -> None:
    """Rows whose nearest seed is too far away to be kept, or beyond where it could be counted in some whole number."""
    view = View((2.0, 2.0), shape=(40000, 3), guard=0, channels=3, slope=0.0)
    view.coc[20:50, 1], view.coc[33000, 0] = -2.0, 5.0
    device = Device(session, view)
    _, count = device.image()
    layer = np.where(view.coc < 0, 1, np.where(view.coc < 3, 2, 3)).astype(np.uint8)
    np.testing.assert_array_equal(device.read("layer", np.uint8), layer)
    seed = twin.seed_hidden(view.coc, layer)
    offset = twin.column_seeds(seed)
    assert count == 3
    assert (offset == NO_SEED).any(axis=0).all()
    assert np.abs(offset[:, 1]).max() > 10000
    np.testing.assert_array_equal(device.read("seed", np.uint8), seed)
    np.testing.assert_array_equal(device.read("offset", np.int32), offset)
    deep = depth_layers.depth_of_hidden(point_spread(view.psf), 7)
    hidden, edge = twin.reach_hidden(layer, seed, offset, deep)
    np.testing.assert_array_equal(device.read("hidden", np.uint8), hidden)
    np.testing.assert_array_equal(device.read("edge", np.bool_), edge)
    assert edge[32000:34000].any()
    assert not edge[32700:32800].any()


def test_the_last_layer_is_extended_as_by_the_twin(session: Session) -> None:
    view = View((-4.2, 3.9), shape=(37, 52), channels=3)
    device = Device(session, view)
    device.image()
    layer, hidden = device.read("layer", np.uint8), device.read("hidden", np.uint8)
    _, largest_sum = twin.find_discontinuities(
        view.coc, view.valid, *depth_layers.bins_of(4.5), 2 * point_spread(view.psf).reach(view.largest) + 1
    )
    deep = depth_layers.depth_of_hidden(point_spread(view.psf), largest_sum)
    value, radius, there = twin.extend_depth_layer(view.radiance, view.coc, layer, hidden, int(layer.max()), deep)
    size = view.coc.shape
    found = np.moveaxis(download(session, device.clusters.buffers["value"], (4, *size), np.float32), 0, -1)
    # A mean of means, each of 16 terms: a few roundings of 2^-24 of values up to 4.
    np.testing.assert_allclose(found, value, rtol=0, atol=1e-6)
    np.testing.assert_allclose(device.read("coc", np.float64), radius, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(device.read("valid", np.bool_), there)


@pytest.mark.slow
@pytest.mark.parametrize("channels", [1, 3])
def test_scatter_is_gather(session: Session, channels: int) -> None:
    """In fixed point, in another order, from the same tables."""
    view = View((-3.5, 1.0, 4.2), channels=channels)
    (first, count), (second, same) = (Device(session, view, method).image() for method in ("gather", "scatter"))
    assert count == same
    assert_close(second, first, 4e-6)


@pytest.mark.slow
def test_single_precision(session: Session) -> None:
    # Radii of 4 px rounded by 2e-7, in a table whose weights change by all of themselves over 1 px at the rim.
    view = VIEWS["four"]
    assert_close(Device(session, view, real="float").image()[0], view.expected()[0], 2 * FIGURE)


def test_moments_add_up(session: Session) -> None:
    view = VIEWS["near and far"]
    device = Device(session, view)
    once, _ = device.image()
    assert_close(device.image(moments=3)[0], once, 1e-6)


def test_the_same_bits_every_time(session: Session) -> None:
    view = VIEWS["four"]
    device = Device(session, view)
    first, _ = device.image()
    for _ in range(3):
        assert device.image()[0].tobytes() == first.tobytes()
    assert Device(session, view).image()[0].tobytes() == first.tobytes()


@pytest.mark.parametrize("method", ["gather", "scatter"])
def test_one_layer_is_plain_scattering_to_the_bit(session: Session, method: Blur) -> None:
    view = View((2.0,), channels=3, slope=0.05)
    device = Device(session, view, method)
    found, count = device.image()
    assert count == 1
    assert_close(found, view.expected()[0], FIGURE)
    plain = Device(session, view, method).blur
    plain.clear()
    value = upload(session, flat(view.radiance, np.float32))
    plain.add(Light(device.layers.source, value), [])
    assert plain.plane([]).read(session).tobytes() == found.tobytes()
