"""Sizes and limits of memory, and the strips that fit."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.constants import BAND, TAP_LANES
from clsco.errors import SceneError
from clsco.plan import memory
from clsco.plan.buffers import margin
from clsco.plan.device import ThisMachine
from clsco.plan.image import ImagePlan
from clsco.plan.memory import Limit, device_bytes, fit_strips, limit_of, parse_size, rows_that_fit
from clsco.resources import machine_bytes
from tests.command import clsco_
from tests.scenes import scene_file
from tests.slow import mostly_slow


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("1.5GiB", 3 * 2**29), ("800MB", 800_000_000), ("800 mb", 800_000_000), ("64KiB", 65536), ("2kB", 2000),
        ("1TiB", 2**40), ("12345", 12345), (12345, 12345), ("7 B", 7), ("0.5kb", 500),
    ],
)  # fmt: skip
def test_sizes(text: str | int, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize(
    "text", ["", "GiB", "-1GiB", "1 PiB", "1e9", "nan", "inf", "1.5.0MB", "٣MB", "0", 0, -5, "0.1B"]
)
def test_what_is_no_size(text: str | int) -> None:
    with pytest.raises(SceneError, match=r"^memory: must be a size greater than 0, like 1.5GiB or 800MB; got "):
        parse_size(text)


def test_the_limit_is_given_or_half_of_what_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine_bytes() > machine_bytes(free=True) > 2**20
    monkeypatch.setattr(memory, "machine_bytes", lambda free: 1000)
    large, small = (ThisMachine(global_mem=size, max_alloc=700) for size in (3000, 600))
    assert limit_of(None, large) == Limit(500, 700, set_by_user=False)
    assert limit_of(None, small).total == 300
    assert limit_of(None, replace(large, unified_memory=False)).total == 1500
    assert limit_of("2kB", small) == Limit(2000, 700, set_by_user=True)


@pytest.mark.parametrize("guard", [0, 3, 24])
@pytest.mark.parametrize("far", [0, 7, 22, 60])
def test_rows_of_the_frame_do_not_lie_below_each_other_in_the_cache(guard: int, far: int) -> None:
    """Vectors hang over by up to `far` and TAP_LANES more; 45 rows of 8 doubles a vector share no place in 4 KiB."""
    for columns in range(1, 2200, TAP_LANES):
        pad, pitch = margin(columns, guard, far)
        assert pad % TAP_LANES == pitch % TAP_LANES == 0
        assert pad >= guard + far + TAP_LANES
        assert columns + 2 * pad <= pitch <= columns + 2 * pad + 12 * TAP_LANES
        places = np.arange(45) * pitch * 8 % 4096
        assert len(set(places.tolist())) == 45
        step = pitch * 8 % 4096
        assert min(step, 4096 - step) >= 256


def test_the_tallest_strips_that_fit() -> None:
    def sizes(rows: int) -> dict[str, int]:
        return {"fixed": 1000, "strip": 10 * rows, "truth": 2 * rows}

    def rows(total: int, buffer: int = 2**40, set_by_user: bool = True, views: int = 1, whole: bool = False) -> int:
        return rows_that_fit(500, Limit(total, buffer, set_by_user, views), sizes, whole)

    assert rows(7000) == 500
    assert rows(6999) == 7 * BAND
    assert rows(1000 + 12 * 3 * BAND) == 3 * BAND
    assert rows(1000 + 12 * 3 * BAND - 1) == 2 * BAND
    assert rows(1000 + 12 * BAND) == BAND
    assert rows(10**6, buffer=10 * 2 * BAND + 9) == 2 * BAND
    assert rows(13_000, views=2) == 500  # truth is made for one view after the other
    assert rows(12_999, views=2) == 7 * BAND
    with pytest.raises(SceneError, match=r"must be at least 1 MiB for this frame, in strips of 64 rows; got"):
        rows(1000 + 12 * BAND - 1)
    assert rows(999, set_by_user=False) == BAND
    assert rows(7000, whole=True) == 500
    with pytest.raises(SceneError, match=r"least 1 MiB for this frame, as the forward warp needs the whole frame; got"):
        rows(6999, whole=True)
    assert rows(6999, set_by_user=False, whole=True) == 500


RNG = np.random.default_rng(5)
SHAPE = (3 * BAND + 10, 70)


BLURS: list[tuple[Any, ...]] = [
    ("gather", 16.0, {}, ()), ("scatter", 9.0, {}, ()), ("convolve", 7.0, {}, (3,)),
    ("gather", 3.0, {}, (3,)), ("gather", 9.0, {"border": "renormalize", "edge": "sampled"}, (1,)),
    ("scatter", 9.0, {"model": "gaussian"}, ()), ("tiles", 4.0, {}, ()),
    ("convolve", 17.0, {}, ()), ("convolve", 3.0, {"model": "gaussian"}, ()),
]  # fmt: skip
LAYERED: list[tuple[Any, ...]] = [
    ("gather", {}, (3,)), ("scatter", {"border": "renormalize"}, ()),
    ("tiles", {"model": "gaussian", "edge": "area"}, ()),
]  # fmt: skip


@pytest.mark.parametrize(("method", "radius", "psf", "channels"), mostly_slow(BLURS, BLURS[:3]))
def test_an_image_in_strips(
    method: str, radius: float, psf: dict[str, object], channels: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same bits as the whole image, from as little memory as is possible."""
    image = RNG.random((*SHAPE, *channels), np.float32)
    i, j = np.indices(SHAPE)
    coc = radius * (np.ones(SHAPE) if method == "convolve" else np.sin(i / 23.0) * np.cos(j / 31.0))
    assert_strips(image, coc, psf, method, monkeypatch)


