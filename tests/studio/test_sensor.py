"""The sensor in the studio: its panel, its views, and what they say where there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.studio.forms import panels
from clsco.studio.pictures import DRAGGING, EXACT, FLOAT16, FLOAT32, picture_of, truth_of
from clsco.studio.session import Document

SCENE = clsco.Scene(
    camera=clsco.Camera(resolution=(12, 8), pixel_pitch=0.2), objects=(clsco.Sphere(texture="#c08040"),),
    sensor=clsco.Sensor(bits=16),
)  # fmt: skip


def test_the_panel_has_all_keys(tmp_path: Path) -> None:
    (panel,) = (panel for panel in panels(Document(tmp_path), 0) if panel.title == "Sensor")
    paths = [field.path for field in panel.fields]
    assert paths == [f"sensor.{key}" for key in clsco.Sensor.model_fields]
    labels = {field.path: field.label for field in panel.fields}
    assert labels["sensor.iso"] == "ISO"
    assert (labels["sensor.seed"], labels["sensor.noise_seed"]) == ("Seed of the sensor", "Seed of the noise")


@pytest.mark.parametrize("mosaic", ["none", "rggb"])
def test_views(mosaic: str) -> None:
    scene = SCENE.replace("sensor.mosaic", mosaic)
    frame = clsco.render_frame(scene, truth=(*truth_of("raw"), *truth_of("noise")))
    for view, name, encoding in (("raw", "raw", FLOAT32), ("noise", "noise_sigma", FLOAT16)):
        data = frame.arrays()[name]
        exact = picture_of(frame, scene, view, EXACT, (12, 8), 0.0)
        assert (exact.encoding, exact.size) == (FLOAT32, (12, 8))
        np.testing.assert_array_equal(np.frombuffer(exact.payload, "<f4").reshape(data.shape), data)
        assert picture_of(frame, scene, view, DRAGGING, (12, 8), 0.0).encoding == encoding


def test_without_a_sensor_a_view_says_so() -> None:
    scene = SCENE.replace("sensor", None)
    frame = clsco.render_frame(scene, truth=(*truth_of("raw"), *truth_of("noise")))
    for view in ("raw", "noise"):
        with pytest.raises(SceneError) as caught:
            picture_of(frame, scene, view, EXACT, (12, 8), 0.0)
        assert str(caught.value) == f"view: {view} belongs to scenes with a sensor, which has a panel; got none"
