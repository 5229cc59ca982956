"""Rules on what is shipped: the wheel's contents, the lazy front door, and the repository's own rules on files."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import clsco
from clsco.resources import folder

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 500


def repository_files() -> list[Path]:
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def python(code: str, cwd: Path, path: Path) -> str:
    environ = os.environ | {"PYTHONPATH": str(path)}
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, cwd=cwd, env=environ, check=True, capture_output=True, text=True).stdout


def test_no_file_is_too_long() -> None:
    files = [path for path in repository_files() if path.suffix in (".py", ".cl", ".clh")]
    assert files
    lengths = {str(path.relative_to(ROOT)): path.read_text("utf-8").count("\n") for path in files}
    assert {name: length for name, length in lengths.items() if length > LONGEST} == {}


def test_no_file_names_a_place_on_one_machine() -> None:
    place = re.compile(rb"""(?<![\w.])/(?:root|home|work|tmp|Users)/\w""")
    assert place.search(b'open("/' + b'home/me/scene.toml")')
    found = [str(path.relative_to(ROOT)) for path in repository_files() if place.search(path.read_bytes())]
    assert found == []


WITHOUT_SUFFIX = ("py", "LICENSE-inter", "LICENSE-lucide")  # py.typed, and licenses of the font and the icons


def shipped() -> set[str]:
    """Names that the wheel has to hold: the package, the kernels, and the example scenes."""
    suffixes = {
        "clsco": (".py", ".pyi", ".js", ".css", ".html", ".json", ".svg", ".webp", ".woff2"),
        "kernels": (".py", ".cl", ".clh"),
        "examples": (".py", ".toml", ".png", ".jpg", ".npy"),
    }
    names = [path.relative_to(ROOT) for path in repository_files()]
    wanted = [name for name in names if name.suffix in suffixes.get(name.parts[0], ()) or name.stem in WITHOUT_SUFFIX]
    return {name.as_posix() if name.parts[0] == "clsco" else f"clsco/{name.as_posix()}" for name in wanted}


@pytest.mark.slow
def test_the_wheel_holds_everything_and_nothing_else_and_finds_it(tmp_path: Path) -> None:
    """Built from a copy of the repository's files, so that nothing is left in the tree."""
    for path in repository_files():
        target = tmp_path / "source" / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, str(tmp_path / "source")], check=True)
    (wheel,) = tmp_path.glob(f"clsco-{clsco.__version__}-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if ".dist-info/" not in name} == shipped()
        (entry_points,) = (name for name in archive.namelist() if name.endswith("entry_points.txt"))
        assert "clsco = clsco.cli.process:run" in archive.read(entry_points).decode()
        archive.extractall(tmp_path / "site")
    code = "from clsco.resources import folder as f; print(f('kernels'), f('examples'), sep='\\n')"
    folders = [Path(line) for line in python(code, tmp_path, tmp_path / "site").splitlines()]
    assert folders == [tmp_path / "site/clsco/kernels", tmp_path / "site/clsco/examples"]


def test_a_source_tree_finds_its_kernels() -> None:
    assert folder("kernels") == ROOT / "kernels"
    with pytest.raises(FileNotFoundError, match=r"^no such folder: must be installed"):
        folder("no such folder")


def test_import_clsco_imports_nothing_large(tmp_path: Path) -> None:
    code = "import clsco, sys; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    loaded = set(python(code, tmp_path, ROOT).split())
    assert "clsco" in loaded
    assert loaded & {"numpy", "pyopencl", "pydantic", "imageio", "click", "rich"} == set()


@pytest.mark.parametrize("words", [["--help"], ["dataset", "make", "--help"]])
def test_help_waits_for_no_numpy(words: list[str], tmp_path: Path) -> None:
    assert imported(words, tmp_path) & {"numpy", "pydantic", "pyopencl", "rich"} == set()


def imported(words: list[str], cwd: Path) -> set[str]:
    """Modules that a command imports, and other words that it prints."""
    code = f"import sys; from clsco.cli.main import main; main({words}, standalone_mode=False); print(*sys.modules)"
    return set(python(code, cwd, ROOT).split())


def test_a_scene_imports_what_it_has(tmp_path: Path) -> None:
    said = imported(["validate", str(ROOT / "examples/sphere.toml")], tmp_path)
    assert "clsco.optics.pupils.circle" in said
    spreads = {f"clsco.optics.{name}" for name in ("field", "pupils.diffracted", "pupils.gaussian", "pupils.outline")}
    others = {"clsco.files.images", "clsco.optics.image_motion"}
    unneeded = {"clsco.cli.dataset", "numpy.polynomial", "rich", "statistics"}
    assert said & (spreads | others | unneeded) == set()


def test_the_front_door_offers_what_the_stub_and_the_docs_list() -> None:
    listed = re.findall(r"^::: clsco\.(\w+)(?:\.render)?$", (ROOT / "docs/api.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(listed) == clsco.__all__
    assert set(clsco.__all__) <= set(dir(clsco))
    for name in clsco.__all__:
        assert getattr(clsco, name).__name__.rpartition(".")[2] == name
    with pytest.raises(AttributeError, match="no attribute missing"):
        _ = clsco.missing  # type: ignore[attr-defined]