@pytest.mark.parametrize(("method", "psf", "channels"), mostly_slow(LAYERED, LAYERED[:1]))
def test_layers_in_strips(
    method: str, psf: dict[str, object], channels: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The farthest surfaces of the image are in its first rows, the nearest in its last ones."""
    image = RNG.random((*SHAPE, *channels), np.float32)
    i, j = np.indices(SHAPE)
    coc = np.where(np.sin(i / 9.0) * np.cos(j / 11.0) > 0.2, -0.4, 1.5) - i / SHAPE[0]
    assert_strips(image, coc, {"occlusion": "layered"} | psf, method, monkeypatch)
    plain = clsco.defocus(image, coc, {"occlusion": "none"} | psf, method=method)
    assert np.abs(clsco.defocus(image, coc, {"occlusion": "layered"} | psf, method=method) - plain).max() > 0.1


def assert_strips(
    image: np.ndarray[Any, Any], coc: np.ndarray[Any, Any], psf: dict[str, object], method: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    needed: dict[int, int] = {}
    used: list[int] = []

    def noted(plan: ImagePlan, limit: Limit) -> ImagePlan:
        needed[BAND] = device_bytes(replace(plan, strip_rows=BAND))
        found = fit_strips(plan, limit)
        used.append(len(found.strips))
        return found

    monkeypatch.setattr(import_module("clsco.engine.defocus"), "fit_strips", noted)
    whole = clsco.defocus(image, coc, psf, method=method)
    assert used[-1] == 1
    with pytest.raises(SceneError, match=r"^memory: must be at least \d+ MiB for this frame, in strips of 64 rows"):
        clsco.defocus(image, coc, psf, method=method, memory=1000)
    tiled = clsco.defocus(image, coc, psf, method=method, memory=needed[BAND])
    assert used[-1] == 4
    assert whole.shape == image.shape
    np.testing.assert_array_equal(tiled.view(np.uint32), whole.view(np.uint32), strict=True)


FLOOR = '[camera]\nresolution = [100, 500]\n[[object]]\nshape = "plane"\ndistance = 300.0\nslope_y = 0.2\n'


@pytest.mark.processor  # whose buffers these are
def test_commands_take_a_limit(tmp_path: Path) -> None:
    scene, out = scene_file(tmp_path / "plane.toml", FLOOR), tmp_path / "out"
    assert "1, the whole frame" in clsco_("plan", scene).stdout
    recorded = clsco_("plan", scene, "--memory", "2300kB")
    assert "3 of up to 192 rows, with up to 16 more on either side" in recorded.stdout
    for command in (("plan", scene), ("render", scene, "-o", out)):
        refused = clsco_(*command, "--memory", "300kB")
        assert (refused.exit_code, refused.stdout) == (1, "")
        assert refused.stderr.startswith(
            f"error: {scene}: memory: must be at least 2 MiB for this frame, in strips of 64"
        )
        wrong = clsco_(*command, "--memory", "lots")
        assert wrong.exit_code == 2
        assert "'--memory': must be a size greater than 0, like 1.5GiB or 800MB; got lots" in wrong.stderr
    assert not out.exists()
    done = clsco_("render", scene, "-o", out, "--memory", "2300kB")
    assert done.exit_code == 0, done.output
    assert json.loads((out / "frame_0000.json").read_text())["strips"] == 3


def test_a_depth_map_that_moves_needs_the_whole_frame(tmp_path: Path) -> None:
    image, depth, out = tmp_path / "image.npy", tmp_path / "depth.npy", tmp_path / "out"
    np.save(image, RNG.random((90, 80), np.float32))
    np.save(depth, np.full((90, 80), 400.0, np.float32))
    moved = ("--set", "object.0.motion.velocity=[9,0,0]", "--set", "sequence.shutter=0.1")
    for target, options, why in (
        (out, moved, "as the forward warp needs the whole frame"),
        (tmp_path / "out.png", (), "in strips of 64 rows"),
    ):
        refused = clsco_("defocus", image, depth, "-o", target, "--memory", "100kB", *options)
        assert (refused.exit_code, refused.stdout) == (1, "")
        assert f"error: {image}: memory: must be at least " in refused.stderr
        assert f" MiB for this frame, {why}; got 0.09537 MiB" in refused.stderr
        assert not target.exists()
