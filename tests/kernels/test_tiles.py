"""tiles.cl against its twin and against scatter: every PSF and kind of source, in small frames; chosen on a GPU."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.cli.check import compare
from clsco.engine.sequence import render_prepared
from clsco.opencl.program import launch
from clsco.opencl.session import Session, session_for
from clsco.passes.blur import GROUP
from clsco.plan.prepare import prepare
from clsco.scene.file import parse_scene
from clsco.scene.model import Psf
from tests.engine.test_defocus import reference as blurred_by_reference
from tests.kernels.sources import FIGURE, ROUNDING, assert_close, blurred, light
from tests.slow import combined, mostly_slow
from tests.spreads import PSFS, layered_before_black, spec_of

KEPT = [(PSFS[5], True)]


@pytest.mark.parametrize(("psf", "tilt"), combined(PSFS, (True, False), kept=KEPT))
def test_every_psf(session: Session, psf: Psf, tilt: bool) -> None:
    given = light(psf.model_copy(update={"tilt": tilt}), shape=(19, 35))
    assert_close(blurred(session, given, "tiles"), given.expected(), FIGURE[psf.edge])


@pytest.mark.parametrize("guard", [0, 9])
def test_subpixel_sources(session: Session, guard: int) -> None:
    given = light(Psf(), shape=(11, 21), guard=guard, samples=3, channels=3)
    expected = given.expected()
    assert np.abs(expected - replace(given, sub=None).expected()).max() > 0.1
    assert_close(blurred(session, given, "tiles"), expected, FIGURE["area"])


@pytest.mark.parametrize(("smallest", "largest"), [(5.0, 8.0), (0.0, 0.0), (0.0, 0.4)])
def test_subpixel_sources_alone(session: Session, smallest: float, largest: float) -> None:
    """All of them wide, or all sharp, and nothing else that lights the frame."""
    given = light(Psf(), shape=(11, 21), guard=9, smallest=smallest, largest=largest, channels=3, samples=3)
    alone = replace(given, sources=replace(given.sources, lit=np.zeros_like(given.sources.lit)))
    expected = alone.expected()
    assert expected.max() > 0.05
    assert_close(blurred(session, alone, "tiles"), expected, FIGURE["area"])


def test_tiles_are_scatter(session: Session) -> None:
    """The same weights, in several chunks for each of several tiles; the same bits every time."""
    given = light(Psf(), shape=(43, 50), guard=3, largest=9.0, channels=3, samples=3)
    found = blurred(session, given, "tiles")
    assert_close(found, blurred(session, given, "scatter"), ROUNDING)
    assert blurred(session, given, "tiles").tobytes() == found.tobytes()
    assert_close(blurred(session, given, "tiles", moments=2), found, ROUNDING)


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (29, 1), GROUP, GROUP[::-1], (9, 17), (7, 15)])
def test_small_and_odd_frames(session: Session, shape: tuple[int, int]) -> None:
    """Also those that are smaller than the PSF, or than a tile."""
    given = light(Psf(), shape=shape, guard=9, largest=6.5, channels=3, samples=3)
    assert_close(blurred(session, given, "tiles"), given.expected(), FIGURE["area"])


def test_renormalized_borders(session: Session) -> None:
    given = light(Psf(border="renormalize"), shape=(13, 31), guard=0, channels=3, samples=3)
    assert_close(blurred(session, given, "tiles"), given.expected(), 4 * FIGURE["area"])  # as in test_blur.py


def test_what_is_not_there_adds_nothing(session: Session) -> None:
    given = light(Psf(), shape=(11, 21), samples=3, channels=3)
    assert given.sub is not None
    gone = replace(given.sources, lit=np.zeros_like(given.sources.lit))
    nothing = replace(given, sources=gone, sub=replace(given.sub, hit=np.zeros_like(given.sub.hit)))
    assert not blurred(session, nothing, "tiles").any()


@pytest.mark.parametrize("edge", mostly_slow(["sampled", "integrated"], ["sampled"]))
def test_a_wide_blur_leaves_a_uniform_image_as_it_is(session: Session, edge: Any) -> None:
    """Five thousand equal taps: a chunk's 128 round by 2^-19 of their sum at worst, and chunks lose nothing more."""
    given = light(Psf(edge=edge, tilt=False), shape=(9, 17), guard=42, largest=40.3).constant(40.3)
    ones = np.ones(given.sources.lit.shape)
    uniform = replace(given.sources, lit=ones > 0, radius=40.3 * ones, radiance=ones[..., None])
    assert np.abs(blurred(session, replace(given, sources=uniform), "tiles") - 1.0).max() < 2.0**-19


