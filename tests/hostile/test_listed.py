"""Listed hostile input: scenes, command lines, textures and depths; one line that names the key, and no file."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from clsco.errors import SceneError
from clsco.scene.sweep import parse_sweep
from tests.command import clsco_
from tests.hostile.commands import bad_files, command_lines, lay_out
from tests.hostile.scenes import listed
from tests.hostile.watch import faults_of, keys_of

LONGEST_S = 5.0


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    lay_out(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_thousands_are_listed() -> None:
    scenes = {bad.about for bad in listed()}
    commands = {tuple(words) for words, _, _ in command_lines()}
    assert len(scenes) >= 8000
    assert len(commands) >= 300


def test_every_bad_scene_is_refused_and_its_key_named() -> None:
    wrong = []
    for bad in listed():
        try:
            parse_sweep(bad.mapping)
            wrong.append(f"{bad.about}: is taken for valid")
        except SceneError as error:
            wrong += [f"{bad.about}: {fault}" for fault in faults_of(error, "scene")]
            recorded = keys_of(error, "scene")
            if not any(key == bad.key or key.startswith((f"{bad.key}[", f"{bad.key}.")) for key in recorded):
                wrong.append(f"{bad.about}: must name {bad.key}; got {error.messages}")
    assert wrong == []


def contents(folder: Path) -> dict[str, tuple[int, int]]:
    """All files of a folder besides `out`, with size and time."""
    paths = (path for path in folder.rglob("*") if path.relative_to(folder).parts[0] != "out")
    return {str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in paths if not path.is_dir()}


def faults(words: list[str], status: int, named: str) -> Iterator[str]:
    """Faults in the end of a command line."""
    start = time.process_time()
    result, seconds = clsco_(*words), time.process_time() - start
    if not isinstance(result.exception, SystemExit):
        yield f"must end in an error; got {result.exception!r}"
    if result.exit_code != status:
        yield f"exit status must be {status}; got {result.exit_code}: {result.stderr[-300:]!r}"
    if seconds > LONGEST_S:
        yield f"must end within {LONGEST_S:g} s; got {seconds:.1f} s"
    lines = [line for line in result.stderr.splitlines() if line.startswith(("error: ", "Error: "))]
    if not lines or not all(line.isprintable() for line in lines):
        yield f"must tell an error on lines of their own; got {result.stderr[-300:]!r}"
    if status == 1 and result.stderr.splitlines() != lines:
        yield f"must tell errors alone; got {result.stderr[-300:]!r}"
    escaped = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in named)
    if not any(name[:50] in result.stderr for name in (named, escaped)):
        yield f"must name {named[:80]!r}; got {result.stderr[-300:]!r}"


@pytest.mark.parametrize("part", range(4))
def test_every_bad_command_line_ends_in_one_message(folder: Path, part: int) -> None:
    before, wrong = contents(folder), []
    for words, status, named in command_lines()[part::4]:
        wrong += [f"{' '.join(words)[:150]}: {fault}" for fault in faults(words, status, named)]
    assert wrong == []
    assert contents(folder) == before
    assert not list((folder / "elsewhere").iterdir())


def test_textures_and_depths_that_are_none(folder: Path) -> None:
    scenes = bad_files(folder)
    before, wrong = contents(folder), []
    for path, key in scenes:
        words = ["validate", path.name]
        wrong += [f"{path.read_text()[-60:]!r}: {fault}" for fault in faults(words, 1, key)]
    assert wrong == []
    assert contents(folder) == before
