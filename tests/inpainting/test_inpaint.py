"""`clsco.inpaint` against the reference, bit by bit, for images of every kind; what it refuses; its report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl.array as cl_array
import pytest
from numpy.typing import NDArray

import clsco
from clsco.errors import ArgumentError, ClscoError, DeviceError, SceneError
from clsco.files.images import read_image
from clsco.inpainting.report import write_report
from clsco.inpainting.rules import MeanMedian, as_stored, value_span
from clsco.opencl.session import Session
from clsco.reference.inpainting.mean_median import Inpainted
from clsco.reference.inpainting.mean_median import inpaint as reference
from tests.slow import combined

Array = NDArray[Any]
Mask = NDArray[np.bool_]
THESIS: dict[str, Any] = {"method": "mean-median"}


def picture(shape: tuple[int, ...], dtype: Any, seed: int = 1) -> Array:
    """Smooth shades with an edge and noise; floats are HDR, and some of them negative."""
    rng = np.random.default_rng(seed)
    i, j = np.indices(shape[:2])
    radiance = 0.5 + 0.3 * np.sin(i / 9.0) * np.cos(j / 7.0) + 0.2 * (j > shape[1] // 2)
    radiance = radiance.reshape(radiance.shape + (1,) * (len(shape) - 2)) + 0.1 * rng.normal(size=shape)
    if np.dtype(dtype).kind == "f":
        return (5.0 * radiance - 1.0).astype(dtype)
    return as_stored((radiance * np.iinfo(dtype).max).astype(np.float32), np.dtype(dtype))


def damage(shape: tuple[int, ...], seed: int = 2) -> Mask:
    """Single pixels, a block at a border, and a scratch."""
    rng = np.random.default_rng(seed)
    missing: Mask = rng.random(shape[:2]) < 0.2
    missing[: shape[0] // 3, shape[1] // 4 : shape[1] // 2] = True
    missing[shape[0] // 2] = True
    missing[-1, -1] = False
    return missing


def expected_of(image: Array, missing: Mask, **constants: Any) -> tuple[Array, Inpainted]:
    """Result of the reference for an image."""
    planes = image.astype(np.float32).reshape(*missing.shape, -1)
    found = reference(planes, missing, value_span(image, missing), MeanMedian(**constants))
    return np.asarray(found.blended), found


def check(image: Array, missing: Mask, **constants: Any) -> Any:
    """Fill an image by the thesis' method, and compare all stages with the reference; its report."""
    filled, report = clsco.inpaint(image, missing, **THESIS, options=MeanMedian(**constants), return_report=True)
    blended, expected = expected_of(image, missing, **constants)
    stages = report.stages
    assert stages is not None
    assert (stages.filled == expected.filled[missing]).all()
    assert (stages.smoothed == expected.smoothed[missing]).all()
    assert (stages.sweeps, stages.border.size) == (expected.sweeps, expected.border.sum())
    assert constants.get("estimator") or stages.score == expected.score
    changed = missing.copy()
    changed.ravel()[stages.border[stages.is_blended]] = True
    assert filled.dtype == image.dtype
    assert filled.shape == image.shape
    assert (filled[changed] == as_stored(blended, image.dtype).reshape(image.shape)[changed]).all()
    assert (filled[~changed] == image[~changed]).all()
    return report


DTYPES, FORMS = (np.uint8, np.uint16, np.float16, np.float32, np.float64), ((40, 51), (33, 30, 3))


@pytest.mark.parametrize(
    ("shape", "dtype"), combined(FORMS, DTYPES, kept=[*((FORMS[1], dtype) for dtype in DTYPES), (FORMS[0], np.uint8)])
)
def test_images_of_every_kind_are_those_of_the_reference(shape: tuple[int, ...], dtype: Any) -> None:
    image, missing = picture(shape, dtype), damage(shape)
    report = check(image, missing)
    assert report.stages.is_blended.sum() >= 0.4 * report.stages.border.size > 50
    if np.dtype(dtype).kind == "f":
        hidden = image.copy()
        hidden[missing] = np.nan
        assert (clsco.inpaint(hidden, missing, **THESIS) == clsco.inpaint(image, missing, **THESIS)).all()


@pytest.mark.parametrize(
    "shape",
    [(1, 2), (2, 1), (1, 40), (40, 1), (2, 2, 1), pytest.param((3, 3, 16), marks=pytest.mark.slow),
     pytest.param((8, 70, 2), marks=pytest.mark.slow), (5, 600)],
)  # fmt: skip
def test_images_of_every_size(shape: tuple[int, ...]) -> None:
    missing = damage(shape)
    missing[0, 0] = True
    check(picture(shape, np.uint8), missing)


