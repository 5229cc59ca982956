"""Approximations by coarser grids: how far off they are, when they are taken, and what is reported of them."""

from __future__ import annotations

import gc
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from click.testing import CliRunner

import clsco
from clsco.cli.main import main
from clsco.engine.defocus import DefocusReport
from clsco.errors import SceneError
from clsco.optics.multigrid import coarse_frame, coarse_radius
from clsco.optics.psf import weights
from clsco.plan.approximation import METHODS, candidates, estimate, sample_places
from clsco.reference.blur.blur import scatter
from clsco.reference.blur.multigrid import coarse
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Psf
from tests.scenes import scene_file

PILLBOX, GAUSSIAN = Psf(tilt=False), Psf(model="gaussian", tilt=False)


def of_one_radius(radiance: Any, radius: float) -> Sources:
    shape = radiance.shape
    there = np.ones(shape, bool)
    label, gradient = there.astype(np.uint8), np.zeros((*shape, 2))
    return Sources(radiance[..., None], np.ones(shape), label, np.full(shape, radius), gradient, there)


def one_step(psf: Psf, radius: float, least: float, guard: int) -> float:
    """RMS error of the twin in a frame of uniform noise of 0 to 1, all of one radius."""
    side = 48 + 2 * guard
    light = of_one_radius(np.random.default_rng(3).random((side, side)), radius)
    exact = scatter(psf, light, None, (48, 48), guard)
    found, wide = coarse(psf, light, None, (48, 48), guard, least)
    assert wide.mean() > 0.4  # all light takes that way
    return float(np.sqrt(np.mean((found - exact) ** 2)))


def test_a_disc_on_a_coarser_grid_is_off_by_its_edge_only() -> None:
    # Noise of deviation 0.29 under weights of 1 / pi R^2 that are wrong in an edge 2 pi R long and about one node
    # (2 px) wide, there by a quarter of their height: 0.29 sqrt(4 pi R / 16) / pi R^2.
    errors = {radius: one_step(PILLBOX, radius, 2.6, 16) for radius in (6.7, 9.5)}
    for radius, error in errors.items():
        edge = 0.29 * np.sqrt(4.0 * np.pi * radius / 16.0) / (np.pi * radius**2)
        assert 0.25 * edge < error < edge


def test_a_gaussian_loses_next_to_nothing() -> None:
    # Its spectrum ends before a node's: what folds over is exp(-(pi s)^2 / 2), s = sigma in nodes = 2.1 here, 3e-10 of
    # it; what is left are the two cuts at 3 sigma, which hold 0.3 % of the light each at slightly different radii.
    assert one_step(GAUSSIAN, 6.0, 2.3, 16) < 0.003 * 0.29


def test_second_moments_are_kept() -> None:
    # So that what is smooth looks the same: of a step of noise-free light x^2, the blur adds the second moment.
    side, guard = 40, 24
    offset = np.arange(side + 2 * guard) - (side + 2 * guard - 1) / 2.0
    light = of_one_radius(np.broadcast_to(offset**2, (offset.size, offset.size)).copy(), 9.0)
    for psf in (PILLBOX, Psf(tilt=False, edge="area")):
        exact, found = (
            scatter(psf, light, None, (side, side), guard),
            coarse(psf, light, None, (side, side), guard, 3.0)[0],
        )
        moment = 9.0**2 / 4.0
        middle = slice(12, 28)  # the light that is not there outside of the guard band does not reach it
        assert np.abs(found - exact)[middle, middle].max() < 0.01 * moment
        assert abs((exact[20, 20, 0] - offset[20 + guard] ** 2) - moment) < 0.01 * moment


def test_no_light_is_lost_and_level_light_stays_level() -> None:
    side = 72
    light = np.zeros((side, side))
    light[30:42, 30:42] = 1.0
    for psf in (PILLBOX, GAUSSIAN):
        found, _ = coarse(psf, of_one_radius(light, 6.0), None, (side, side), 0, 2.0)
        assert found.sum() == pytest.approx(light.sum(), rel=1e-6)
    level = clsco.defocus(np.ones((128, 128)), np.full((128, 128), 9.0), PILLBOX, method="coarse4")
    assert np.abs(level[20:-20, 20:-20] - 1.0).max() < 1e-5  # weights add up to 1 on every grid
    slope = np.broadcast_to(np.linspace(8.0, 16.0, 128), (128, 128))
    tilted = clsco.defocus(np.ones((128, 128)), slope, method="coarse4")
    exact = clsco.defocus(np.ones((128, 128)), slope, method="gather")
    assert np.abs(exact - 1.0)[36:-36, 36:-36].max() < 2e-3  # the tilt does that, and so it does on coarser grids
    assert np.abs(tilted - 1.0)[36:-36, 36:-36].max() < 2e-3


