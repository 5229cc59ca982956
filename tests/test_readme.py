"""The README's examples work as they stand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.cli import main
from clsco.frame import STEREO_NAMES, TRUTH_NAMES

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_the_scene_is_valid(tmp_path: Path) -> None:
    (text,) = blocks("toml")
    path = tmp_path / "scene.toml"
    path.write_text(text, "utf-8")
    scene = clsco.load_scene(path)
    assert (scene.title, scene.sequence.frames, scene.camera.aperture_diameter) == ("Turning ball", 3, 10.0)
    assert scene.objects[0].motion.moves


def test_the_python_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    whole = clsco.load_scene
    small = ["camera.resolution=[48, 32]", "camera.pixel_pitch=0.1"]
    monkeypatch.setattr(clsco, "load_scene", lambda path: whole(path, small))
    given: dict[str, Any] = {"image": np.ones((9, 12), np.float32), "coc": np.full((9, 12), 2.0, np.float32)}
    given["missing"] = np.eye(9, 12, dtype=np.bool_)
    first, second = blocks("python")
    exec(first, given)
    assert capsys.readouterr().out.count("(32, 48)") == 3
    exec(second, given | {"clsco": clsco})


def test_commands_and_outputs_are_all_named() -> None:
    assert set(re.findall(r"^\| `clsco (\w+)", TEXT, re.MULTILINE)) == set(main.commands)
    named = re.findall(r"^\| `(\w+)` \| (?:float32|bool|u?int\d+)", TEXT, re.MULTILINE)
    assert sorted(named) == sorted(["color", *TRUTH_NAMES, *STEREO_NAMES])


def test_options_and_examples_of_files_exist() -> None:
    (command,) = (block for block in blocks("sh") if "clsco defocus" in block)
    options = {name for option in main.commands["defocus"].params for name in option.opts}
    table = re.findall(r"^\| [^|]+ \| `(--unit [^`]+)`", TEXT, re.MULTILINE)
    assert len(table) == 3
    used = set(re.findall(r"--[\w-]+", " ".join([command, *table])))
    assert used <= options
    assert {"--unit", "--scale", "--baseline", "--offset"} <= used


def test_keys_and_links_exist() -> None:
    scene = clsco.parse_scene({"object": [{"shape": "plane"}]})
    keys = re.findall(r"^\| `(\w+)\.(?!toml)(\w+)` \|", TEXT, re.MULTILINE)
    assert len(keys) > 5
    for section, key in keys:
        assert key in type(getattr(scene, section)).model_fields
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT) + re.findall(r"`((?:benchmarks|examples|\.ci)/[\w./]+)`", TEXT):
        assert (ROOT / target).exists(), target
    for name in re.findall(r"`(\w+\.toml)`", TEXT):
        assert (ROOT / "examples" / name).exists(), name
