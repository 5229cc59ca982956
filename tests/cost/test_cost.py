"""Predicted work and time of frames; `python -m benchmarks.speed.prediction` compares it with what frames take."""

from __future__ import annotations

import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.cost import predict
from clsco.cost.cheaper import SETTINGS, SHORT, WORTH, cheaper_settings, warning_of
from clsco.cost.predict import Cost, cost_of, duration, host_work
from clsco.cost.rates import CORE_SECONDS, RATES
from clsco.cost.short import LONG_FRAME, most_seconds
from clsco.cost.work import LATTICE, frame_work, lattice_of
from clsco.plan.device import ThisMachine
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared, prepare
from clsco.plan.request import Request
from clsco.reference.trace.trace import mark_silhouettes, trace, view_at
from clsco.scene.examples import EXAMPLES, example
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene

CARD = {"shape": "rectangle", "center": [-60.0, 30.0, 600.0], "size": [160.0, 120.0], "texture_mapping": "surface"}
TUBE = {"shape": "cylinder", "center": [70.0, 0.0, 450.0], "radius": 30.0, "texture": "#c86432"}
TUBE |= {"bounds": [[-40.0, 40.0], [-60.0, 60.0], [-40.0, 40.0]]}
BALL = {"shape": "sphere", "center": [0.0, -40.0, 350.0], "radius": 25.0}
BALL |= {"motion": {"velocity": [600.0, 0.0, 0.0]}}
CAMERA = {"focal_length": 35.0, "f_number": 1.8, "focus_distance": 600.0, "pixel_pitch": 0.0045}
DOCS = Path(__file__).resolve().parents[2] / "docs"


