"""What the tests share: one session on PoCL, which runs everywhere."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from clsco.device import Session, choose


@pytest.fixture(scope="session")
def session() -> Iterator[Session]:
    with Session(choose("pocl")) as opened:
        yield opened
