"""Data sets made from Python: of a file, its content, and a function; what cannot be."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import clsco
import clsco.data
from clsco.cli.main import main
from clsco.data import creation
from clsco.data.distribution import scripted
from clsco.errors import SceneError
from clsco.files.images import save_image
from clsco.scene.toml import toml_text
from tests.cli.test_dataset import DISTRIBUTION, HerePool
from tests.data.test_shards import files

CONTENT: dict[str, Any] = {
    "camera": {"resolution": np.array([24, 16]), "pixel_pitch": 0.2},
    "vary": {"camera": {"focus_distance": {"uniform": (220, 320)}}},
    "object": ({"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": np.float64(30)},),
}
SMALL: Any = {"count": 4, "shard_size": 2}


def draw(rng: np.random.Generator, sample: int) -> clsco.Scene:
    """A ball with a texture from a file, an array or none, in a camera that varies."""
    texture: str | NDArray[np.float32] = ("dots.png", "bricks", rng.random((8, 8), np.float32))[sample % 3]
    ball = clsco.Sphere(center=(0, 0, 280), radius=30, texture=texture)
    camera = clsco.Camera(resolution=(24, 16), pixel_pitch=0.2, focus_distance=rng.uniform(220, 320))
    return clsco.Scene(camera=camera, objects=(ball,))


def draw_stack(rng: np.random.Generator, sample: int) -> tuple[Any, dict[str, Any]]:
    """A focal stack of two, as a list of scenes, a mapping with lists, or [[variant]]; with what was drawn."""
    radius = np.float64(rng.uniform(20, 30))
    drawn = {"radius": radius, "scene": sample // 2}
    content: dict[str, Any] = {"camera": {"resolution": [24, 16], "pixel_pitch": 0.2}, "sensor": {}}
    content["object"] = [{"shape": "sphere", "center": [0, 0, 280], "radius": radius, "texture": "dots.png"}]
    if sample % 3 == 0:
        scene = clsco.parse_scene(content)
        return [scene.replace("camera.focus_distance", u) for u in (230, 300)], drawn
    if sample % 3 == 1:
        content["camera"]["focus_distance"] = [230, 300]
    else:
        content["variant"] = [{"camera": {"focus_distance": 230}}, {"camera": {"focus_distance": 300, "f_number": 4}}]
    return content, drawn


def draw_badly(rng: np.random.Generator, sample: int) -> Any:
    """The scene of sample 1; others leave the folder, have parameters that JSON cannot hold, end in a Python error."""
    texture = "bricks" if sample else "../dots.png"
    scene = {"camera": {"resolution": [24, 16]}, "object": [{"shape": "plane", "texture": [texture][sample // 3]}]}
    return (scene, {"generator": rng}) if sample == 2 else scene


def test_a_function_gives_variants_and_parameters(place: Path) -> None:
    options: dict[str, Any] = {"splits": "a=1,b=2", "split_by": "scene", "workers": 1, "format": "npz"}
    clsco.data.make(draw_stack, "stacks", count=6, truth="depth,raw", **options)
    data = clsco.data.open("stacks")
    groups = [[record.meta["parameters"]["scene"] for record in clsco.data.open("stacks", name)] for name in "ab"]
    assert sorted(groups[0] + groups[1]) == [0, 0, 1, 1, 2, 2]
    assert [len(groups[0]), len({*groups[0]})] == [2, 1]
    for record in data:
        number = record.meta["number"]
        assert set(record) == {"v00.color", "v01.color", "v00.raw", "v01.raw", "depth"}
        assert record.meta["parameters"]["radius"] == record.meta["scene"]["object"][0]["radius"]
        assert len(record.meta["labels"]) == len(record.meta["scene"].get("variant", [0, 0])) == 2
        scenes = clsco.parse_sweep(record.meta["scene"] | {"object": [{"shape": "plane"}]}).scenes
        assert [scene.camera.focus_distance for scene in scenes] == [230, 300]
        seeds = [scene.sensor.noise_seed for scene in scenes if scene.sensor is not None]
        assert seeds[1] == seeds[0] + 1  # two exposures, not a copy
        assert np.abs(record["v00.raw"].astype(int) - record["v01.raw"]).max() > 3, number
    stack = data.stacked()[0]
    assert stack["color"].shape == (2, 16, 24)
    assert stack["depth"].shape == (16, 24)
    run = CliRunner().invoke(main, ["dataset", "verify", "stacks"])
    assert run.output == "stacks: 6 samples as recorded, 6 rendered again\n"
    assert not clsco.data.remake("stacks", distribution=draw_stack, workers=1)
    shown = CliRunner().invoke(main, ["dataset", "show", "stacks", "2"])
    (place / "shown.toml").write_text(shown.output)
    assert len(clsco.load_sweep("shown.toml").scenes) == 2


def test_samples_with_arrays_are_verified_by_their_function(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clsco.data.make(draw, "one", count=3, truth="depth", workers=1)
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parents[2]), *sys.path])
    words = ["dataset", "verify", "one", "--draw"]
    run = CliRunner().invoke(main, [*words, "tests.data.test_creation:draw"])
    assert run.output == "one: 3 samples as recorded, 3 rendered again\n"
    for name, rule in (
        ("tests.data.test_creation:draw_badly", "draw: must be the function that made the set, from the same source"),
        ("tests.data.nothing:draw", "draw: must be MODULE:FUNCTION that Python can import"),
        ("draw", "draw: must be MODULE:FUNCTION that Python can import"),
    ):
        run = CliRunner().invoke(main, [*words, name])
        assert run.exit_code == 1
        assert rule in run.output


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("clsco.data.pool._Pool", HerePool)
    monkeypatch.chdir(tmp_path)
    save_image("dots.png", np.eye(8, dtype=np.float32))
    return tmp_path


def test_a_file_its_content_and_its_command_make_one_set(place: Path) -> None:
    Path("set.toml").write_text(DISTRIBUTION)
    status = clsco.data.make("set.toml", "file", **SMALL)
    assert (repr(status), status.made) == ("<Status: 4 of 4 samples made, 0 failed>", 4)
    run = CliRunner().invoke(
        main, ["dataset", "make", "set.toml", "-o", "command", "--count", "4", "--shard-size", "2"]
    )
    assert run.exit_code == 0, run.output
    assert files(place / "file") == files(place / "command")
    clsco.data.make(CONTENT, "content", **SMALL)
    one, two = (clsco.data.open(name) for name in ("file", "content"))
    assert [record.sha256() for record in one] == [record.sha256() for record in two]
    assert two.card["recipe"] == toml_text(two.card["distribution"])
    assert one.card["recipe"] == DISTRIBUTION


def test_samples_that_are_compared_with_rays(place: Path) -> None:
    content: dict[str, Any] = CONTENT | {"check": {"every": 2}}
    clsco.data.make(content, "CHECKED", count=3, seed=7, folder=place)
    frames = [record.meta["frames"][0] for record in clsco.data.open("CHECKED")]
    assert [frame.get("check", {}).get("pixels", 0) > 50 for frame in frames] == [True, False, True]
    with pytest.raises(SceneError, match="check: must be a table with every, a whole number from 1 on; got a table"):
        clsco.data.make(content | {"check": {"every": 0}}, "OTHER", count=1, folder=place)


def test_a_function_draws_scenes(place: Path) -> None:
    clsco.data.make(draw, "one", count=6, shard_size=4, seed=5, splits={"a": 0.5, "b": 0.5})
    for part in (1, 0):
        clsco.data.make(draw, "two", count=6, shard_size=4, seed=5, splits="a=0.5,b=0.5", part=(part, 2))
    assert files(place / "one") == files(place / "two")
    assert clsco.data.make(draw, "one", count=6, shard_size=4, seed=5, splits="a=0.5,b=0.5", resume=True).made == 6
    data = clsco.data.open("one")
    assert (len(data), data.card["function"]) == (6, "draw")
    assert "def draw(rng" in data.card["recipe"]
    assert "```python" in Path("one/README.md").read_text()
    for record in data:
        number = record.meta["number"]
        rng = np.random.Generator(np.random.Philox(key=[5, number]))
        expected = clsco.render_frame(draw(rng, number), truth="depth")
        np.testing.assert_array_equal(record["depth"], expected.depth)
        texture = record.meta["scene"]["object"][0]["texture"]
        assert texture == ("dots.png", "bricks", texture)[number % 3]
        assert isinstance(texture, dict) == (number % 3 == 2)
    run = CliRunner().invoke(main, ["dataset", "verify", "one"])
    said = "one: 6 samples as recorded, 4 rendered again, not 2 with arrays that their function alone makes\n"
    assert run.output == said


def test_samples_of_a_function_may_fail(place: Path) -> None:
    with pytest.raises(
        creation.FailedSamplesError, match="bad: every sample must be made; got 3 of 4 that failed; "
    ) as e:
        clsco.data.make(draw_badly, "bad", **SMALL)
    assert e.value.status.failed == 3
    rows = [json.loads(line)["error"] for line in Path("bad/failed.jsonl").read_text().splitlines()]
    assert rows[0].startswith("draw_badly: texture: files must lie in ")
    rule = "must be a mapping of numbers, texts, lists and mappings; got a value of type Generator"
    assert rows[1] == f"draw_badly: parameters: {rule} (sample 2, seed 0)"
    assert rows[2] == "draw_badly: must give a scene; got IndexError('list index out of range') (sample 3, seed 0)"
    assert clsco.data.make(draw_badly, "bad", resume=True, allow_failures=3, **SMALL).failed == 3


def test_other_processes_import_the_function(tmp_path: Path) -> None:
    """The same bytes from a script, in two processes, and from a module."""
    code = (
        "import clsco, clsco.data\n"
        "def draw(rng, sample):\n"
        "    camera = {'resolution': [12, 8], 'focus_distance': rng.uniform(220, 320)}\n"
        "    return {'camera': camera, 'object': [{'shape': 'plane', 'distance': 280}]}\n"
        "if __name__ == '__main__':\n"
        "    clsco.data.make(draw, 'one', count=4, shard_size=1, workers=2)\n"
        "    import own\n"
        "    clsco.data.make(own.draw, 'two', count=4, shard_size=2, workers=1)\n"
    )
    (tmp_path / "own.py").write_text(code)
    subprocess.run([sys.executable, "own.py"], cwd=tmp_path, check=True, timeout=300)
    one, two = (clsco.data.open(tmp_path / name) for name in ("one", "two"))
    assert one.card["identity"]["distribution"] == two.card["identity"]["distribution"]
    assert [record.sha256() for record in one] == [record.sha256() for record in two]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "count: must be an integer between 1 and 1000000000000; got 0"),
        ({"count": 2, "seed": -1}, "seed: must be an integer between 0 and "),
        ({"count": 2, "shard_size": 2.5}, "shard_size: must be an integer between 1 and 1000000; got 2.5"),
        ({"only": range(0, 4, 2)}, "only: must be a range of numbers from 0 on, one by one; got range(0, 4, 2)"),
        ({"count": 2, "truth": "blur"}, 'truth: must be "all" or some of color, sharp, depth, coc'),
        ({"count": 2, "truth": (), "color": False}, "truth: must name arrays"),
        ({"count": 2, "precision": "half"}, 'precision: must be "double" or "single"; got "half"'),
        ({"count": 2, "types": {"color": "int"}}, "types: color must be one of float32, float16, uint8, uint16"),
        ({"count": 2, "overrides": ["camera.f_number=2"]}, "overrides: are for files and their content"),
    ],
)
def test_what_cannot_be_is_told_before_anything_is_written(place: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError) as error:
        clsco.data.make(draw, "set", **options)
    assert str(error.value).startswith(message)
    assert not Path("set").exists()
    with pytest.raises(TypeError, match="unexpected keyword argument 'sead'"):
        clsco.data.make(draw, "set", sead=1)  # type: ignore[call-arg]


def test_functions_that_nobody_can_import_are_refused(place: Path) -> None:
    rule = "distribution: a function must stand at the top of a module or script"
    functions: list[Any] = [lambda rng, sample: {}, print]
    for function in functions:
        with pytest.raises(SceneError) as error:
            scripted(function)
        assert str(error.value).startswith(rule)
    with pytest.raises(SceneError, match="distribution: must hold tables, lists, numbers and texts; got "):
        clsco.data.make({"camera": {"f_number": object()}}, "set", count=1)