def crowd(rows: int = 2880, **camera: Any) -> Scene:
    """A card in focus, a tube and a moving ball before a far background; minutes per frame by default."""
    size = {"resolution": [rows * 4 // 3, rows], "pixel_pitch": 0.0045 * 2880 / rows}
    objects = [CARD, TUBE, BALL, {"shape": "background"}]
    return parse_scene({"camera": CAMERA | size | camera, "sequence": {"shutter": 0.05}, "object": objects})


def cost(scene: Scene, truth: tuple[str, ...] = ()) -> Cost:
    found = cost_of(prepare(scene, Request(truth)), cores=2, slower=1.0)
    assert found is not None
    return found


def seconds(scene: Scene) -> float:
    return cost(scene).seconds


def rises(scenes: list[Scene]) -> bool:
    found = [seconds(scene) for scene in scenes]
    return all(1.02 * less < more for less, more in pairwise(found))


def test_time_rises_with_the_blur_radius_the_time_samples_the_size_and_the_colors() -> None:
    scene = crowd(180).replace("sequence.samples", 3)
    assert rises([scene.replace("camera.f_number", opening) for opening in (8.0, 2.0, 0.5)])
    assert rises([scene.replace("sequence.samples", count) for count in (1, 3, 9, 90)])
    assert rises([crowd(rows).replace("sequence.samples", 3) for rows in (90, 180, 360)])
    assert rises([scene.replace("psf.silhouette_samples", count) for count in (1, 4, 16)])
    plain = example("occlusion_three")
    assert rises([plain, plain.replace("object.0.texture", "#c86432")])
    assert cost(plain, ("depth",)).seconds > cost(plain).seconds


def test_what_costs_nothing_is_not_reckoned_with() -> None:
    one, three = example("sphere"), example("occlusion_three")
    names = {name for scene in (one, three) for _, work in works(scene) for name in work}
    assert "edge row" in names
    assert "edge taps" not in names
    assert any("edge taps" in work for _, work in works(three.replace("psf.model", "gaussian")))
    assert not any(name.startswith(("hidden", "edge", "test")) for _, work in works(one) for name in work)


def works(scene: Scene, truth: tuple[str, ...] = ()) -> list[tuple[str, dict[str, float]]]:
    return works_of(prepare(scene, Request(truth)))


def works_of(prepared: Prepared) -> list[tuple[str, dict[str, float]]]:
    return [(step.kind, work) for plan in prepared.plans for step, work in frame_work(plan, prepared.maps)]


@cache
def prepared_example(name: str) -> Prepared:
    return prepare(example(name), Request(("depth",)))


def test_every_pass_has_a_rate_and_every_rate_is_of_a_pass() -> None:
    others = ("lit", "plane_defocused", "thesis_pipeline", "tilted_mirror")
    scenes = [crowd(90), *(example(name) for name in others)]
    scenes += [example("sphere").replace("psf.edge", edge) for edge in ("area", "sampled")]
    scenes += [example("occlusion_three").replace(*pair) for pair in (
        ("psf.model", "gaussian"), ("psf.occlusion", "layered"), ("aperture.shape", "polygon"),
            ("aperture.rim", [{"distance": 30.0, "diameter": 12.0}]),
    )]  # fmt: skip
    scenes += [example("sphere").replace("sensor", {})]
    scenes += [example("siemens_star").replace("psf.edge", "sampled").replace("camera.f_number", 64.0)]
    scenes += [example("wide_angle")]
    used = {name for scene in scenes for _, work in works(scene, ("depth",)) for name in work}
    used |= {name for each in EXAMPLES for _, work in works_of(prepared_example(each)) for name in work}
    used |= host_work(prepare(scenes[0]).plan).keys()
    assert used == RATES.keys()


def whole(plan: Plan) -> tuple[int, int]:
    """Pixels near silhouettes, and sources that are hidden in part, of all groups, counted by the reference."""
    textures = (np.zeros((plan.rows, plan.columns, 1)),) * len(plan.scene.objects)
    near = hidden = 0
    for group in plan.groups:
        sources = trace(view_at(plan.scene, textures, 0.0, "left", False), group, plan.guard_px)
        near += int(mark_silhouettes(sources.label).sum())
        hidden += 0 if sources.visibility is None else int((sources.visibility.row >= 0).sum())
    return near, hidden


@pytest.mark.parametrize("rows", [64, 384])
def test_a_lattice_counts_what_the_reference_does(rows: int) -> None:
    ball, wall = BALL | {"center": [0.0, 0.0, 350.0]}, {"shape": "plane", "distance": 500.0}
    ball.pop("motion")
    camera = CAMERA | {"resolution": [rows, rows], "pixel_pitch": 0.036 * 384 / rows, "focus_distance": 350.0}
    scene = parse_scene({"camera": camera, "object": [ball, wall]})
    plan = prepare(scene).plan
    lattice = lattice_of(plan)
    assert (len(lattice.row) < plan.height) == (plan.height > LATTICE)
    assert lattice.total(np.ones((len(lattice.row), len(lattice.column)))) == pytest.approx(plan.height * plan.width)
    near, hidden = whole(plan)
    work = [each for _, each in works(scene)]
    assert sum(each.get("sub-pixel ray", 0.0) for each in work) == pytest.approx(plan.silhouettes**2 * near, rel=0.3)
    work = [each for _, each in works(scene.replace("psf.silhouette_samples", 1))]
    sources = sum(each.get("hidden source", 0.0) for each in work)
    assert 0.9 * hidden < sources < 2.0 * hidden  # more, as those that reach over the end of a band count twice


def test_a_graphics_card_has_no_prediction() -> None:
    scene = example("sphere")
    assert cost_of(prepare(scene, device=ThisMachine(kind="gpu"))) is None
    assert cost_of(prepare(scene, Request(method="tiles"))) is None


def test_more_cores_help_as_far_as_there_are_bands() -> None:
    prepared = prepare(example("occlusion_three"))  # 512 rows are 8 bands

    def blur(cores: int) -> float:
        found = cost_of(prepared, cores=cores, slower=1.0)
        assert found is not None
        return found.views[0]["blur"]

    assert blur(1) == pytest.approx(8 * blur(8)) == pytest.approx(8 * blur(64))


def test_a_long_frame_is_announced_with_what_takes_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predict, "core_seconds", lambda: CORE_SECONDS)  # whatever else the machine does
    prepared = prepare(crowd().replace("sequence.samples", 299))
    found = cost(prepared.scene)
    assert found.seconds > LONG_FRAME
    assert found.dearest[0] == "blur"
    line = warning_of(prepared)
    assert line is not None
    time = r"a frame will take about [\d.]+ (min|h) on \d+ cores?, \d+% of it in the pass blur; cheaper: "
    assert re.match(time, line)
    assert 'psf.occlusion = "none", ' in line
    assert "(21 to 35 dB where objects overlap, docs/occlusion.md)" in line
    assert "sequence.samples = 5, " in line
    for setting, less in cheaper_settings(prepared, found):
        assert less <= WORTH * found.seconds
        assert seconds(prepared.scene.replace(setting.key, setting.value)) == pytest.approx(less, rel=0.5)
    assert warning_of(prepare(crowd(90))) is None


def test_a_glance_does_not_take_a_long_frame_for_a_short_one() -> None:
    crowds = [prepare(scene) for scene in (crowd(90), crowd(180, f_number=0.5), crowd(360))]
    for prepared in (*crowds, *map(prepared_example, EXAMPLES)):
        found = cost_of(prepared, cores=1, slower=1.0)
        assert found is None or 2 * found.seconds < most_seconds(prepared.plan), prepared.scene


def test_a_small_scene_is_short_at_a_glance() -> None:
    assert most_seconds(prepare(example("sphere")).plan) < LONG_FRAME / 5


def test_what_a_scene_has_is_not_offered() -> None:
    scene = example("sphere_moving").replace("sequence.samples", 5).replace("psf.silhouette_samples", 1)
    prepared = prepare(scene)
    assert cheaper_settings(prepared, cost(scene)) == []


def test_nothing_is_offered_for_a_short_frame() -> None:
    prepared = prepare(example("sphere"))
    found = cost(prepared.scene)
    assert found.seconds < SHORT
    assert cheaper_settings(prepared, found) == []


def column(page: str, heading: str, name: str, rows: str) -> list[float]:
    """PSNR of the whole frame in a table of a page: in the column of this name, of rows that match."""
    lines = (DOCS / page).read_text("utf-8").partition(heading)[2].partition("<!-- table: end -->")[0].splitlines()
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    place = next(number for number, cell in enumerate(table[0]) if name in cell)
    cells = [row[place] for row in table[2:] if re.search(rows, row[0])]
    return [float(number) for cell in cells for number in re.findall(r"[\d.]+", cell.split(" / ")[0])]


def test_errors_are_those_of_the_documentation() -> None:
    overlap = r"^(?!one sphere)"
    columns = ("sphere", "cylinder", "ellipsoid", "cone", "plane tilted")
    moving = ("in focus", "defocused", "sphere turning", "turning and moving")
    found = {
        ("psf.occlusion", "layered"): column("occlusion.md", "PSNR in dB", "`layered`", overlap),
        ("psf.occlusion", "none"): column("occlusion.md", "PSNR in dB", "`none`", overlap),
        ("psf.silhouette_samples", 1): [
            value for name in columns
            for value in column("accuracy.md", "PSNR in dB", name, "^no silhouettes$")
        ],
        ("sequence.samples", 5): [
            value for name in moving for value in column("accuracy.md", "table: moving", name, "^5 time samples$")
        ],
    }  # fmt: skip
    for setting in SETTINGS:
        stated = [int(number) for number in re.findall(r"\d+", setting.error)[:2]]
        values = found[setting.key, setting.value]
        assert stated == [round(min(values)), round(max(values))], setting.key


def test_durations_are_short() -> None:
    shown = ["4.2 ms", "990 ms", "1.5 s", "41 s", "1.7 min", "1.9 h", "120 h"]
    assert [duration(value) for value in (0.0042, 0.99, 1.5, 41.0, 100.0, 7000.0, 432000.0)] == shown
