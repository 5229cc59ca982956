"""PoCL's cache folder: where it is, and that damage to it and a crowd around it do no harm."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from clsco import resources
from clsco.opencl import pocl_cache as poclcache
from clsco.opencl.device import choose
from tests.slow import combined

RENDER = """\
import sys
from pathlib import Path
import numpy as np
from clsco.opencl import buffers, program, source_text
from clsco.opencl.device import choose
from clsco.opencl.session import Session
program.folder = source_text.folder = lambda name: Path(sys.argv[1])
with Session(choose("pocl")) as session:
    built = program.build(session, "work.cl", {}, {}, "float")
    for name in ("first", "second"):
        buffer = buffers.empty(session, 4 * 256)
        program.launch(session, built[name], (256,), (64,), buffer)
        print(buffers.download(session, buffer, (256,), np.int32).sum())
"""
WORK = """\
__kernel void first(__global int *out) { out[get_global_id(0)] = 1; }
__kernel void second(__global int *out) { out[get_global_id(0)] = 2; }
"""


Start = Callable[[Path], subprocess.Popen[str]]


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    """Starts a process that builds and launches two kernels with its cache below a given folder."""
    kernels = tmp_path_factory.mktemp("kernels")
    (kernels / "common/cpu").mkdir(parents=True)
    declared = resources.folder("kernels") / "common/cpu/pocl.clh"
    (kernels / "common/cpu/pocl.clh").write_text(declared.read_text("utf-8"))
    for header in ("common/cpu/builtins.clh", "common/distortion.clh", "common/geometry.clh"):
        (kernels / header).write_text("")
    (kernels / "work.cl").write_text(WORK)
    environ = {name: value for name, value in os.environ.items() if name not in ("POCL_CACHE_DIR", "PYOPENCL_CTX")}
    environ["PYTHONPATH"] = str(Path(poclcache.__file__).parents[2])

    def started(cache: Path) -> subprocess.Popen[str]:
        command = [sys.executable, "-W", "error", "-c", RENDER, str(kernels)]
        return subprocess.Popen(
            command,
            env=environ | {"XDG_CACHE_HOME": str(cache)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    return started


@pytest.fixture(scope="module")
def warm(start: Start, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that one process has filled; to be copied."""
    cache = tmp_path_factory.mktemp("warm")
    assert ended(start(cache)) == (0, "256\n512\n")
    return cache


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    output, _ = process.communicate(timeout=120)
    return process.returncode, output


def overwrite(path: Path) -> None:
    path.write_bytes(b"damaged " * 400)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size * 6 // 10)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("damage", "pattern"),
    combined([overwrite, cut, flip, Path.unlink], ["program.bc", "second.so"], kept=[(overwrite, "second.so")]),
)
def test_a_damaged_cache_is_found_and_rebuilt(
    start: Start, warm: Path, tmp_path: Path, pattern: str, damage: Callable[[Path], None]
) -> None:
    shutil.copytree(warm, tmp_path, dirs_exist_ok=True)
    (path,) = (tmp_path / "clsco").rglob(pattern)
    damage(path)
    damaged = path.read_bytes() if path.is_file() else b""
    assert ended(start(tmp_path)) == (0, "256\n512\n")
    assert path.read_bytes() != damaged


def test_a_file_of_a_process_that_died_over_it_is_not_loaded(start: Start, warm: Path, tmp_path: Path) -> None:
    shutil.copytree(warm, tmp_path, dirs_exist_ok=True)
    (folder,) = (tmp_path / "clsco").iterdir()
    (folder / poclcache.LIST).unlink()  # nothing is recorded, as if the process had been killed before it could
    for path in folder.rglob("*.so"):
        cut(path)
    assert ended(start(tmp_path)) == (0, "256\n512\n")


def test_an_undamaged_cache_is_used(start: Start, warm: Path, tmp_path: Path) -> None:
    shutil.copytree(warm, tmp_path, dirs_exist_ok=True)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "clsco").rglob("*.so")}
    assert len(before) == 2
    assert ended(start(tmp_path)) == (0, "256\n512\n")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "clsco").rglob("*.so")} == before


def test_many_cold_starts_at_once(start: Start, tmp_path: Path) -> None:
    processes = [start(tmp_path) for _ in range(2)]
    assert [ended(process) for process in processes] == [(0, "256\n512\n")] * 2


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux lists the signals of threads")
def test_ctrl_c_reaches_no_thread_and_no_linker_of_pocl() -> None:
    choose("pocl")
    threads = [path.read_text() for path in Path("/proc/self/task").glob("*/status")]
    held = [int(text.partition("SigBlk:")[2].split()[0], 16) for text in threads]
    both = 1 << signal.SIGINT - 1 | 1 << signal.SIGTERM - 1
    assert any(signals & both == both for signals in held)
    with poclcache.exclusive():
        assert {signal.SIGINT, signal.SIGTERM} <= signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert not {signal.SIGINT, signal.SIGTERM} & signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_folder_that_the_user_has_set_stays() -> None:
    environ = {"POCL_CACHE_DIR": "mine"}
    poclcache.prepare(environ)
    assert environ == {"POCL_CACHE_DIR": "mine", "POCL_WORK_GROUP_SPECIALIZATION": "0"}


