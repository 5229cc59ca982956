"""Messages of a tab that no page of ours sends: each is refused with a message, and the tab goes on."""

from __future__ import annotations

import asyncio
import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="needs the extra studio")

from clsco.studio.moving import Pointer
from clsco.studio.preview import Preview
from clsco.studio.server import Studio, Tab, _tell
from clsco.studio.session import Document
from tests.studio.test_preview import Renderer
from tests.studio.test_store import linked

GOOD: tuple[dict[str, Any], ...] = (
    {"ack": [1, 2]}, {"path": "object.0.distance", "value": 300.0, "drag": 3}, {"hidden": False},
    {"watch": ["title"]}, {"watch": ["camera.__class__", "object.0.model_fields", "a" * 9999, "a..b"]},
    {"at": [1, 2]}, {"measure": [1, 2]}, {"overview": True}, {"focus": [1, 2], "drag": 4},
    {"grab": [1, 2], "drag": 5}, {"pull": [1.0, 2.0], "along": True, "drag": 5}, {"link": "#s=q1YqUbKqjq0FAA"},
    {"keyframe": "object.0.motion.keyframe", "add": 0.5}, {"keyframe": "lens.keyframe", "remove": 0},
    {"do": "pin thesis"}, {"do": "cancel"}, {"do": "keep"}, {"do": "undo"}, {"do": "redo"},
    {"resume": {"scene": "#s=q1YqUbKqjq0FAA", "file": "a.toml", "digest": "0"}, "tab": "x"}, {"view": "depth"},
    {"frame": 0, "time": 0.1, "eye": "left", "again": True}, {"stack": [200.0, 400.0, 3]},
)  # fmt: skip


def nested(depth: int) -> Any:
    value: Any = 1
    for k in range(depth):
        value = [value] if k % 2 else {"a": value}
    return value


BAD: tuple[Any, ...] = (
    None, True, -1, 10**400, 1e308, float("nan"), float("inf"), "", "x" * 5000, "\0", "../../etc/passwd", "\ud800",
    [], {}, [[]], nested(20), nested(400),
)  # fmt: skip


def spoiled(message: Any) -> Iterator[Any]:
    """A message with each of its parts replaced, and left out."""
    parts = message.items() if isinstance(message, dict) else enumerate(message)
    for key, value in list(parts):
        for bad in BAD:
            changed = copy.copy(message)
            changed[key] = bad
            yield changed
        if isinstance(message, dict):
            yield {other: kept for other, kept in message.items() if other != key}
        if isinstance(value, dict | list):
            for inner in spoiled(value):
                changed = copy.copy(message)
                changed[key] = inner
                yield changed


RAW = [
    "", "{", "[" * 30000, '{"path":' * 5000, "[]", "1", "null", '"x"', '{"path": "title", "value": "\\ud800"}',
    "\ufeff{}", "NaN",
]  # fmt: skip


def link_of(content: Any) -> str:
    return linked(json.dumps(content).encode())


NAMES = ("x" * 5000, "a/" * 2500, "\0", "*", "..", "/", "a/..", "**/*", "\ud800", "", ".")
LINKS = [
    "", "#s=***", "A" * 5000, "#s=" + "A" * 5000, "\N{BULLET}" * 5000,
    *(link_of({"object": [{"shape": "plane", "texture": name}], "files": {name: "0" * 64}}) for name in NAMES),
    *(link_of({"object": [{"shape": "plane", "texture": "a.png"}], "files": bad}) for bad in (*BAD, {"a.png": 1})),
    *(link_of({"object": [{"shape": bad}]}) for bad in BAD),
    *(link_of({"object": bad}) for bad in BAD),
    *(link_of({"title": bad, "object": [{"shape": "plane"}]}) for bad in BAD),
]  # fmt: skip


class Said:
    """A tab without a socket, and what it was told."""

    def __init__(self, root: Path) -> None:
        self.studio, self.told = Studio(root), list[dict[str, Any]]()
        self.tab = Tab(Document(root))

    async def hear(self, text: str) -> None:
        preview = Preview(self.tab.session, Renderer(), self.send)
        await self.studio.hear(self.tab, preview, Pointer(self.tab.session, preview), text)
        self.tab.session.remembered()
        values = {path: self.tab.session.shown(path) for path in self.tab.watched}
        await preview.tell(values=values, faults=self.tab.session.faults)

    async def send(self, data: bytes) -> None:
        self.told.append(json.loads(data[20:]))

    @property
    def errors(self) -> list[str]:
        return [message for said in self.told for message in said.get("error", ())]


@pytest.fixture
def said(tmp_path: Path) -> Said:
    return Said(tmp_path)


def test_malformed_messages(said: Said) -> None:
    messages = [json.dumps(each) for good in GOOD for each in spoiled(good)] + RAW
    assert len(messages) > 850

    async def talk() -> None:
        for text in messages:
            await said.hear(text)

    asyncio.run(talk())
    assert said.errors
    assert all(len(message) < 1000 for message in said.errors)
    assert not any("must not fail" in message for message in said.errors)


@pytest.mark.parametrize(
    "text", ["[" * 30000, '{"path": "title", "value": ' + "[" * 2000 + "]" * 2000 + "}", "{", "\ufeff{}"]
)
def test_what_cannot_be_read_is_said(said: Said, text: str) -> None:
    asyncio.run(said.hear(text))
    assert len(said.errors) == 1
    assert "message: must be JSON" in said.errors[0]


def test_a_box_hears_of_an_undo_that_comes_right_after_what_was_typed(said: Said) -> None:
    path = "object.0.distance"

    async def talk() -> None:
        telling = asyncio.create_task(_tell(said.tab, Preview(said.tab.session, Renderer(), said.send)))
        await said.hear(json.dumps({"watch": [path]}))
        await asyncio.sleep(0.1)
        for each in ({"path": path, "value": 300.0}, {"do": "undo"}):
            await said.hear(json.dumps(each))
        said.told.clear()
        said.tab.told.set()
        await asyncio.sleep(0.1)
        telling.cancel()

    asyncio.run(talk())
    assert [each["values"] for each in said.told if "values" in each] == [{path: 250.0}]


def test_links_that_cannot_be(said: Said) -> None:
    async def talk() -> None:
        for link in LINKS:
            said.told.clear()
            said.tab = Tab(Document(said.studio.root))
            before = said.tab.session.table
            await said.hear(json.dumps({"link": link}))
            assert said.errors or said.tab.session.refused or said.tab.session.table != before, link[:100]
            assert all(len(message) < 1000 for message in said.errors)

    asyncio.run(talk())
