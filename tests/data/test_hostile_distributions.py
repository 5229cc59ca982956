"""Distribution files of strangers: they read nothing outside of their folder, and are refused at once."""

from __future__ import annotations

import os
import random
import time
import tomllib
from pathlib import Path

import pytest

from clsco.data.distribution import load_distribution
from clsco.data.folder import Folder, RefusedError
from clsco.errors import SceneError
from tests.data.distributions import SCENE, Load, messages
from tests.hostile.mutate import VALUE_CHANGES

OUT = "must be a path inside the folder of the distribution file, without .."
LINK = "must not lead out of the folder of the distribution file by a link"
OBJECT = "[[vary.object]]\nindex = 0\n"


@pytest.fixture
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of secrets, to which links in the folder of the distribution may lead."""
    folder = tmp_path_factory.mktemp("outside")
    (folder / "secret.png").write_bytes(b"secret")
    (folder / "secret.toml").write_text(SCENE)
    return folder


def linked(tmp_path: Path, outside: Path) -> None:
    for name in ("secret.png", "secret.toml"):
        (tmp_path / name).symlink_to(outside / name)
    (tmp_path / "folder").symlink_to(outside)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ('{base}"../secret.toml"', OUT), ('{base}"{outside}/secret.toml"', OUT), ('{base}"secret.toml"', LINK),
        ('{base}"folder/secret.toml"', LINK), ('{base}"C:\\\\secret.toml"', OUT),
        ('{base}"\\\\\\\\host\\\\secret.toml"', OUT), ('{base}"missing.toml"', "must be an existing file"),
        ("{base}3", "must be the name of a file"), ('{base}"a\\u0000b.toml"', "must be the name of a file"),
        ('{base}"set.toml"', "must not lead back"), ('{object}texture = "../secret.png"', OUT),
        ('{object}texture = "{outside}/secret.png"', OUT), ('{object}texture = "secret.png"', LINK),
        ('{object}texture = "folder/secret.png"', LINK),
        ('{object}texture = {{ choice = ["bricks", "../secret.png"] }}', OUT),
        ('{object}texture = {{ choice = ["bricks", "secret.png"] }}', LINK),
        ('{object}texture = {{ files = "../*.png" }}', "must be a pattern inside the folder"),
        ('{object}texture = {{ files = "{outside}/*.png" }}', "must be a pattern inside the folder"),
        ('{object}texture = {{ files = "*.png" }}', LINK),
        ('{object}texture = {{ files = "folder/*.png" }}', "must fit a file"),
        ('{object}texture = {{ files = "**/**/*.png" }}', "must have ** at most once"),
        ("{object}texture = {{ files = 3 }}", "must be a pattern of files"),
        ('[[vary.object]]\nshape = "sphere"\ntexture = "secret.png"', LINK),
        ('[[vary.object]]\nshape = "box"\ntexture_back = "secret.png"', LINK),
        ('[[vary.object]]\nshape = "depth_map"\ndepth = "secret.png"', LINK),
        ('[[vary.object]]\nshape = "depth_map"\ndepth = "bricks"', "must be an existing file"),
        ('[[object]]\nshape = "sphere"\ntexture = "../secret.png"', OUT),
        ('[aperture]\nshape = "image"\nimage = "../secret.png"', OUT),
        ('[aperture]\nshape = "image"\nimage = "secret.png"', LINK),
        ('[aperture]\nshape = "image"\n[vary.aperture]\nimage = {{ choice = ["{outside}/secret.png"] }}', OUT),
    ],
)  # fmt: skip
def test_no_path_leaves_the_folder(load: Load, tmp_path: Path, outside: Path, text: str, wanted: str) -> None:
    linked(tmp_path, outside)
    given = text.format(base="base = ", object=OBJECT, outside=outside)
    scene, more = (given, "") if given.startswith("base") else (SCENE, given)
    (found,) = messages(load, more, scene)
    assert wanted in found
    assert "b'secret'" not in found


def test_loops_and_long_rows_of_bases_are_refused(tmp_path: Path) -> None:
    for name, base in (("a", "b"), ("b", "c"), ("c", "b"), ("d", "d")):
        (tmp_path / f"{name}.toml").write_text(f'base = "{base}.toml"\n')
    for name in ("a", "b", "d"):
        with pytest.raises(SceneError, match="base: must not lead back to a file that it is a base of"):
            load_distribution(tmp_path / f"{name}.toml")
    for k in range(12):
        (tmp_path / f"{k}.toml").write_text(f'base = "{k + 1}.toml"\n')
    with pytest.raises(SceneError, match="base: must be at most 8 files"):
        load_distribution(tmp_path / "0.toml")


DEEP = 400
BOMBS = {
    "inline tables": "vary.camera.f_number = " + "{ uniform = " * DEEP + "1" + " }" * DEEP,
    "lists": "vary.camera.f_number = " + "[" * DEEP + "1" + "]" * DEEP,
    "dots": "vary" + ".a" * 90 + " = 1",
    "entries of a choice": f"[vary.camera]\nf_number = {{ choice = [{'2,' * 20000}] }}",
    "entries of a list": f"[vary.camera]\nf_number = [{'2,' * 5000}]",
    "distributions": "[vary.camera]\n" + "\n".join(f"k{k} = {{ uniform = [1, 2] }}" for k in range(2000)),
    "populations": '[[vary.object]]\nshape = "sphere"\n' * 3000,
    "objects": '[[vary.object]]\nshape = "sphere"\ncount = 64\n' * 64,
    "sizes": "[vary.camera]\nf_number = { uniform = [1, 2], size = 1000000000 }",
    "integers": f"[vary.camera]\nf_number = {{ integers = [0, {'9' * 300}] }}",
    "numbers": f"[vary.camera]\nf_number = {{ uniform = [0, {'9' * 300}] }}",
    "frames": "[sequence]\nframes = 999999999999\n[vary.camera]\nf_number = { uniform = [1, 2] }",
    "a file of a gigabyte": "#" * (2**20 + 1),
    "code": '[vary.camera]\nf_number = { choice = ["__import__(\'os\').system(\'true\')"] }',
    "dates": "[vary.camera]\nf_number = { choice = [1979-05-27T07:32:00Z] }",
    "names": '[[vary.object]]\nname = "' + "a" * 100000 + '"\nshape = "sphere"',
    "sweeps": "[vary.camera]\n" + "\n".join(
        f"{key} = {{ from = 30, to = 31, steps = 4096 }}" for key in ("focal_length", "pixel_pitch", "focus_distance")
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_at_once(load: Load, name: str) -> None:
    start = time.process_time()
    found = messages(load, BOMBS[name])
    assert time.process_time() - start < 2.0
    assert all(len(message) < 600 for message in found)
    assert len(found) <= 101


def test_special_files_and_deep_folders_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "here").symlink_to(tmp_path)
    folder = Folder(tmp_path)
    for name in ("pipe.png", "loop", ".", "here", "x" * 300, "a\nb", ""):
        with pytest.raises(RefusedError):
            folder.inside(name)
    deep = tmp_path
    for _ in range(60):
        deep /= "d"
    deep.mkdir(parents=True)
    with pytest.raises(RefusedError, match="folders in each other"):
        folder.match("**/*.png")
    (tmp_path / "a.png").write_bytes(b"1")
    (tmp_path / "b.png").symlink_to(tmp_path / "a.png")
    assert folder.match("*.png") == ["a.png", "b.png"]  # a link that stays inside
    assert folder.take("a.png") == folder.take("b.png")


FULL = (
    SCENE
    + """
