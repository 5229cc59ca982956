"""Inpainting in the studio: masks as they are painted, methods side by side, and nothing elsewhere."""

from __future__ import annotations

import shlex
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import clsco
from clsco import FileError, SceneError
from clsco.cli.main import main
from clsco.files.images import read_image, write_png
from clsco.studio.inpainting import Inpainting
from clsco.studio.presets import REMOVALS
from tests.studio.running import until


@pytest.fixture
def inpainting(tmp_path: Path) -> Iterator[Inpainting]:
    draw = np.random.default_rng(1)
    write_png(tmp_path / "small.png", draw.integers(0, 255, (12, 16, 3), np.uint8))
    opened = Inpainting(tmp_path, "pocl")
    opened.open("small.png")
    yield opened
    opened.filler.close()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_mask_comes_back_from_its_runs(inpainting: Inpainting, share: float) -> None:
    mask = np.random.default_rng(2).random((12, 16)) < share
    inpainting.mask = mask
    runs = inpainting.runs()
    inpainting.paint(16, 12, [192])
    assert not inpainting.mask.any()
    inpainting.paint(16, 12, runs)
    assert np.array_equal(inpainting.mask, mask)


@pytest.mark.parametrize(
    ("columns", "rows", "runs", "rule"),
    [
        (16, 13, [208], "must have 16 x 12 pixels; got 16 x 13"),
        (16, 12, [191], "runs must make up 192 pixels; got 191"),
        *((16, 12, runs, "lengths of runs") for runs in ([-1, 193], [10**30], ["192"], [True, 191])),
        (16, 12, [0] * (2**20 + 1), "at most 1048576 lengths"),
    ],
)
def test_what_is_no_mask_is_refused(
    inpainting: Inpainting, columns: int, rows: int, runs: list[int], rule: str
) -> None:
    with pytest.raises(FileError, match=rule):
        inpainting.paint(columns, rows, runs)
    assert not inpainting.mask.any()


def test_letters_of_one_color_are_found(inpainting: Inpainting) -> None:
    image = np.full((12, 16, 3), 90, np.uint8)
    image[3:6, 2:9] = (200, 20, 30)
    image[4, 4] = (190, 25, 35)
    write_png(inpainting.root / "letters.png", image)
    inpainting.open("letters.png")
    inpainting.add_color(2, 3, 0.0)
    assert inpainting.mask.sum() == 20
    inpainting.add_color(2, 3, 0.05)
    assert np.array_equal(np.argwhere(inpainting.mask).min(axis=0), (3, 2))
    assert inpainting.mask.sum() == 21
    inpainting.add_color(4, 4, 0.0, erase=True)
    assert inpainting.mask.sum() == 20
    assert not inpainting.mask[4, 4]
    with pytest.raises(FileError, match="must be that of a pixel"):
        inpainting.add_color(16, 3, 0.0)


def test_methods_side_by_side_are_those_of_the_command(inpainting: Inpainting) -> None:
    with pytest.raises(FileError, match="some pixel must be missing"):
        inpainting.fill("mean-median")
    with pytest.raises(SceneError, match="must be one of mean-median"):
        inpainting.fill("magic")
    inpainting.paint(16, 12, [50, 4, 12, 4, 122])
    filled = inpainting.fill("mean-median")
    assert filled is not None
    assert inpainting.filler.share > 0.99
    expected = clsco.inpaint(inpainting.image, inpainting.mask, method="mean-median", device="pocl")
    assert np.array_equal(filled.image, expected)
    table = dict(inpainting.table())
    assert table["Missing pixels"] == ["8"]
    assert table["Sweeps"] == [str(filled.figures["sweeps"])]
    assert " to " in table["Range of gradients"][0]
    assert inpainting.save("out") == ["image.png", "mask.png", "mean-median.png"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(inpainting.root)
        assert CliRunner().invoke(main, shlex.split(inpainting.command("mean-median", "out"))[1:]).exit_code == 0
    assert np.array_equal(read_image(inpainting.root / "out/mean-median/filled.png").data, expected)
    assert inpainting.picture("mean-median").startswith(b"\x89PNG")
    assert inpainting.picture("texture") == b""
    inpainting.paint(16, 12, [192])
    assert not inpainting.results


def test_auto_is_the_method_that_it_names(inpainting: Inpainting) -> None:
    inpainting.paint(16, 12, [50, 4, 12, 4, 122])
    filled = inpainting.fill("auto")
    assert filled is not None
    assert (took := filled.figures["method"]) in ("biharmonic", "texture")
    assert np.array_equal(filled.image, clsco.inpaint(inpainting.image, inpainting.mask, method=took, device="pocl"))


@pytest.mark.slow
def test_what_is_being_filled_is_canceled(inpainting: Inpainting) -> None:
    inpainting.image = np.zeros((2000, 2000, 3), np.uint8)
    inpainting.mask = np.random.default_rng(4).random((2000, 2000)) < 0.5
    found: list[object] = []
    work = threading.Thread(target=lambda: found.append(inpainting.fill("texture")))
    work.start()
    until(lambda: 0.0 < inpainting.filler.share < 1.0, 60.0)
    with pytest.raises(FileError, match="must wait for what is being filled"):
        inpainting.fill("texture")
    inpainting.filler.cancel()
    work.join(10.0)
    assert found == [None]
    assert not inpainting.results
    inpainting.open("small.png")
    inpainting.paint(16, 12, [50, 4, 138])
    assert inpainting.fill("mean-median") is not None


def test_masks_are_written_and_read(inpainting: Inpainting) -> None:
    mask = np.random.default_rng(3).random((12, 16)) < 0.4
    inpainting.mask = mask
    inpainting.save_mask("masks/one.png")
    inpainting.paint(16, 12, [192])
    inpainting.load_mask("masks/one.png")
    assert np.array_equal(inpainting.mask, mask)
    rules = {"../m.png": "below the folder", "m.jpg": r"ends in \.png", "small.png": "place of the image"}
    for name, rule in rules.items():
        with pytest.raises(FileError, match=rule):
            inpainting.save_mask(name)


@pytest.mark.parametrize("name", REMOVALS)
def test_presets_have_something_to_remove(inpainting: Inpainting, name: str) -> None:
    inpainting.open_removal(name)
    assert inpainting.image.shape[:2] == inpainting.mask.shape
    assert 0.01 < inpainting.mask.mean() < 0.2
    column, row = np.argwhere(inpainting.mask)[0][::-1]
    mask = inpainting.mask
    if name == "red_letters":  # as the thesis makes its mask
        inpainting.paint(*mask.shape[::-1], [mask.size])
        inpainting.add_color(int(column), int(row), 0.0)
        assert np.array_equal(inpainting.mask, mask)
    with pytest.raises(SceneError, match="must be one of red_letters, rope"):
        inpainting.open_removal("other")


@pytest.mark.parametrize("name", ["/etc/passwd", "gone.png", "a\0.png"])
def test_nothing_elsewhere_is_read(inpainting: Inpainting, name: str) -> None:
    for action in (inpainting.open, inpainting.load_mask):
        with pytest.raises(FileError, match="must be a file below the folder of the studio"):
            action(name)
    with pytest.raises(FileError, match="must be below the folder of the studio"):
        inpainting.save("../out")
