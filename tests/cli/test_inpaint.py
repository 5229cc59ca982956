"""`clsco inpaint`: files in and out, what it tells, and files that it refuses."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from numpy.typing import NDArray

import clsco
from clsco.cli.inpaint import read_pair
from clsco.cli.progress import shares
from clsco.files.images import read_image, write_exr, write_png, write_tiff
from tests.command import clsco_, done

ROWS, COLUMNS = 20, 24
MISSING = np.zeros((ROWS, COLUMNS), np.bool_)
MISSING[5:9, 3:20] = MISSING[:, 11] = True
MASK = np.where(MISSING, 255, 0).astype(np.uint8)
CODES = (np.indices((ROWS, COLUMNS)).sum(axis=0) * 5 % 256).astype(np.uint8)

Save = Callable[[str, NDArray[Any]], Path]


@pytest.fixture
def save(tmp_path: Path) -> Save:
    """save(name, array): a PNG, TIFF, EXR or NPY in the test's folder."""

    def write(name: str, array: NDArray[Any]) -> Path:
        path = tmp_path / name
        if path.suffix == ".exr":
            write_exr(path, {"Y": array} if array.ndim == 2 else {c: array[..., n] for n, c in enumerate("RGB")})
        else:
            savers: dict[str, Callable[..., None]] = {".png": write_png, ".tif": write_tiff, ".npy": np.save}
            savers[path.suffix](path, array)
        return path

    return write


def run(*words: str | Path) -> Result:
    return clsco_("inpaint", *words)


@pytest.mark.parametrize(
    ("name", "out", "dtype", "channels"),
    [
        pytest.param("image.png", "filled.png", np.uint8, 1, marks=pytest.mark.slow),
        pytest.param("image.png", "filled.tif", np.uint16, 3, marks=pytest.mark.slow),
        pytest.param("image.tif", "filled.png", np.uint8, 3, marks=pytest.mark.slow),
        ("image.tif", "filled.tif", np.float32, 3), ("image.exr", "filled.exr", np.float32, 3),
        ("image.npy", "filled.exr", np.float32, 1),
    ],
)  # fmt: skip
def test_files_are_filled_as_arrays_are(
    save: Save, tmp_path: Path, name: str, out: str, dtype: Any, channels: int
) -> None:
    data = CODES.astype(dtype) if channels == 1 else np.stack([CODES, CODES // 2, 255 - CODES], -1).astype(dtype)
    image, mask = save(name, data), save("mask.png", MASK)
    result = done("inpaint", image, mask, "-o", tmp_path / "made" / out, "--method", "mean-median")
    expected, report = clsco.inpaint(data, MISSING, method="mean-median", return_report=True)
    pixels = read_image(tmp_path / "made" / out).data
    if out.endswith(".exr") and channels == 1:
        assert (pixels[..., :1] == pixels).all()
        pixels = pixels[..., 0]
    assert pixels.dtype == expected.dtype
    assert (pixels == expected).all()
    assert report.stages is not None
    counts = (MISSING.sum(), report.stages.border.size, report.stages.sweeps)
    assert all(recorded in result.stdout for recorded in (*map(str, counts), "24 x 20", "median"))
    assert result.stderr == ""


def test_options_are_the_constants(save: Save, tmp_path: Path) -> None:
    image, mask, out = save("image.png", CODES), save("mask.png", MASK), tmp_path / "out.png"
    words = ["--estimator", "median", "--minimum", "2", "--smoothing-rounds", "3", "--border-share", "0.7"]
    assert run(image, mask, "-o", out, "--method", "mean-median", *words).exit_code == 0
    constants: dict[str, Any] = {"estimator": "median", "minimum": 2, "smoothing_rounds": 3, "border_share": 0.7}
    expected = clsco.inpaint(CODES, MISSING, method="mean-median", options=clsco.MeanMedian(**constants))
    assert (read_image(out).data == expected).all()
    result = run(image, mask, "-o", out, *words)
    assert (result.exit_code, result.stderr) == (1, "error: --estimator: belongs to --method mean-median; got auto\n")


def test_missing_pixels_of_floats_may_be_no_numbers(save: Save, tmp_path: Path) -> None:
    data = CODES.astype(np.float32)
    data[MISSING] = np.nan
    image, mask = save("image.npy", data), save("mask.png", MASK)
    assert run(image, mask, "-o", tmp_path / "out.tif").exit_code == 0
    assert np.isfinite(read_image(tmp_path / "out.tif").data).all()


def test_an_image_without_missing_pixels_is_copied_and_that_is_reported(save: Save, tmp_path: Path) -> None:
    image, mask, out = save("image.png", CODES), save("mask.png", 0 * MASK), tmp_path / "out.png"
    result = done("inpaint", image, mask, "-o", out)
    assert f"no pixel is missing: {out} is a copy of {image}\n" in result.stdout
    assert (read_image(out).data == CODES).all()


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("mask.png", np.stack([MASK] * 3, axis=-1)), ("mask.png", MASK.astype(np.uint16) * np.uint16(257)),
        ("mask.npy", MISSING.astype(np.float32)), ("mask.npy", MISSING), ("mask.npy", MISSING[None]),
    ],
)  # fmt: skip
def test_masks_of_other_kinds(save: Save, name: str, values: NDArray[Any]) -> None:
    _, missing = read_pair(save("image.png", CODES), save(name, values))
    assert (missing == MISSING).all()


