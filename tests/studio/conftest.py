"""Fixtures of all tests of the studio in Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.studio.browser import opened
from tests.studio.running import Running


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    """A page of the studio of the module, which shows an exact frame."""
    with opened(running) as shown:
        yield shown
