"""What the tests share: one session on PoCL, which runs everywhere, and a kernel cache for each worker."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator

import pytest

# Workers would wait for each other's compilations, and every session would check the files of all tests before it:
# in a folder that the user has set, clsco does neither. Before the first query of the platforms, hence not a fixture.
if not os.environ.get("POCL_CACHE_DIR"):
    os.environ["POCL_CACHE_DIR"] = tempfile.mkdtemp(prefix="clsco-tests-")
    atexit.register(shutil.rmtree, os.environ["POCL_CACHE_DIR"], ignore_errors=True)

from clsco.device import Session, choose


@pytest.fixture(scope="session")
def session() -> Iterator[Session]:
    with Session(choose("pocl")) as opened:
        yield opened
