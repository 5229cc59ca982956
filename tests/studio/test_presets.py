"""Presets: captions of the thesis, and the switch to its method."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from clsco import load_scene
from clsco.studio.presets import OF_THE_THESIS, PICTURES, choose_method, is_as_the_thesis, load_preset, presets
from clsco.studio.session import Document
from tests.scenes import bare

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_every_figure_that_a_scene_makes_is_a_preset(session: Document) -> None:
    from benchmarks.thesis.figures import FIGURES

    names = [preset.name for preset in presets() if preset.group == OF_THE_THESIS]
    assert {scene for figure in FIGURES for scene in figure.scenes} <= {name.partition("/")[2] for name in names}
    titles = [preset.title for preset in presets()]
    assert len(set(titles)) == len(titles)
    examples = {path.stem for path in EXAMPLES.glob("*.toml")}
    assert {preset.name for preset in presets() if preset.group != OF_THE_THESIS} == examples
    for preset in presets():
        assert (PICTURES / f"{preset.name}.webp").is_file()
        load_preset(session, preset.name)
        if preset.name not in ("thesis/section_4_3_3", "focal_stack"):  # several scenes
            assert bare(session.scene) == bare(load_scene(preset.path))
        assert session.path is None


@pytest.mark.parametrize("name", ["depth_map", "thesis/fig_4_19"])
def test_a_saved_preset_has_its_images_beside_it(session: Document, tmp_path_factory: Any, name: str) -> None:
    load_preset(session, name)
    session.save(Path("saved.toml"))
    elsewhere = tmp_path_factory.mktemp("other") / "copy"
    session.root.rename(elsewhere)
    scene = load_scene(elsewhere / "saved.toml")
    original = {preset.name: preset for preset in presets()}[name].path
    assert bare(scene) == bare(load_scene(original))
    for item, other in zip(scene.objects, load_scene(original).objects, strict=True):
        for key, file in item.files().items():
            assert Path(file).is_relative_to(elsewhere)
            assert Path(file).read_bytes() == Path(other.files()[key]).read_bytes()


def test_images_of_presets_leave_those_of_others(session: Document) -> None:
    place = session.root / "images" / "road.jpg"
    place.parent.mkdir()
    shutil.copy(EXAMPLES / "depth_map_image.png", place)
    before = place.read_bytes()
    load_preset(session, "thesis/fig_4_19")
    session.save(Path("saved.toml"))
    assert place.read_bytes() == before
    (name,) = {file for item in session.scene.objects for file in item.files().values()}
    assert Path(name).read_bytes() == (EXAMPLES / "thesis" / "road.jpg").read_bytes()


def test_the_method_of_the_thesis_is_a_switch(session: Document) -> None:
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
