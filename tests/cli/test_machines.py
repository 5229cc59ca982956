"""Machines that are not ours: no folder in the home can be written, and one in it has what a stranger left there."""

from __future__ import annotations

import os
import pickle
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from clsco.opencl.session import Session
from tests.slow import mostly_slow

NOWHERE = "/proc/none"  # in which nobody makes a folder
HOMES = {
    "home": {"HOME": NOWHERE},
    "cache": {"HOME": "/", "XDG_CACHE_HOME": NOWHERE},
    "everything": {"HOME": NOWHERE, "XDG_CACHE_HOME": NOWHERE, "XDG_CONFIG_HOME": NOWHERE, "XDG_STATE_HOME": NOWHERE},
}
BLUR = "import numpy as np, clsco; clsco.defocus(np.ones((8, 8), np.float32), np.ones((8, 8)))"
PYOPENCL_FIRST = f"import pyopencl; {BLUR}"
KEPT = f"import pyopencl, clsco.opencl.device; pyopencl._PYOPENCL_NO_CACHE = False; {BLUR}"  # as it was before


def ran(code: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run a Python process where nothing but these variables, and the cache of kernels, is set."""
    kept = {name: os.environ[name] for name in ("PATH", "POCL_CACHE_DIR", "CLSCO_POCL_CPU")}
    return subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=120, env=kept | environ
    )


def done(code: str, **environ: str) -> None:
    process = ran(code, **environ)
    assert (process.returncode, process.stderr) == (0, "")


@pytest.mark.parametrize("where", mostly_slow(HOMES, ["home"]))
@pytest.mark.parametrize("code", mostly_slow([BLUR, PYOPENCL_FIRST], [BLUR]), ids=["clsco", "pyopencl first"])
def test_kernels_run_where_nothing_can_be_kept(where: str, code: str) -> None:
    done(code, **HOMES[where])


def test_the_command_makes_a_frame_there(tmp_path: Path) -> None:
    """With the cache of kernels that it makes for itself, which is gone afterwards."""
    (tmp_path / "tmp").mkdir()
    scene = "[[object]]\nshape = 'plane'\ndistance = 300\n[camera]\nresolution = [8, 8]\n"
    (tmp_path / "scene.toml").write_text(scene)
    words = ["clsco", "render", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out")]
    code = f"import sys; from clsco.cli.process import run; sys.argv = {words}; run()"
    process = ran(code, **HOMES["everything"], POCL_CACHE_DIR="", TMPDIR=str(tmp_path / "tmp"))
    assert (process.returncode, process.stderr) == (0, "")
    assert (tmp_path / "out" / "frame_0000.png").is_file()
    assert list((tmp_path / "tmp").iterdir()) == []


ABSENT = ("pread", "sysconf", "killpg", "getpgid", "geteuid", "fork", "sched_getaffinity", "O_NOFOLLOW", "O_DIRECTORY")
OTHER_SYSTEM = f"""
import asyncio, multiprocessing.popen_spawn_posix, os, psutil, subprocess, sys, tempfile
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
for name in {ABSENT}:
    delattr(os, name)
"""
SET = """
[camera]
resolution = [16, 12]
[[object]]
shape = "plane"
[[vary.object]]
index = 0
distance = { uniform = [300, 400] }
"""


def test_what_windows_lacks_is_not_needed(tmp_path: Path) -> None:
    """Each module is imported, a studio finds its state, and a set is made by two processes."""
    (tmp_path / "sitecustomize.py").write_text(OTHER_SYSTEM)
    (tmp_path / "set.toml").write_text(SET)
    words = ["clsco", "dataset", "make", str(tmp_path / "set.toml"), "-o", str(tmp_path / "set"), "--count", "3"]
    words += ["--workers", "2", "--shard-size", "1", "--quiet"]
    code = f"""if __name__ == "__main__":
    import pkgutil, sys, importlib, clsco
    for module in pkgutil.walk_packages(clsco.__path__, "clsco."):
        if not module.name.endswith("__main__") and "truth" not in module.name:  # Numba takes long
            importlib.import_module(module.name)
    from clsco.studio.session import StateFolder
    StateFolder("studio")
    from clsco.cli.process import run
    sys.argv = {words}
    run()
"""
    (tmp_path / "run.py").write_text(code)
    command = f"import runpy, sys; runpy.run_path({str(tmp_path / 'run.py')!r}, run_name='__main__')"
    process = ran(command, HOME=str(tmp_path), PYTHONPATH=str(tmp_path))
    assert (process.returncode, process.stderr) == (0, "")
    assert len(list((tmp_path / "set").rglob("*.tar"))) == 3


def test_without_a_linker_there_is_a_message(tmp_path: Path, session: Session) -> None:
    """PoCL 3.0 would end the process."""
    if "PoCL 3." not in session.device.platform_version:
        pytest.skip("another PoCL may bring its linker")
    process = ran(BLUR, PATH=str(tmp_path), HOME=str(tmp_path), POCL_CACHE_DIR="")
    assert process.returncode == 1
    assert "kernels are linked by ld, which must be in a folder of PATH;" in process.stderr.splitlines()[-1]


class Planted:
    """Unpickled, it makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        """Call that unpickling makes."""
        return Path.touch, (self.mark,)


def plant(cache: Path, mark: Path) -> int:
    """Put something else in the place of every value that pytools has pickled into a user's cache folder."""
    planted = 0
    for path in (cache / "pytools").iterdir():
        with sqlite3.connect(path) as database:
            planted += database.execute("UPDATE dict SET key_value = ?", (pickle.dumps(Planted(mark)),)).rowcount
        database.close()
    return planted


def test_what_others_pickled_is_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    environ = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    done(KEPT, **environ)
    assert plant(tmp_path, mark) > 0
    ran(KEPT, **environ)
    assert mark.exists()  # so that it would be run
    mark.unlink()
    done(f"import pyopencl.invoker; {BLUR}", **environ)
    assert not mark.exists()