@pytest.fixture(scope="module")
def scene() -> tuple[Any, Any, Any]:
    """Noise, radii of a tilted plane and their exact blur."""
    image = np.random.default_rng(5).random((160, 192)).astype(np.float32)
    coc = np.broadcast_to(np.linspace(10.0, 24.0, 192), image.shape)
    return image, coc, clsco.defocus(image, coc)


def test_the_method_follows_the_tolerance(scene: tuple[Any, Any, Any]) -> None:
    image, coc, exact = scene
    chosen = []
    for tolerance in (1e-2, 2e-3, 1e-3, 1e-6):
        found, one = clsco.defocus(image, coc, tolerance=tolerance, return_report=True)
        off = float(np.sqrt(np.mean((found.astype(np.float64) - exact) ** 2)))
        assert off <= tolerance
        assert one.rms_error == pytest.approx(off, rel=0.3, abs=1e-9)  # of 256 pixels
        assert one.tolerance == tolerance
        assert one.at_most <= tolerance
        assert all(error > tolerance for _, error in one.tried)
        chosen.append(one.method)
    assert chosen[0] == "coarse2"
    assert chosen[-1] == "exact"
    assert len(set(chosen)) >= 3
    assert np.array_equal(found, exact)  # to the bit


def test_errors_are_measured_where_they_are(scene: tuple[Any, Any, Any]) -> None:
    image, coc, exact = scene
    found, one = clsco.defocus(image, coc, method="coarse2", return_report=True)
    place = sample_places(*image.shape)
    off = (found - exact)[place[:, 0], place[:, 1]]
    rms, at_most = estimate(off[:, None])
    assert rms > 1e-4
    assert (one.method, one.tolerance, one.pixels, one.tried) == ("coarse2", None, len(place), ())
    assert (one.rms_error, one.at_most) == pytest.approx((rms, at_most), rel=1e-2)
    assert np.array_equal(found, clsco.defocus(image, coc, method="coarse2"))  # measured or not


@pytest.mark.parametrize("how", [{}, {"method": "coarse2"}, {"tolerance": 0.01}])
def test_buffers_are_given_back_at_once(scene: tuple[Any, Any, Any], how: dict[str, Any]) -> None:
    image, coc, _ = scene
    clsco.defocus(image, coc, **how)  # what a session keeps is there then
    gc.collect()
    gc.disable()
    try:
        clsco.defocus(image, coc, **how)
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        assert [type(each) for each in gc.garbage if isinstance(each, cl.Buffer)] == []  # in cycles of references
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()