def test_a_threshold_takes_masks_with_other_values(save: Save) -> None:
    values = CODES.copy()
    _, missing = read_pair(save("image.png", CODES), save("mask.png", values), 100.0)
    assert (missing == (CODES >= 100)).all()


COLORS = np.stack([MASK, MASK, 0 * MASK], axis=-1)
WRONG = CODES.astype(np.float32)
WRONG[2, 1] = np.nan
WHITE = np.ones((ROWS, COLUMNS), np.float32)


@pytest.mark.parametrize(
    ("image", "mask", "out", "message"),
    [
        (CODES, MASK[:, 1:], "out.png", "{mask}: the size must be that of {image}, 24 x 20 pixels; got 23 x 20"),
        (CODES, MASK // 255, "out.png",
         "{mask}: values must be 0 (known) or 255 (missing), or give --threshold; got 1 at row 0, column 11 ("),
        (CODES, COLORS, "out.png", "{mask}: a mask must be gray; got colors"),
        (CODES, MASK | 255, "out.png", "{mask}: some pixel must be known, and be 0; got only missing ones"),
        (WRONG, MASK, "out.tif", "{image}: values must be finite, and at most 1e+36 in size; got nan at row"),
        (WHITE, MASK, "out.png", "{out}: a PNG holds codes; for floats it must end in .tif, .tiff or .exr; got"),
        (CODES, MASK, "out.exr", "{out}: an EXR holds floats; for codes it must end in .png, .tif or .tiff; got the"),
        (CODES, MASK, "out.jpg", "{out}: must be a file that ends in one of .png .tif .tiff .exr; got '.jpg'"),
        (CODES, MASK, "out", "{out}: must be a file that ends in one of .png .tif .tiff .exr; got ''"),
        (CODES, MASK, "mask.png", "{out}: must not be the image or the mask that it is made of; got {mask}"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_are_refused(
    save: Save, tmp_path: Path, image: NDArray[Any], mask: NDArray[Any], out: str, message: str
) -> None:
    paths = {"image": save("image.npy" if image.dtype == np.float32 else "image.png", image)}
    paths |= {"mask": save("mask.png", mask), "out": tmp_path / out}
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    result = run(paths["image"], paths["mask"], "-o", paths["out"])
    assert result.exit_code == 1
    assert result.stderr.startswith(f"error: {message.format(**paths)}")
    assert result.stderr.count("\n") == 1
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_threshold_that_is_no_number_is_refused(save: Save, tmp_path: Path) -> None:
    image, mask, out = save("image.png", CODES), save("mask.png", MASK), tmp_path / "out.png"
    result = run(image, mask, "-o", out, "--threshold", "nan")
    assert (result.exit_code, result.stderr) == (1, "error: --threshold: must be a finite number; got nan\n")
    assert not out.exists()


def test_progress_is_shown_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with shares(False) as progress:
        for share in (0.0, 0.005, 0.3, 0.3, 0.999):
            progress(share)
    assert "99/100" in terminal.getvalue()


def test_all_images_of_a_folder_are_filled(save: Save, tmp_path: Path) -> None:
    mask = save("mask.png", MASK)
    for folder in ("images", "masks"):
        (tmp_path / folder).mkdir()
    for name in "ab":
        save(f"images/{name}.png", np.roll(CODES, ord(name)))
        save(f"masks/{name}.png", MASK)
    for masks in (mask, tmp_path / "masks"):
        out = tmp_path / f"{masks.stem}_{{}}.png"
        assert run(tmp_path / "images", masks, "-o", out).stdout == f"{out}: 2 images\n"
        for name in "ab":
            expected = clsco.inpaint(np.roll(CODES, ord(name)), MISSING)
            np.testing.assert_array_equal(read_image(tmp_path / f"{masks.stem}_{name}.png").data, expected)
    out = tmp_path / "one.png"
    rule = "must be a file with {} for the name of each image, or a folder without {}; got 2 images"
    assert run(tmp_path / "images", mask, "-o", out).stderr == f"error: {out}: {rule}\n"
