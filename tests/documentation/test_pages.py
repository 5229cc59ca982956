"""Commands of the pages of docs/, pasted in order into a shell as readers do, and the Python of those for newcomers."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from clsco.files.images import write_exr

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"(?:<!-- ([^\n]*) -->\n)?```(sh|python|toml)\n(.*?)```", re.DOTALL)
ENDLESS = "runs until Ctrl-C"
ENVIRONMENT = os.environ | {"PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))}


def blocks(page: str, language: str) -> Iterator[tuple[str, str]]:
    """Remark above each block of code of a page, and its text."""
    for remark, name, text in BLOCK.findall((DOCS / f"{page}.md").read_text("utf-8")):
        if name == language:
            yield remark, text


PAGES = [path.stem for path in sorted(DOCS.glob("*.md")) if any(True for _ in blocks(path.stem, "sh"))]


def given(page: str, folder: Path) -> None:
    """Files that the reader of a page brings along."""
    if page == "first_data_set":
        (folder / "stacks.toml").write_text(next(text for _, text in blocks(page, "toml")))
    if page == "blender":
        across = np.linspace(0, 1, 320, dtype=np.float32) * np.ones((180, 1), np.float32)
        view = {f"ViewLayer.Combined.{name}": across for name in "RGB"}
        view |= {"ViewLayer.Combined.A": np.ones_like(across), "ViewLayer.Depth.Z": 5 + 20 * across}
        write_exr(folder / "render.exr", view)


def paste(text: str, folder: Path, *, endless: bool = False) -> None:
    """Run lines in bash, which ends at the first one that fails; Ctrl-C where they go on by themselves."""
    if endless:
        text = text.replace("clsco studio", "clsco studio --no-browser")
    command = ["bash", "-euo", "pipefail", "-c", text]
    with subprocess.Popen(
        command, cwd=folder, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if endless and "http://127.0.0.1" in line:
                os.killpg(process.pid, signal.SIGINT)
    assert process.returncode == 0, "".join(said)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_commands_can_be_pasted(page: str, tmp_path: Path) -> None:
    given(page, tmp_path)
    for remark, text in blocks(page, "sh"):
        if remark.startswith("not pasted: "):
            continue
        assert remark in ("", ENDLESS)
        paste(text, tmp_path, endless=remark == ENDLESS)
    if page in ("start", "errors"):
        for _, text in blocks(page, "python"):
            subprocess.run([sys.executable, "-c", text], cwd=tmp_path, env=ENVIRONMENT, check=True)


@pytest.mark.slow
def test_the_first_data_set_is_read_and_trained_on(tmp_path: Path) -> None:
    """Error of a network falls; without PyTorch the part that reads runs alone."""
    given("first_data_set", tmp_path)
    fewer = {
        "--count 60": "--count 6",
        "=50,test=10": "=5,test=1",
        "--count 100": "--count 12",
        "=80,test=20": "=10,test=2",
    }
    for _, text in blocks("first_data_set", "sh"):
        for many, few in fewer.items():
            text = text.replace(many, few)
        paste(text.replace("STACKS 7", "STACKS 4"), tmp_path)
    reading, drawing, training = (text for _, text in blocks("first_data_set", "python"))
    (tmp_path / "boards.py").write_text(drawing.replace("count=60", "count=6").replace("=50,test=10", "=5,test=1"))
    boards = "import clsco.data, boards\nassert clsco.data.remake('BOARDS', distribution=boards.draw) == []"
    for code in (["-c", reading], ["boards.py"], ["-c", boards]):
        subprocess.run([sys.executable, *code], cwd=tmp_path, env=ENVIRONMENT, check=True)
    if find_spec("torch") is None:
        pytest.skip("PyTorch is not installed: the loop has not run")
    found = subprocess.run(
        [sys.executable, "-c", training], cwd=tmp_path, env=ENVIRONMENT, check=True, capture_output=True, text=True
    )
    errors = [float(number) for number in re.findall(r"RMS error ([\d.]+)", found.stdout)]
    assert len(errors) == 8
    assert errors[-1] < 0.8 * errors[0]


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path) -> None:
    shutil.copy(DOCS / "first_steps.ipynb", tmp_path)
    command = [sys.executable, "-c", "from nbclient.cli import main; main()", "first_steps.ipynb", "--output", "run"]
    subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT, check=True, capture_output=True)
    assert "image/png" in (tmp_path / "run.ipynb").read_text("utf-8")
    assert (tmp_path / "ball.png").is_file()


def test_the_gallery_has_each_example_once() -> None:
    page = (DOCS / "gallery.md").read_text("utf-8")
    examples = ROOT / "examples"
    names = [
        path.relative_to(ROOT).as_posix() for folder in (examples, examples / "sets") for path in folder.glob("*.toml")
    ]
    assert sorted(re.findall(r"\]\(\.\./(examples/[\w/]+\.toml)\)", page)) == sorted(names)
    pictures = re.findall(r"\]\(gallery/(\w+\.jpg)\)", page)
    assert sorted(pictures) == sorted(path.name for path in (DOCS / "gallery").iterdir())
