"""The reference of inpainting against SciPy, closed forms and plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from clsco.errors import SceneError
from clsco.inpainting.rules import MeanMedian, border_histogram, score_scale, value_span
from clsco.reference.inpainting.mean_median import blend_border, border_pixels, inpaint, sweep_holes


def test_gradients_and_medians_are_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    values, border = rng.random((13, 17, 2)), rng.random((13, 17)) < 0.5
    square, medians = blend_border(values, border)
    planes = [values[..., c] for c in range(2)]
    expected = [sum(ndimage.sobel(p, axis, mode="nearest") ** 2 for axis in (0, 1)) for p in planes]
    np.testing.assert_allclose(square, np.max(expected, axis=0)[border], rtol=1e-12)
    filtered = [ndimage.median_filter(p, 3, mode="nearest")[border] for p in planes]
    assert (medians == np.stack(filtered, axis=-1)).all()


def test_pixels_beside_holes_are_those_that_dilation_adds() -> None:
    missing = np.random.default_rng(5).random((15, 20)) < 0.1
    assert (border_pixels(missing) == (ndimage.binary_dilation(missing, np.ones((3, 3))) & ~missing)).all()


def test_half_an_image_is_filled_row_by_row() -> None:
    """Beside a straight edge three neighbors are known in every row but at its ends: each row takes a relaxed sweep."""
    missing = np.zeros((20, 9), np.bool_)
    missing[10:] = True
    values = np.where(missing, 0.0, 3.0)[..., None]
    filled, sweeps = sweep_holes(values, ~missing, missing, np.zeros(9, np.bool_), 4)
    assert (filled == 3.0).all()
    assert sweeps == 2 * 10  # the ends have two known ones, and four when the rest of the row is filled


def test_a_flat_image_stays_flat_and_known_pixels_stay() -> None:
    rng = np.random.default_rng(7)
    missing = rng.random((30, 31)) < 0.5
    flat = np.full((30, 31, 1), 7.0, np.float32)
    found = inpaint(np.where(missing[..., None], np.nan, flat), missing, 0.0, MeanMedian())
    assert (found.blended == 7.0).all()
    image = rng.random((30, 31, 1)).astype(np.float32)
    found = inpaint(image, missing, 1.0, MeanMedian(border_share=0.0))
    assert (found.blended == found.smoothed).all()
    assert (found.blended[~missing] == image[~missing]).all()
    assert (found.filled[missing] != found.smoothed[missing]).any()


def test_the_threshold_leaves_the_wanted_share_above_it() -> None:
    gradients = np.random.default_rng(9).gamma(2.0, 30.0, 5000)
    histogram = border_histogram(gradients, 1.0, 0.4)
    assert histogram.threshold is not None
    assert histogram.counts.sum() == 5000
    assert (gradients >= histogram.threshold).mean() >= 0.4 > (gradients >= histogram.threshold + 1.0).mean()
    assert histogram.threshold == np.floor(np.quantile(gradients, 0.6, method="lower"))
    assert (histogram.least, histogram.most) == (gradients.min(), gradients.max())
    assert border_histogram(gradients, 1.0, 1.0).threshold == np.floor(gradients.min())
    assert border_histogram(gradients, 1.0, 0.0).threshold is None
    assert border_histogram(np.zeros(5), 0.0, 0.4).threshold == 0.0


@pytest.mark.parametrize("span", [0.0, 1e-30, 1e-3, 0.999, 1.0, 1.001, 255.0, 256.0, 65535.0, 1e18])
def test_scores_take_at_most_so_many_steps(span: float) -> None:
    scale = score_scale(span)
    assert np.float32(scale) == scale
    assert span * scale <= 2**16
    assert span * scale > 2**15 or span < 1e-29


def test_the_span_is_that_of_known_pixels() -> None:
    image = np.array([[1.0, np.nan, 5.0]], np.float32)
    assert value_span(image, np.isnan(image)) == 4.0
    assert value_span(np.stack([image, image + 2], axis=-1), np.isnan(image)) == 6.0
    assert value_span(np.ones((1, 3), np.uint8), np.isnan(image)) == 255.0


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        ({"estimator": "best"}, "estimator: must be scored, mean or median; got best"),
        ({"minimum": 0}, "minimum: must be a whole number from 1 to 8; got 0"),
        ({"minimum": 9}, "minimum: must be a whole number from 1 to 8; got 9"),
        ({"minimum": 4.0}, "minimum: must be a whole number from 1 to 8; got 4.0"),
        ({"smoothing_rounds": -1}, "smoothing_rounds: must be a whole number from 0 to 1000; got -1"),
        ({"border_share": 1.5}, "border_share: must be from 0 to 1; got 1.5"),
        ({"border_share": float("nan")}, "border_share: must be from 0 to 1; got nan"),
        ({"border_share": "x"}, "border_share: must be from 0 to 1; got x"),
    ],
)
def test_constants_out_of_range_are_refused(constants: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError) as caught:
        MeanMedian(**constants)  # type: ignore[arg-type]
    assert str(caught.value) == message
