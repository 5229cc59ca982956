"""Fixtures of all tests: one session on PoCL, which runs everywhere, or on CLSCO_DEVICE; a kernel cache of all runs."""

from __future__ import annotations

import atexit
import gc
import os
import re
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import kernel_cache

# Tests see what a user has who has set nothing; and what those who start them set: workers, other folders, simulators.
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers inherit it
    kept = {
        "PATH", "HOME", "USER", "LANG", "LC_ALL", "TMPDIR", "LD_LIBRARY_PATH", "OCL_ICD_VENDORS", "CI",
        "CLSCO_DEVICE", "PYTHONPATH", "POCL_CACHE_DIR", "POCL_DEVICES", "PYOPENCL_BUILD_OPTIONS", "CLSCO_EVERY",
    }  # fmt: skip
    for name in os.environ.keys() - kept:
        if not name.startswith("PYTEST_"):
            del os.environ[name]

# Those that a shell starts in the background ignore Ctrl-C, and so would what they start.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Before the first query of the platforms, hence not a fixture. In a folder that is not its own, clsco does not check
# the files of all tests before. Workers inherit the folder of the process that starts them.
if Path(os.environ.get("POCL_CACHE_DIR") or kernel_cache.WORKER).name.startswith(kernel_cache.WORKER):
    os.environ["POCL_CACHE_DIR"] = str(kernel_cache.worker_folder())
if "PYTEST_XDIST_WORKER" not in os.environ:  # tables, textures and studios of all workers, and none of the user's
    os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="clsco-state-")
    atexit.register(shutil.rmtree, os.environ["XDG_STATE_HOME"], ignore_errors=True)
    os.environ["XDG_CACHE_HOME"] = str(kernel_cache.array_folder())
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # those of several workers would wait for each other
# What a processor newer than PoCL needs is done without the line on stderr, which tests compare.
os.environ.setdefault("CLSCO_POCL_CPU", "1")

from clsco.errors import KernelError, SceneError
from clsco.opencl.device import Device, choose
from clsco.opencl.session import Session

MARK_OF_ALL = re.compile(r"^pytestmark = pytest\.mark\.(\w+)", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Skip the import of modules whose tests are all deselected by their mark."""
    if collection_path.is_dir() or not collection_path.name.startswith("test_"):
        return None
    mark = MARK_OF_ALL.search(collection_path.read_text("utf-8"))
    return True if mark and f"not {mark[1]}" in config.option.markexpr.split(" and ") else None


def pytest_collection_finish() -> None:
    """The tests themselves are never garbage: not to be looked at each time that something is collected."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def exchanged_programs() -> Iterator[None]:
    """Exchange of compiled programs after each file of tests, so that no worker compiles them again."""
    yield
    if Path(os.environ["POCL_CACHE_DIR"]).name.startswith(kernel_cache.WORKER):
        kernel_cache.exchange_programs(Path(os.environ["POCL_CACHE_DIR"]))


def pytest_unconfigure() -> None:
    """Leave the compiled kernels to later runs."""
    folder = Path(os.environ["POCL_CACHE_DIR"])
    if folder.name.startswith(kernel_cache.WORKER):
        kernel_cache.exchange_programs(folder)
        shutil.rmtree(folder, ignore_errors=True)
        if "PYTEST_XDIST_WORKER" not in os.environ:
            kernel_cache.remove_old()


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("processor") and tested_device().kind == "gpu":
        pytest.skip("needs a processor")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Leave out what needs the kernels of processors where the tests run on a graphics card."""
    try:
        yield
    except (KernelError, SceneError) as error:
        needs_processor = any(words in str(error) for words in ("blur/cpu/", "-DGATHER=1 ", "gather needs a processor"))
        if needs_processor and tested_device().kind == "gpu":
            pytest.skip("needs a processor")
        raise


def tested_device() -> Device:
    """CLSCO_DEVICE, or PoCL."""
    return choose(os.environ.get("CLSCO_DEVICE", "pocl"))


@pytest.fixture(scope="session")
def session() -> Iterator[Session]:
    with Session(tested_device()) as opened:
        yield opened
