"""`python -m benchmarks thesis`: the figures of the thesis, its numbers and those measured, and the page of both."""

from __future__ import annotations

from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image

import clsco
from benchmarks.__main__ import main
from benchmarks.thesis import page as thesis
from benchmarks.thesis.figures import FIGURES, NUMBERS, OTHERS, Figure, Number, chosen, numbers_named
from clsco.errors import FileError
from clsco.files.images import read_image
from clsco.files.transfer import encode
from clsco.scene.model import Plane, Scene
from tests.cli.test_main import messages, names

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "examples" / "thesis"
DOCUMENT = (ROOT / "docs" / "thesis.md").read_text("utf-8")
ALL_NUMBERS = (ROOT / "benchmarks/results/thesis_numbers.md").read_text("utf-8")


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


def scene(stem: str, *overrides: str) -> Scene:
    return clsco.load_scene(SCENES / f"{stem}.toml", overrides)


@pytest.mark.slow
def test_all_figures_are_the_document(tmp_path: Path) -> None:
    assert run("thesis", "-o", tmp_path).exit_code == 0
    assert (tmp_path / "thesis.md").read_text("utf-8") == DOCUMENT
    assert (tmp_path / "thesis_numbers.md").read_text("utf-8") == ALL_NUMBERS
    pictures = {picture for figure in FIGURES for picture in figure.pictures}
    assert pictures <= set(names(tmp_path))
    for figure in FIGURES:
        with (
            Image.open(tmp_path / thesis._small(figure)) as made,
            Image.open(ROOT / "docs" / thesis._small(figure)) as kept,
        ):
            np.testing.assert_allclose(np.asarray(made, int), np.asarray(kept, int), atol=4)


def test_the_page_is_the_last_thing_that_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("thesis", "-o", tmp_path, "--only", "4.15").exit_code == 0
    assert (tmp_path / "thesis_only.md").is_file()

    def no_space(out: Path, figure: Figure) -> None:
        raise FileError(f"{out}: the file must be writable; got No space left on device")

    monkeypatch.setattr(thesis, "small_figure", no_space)
    result = run("thesis", "-o", tmp_path, "--only", "4.15")
    assert messages(result, 1) == [f"error: {tmp_path}: the file must be writable; got No space left on device"]
    assert not list(tmp_path.glob("thesis_only.*"))


def test_a_figure_that_is_not_there(tmp_path: Path) -> None:
    result = run("thesis", "-o", tmp_path / "out", "--only", "4.1")
    assert result.exit_code == 2
    assert "--only: must be one of 3.3, 3.4, 3.5, 3.8, 3.9, 3.12," in result.stderr
    assert "got 4.1" in result.stderr
    assert not (tmp_path / "out").exists()


def test_one_of_a_span_of_figures_is_enough() -> None:
    figures, numbers = chosen(["3.12"])
    assert [figure.number for figure in figures] == ["3.12"]
    assert {number.figure for number in numbers} == {"3.8 to 3.17"}
    assert numbers_named("3.8 to 3.17") == ["3.8", "3.9", "3.12", "3.13", "3.15", "3.17"]
    assert {number.figure for number in chosen(["4.5"])[1]} == {"4.4, 4.5"}


def test_every_figure_of_the_thesis_is_on_the_page() -> None:
    last = {2: 3, 3: 17, 4: 19, 5: 21, 6: 1}
    wanted = {f"{chapter}.{n}" for chapter, most in last.items() for n in range(1, most + 1)}
    found = [figure.number for figure in FIGURES]
    for listed, _ in OTHERS:
        for part in listed.split(", "):
            first, _, end = part.partition(" to ")
            chapter, least = first.split(".")
            found += [f"{chapter}.{n}" for n in range(int(least), int((end or first).split(".")[1]) + 1)]
    assert sorted(found) == sorted(wanted)
    stems = {stem for row in FIGURES for stem in row.scenes} | {stem for row in NUMBERS for stem in row.scenes}
    assert stems == {path.stem for path in SCENES.glob("*.toml")}


@pytest.mark.parametrize(
    ("stated", "most", "near", "far"),
    [("36993", None, 36993.0, 36994.0), ("70", None, 70.1754, 70.6), ("0.707", None, 0.7071, 0.7081),
     ("at most about 6", 6.5, 3.48, 7.7)],
)  # fmt: skip
def test_when_a_number_agrees(stated: str, most: float | None, near: float, far: float) -> None:
    number = Number("4.15", "", stated, (), float, most=most)
    assert number.agrees(near)
    assert not number.agrees(far)