[vary.camera]
focus_distance = { uniform = [300, 500] }
f_number = { choice = [2, 4, 8], weights = [1, 2, 1] }
[[vary.object]]
index = 0
slope_x = { normal = [0, 0.2], clip = [-0.5, 0.5] }
texture = { files = "*.png", split = "by_file" }
[[vary.object]]
name = "ball"
count = { integers = [0, 3] }
shape = { choice = ["sphere", "cone"] }
center = { frustum = { depth = [200, 350], margin = 4 } }
[accept]
max_blur_px = 200
[derive]
camera.focus_distance = { depth_quantile = 0.5 }
"""
)


def draw_mutations(tmp_path: Path, first: int, count: int) -> int:
    """Load distributions with other values and draw a sample of each that loads; returns how many did."""
    (tmp_path / "a.png").write_bytes(b"not an image")
    loaded = 0
    for seed in range(first, first + count):
        rng, content = random.Random(seed), tomllib.loads(FULL)
        for _ in range(rng.randint(1, 2)):
            rng.choice(VALUE_CHANGES)(rng, content)
        try:
            distribution = load_distribution(content, folder=tmp_path)
            loaded += 1
            distribution.draw(1, seed)
        except SceneError as error:
            refused = error.messages
            if not all(message.startswith("distribution: ") and message.isprintable() for message in refused):
                pytest.fail(f"{seed}: {refused}")
    return loaded


def test_mutated_files_are_refused_or_drawn(tmp_path: Path) -> None:
    assert 5 < draw_mutations(tmp_path, 0, 80) < 80


@pytest.mark.slow
def test_many_mutated_files_are_refused_or_drawn(tmp_path: Path) -> None:
    assert draw_mutations(tmp_path, 1000, 1500) > 100
