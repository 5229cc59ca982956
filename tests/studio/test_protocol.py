"""The page's module of the protocol is the one that Python's constants make."""

from __future__ import annotations

from tests.studio.protocol import MODULE, protocol


def test_the_module_is_made_of_the_constants_of_python() -> None:
    assert MODULE.read_text("utf-8") == protocol()
