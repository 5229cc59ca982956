"""Codes of a sensor as an image: light again, mosaics in color, and the extra that demosaicing needs."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from clsco.errors import MissingDependencyError, SceneError
from clsco.frame.demosaicing import demosaic
from clsco.frame.development import check_development, develop, sensor_truth
from clsco.optics.sensor import SensorModel, sensor_model
from clsco.scene.model import Plane, Scene, Sensor

GAIN: dict[str, Any] = {"gain": 0.5, "black_level": 100, "white_electrons": 1000.0, "bits": 16}
RAW = np.array([[[100], [600]], [[50], [350]]], np.uint16)


def model_of(channels: int, **keys: Any) -> SensorModel:
    return sensor_model(Scene(objects=(Plane(),), sensor=Sensor(**{**GAIN, **keys})), channels)


def test_codes_are_light_again() -> None:
    assert develop(RAW, model_of(1)).tolist() == [[0.0, 1.0], [np.float32(-0.1), 0.5]]
    green = model_of(1, quantum_efficiency=(1.0, 0.5, 1.0))
    assert develop(RAW, green).tolist() == [[0.0, 2.0], [np.float32(-0.2), 1.0]]
    color = develop(np.concatenate([RAW, RAW, RAW], axis=2), model_of(3, quantum_efficiency=(1.0, 0.5, 0.25)))
    assert color[0, 1].tolist() == [1.0, 2.0, 4.0]
    assert color.dtype == np.float32


def test_a_mosaic_that_is_not_demosaiced_has_what_was_measured() -> None:
    outputs = develop(RAW, model_of(3, mosaic="gbrg", quantum_efficiency=(0.5, 1.0, 0.25)))
    assert outputs.tolist() == [[[0, 0, 0], [0, 0, 4.0]], [[np.float32(-0.2), 0, 0], [0, 0.5, 0]]]
    gray = develop(RAW, model_of(1, mosaic="gbrg", quantum_efficiency=(0.5, 1.0, 0.25)))
    assert gray.tolist() == [[0.0, 4.0], [np.float32(-0.2), 0.5]]


@pytest.mark.parametrize("method", ["bilinear", "malvar", "menon"])
@pytest.mark.parametrize("mosaic", ["rggb", "bggr", "grbg", "gbrg"])
def test_an_even_color_is_found_again(method: str, mosaic: str) -> None:
    if method == "menon" and find_spec("colour_demosaicing") is None:
        pytest.skip("needs colour-demosaicing")
    known = model_of(3, mosaic=mosaic, demosaic=method, quantum_efficiency=(0.5, 1.0, 0.75))
    light = np.array([0.2, 0.6, 0.4])
    filters = np.tile(np.array(known.filters[0]).reshape(2, 2), (5, 6))
    codes = np.round(100 + 0.5 * light[filters] * np.array(known.scale)[filters]).astype(np.uint16)
    outputs = develop(codes[..., None], known)
    np.testing.assert_allclose(outputs, np.broadcast_to(light, outputs.shape), atol=2e-6)
    assert outputs.dtype == np.float32
    assert repr(np.float64(0.5)) == "np.float64(0.5)"  # which colour-demosaicing changes


@pytest.mark.parametrize(("method", "name"), [("bilinear", "bilinear"), ("malvar", "Malvar2004")])
@pytest.mark.parametrize("filters", [(0, 1, 1, 2), (1, 2, 0, 1)])
def test_colors_are_those_of_colour_demosaicing(method: str, name: str, filters: tuple[int, ...]) -> None:
    with np.printoptions():
        package = pytest.importorskip("colour_demosaicing")
    plane = np.random.default_rng(1).random((13, 10))
    pattern = "".join("RGB"[channel] for channel in filters)
    expected = getattr(package, f"demosaicing_CFA_Bayer_{name}")(plane, pattern)
    np.testing.assert_allclose(demosaic(plane, filters, method)[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-12)


@pytest.mark.parametrize("method", ["bilinear", "malvar"])
def test_gray_ramps_are_found_again(method: str) -> None:
    y, x = np.indices((9, 11))
    outputs = demosaic(2.0 * x - y, (1, 0, 2, 1), method)[2:-2, 2:-2]
    np.testing.assert_allclose(outputs, np.repeat((2.0 * x - y)[2:-2, 2:-2, None], 3, axis=2), atol=1e-12)


def test_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    known = model_of(3, mosaic="rggb", demosaic="menon")
    monkeypatch.setitem(sys.modules, "colour_demosaicing", None)
    message = r"sensor.demosaic: needs colour_demosaicing: pip install 'clsco\[sensor\]'; got "
    with pytest.raises(MissingDependencyError, match=message):
        develop(RAW, known)
    with pytest.raises(MissingDependencyError, match=message):
        check_development(known, 2, 2)
    gray = model_of(1, mosaic="rggb", demosaic="menon")
    check_development(gray, 1, 1)
    assert develop(RAW, gray)[0, 1] == 1


def test_frames_that_are_too_small() -> None:
    with pytest.raises(SceneError) as caught:
        check_development(model_of(3, mosaic="rggb", demosaic="malvar"), 1, 7)
    assert str(caught.value) == "sensor.demosaic: needs frames of 2 x 2 px at least; got 7 x 1"


def test_outputs_of_a_mosaic() -> None:
    known = model_of(3, mosaic="rggb", quantum_efficiency=(0.5, 1.0, 0.25), prnu=0.0, dsnu=0.0, dark_current=4.0)
    light = np.full((2, 2, 3), [0.1, 0.2, -0.4], np.float32)
    outputs = sensor_truth(("raw", "electrons", "noise_sigma", "saturated", "depth"), RAW, RAW > 500, light, known)
    np.testing.assert_allclose(outputs["electrons"], [[54, 204], [204, 4]], rtol=1e-6)
    np.testing.assert_allclose(outputs["noise_sigma"] ** 2, outputs["electrons"] + 4 + 1 / 3, rtol=1e-6)
    assert outputs["raw"].tolist() == RAW[..., 0].tolist()
    assert outputs["saturated"].tolist() == [[False, True], [False, False]]
    assert [array.dtype.name for array in outputs.values()] == ["uint16", "float32", "float32", "bool"]
    assert sensor_truth(("electrons", "raw"), RAW, RAW > 500, None, known).keys() == {"raw"}