def test_a_wider_apron_changes_no_bit(session: Session) -> None:
    """Renderings that share their rays have the apron of the one that needs most."""
    given, more = light(Psf(), shape=(43, 50), guard=5, largest=9.0, channels=3, samples=3), 37
    assert given.sub is not None
    arrays: dict[str, Any] = {name: array for name, array in vars(given.sources).items() if array is not None}
    for name, array in arrays.items():
        arrays[name] = np.pad(array, [(more, more)] * 2 + [(0, 0)] * (array.ndim - 2))
    sources = replace(given.sources, **arrays)
    sub = replace(given.sub, row=given.sub.row + more, column=given.sub.column + more)
    wider = replace(given, sources=sources, sub=sub, guard=given.guard + more)
    assert blurred(session, wider, "tiles").tobytes() == blurred(session, given, "tiles").tobytes()


def test_a_sum_of_a_thousand_chunks_is_rounded_once(session: Session) -> None:
    """One or two of 128 sources are lit, so rounding is that of the sum over chunks; added naively 80 units of it."""
    radius, shape, guard = 160.3, (9, 17), 162
    given = light(Psf(edge="sampled", tilt=False), shape=shape, guard=guard, largest=radius).constant(radius)
    grid = given.sources.lit.shape
    lit = np.random.default_rng(1).random(grid) < 0.01
    sources = replace(given.sources, lit=lit, radius=np.full(grid, radius), radiance=np.ones((*grid, 1)))
    found = blurred(session, replace(given, sources=sources), "tiles")
    y, x = np.nonzero(lit)
    rows, columns = np.indices(shape) + guard
    reach = np.arange(-guard, guard + 1)
    within = np.hypot(rows[..., None] - y, columns[..., None] - x) <= radius
    expected = within.sum(axis=-1) / (np.hypot(reach, reach[:, None]) <= radius).sum()
    np.testing.assert_allclose(found[..., 0], expected, rtol=4 * 2.0**-24)