def test_only_what_is_stated_as_a_bound_is_one() -> None:
    assert {number.stated for number in NUMBERS if number.most is not None} == {"at most about 6", "one, rarely two"}


@pytest.mark.parametrize(
    ("number", "verdict"),
    [
        (Number("4.15", "", "5", (), float), "differs"),
        (Number("4.13", "", "5", (), float), "size not stated"),
        (Number("4.13", "", "4", (), float), "agrees"),
        (Number("4.15", "", "5", (), float, is_input=True), "differs"),
        (Number("4.7", "", "", (), float), "not stated"),
        (Number("3.8 to 3.17", "", "5", (), float), "size not stated"),
        (Number("section 4.3.3", "", "5", (), float), "differs"),
    ],
)
def test_what_the_page_says_of_a_number(number: Number, verdict: str) -> None:
    row = f"| 4 | {verdict} |"
    assert row in thesis.numbers_page({number: 4.0})
    assert (row in thesis.page((), {number: 4.0})) == (verdict not in ("agrees", "not stated"))


def test_inputs_are_listed_apart() -> None:
    values: thesis.Values = {Number("4.13", "sub-frames", "4", (), float, is_input=True): 4.0}
    assert "Inputs, as stated:\n\n- 4.13: sub-frames 4\n" in thesis.numbers_page(values)
    assert "\n1 of 1 agree (" in thesis.page((), values)


def test_figures_before_filling_are_those_that_are_filled_later() -> None:
    rest = {"08": "3_12_right", "09": "3_03", "10": "3_03", "11": "3_08_right", "12": "3_15_right"}
    for before, still in rest.items():
        unfilled, filled = (scene(f"fig_4_{n}") for n in (before, f"{int(before) + 5}"))
        assert unfilled.replace("fill.method", "ait").replace("title", filled.title) == filled
        (item,), (standing,) = unfilled.objects, scene(f"fig_{still}").objects
        assert item.model_copy(update={"motion": standing.motion}) == standing


def test_away_from_the_lens_nothing_is_missing() -> None:
    """The caption of figure 4.14 read to the letter."""
    frame = clsco.render_frame(scene("fig_4_09", "object.0.motion.velocity=[0.0, 0.0, 10.0]"), truth=("missing",))
    assert not frame.arrays()["missing"].any()


@pytest.fixture(scope="module")
def road() -> dict[str, Any]:
    """Names of examples/thesis/road.py."""
    return run_path(str(SCENES / "road.py"))


def test_two_cameras_see_one_road(road: dict[str, Any]) -> None:
    """The upper camera, moved to the car, has the car's depths of the road, and sees its texture there."""
    moved: Scene = road["view"]()
    still = scene("fig_4_19", "object.0.motion.velocity=[0.0, 0.0, 0.0]")
    above, car = (clsco.render_frame(view, truth=("depth", "sharp")).arrays() for view in (moved, still))
    np.testing.assert_allclose(above["depth"], car["depth"], rtol=1e-6)
    codes = read_image(SCENES / "road.jpg").data
    away = encode(above["sharp"], 8, "linear").astype(int) - codes  # a JPEG
    assert np.abs(away).mean() < 5
    np.testing.assert_array_equal(encode(car["sharp"], 8, "linear"), codes)
    assert np.ptp(codes) > 100


def test_the_car_drives_along_the_road(road: dict[str, Any]) -> None:
    """5 mm/s, at 30 deg to the optical axis, and up in the image of the upper camera."""
    (item,) = scene("fig_4_19").objects
    assert isinstance(item, Plane)
    assert 1.0 / np.tan(np.radians(90.0 - road["ANGLE"])) == pytest.approx(item.slope_y)
    velocity = np.array(item.motion.velocity)
    assert np.linalg.norm(velocity) == pytest.approx(5.0)
    assert velocity @ [-item.slope_x, -item.slope_y, 1.0] == pytest.approx(0.0, abs=1e-12)
    angle = np.radians(road["ANGLE"])
    upper = [velocity[0], velocity[1] * np.cos(angle) + velocity[2] * np.sin(angle)]
    assert upper == pytest.approx([0.0, -5.0])
