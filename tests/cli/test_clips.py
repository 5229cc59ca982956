"""Clips of layers in one command: a disc that moves before a plate, with a focus track."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pyopencl as cl
import pytest

import clsco
from clsco.files.images import read_image
from tests.command import done
from tests.files.test_layers import layer, save

LENS = ("--unit", "m", "--focal-length", "50mm", "--f-number", 2, "--pixel-pitch", "25um")
ROWS, COLUMNS = 32, 40


def write_frames(folder: Path, near: np.ndarray, far: np.ndarray) -> list[Path]:
    """fg_0001 to fg_0003: a disc of color `near` at 2 m that moves; plate.exr: color `far` at 4 m."""
    y, x = np.mgrid[:ROWS, :COLUMNS]
    for number in (1, 2, 3):
        alpha = np.clip(8.0 - np.hypot(y - 16, x - 12 - 4 * number), 0, 1).astype(np.float32)
        rgba = np.dstack([near * alpha[..., None], alpha]).astype(np.float32)
        z = np.where(alpha > 0.5, 2.0, np.inf).astype(np.float32)
        save(folder / f"fg_{number:04d}.exr", layer("", rgba, "RGBA") | {"Z": z})
    plate = np.broadcast_to(far, (ROWS, COLUMNS, 3)).astype(np.float32)
    save(folder / "plate.exr", layer("", plate) | {"Z": np.full((ROWS, COLUMNS), 4.0, np.float32)})
    return [folder / "fg_####.exr", folder / "plate.exr"]


def run(folder: Path, layers: list[Path], *more: object) -> list[np.ndarray]:
    words = [word for path in layers for word in ("--layer", path)]
    track = "--focus-distance", "1:2m,3:4m", "--frames", "1:4"
    done("defocus", *words, "-o", folder / "out_####.exr", *LENS, *track, *more)
    return [read_image(folder / f"out_{number:04d}.exr").data for number in (1, 2, 3)]


def test_white_stays_white_and_one_program_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    layers = write_frames(tmp_path, np.ones(3), np.ones(3))
    builds, builds_of_frames = list[int](), list[int]()
    build, defocus = cl.Program.build, clsco.defocus

    def counted_build(*args: Any, **options: Any) -> Any:
        builds.append(1)
        return build(*args, **options)

    def counted(*args: Any, **options: Any) -> Any:
        result = defocus(*args, **options)
        builds_of_frames.append(len(builds))
        return result

    monkeypatch.setattr(cl.Program, "build", counted_build)
    monkeypatch.setattr(clsco, "defocus", counted)
    for image in run(tmp_path, layers):
        np.testing.assert_allclose(image, 1.0, atol=1e-5)
    assert builds_of_frames[1:] == builds_of_frames[:1] * 2  # the second and third frame build nothing


def test_the_order_of_layers_does_not_matter_and_focus_moves(tmp_path: Path) -> None:
    layers = write_frames(tmp_path, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    images, others = run(tmp_path, layers), run(tmp_path, layers[::-1])
    for image, other in zip(images, others, strict=True):
        np.testing.assert_allclose(image, other, atol=1e-5)
        np.testing.assert_allclose(image.sum(axis=2), 1.0, atol=1e-3)  # red covers as much as it hides of blue
    # The first frame is focused on the disc, which is as sharp as its file; the last one on the plate.
    alpha = OpenEXR.File(str(tmp_path / "fg_0001.exr"), separate_channels=True).channels()["A"].pixels
    np.testing.assert_allclose(images[0][..., 0], alpha, atol=2e-3)
    assert np.abs(np.diff(images[2][16, :, 0])).max() < 0.5 * np.abs(np.diff(images[0][16, :, 0])).max()


def test_the_foreground_alone_has_alpha(tmp_path: Path) -> None:
    layers = write_frames(tmp_path, np.array([0.5, 0.25, 1.0]), np.zeros(3))
    run_words = ("-o", tmp_path / "out_####.exr", *LENS, "--focus-distance", "4m", "--frames", "1:2")
    done("defocus", "--layer", layers[0], *run_words)
    channels = OpenEXR.File(str(tmp_path / "out_0001.exr"), separate_channels=True).channels()
    rgba = np.dstack([channels[name].pixels for name in "RGBA"])
    np.testing.assert_allclose(rgba[..., :3], rgba[..., 3:] * [0.5, 0.25, 1.0], atol=1e-5)
    assert np.count_nonzero((rgba[..., 3] > 0.01) & (rgba[..., 3] < 0.99)) / rgba[..., 3].size > 0.05


def test_a_transparent_layer_has_no_effect(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    layers = write_frames(tmp_path, np.zeros(3), np.zeros(3))
    plate = layer("", rng.random((ROWS, COLUMNS, 3), np.float32)) | {"Z": np.full((ROWS, COLUMNS), 4.0, np.float32)}
    save(tmp_path / "plate.exr", plate)
    for number in (1, 2, 3):
        empty = np.zeros((ROWS, COLUMNS, 4), np.float32)
        save(tmp_path / f"fg_{number:04d}.exr", layer("", empty, "RGBA") | {"Z": empty[..., 0] + np.float32(2)})
    images = run(tmp_path, layers)
    done("defocus", tmp_path / "plate.exr", "-o", tmp_path / "alone.exr", *LENS, "--focus-distance", "2m")
    np.testing.assert_allclose(images[0], read_image(tmp_path / "alone.exr").data, atol=2e-3)