def test_places_are_spread_over_the_frame() -> None:
    places = sample_places(100, 200)
    assert places.shape == (256, 2)
    assert places.min() >= 0
    assert (places.max(axis=0) < [100, 200]).all()
    quarters = (places // [50, 100]) @ [2, 1]
    assert np.bincount(quarters, minlength=4).min() >= 60  # 64 each would be even


def test_what_is_too_narrow_is_not_approximated() -> None:
    assert candidates(Psf(), np.array([2.0, 6.0])) == ()
    assert candidates(Psf(), np.array([60.0])) == tuple(METHODS)
    assert candidates(Psf(), np.array([12.0])) == ("coarse2", "coarse4")
    assert candidates(Psf(), np.array([11.0])) == ()  # the exact way is faster there
    assert candidates(Psf(edge="sampled"), np.array([12.0])) == ()
    assert candidates(Psf(model="gaussian"), np.array([12.0])) == ("coarse2", "coarse4")
    assert candidates(Psf(border="renormalize"), np.array([60.0])) == ()
    image, coc = np.ones((16, 16)), np.full((16, 16), 3.0)
    found, report = clsco.defocus(image, coc, tolerance=1.0, return_report=True)
    assert np.array_equal(found, clsco.defocus(image, coc))
    assert report == DefocusReport("exact", 1.0, 0.0, 0.0, 0)
    assert report.line() == "exact: nothing that fits the memory is faster"


def test_a_radius_shrinks_with_its_grid() -> None:
    # Of a disc far beyond its edge half as wide; less by what the way there and back blurs by itself.
    assert coarse_radius(PILLBOX, 100.0, finest=True) == pytest.approx(50.0, rel=1e-3)
    assert coarse_radius(PILLBOX, 4.0, finest=True) < 2.0
    assert coarse_radius(PILLBOX, 0.1, finest=True) == 0.0
    # Nodes of a frame of 10 x 7 px in a band of 3: those that its pixels lie between, and one more on each side.
    assert coarse_frame(10, 7, 3) == (8, 7, 2)


@pytest.mark.parametrize("psf", [Psf(), Psf(edge="sampled"), GAUSSIAN, Psf(model="gaussian", edge="sampled")])
def test_second_moments_are_those_of_the_weights(psf: Psf) -> None:
    from clsco.optics.psf import shape_of

    offset, radius = np.arange(-40.0, 41.0), 12.0
    table = weights(psf, offset[None, :], offset[:, None], np.asarray(radius))
    found = float((table * offset[None, :] ** 2).sum())
    # A circle of pixel centers is not round, by up to 3 % at 12 px.
    assert found == pytest.approx(shape_of(psf).second_moment * radius**2 + shape_of(psf).pixel_moment, rel=3e-2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tolerance": 0.0}, "tolerance: must be a number above 0"),
        ({"tolerance": float("nan")}, "tolerance: must be a number above 0"),
        ({"tolerance": 1e-3, "method": "gather"}, "tolerance: chooses the method"),
        ({"method": "coarse3"}, "method: must be one of auto"),
        ({"method": "coarse4", "psf": {"border": "renormalize"}}, "method: coarse4 needs psf.border"),
    ],
)
def test_what_cannot_be_asked_for(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        clsco.defocus(np.ones((4, 4)), np.ones((4, 4)), **arguments)


SCENE = """
[camera]
f_number = 0.5
resolution = [96, 80]
[[object]]
shape = "plane"
distance = 300.0
slope_x = 0.3
texture = "bricks"
"""


@pytest.mark.slow
def test_the_commands_tell_what_was_taken(tmp_path: Path) -> None:
    path, out = scene_file(tmp_path / "scene.toml", SCENE), tmp_path / "out"

    def recorded(*arguments: str) -> dict[str, Any]:
        result = CliRunner().invoke(main, ["render", str(path), "-o", str(out), "--quiet", *arguments])
        assert result.exit_code == 0, result.output
        content: dict[str, Any] = json.loads((out / "frame_0000.json").read_text("utf-8"))
        taken = content["approximation"]
        assert (f"{taken['method']}: " in result.stderr) if taken else not result.stderr
        return content

    assert recorded()["approximation"] is None
    wide = recorded("--tolerance", "0.05")
    assert (wide["blur_method"], wide["approximation"]["method"]) == ("gather", "coarse2")
    assert 0.0 < wide["approximation"]["at_most"] <= 0.05
    narrow = recorded("--tolerance", "1e-7")["approximation"]
    assert (narrow["method"], narrow["rms_error"]) == ("exact", 0.0)
    assert narrow["tried"][0][0] == "coarse2"
    named = recorded("--method", "coarse2", "--resume")["approximation"]  # another one than what is there
    assert (named["method"], named["tolerance"]) == ("coarse2", None)
    assert named["rms_error"] == wide["approximation"]["rms_error"]
    files = sorted(out.iterdir())
    again = CliRunner().invoke(main, ["render", str(path), "-o", str(out), "--method", "coarse2", "--resume"])
    assert (again.exit_code, again.stderr, sorted(out.iterdir())) == (0, "", files)


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("--method", "coarse3"), 2, "--method: must be one of auto, coarse2"),
        (("--method", "coarse2", "--tolerance", "1"), 2, "--tolerance: chooses the method"),
        (("--tolerance", "0"), 2, "--tolerance"),
        (("--method", "coarse2", "--set", 'psf.border="renormalize"'), 1, "method: coarse2 needs psf.border"),
    ],
)
def test_what_the_commands_refuse(tmp_path: Path, arguments: tuple[str, ...], status: int, message: str) -> None:
    path, out = scene_file(tmp_path / "scene.toml", SCENE), tmp_path / "out"
    result = CliRunner().invoke(main, ["render", str(path), "-o", str(out), *arguments])
    assert result.exit_code == status
    assert message in result.stderr
    assert not out.exists()