@pytest.mark.parametrize(
    "constants",
    [
        {"estimator": "mean"}, {"estimator": "median", "minimum": 1}, {"minimum": 8, "smoothing_rounds": 3},
        {"smoothing_rounds": 0}, {"border_share": 0.0}, {"border_share": 1.0, "smoothing_rounds": 0},
    ],
)  # fmt: skip
def test_stages_can_be_turned_off_and_constants_set(constants: dict[str, Any]) -> None:
    image, missing = picture((30, 41), np.uint8), damage((30, 41))
    report = check(image, missing, **constants)
    assert (report.stages.score is None) == ("estimator" in constants)
    assert (report.stages.histogram is None) == (constants.get("border_share") == 0.0)
    assert {"seconds", "constants"} <= report.figures().keys()


def test_the_same_bits_every_time_in_bands_of_any_height(monkeypatch: pytest.MonkeyPatch) -> None:
    from clsco.inpainting import mean_median

    image, missing = picture((90, 110, 3), np.uint8), damage((90, 110))
    first = clsco.inpaint(image, missing, **THESIS)
    for values in (mean_median.BAND_VALUES, 1000):
        monkeypatch.setattr(mean_median, "BAND_VALUES", values)
        again, report = clsco.inpaint(image, missing, **THESIS, return_report=True)
        assert (again == first).all()
        assert report.figures()["missing_pixels"] == missing.sum()


def test_auto_fills_and_progress_comes_to_its_end() -> None:
    image, missing, shares = picture((40, 50), np.uint8), damage((40, 50)), list[float]()
    filled, report = clsco.inpaint(image, missing, progress=shares.append, return_report=True)
    assert shares == sorted(shares)
    assert shares[0] >= 0.0
    assert shares[-1] == pytest.approx(1.0)
    assert report.missing_pixels == missing.sum()
    assert filled.shape == image.shape


def test_a_mask_of_codes_and_arrays_on_the_device(session: Session) -> None:
    image, missing = picture((20, 30, 3), np.float32), damage((20, 30))
    expected = clsco.inpaint(image, missing, **THESIS)
    codes = np.where(missing, 255, 0).astype(np.uint8)
    assert (clsco.inpaint(image, codes, **THESIS) == expected).all()
    on_device = [cl_array.to_device(session.queue, array) for array in (image, codes)]
    filled = clsco.inpaint(*on_device, **THESIS)
    assert isinstance(filled, cl_array.Array)
    assert (filled.get() == expected).all()
    with pytest.raises(DeviceError, match=r"^image: a pyopencl array must have a queue"):
        clsco.inpaint(on_device[0].with_queue(None), on_device[1])


def test_an_image_without_missing_pixels_is_copied() -> None:
    image = picture((5, 6), np.uint8)
    filled, report = clsco.inpaint(image, np.zeros((5, 6), np.bool_), return_report=True)
    assert (filled == image).all()
    assert filled is not image
    assert (report.missing_pixels, report.stages) == (0, None)


GRAY, NOTHING = np.zeros((4, 5), np.float32), np.zeros((4, 5), np.bool_)


