"""The examples of the README and of docs/ work as they stand."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import clsco
from clsco.cli.images import defocus
from clsco.cli.main import main
from clsco.frame.outputs import FILE_NAMES

ROOT = Path(__file__).resolve().parents[2]
PAGES = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
PAGES["CONTRIBUTING.md"] = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
PAGES["README.md"] = (ROOT / "README.md").read_text("utf-8")


def blocks(language: str, page: str = "README.md") -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


def test_the_scene_is_valid(tmp_path: Path) -> None:
    (text,) = blocks("toml", "docs/scene_files.md")
    path = tmp_path / "scene.toml"
    path.write_text(text, "utf-8")
    scene = clsco.load_scene(path)
    assert (scene.title, scene.sequence.frames, scene.camera.aperture_diameter) == ("Turning ball", 3, 10.0)
    assert scene.objects[0].motion.moves


def test_the_python_of_the_readme_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (text,) = blocks("python")
    assert text == (Path(__file__).with_name("readme_lines.py")).read_text("utf-8")  # whose types `make lint` checks
    monkeypatch.chdir(tmp_path)
    exec(text, {})
    assert capsys.readouterr().out.startswith("<Frame 0: 512 x 512 px, gray, f/2, R ")
    assert (tmp_path / "ball.png").stat().st_size > 10_000


def test_the_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    whole = clsco.load_scene
    small = ["camera.resolution=[48, 32]", "camera.pixel_pitch=0.1"]
    monkeypatch.setattr(clsco, "load_scene", lambda path: whole(ROOT / path, small))
    given: dict[str, Any] = {"image": np.ones((9, 12), np.float32), "blur_radius": np.full((9, 12), 2.0, np.float32)}
    given["mask"] = np.eye(9, 12, dtype=np.bool_)
    first, moving, live, last = blocks("python", "docs/python.md")
    exec(first, given)
    assert capsys.readouterr().out.count("48 x 32 px") == 3
    assert len(list(tmp_path.glob("frame_000?.png"))) == 3
    exec(moving, given | {"clsco": clsco})
    monkeypatch.setattr(clsco.Live, "warm", lambda self, scene: None)  # half a minute; tests/engine/test_live.py has it
    exec(live, given)
    assert given["frame"].color.shape == (32, 48)
    exec(last, given | {"clsco": clsco})


def test_the_python_of_the_shutter_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """It prints what its comments say."""
    (text,) = blocks("python", "docs/shutter.md")
    exec(text, {})
    assert capsys.readouterr().out.splitlines() == re.findall(r"  # (.+)$", text, re.MULTILINE)


def test_commands_and_outputs_are_all_named() -> None:
    context = click.Context(main)
    commands = {name: main.get_command(context, name) for name in main.list_commands(context)}
    shown = {name for name, command in commands.items() if command is not None and not command.hidden}
    assert set(re.findall(r"^\| `clsco (\w+)", PAGES["docs/commands.md"], re.MULTILINE)) == shown
    named = re.findall(r"^\| `(\w+)` \| (?:float\d+|bool|u?int\d+)", PAGES["docs/outputs.md"], re.MULTILINE)
    assert sorted(named) == sorted(FILE_NAMES.values())


def test_options_and_examples_of_files_exist() -> None:
    (command,) = (block for block in blocks("sh", "docs/depth_maps.md") if "clsco defocus" in block)
    options = {name for option in defocus.params for name in option.opts}
    table = re.findall(r"^\| [^|]+ \| `(--unit [^`]+)`", PAGES["docs/depth_maps.md"], re.MULTILINE)
    assert len(table) == 10
    used = set(re.findall(r"--[\w-]+", " ".join([command, *table])))
    assert used <= options
    assert {"--unit", "--scale", "--baseline", "--offset"} <= used


def test_keys_exist_and_have_their_defaults() -> None:
    scene = clsco.parse_scene({"object": [{"shape": "plane"}]})
    keys = re.findall(r"^\| `(\w+)\.(?!toml)(\w+)` \| (?:`(\w+)`|(\d+))", PAGES["docs/scene_files.md"], re.MULTILINE)
    assert len(keys) > 5
    for section, key, word, number in keys:
        assert key in type(getattr(scene, section)).model_fields
        default = getattr(getattr(scene, section), key)
        assert str(default).lower() == (word or number), key


def test_the_sensor_of_its_page_has_the_defaults() -> None:
    lines = PAGES["docs/sensor.md"].partition("    [sensor]")[2].partition("\n\n")[0]
    scene = clsco.parse_scene(f"[sensor]{lines}\n[[object]]\nshape = 'plane'")
    assert scene.sensor == clsco.Sensor()


@pytest.mark.parametrize("page", PAGES)
def test_links_exist(page: str) -> None:
    text, folder = PAGES[page], (ROOT / page).parent
    for target, part in re.findall(r"\]\(([^)#]*)(?:#([\w-]+))?\)", text):
        assert (folder / target).exists(), target
        if part:
            linked = PAGES[page if not target else (folder / target).resolve().relative_to(ROOT).as_posix()]
            titles = re.findall(r"^#+ (.*)", linked, re.MULTILINE)
            assert part in [re.sub(r"[^\w-]", "", title.lower().replace(" ", "-")) for title in titles], part
    for target in re.findall(r"`((?:benchmarks|examples|docs|\.ci)/[\w./]+)`", text):
        assert (ROOT / target).exists(), target
    for name in set(re.findall(r"`(\w+\.toml)`", text)) - {"pyproject.toml"}:
        assert any((ROOT / folder / name).exists() for folder in ("examples", "examples/sets")), name


@pytest.mark.parametrize("page", PAGES)
def test_modules_tests_and_targets_of_commands_exist(page: str) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for module in re.findall(r"python -m ([\w.]+)", PAGES[page]):
        assert find_spec(module) is not None, module
    for path in re.findall(r"\b(?:tests|clsco)/[\w/]+\.py", PAGES[page]):
        assert (ROOT / path).exists(), path
    for target in re.findall(r"(?:`|^)make ([a-z-]+)", PAGES[page], re.MULTILINE):
        assert target in targets, target


def test_pages_are_in_the_site() -> None:
    pages = PAGES.keys() - {"README.md", "CONTRIBUTING.md"}
    shown = re.findall(r": (\w+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    assert sorted(f"docs/{name}" for name in shown) == sorted(pages)
    assert set(re.findall(r"\]\((docs/\w+\.md)", PAGES["README.md"])) <= pages