def chosen(root: Path) -> str:
    """The folder for kernels below `root`, or a temporary one."""
    environ = {"XDG_CACHE_HOME": str(root)}
    poclcache.prepare(environ)
    return environ[poclcache.VARIABLE]


def test_the_folder_names_the_versions(tmp_path: Path) -> None:
    folder = Path(chosen(tmp_path))
    assert folder.is_dir()
    assert folder.parent == tmp_path / "clsco"
    assert folder.name.startswith("pocl-")
    assert any(character.isdigit() for character in folder.name)


def test_a_cache_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    folder = Path(chosen(tmp_path / "file"))
    assert folder.is_dir()
    assert tmp_path not in folder.parents


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache of this process."""
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "clsco" / "pocl-1"))
    return tmp_path / "clsco" / "pocl-1"


def compiled(folder: Path, *files: str) -> None:
    """Put files into a cache and its list; what they hold are their names."""
    with poclcache.exclusive():
        for file in files:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(file)


def test_too_large_a_cache_is_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = ("AB/one/program.bc", "AB/two/program.bc", "CD/three/program.bc")
    compiled(folder, *files)
    size = sum(len(file) for file in files)
    monkeypatch.setattr(poclcache, "_LARGEST", size)
    assert poclcache.check() == 0
    monkeypatch.setattr(poclcache, "_LARGEST", size - 1)
    assert poclcache.check() == 3
    assert list(folder.rglob("program.bc")) == []


def test_only_the_damaged_program_is_removed(folder: Path) -> None:
    compiled(folder, "AB/one/program.bc", "AB/two/program.bc")
    (folder / "AB/one/program.bc").write_text("AB/One/program.bc")
    assert poclcache.check() == 1
    assert [path.parent.name for path in folder.rglob("program.bc")] == ["two"]
    assert poclcache.check() == 0
    (folder / poclcache.LIST).write_text('{"AB/two/program.bc": 3}')
    assert poclcache.check() == 1


def test_a_list_that_lost_the_damaged_file_is_none(folder: Path) -> None:
    compiled(folder, "AB/one/program.bc", "AB/one/work.so")
    assert poclcache.check() == 0
    (folder / "AB/one/program.bc").unlink()
    (folder / "AB/one/program.bc").mkdir()  # which PoCL would read
    listed = (folder / poclcache.LIST).read_text()
    (folder / poclcache.LIST).write_text(listed.replace("AB/one/program.bc", "AB/onf/program.bc"))
    assert poclcache.check() == 1
    assert list((folder / "AB").iterdir()) == []


def test_folders_that_did_not_change_are_not_read_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled(folder, "AB/one/program.bc", "AB/two/program.bc")
    for path in folder.glob("AB/*"):
        os.utime(path, (1.0, 1.0))
    read: list[str] = []
    scandir = os.scandir

    def noted(path: str) -> os._ScandirIterator[str]:
        read.append(str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", noted)
    with poclcache.exclusive():
        pass
    assert sorted(read)[-2:] == [f"{folder}/AB/one/", f"{folder}/AB/two/"]
    read.clear()
    with poclcache.exclusive():
        (folder / "AB/two/kernel").mkdir()
        (folder / "AB/two/kernel/work.so").write_text("compiled")
    assert f"{folder}/AB/one/" not in read
    assert f"{folder}/AB/two/kernel/" in read
    assert poclcache.check() == 0
    (folder / "AB/two/kernel/work.so").write_text("Compiled")  # in place, as no folder tells
    assert poclcache.check() == 1


@pytest.mark.parametrize("place", ["clsco", "clsco/{versions}"])
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o702])
def test_a_folder_that_others_may_write_to_is_not_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, place: str, mode: int
) -> None:
    """Files in the folder are executed."""
    ours = tmp_path / "clsco" / f"pocl-{poclcache._versions()}"
    planted = ours / "AB/one/work.so"
    planted.parent.mkdir(parents=True)
    planted.write_text("planted")
    for folder in (ours.parent, ours):
        folder.chmod(0o700)
    assert chosen(tmp_path) == str(ours)
    assert caplog.messages == []
    (tmp_path / place.format(versions=ours.name)).chmod(mode)
    assert not chosen(tmp_path).startswith(str(tmp_path))
    assert ["must belong to you, and be writable by you alone" in each for each in caplog.messages] == [True]


def test_a_folder_of_another_user_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tmp_path.chmod(0o700)
    user = os.geteuid()
    assert chosen(tmp_path).startswith(str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    assert not chosen(tmp_path).startswith(str(tmp_path))


def test_a_link_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    (tmp_path / "clsco").symlink_to(tmp_path / "elsewhere")
    assert not chosen(tmp_path).startswith(str(tmp_path))


@pytest.mark.parametrize(("mode", "used"), [(0o777, False), (0o1777, True), (0o755, True)])
def test_where_the_folder_itself_could_be_replaced(tmp_path: Path, mode: int, used: bool) -> None:
    tmp_path.chmod(mode)
    assert chosen(tmp_path).startswith(str(tmp_path)) == used