@pytest.mark.parametrize(
    ("image", "missing", "options", "message"),
    [
        (np.zeros((4, 5, 17), np.uint8), NOTHING, {}, "image: must have the shape (rows, columns) or"),
        (np.zeros((0, 5), np.uint8), NOTHING, {}, "image: must have the shape"),
        (np.zeros((4, 5), np.int32), NOTHING, {}, "image: must be uint8, uint16, float16, float32 or float64; got"),
        (GRAY, NOTHING.T, {}, "mask: must have the rows and columns of the image, (4, 5); got (5, 4)"),
        (GRAY, NOTHING.astype(np.int8), {}, "mask: must be bool, or uint8 of 0 and 255; got int8"),
        (GRAY, np.full((4, 5), 7, np.uint8), {}, "mask: must be 0 or 255 where it is uint8; got 20 other values"),
        (GRAY, ~NOTHING, {}, "mask: some pixel must be known; got none that is"),
        (np.full((4, 5), np.nan), NOTHING, {}, "image: known pixels must be finite, and at most 2^60 in size; got 20"),
        (np.full((4, 5), np.inf, np.float16), NOTHING, {}, "image: known pixels must be finite"),
        (np.full((4, 5, 3), -2e18), NOTHING, {}, "image: known pixels must be finite, and at most 2^60 in size"),
        (GRAY, NOTHING, {"method": "best"}, "method: must be one of auto, mean-median, biharmonic, texture; got best"),
        (GRAY, NOTHING, {"options": MeanMedian(minimum=3)}, "options: belong to method mean-median; got auto"),
        (GRAY, NOTHING, THESIS | {"options": {"rounds": 3}}, "options: must be a MeanMedian; got dict"),
    ],
)  # fmt: skip
def test_what_cannot_be_filled_is_refused(image: Array, missing: Array, options: dict[str, Any], message: str) -> None:
    before = image.copy()
    with pytest.raises((ArgumentError, SceneError)) as caught:
        clsco.inpaint(image, missing, **options)
    assert str(caught.value).startswith(message)
    assert np.array_equal(image, before, equal_nan=image.dtype.kind == "f")


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [
        ((40, 50), np.uint8),
        pytest.param((30, 40, 3), np.uint16, marks=pytest.mark.slow),
        pytest.param((30, 40, 3), np.float32, marks=pytest.mark.slow),
    ],
)
def test_the_report_tells_what_the_thesis_shows(tmp_path: Path, shape: tuple[int, ...], dtype: Any) -> None:
    image, missing = picture(shape, dtype), damage(shape)
    image = np.abs(image)
    filled, report = clsco.inpaint(image, missing, **THESIS, return_report=True)
    names = write_report(tmp_path / "report", report, image, missing, filled)
    stages = ["1_filled.png", "2_smoothed.png", "3_blended.png"]
    assert names == [*stages, "before_mask_after.png", "gradients.png", "mse.png", "report.json"]
    assert sorted(path.name for path in (tmp_path / "report").iterdir()) == names
    figures, (_, expected) = json.loads((tmp_path / "report/report.json").read_text()), expected_of(image, missing)
    histogram = expected.histogram
    assert histogram is not None
    assert (figures["missing_pixels"], figures["sweeps"]) == (missing.sum(), expected.sweeps)
    assert (figures["border_pixels"], figures["threshold"]) == (expected.border.sum(), histogram.threshold)
    assert figures["gradient_range"] == [histogram.least, histogram.most]
    mean, median = expected.score.mean_square_errors()
    assert (figures["mse"]["mean"], figures["mse"]["median"]) == (mean, median)
    better = ["median" if b < a else "mean" for a, b in zip(mean, median, strict=True)]
    assert (figures["mse"]["neighbors"], figures["mse"]["chosen"]) == ([4, 5, 6, 7, 8], better)
    last = read_image(tmp_path / "report/3_blended.png").data
    if dtype == np.uint8:
        assert (last == filled).all()
        first = read_image(tmp_path / "report/1_filled.png").data
        assert (first[missing] == as_stored(expected.filled[..., 0].astype(np.float32), image.dtype)[missing]).all()
    rows, columns = shape[:2]
    sheet = read_image(tmp_path / "report/before_mask_after.png").data
    assert sheet.shape == (rows, 3 * columns + 2 * 8, 3)
    assert (sheet[:, -columns:].reshape(last.shape) == last).all() if last.ndim == 3 else True
    assert (sheet[:, columns + 8 : 2 * columns + 8, 0] == np.where(missing, 255, 0)).all()


def test_the_report_leaves_out_what_was_turned_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, missing = picture((20, 30), np.uint8), damage((20, 30))
    off: dict[str, Any] = {"estimator": "mean", "smoothing_rounds": 0, "border_share": 0}
    filled, report = clsco.inpaint(image, missing, **THESIS, options=MeanMedian(**off), return_report=True)
    names = write_report(tmp_path, report, image, missing, filled)
    assert names == ["1_filled.png", "before_mask_after.png", "report.json"]
    assert "mse" not in report.figures()
    monkeypatch.setattr("clsco.errors.find_spec", lambda name: None)
    with pytest.raises(ClscoError, match=r"report: needs matplotlib: pip install 'clsco\[report\]'"):
        write_report(tmp_path / "other", report, image, missing, filled)
    assert not (tmp_path / "other").exists()


def test_large_sheets_are_reduced(tmp_path: Path) -> None:
    image = np.tile(np.arange(1100, dtype=np.uint8), (3, 1))
    missing = np.zeros(image.shape, np.bool_)
    missing[1, 5] = True
    filled, report = clsco.inpaint(image, missing, **THESIS, return_report=True)
    write_report(tmp_path, report, image, missing, filled)
    assert read_image(tmp_path / "before_mask_after.png").data.shape == (2, 3 * 550 + 16, 3)
