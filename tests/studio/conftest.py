"""Fixtures of all tests of the studio against a running server, and in Chromium.

A module says what its studio begins with: `FILES`, texts by their names; `SHIPPED`, names of examples; `OPENS`, the
scene of the command line, if any.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from clsco.studio.session import Document
from tests.studio.browser import EXAMPLES, end_chromium, opened
from tests.studio.running import Running, studio


@pytest.fixture(scope="module")
def root(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the studio of the module."""
    folder: Path = tmp_path_factory.mktemp("root")
    for name, text in getattr(request.module, "FILES", {}).items():
        (folder / name).write_text(text)
    for name in getattr(request.module, "SHIPPED", ()):
        shutil.copy(EXAMPLES / name, folder)
    return folder


@pytest.fixture(scope="module")
def running(request: pytest.FixtureRequest, root: Path) -> Iterator[Running]:
    """The studio of the module."""
    scene = getattr(request.module, "OPENS", "")
    device = getattr(request.module, "DEVICE", ("--device", "pocl"))
    with studio(root, *([str(root / scene)] if scene else []), *device) as started:
        yield started


@pytest.fixture(scope="module", autouse=True)
def one_chromium() -> Iterator[None]:
    """All tests of a module use one Chromium, if any."""
    yield
    end_chromium()


@pytest.fixture
def session(tmp_path: Path) -> Document:
    """A session with the scene that a studio begins with."""
    return Document(tmp_path)


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    """A page of the studio of the module, which shows an exact frame."""
    with opened(running) as shown:
        yield shown
