"""The end of the command's process: its status, its output, and what was to be done at the end."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.slow import mostly_slow

COMMAND = """
import atexit, sys
from clsco.cli.process import run
atexit.register(print, "at the end")
sys.argv = ["clsco", *sys.argv[1:]]
{before}
run()
print("not reached")
"""
THREAD = "import threading, time; threading.Thread(target=lambda: (time.sleep(1.0), print('thread'))).start()"


def ended(*words: str, before: str = "", **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", COMMAND.format(before=before), *words]
    return subprocess.run(command, check=False, text=True, timeout=60, **options)  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("words", "status", "begins"),
    [(("--version",), 0, "clsco, version"), (("check", "no such file"), 1, ""), (("no such command",), 2, "")],
    ids=["done", "user's error", "usage"],
)
def test_the_process_ends_with_its_status_and_all_its_output(words: tuple[str, ...], status: int, begins: str) -> None:
    process = ended(*words, capture_output=True)
    assert (process.returncode, process.stderr == "") == (status, status == 0)
    assert process.stdout.startswith(begins)
    assert process.stdout.endswith("at the end\n")
    assert "Traceback" not in process.stderr


AT_IMPORT = """
import builtins, os, signal
imports = builtins.__import__
async def work(): pass
def interrupt(name, *rest):
    if name == "{place}":
        dropped = work()  # as libraries leave behind
        os.kill(os.getpid(), signal.{name})
    return imports(name, *rest)
builtins.__import__ = interrupt
"""
AT_CLASS = """
import functools, os, signal
set_name = functools.cached_property.__set_name__
def interrupt(self, owner, name):
    if name == "{place}":
        os.kill(os.getpid(), signal.{name})
    set_name(self, owner, name)
functools.cached_property.__set_name__ = interrupt
"""


@pytest.mark.parametrize(
    ("setup", "place", "name", "end"),
    [
        (AT_IMPORT, "clsco.cli.main", "SIGINT", (130, "interrupted\n")),
        (AT_IMPORT, "click", "SIGTERM", (143, "terminated\n")),
        (AT_IMPORT, "clsco.scene.quantities", "SIGTERM", (143, "terminated\n")),
        (AT_IMPORT, "clsco.plan.prepare", "SIGINT", (130, "interrupted\n")),
        (AT_CLASS, "color_plans", "SIGINT", (130, "interrupted\n")),  # of Plan: Python raises RuntimeError there
    ],
)
def test_a_signal_while_modules_are_imported_ends_with_one_line(
    setup: str, place: str, name: str, end: tuple[int, str]
) -> None:
    script = setup.format(place=place, name=name) + COMMAND.format(before="")
    scene = Path(__file__).parents[2] / "examples" / "sphere.toml"
    command = [sys.executable, "-c", script, "plan", str(scene)]
    process = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert (process.returncode, process.stderr) == end


def test_a_worker_that_is_ended_says_nothing_of_what_it_drops() -> None:
    lines = [
        "import os, signal; from clsco.data.pool import stoppable",
        "async def work(): pass",
        "with stoppable():",
        "    dropped = work()",
        "    os.kill(os.getpid(), signal.SIGTERM)",
    ]
    process = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=60)
    assert (process.returncode, process.stderr) == (143, "")


def test_a_thread_that_works_is_waited_for() -> None:
    process = ended("--version", before=THREAD, capture_output=True)
    assert process.returncode == 0
    assert "thread\n" in process.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_output_that_cannot_be_written_is_an_error() -> None:
    with Path("/dev/full").open("w") as full:
        process = ended("--version", stdout=full, stderr=subprocess.PIPE)
    assert process.returncode != 0
    assert "No space left" in process.stderr


@pytest.mark.parametrize("encoding", mostly_slow(["ascii", "cp1252", "utf-16"], ["cp1252"]))
def test_what_an_output_has_no_letters_for_is_printed_as_escapes(encoding: str, tmp_path: Path) -> None:
    """In tables, whose frame is of other characters then, and in errors."""
    scene = tmp_path / "scene.toml"
    plane = "[camera]\nnormalization_distance = 20\n[[object]]\nshape = 'plane'\ndistance = 300\n"
    scene.write_text(f"title = 'winter \u2603'\n{plane}", "utf-8")
    environ = os.environ | {"PYTHONIOENCODING": encoding}
    process = ended("plan", str(scene), capture_output=True, encoding=encoding, env=environ)
    snow = "\\u2603" if encoding != "utf-16" else "\u2603"
    assert (process.returncode, process.stderr, process.stdout.splitlines()[0]) == (0, "", f"Plan: winter {snow}")
    assert "guard band" in process.stdout
    encoding = "utf-8" if encoding == "ascii" else encoding  # which click takes for a mistake
    snow = "\u2603" if encoding != "cp1252" else snow
    process = ended("plan", "\u2603", capture_output=True, encoding=encoding, env=environ)
    assert (process.returncode, process.stdout) == (1, "at the end\n")
    assert process.stderr.startswith(f"error: {snow}: ")


def test_the_package_runs_as_the_command() -> None:
    words = [sys.executable, "-m", "clsco", "--version"]
    assert subprocess.run(words, check=True, text=True, capture_output=True, timeout=60).stdout.startswith("clsco, ver")
    words[-1] = "no such command"
    run = subprocess.run(words, check=False, text=True, capture_output=True, timeout=60)
    assert (run.returncode, run.stderr.startswith("Usage: clsco ")) == (2, True)
