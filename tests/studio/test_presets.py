"""Presets: captions of the thesis, and the switch to its method."""

from __future__ import annotations

from pathlib import Path

import pytest

from clsco import load_scene
from clsco.studio.presets import OF_THE_THESIS, choose_method, is_as_the_thesis, load_preset, presets
from clsco.studio.session import Session


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path)


def test_every_figure_that_a_scene_makes_is_a_preset(session: Session) -> None:
    from clsco.cli.thesis_figures import FIGURES

    names = [preset.name for preset in presets() if preset.group == OF_THE_THESIS]
    assert {scene for figure in FIGURES for scene in figure.scenes} <= {name.partition("/")[2] for name in names}
    titles = [preset.title for preset in presets()]
    assert len(set(titles)) == len(titles)
    for preset in presets():
        load_preset(session, preset.name)
        if preset.name not in ("thesis/section_4_3_3",):
            assert session.scene == load_scene(preset.path)
        assert session.path is None
    while session.undo():
        pass


@pytest.mark.parametrize(
    ("name", "path", "value"),
    [
        ("fig_3_04_left", "object.0.distance", 230.0),
        ("fig_3_04_right", "object.0.slope_x", 1.5),
        ("fig_3_05_left", "object.0.slope_y", 0.7),
        ("fig_3_05_right", "object.0.slope_y", 1.0),
        ("fig_3_12_left", "object.0.radius", 30.0),
        ("fig_4_06", "object.0.motion.angular_velocity", [0.0, 5.0, 0.0]),
        ("fig_4_06", "sequence.frames", 3),
        ("fig_4_02", "sequence.samples", 5),
    ],
)
def test_presets_have_the_numbers_of_their_captions(session: Session, name: str, path: str, value: object) -> None:
    load_preset(session, f"thesis/{name}")
    assert session.known(path) == value


def test_the_method_of_the_thesis_is_a_switch(session: Session) -> None:
    before = session.table
    assert not is_as_the_thesis(session)
    choose_method(session, True)
    assert is_as_the_thesis(session)
    assert session.scene.psf.model == "gaussian"
    assert session.scene.motion.warp == "forward"
    assert session.scene.fill.method == "ait"
    choose_method(session, False)
    assert session.table == before
    session.undo()
    assert is_as_the_thesis(session)