COLORS = np.random.default_rng(8).random((30, 45, 3))
BALL = {
    "camera": {"resolution": [45, 30], "pixel_pitch": 0.1, "aperture_diameter": 30.0},
    "psf": {"silhouette_samples": 2},
    "object": [{"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0, "texture": COLORS}],
}  # R up to 2.2 px, in color


@pytest.fixture
def on_a_gpu(session: Session, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """PoCL taken for a graphics card; gives the names of the kernels of the blur that are launched."""
    device = replace(session.device, kind="gpu")
    monkeypatch.setattr(import_module("clsco.opencl.session"), "choose", lambda name: device)
    names: list[str] = []

    def noted(session: Session, kernel: Any, *args: Any, **given: Any) -> Any:
        names.append(kernel.function_name)
        return launch(session, kernel, *args, **given)

    monkeypatch.setattr("clsco.opencl.program.launch", noted)
    return names


def test_a_scene_agrees_with_the_reference(on_a_gpu: list[str]) -> None:
    """By name, and chosen for a GPU."""
    scene = parse_scene(BALL)
    (exact,) = reference.render(scene)
    assert np.ptp(exact.color) > 0.1
    frame = clsco.render_frame(scene, truth=(), method="tiles", device="pocl")
    chosen = clsco.render_frame(scene, truth=())
    for each in (frame, chosen):
        assert each.metadata["blur_method"] == "tiles"
        assert [difference for difference in compare(each, exact) if difference.count] == []
    assert "tiles" in on_a_gpu
    assert not {"gather", "scatter"} & set(on_a_gpu)
    assert chosen.color.tobytes() == frame.color.tobytes()


@pytest.mark.parametrize(
    ("opening", "atomics", "chosen"), [(20.0, True, "scatter"), (20.0, False, "tiles"), (30.0, True, "tiles")]
)
def test_few_taps_are_added_by_atomics_where_the_card_has_them(
    session: Session, opening: float, atomics: bool, chosen: str
) -> None:
    scene = parse_scene(BALL).replace("camera.aperture_diameter", opening)
    known = prepare(scene, device=replace(session.device, kind="gpu", has_int64_atomics=atomics)).plan
    assert known.blur == chosen
    assert prepare(scene, device=replace(session.device, kind="cpu")).plan.blur == "gather"


def test_an_image_of_few_taps_on_a_gpu(on_a_gpu: list[str]) -> None:
    """In gray R up to 6 px, in color a third of that."""
    image = np.random.default_rng(7).random((24, 40, 3), np.float32)
    radii = np.linspace(-4.0, 4.0, 40) * np.ones((24, 1))
    gray = clsco.defocus(image[..., 0], radii, {"occlusion": "none"}, outside="black")
    assert "scatter" in on_a_gpu
    on_a_gpu.clear()
    color = clsco.defocus(image, radii, {"occlusion": "none"}, outside="black")
    assert {"tiles", "prepare_sources"} <= set(on_a_gpu)
    np.testing.assert_allclose(color[..., 0], gray, atol=1e-6)


def test_a_plan_for_a_processor_is_made_again(on_a_gpu: list[str]) -> None:
    """As commands plan before they open a device."""
    planned = prepare(parse_scene(BALL))
    assert planned.plan.blur == "gather"
    ((_, frame),) = render_prepared(session_for(None), [planned])
    assert frame.metadata["blur_method"] == "tiles"
    assert "tiles" in on_a_gpu


@pytest.mark.slow
@pytest.mark.parametrize("occlusion", ["none", "layered"])
def test_an_image_on_a_gpu(occlusion: Any, on_a_gpu: list[str]) -> None:
    """A near square before a slope: one jump, so a layer for each; coverage makes it two channels."""
    image, (rows, columns) = np.random.default_rng(6).random((24, 40), np.float32), np.indices((24, 40))
    near = (abs(rows - 12) < 6) & (abs(columns - 20) < 8)
    coc, psf = np.where(near, -4.0, 3.0 + 0.1 * columns), Psf(occlusion=occlusion)
    expected = blurred_by_reference(image, coc, psf)
    if occlusion == "layered":
        expected = layered_before_black(spec_of(psf, 7.0), image[..., None].astype(np.float64), coc)[0][..., 0]
        assert np.abs(expected - blurred_by_reference(image, coc, psf)).max() > 0.1
    assert_close(clsco.defocus(image, coc, psf, outside="black"), expected, 1e-5)  # as in test_defocus.py
    assert {"tiles", "prepare_sources"} <= set(on_a_gpu)
    assert not {"gather", "scatter"} & set(on_a_gpu)


BLURS: Any = [
    ({}, "convolve", True), ({"model": "gaussian"}, "convolve", True), ({"occlusion": "layered"}, "scatter", False),
]  # fmt: skip


@pytest.mark.processor
@pytest.mark.parametrize(("psf", "method", "constant"), mostly_slow(BLURS, BLURS[:1]))
def test_plain_opencl_has_the_bits_of_processors(
    session: Session, monkeypatch: pytest.MonkeyPatch, psf: dict[str, Any], method: str, constant: bool
) -> None:
    """The builtins of GPUs and those of processors, kernels/common/builtins.clh and its form in cpu/."""
    image = np.random.default_rng(11).random((41, 75), np.float32)
    radii = np.full(image.shape, 6.3) if constant else np.where(np.arange(75) < 30, -3.0, 7.0) + np.zeros(image.shape)
    kinds = []
    for kind in ("cpu", "gpu"):
        device = replace(session.device, kind=kind)
        monkeypatch.setattr(import_module("clsco.opencl.session"), "choose", lambda name, device=device: device)
        kinds.append(clsco.defocus(image, radii, psf, method=method))
    assert np.ptp(kinds[0]) > 0.01
    np.testing.assert_array_equal(kinds[0], kinds[1])
