"""The page as it is drawn, parts of it that are drawn again, and what its elements do."""

from __future__ import annotations

import asyncio
import gc
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="needs the extra clsco[studio]")

import httpx

from clsco.errors import ClscoError
from clsco.studio import server
from clsco.studio.page import draw
from clsco.studio.server import Studio, application
from clsco.studio.session import Document
from clsco.studio.widgets.html import Dialog, Page, PagePart, button, check_box, notify, say, text_box
from clsco.studio.widgets.panels import Chosen, draw_panels
from tests.studio.test_messages import BAD, Said

EMPTY = ("img", "input", "link", "meta")


class Elements(HTMLParser):
    """Elements that are open at the end, and attributes of all."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def numbers(html: str) -> list[int]:
    return [int(number) for number in re.findall(r'data-number="(\d+)"', html)]


def test_text_and_attributes_are_never_markup() -> None:
    with (page := Page()).current(), say("p", '<b>"&', title='"><script>', hidden=True, lang=None, class_="a b"):
        say("input", value=0, checked=False, data_x="")
    assert "".join(page.out) == (
        '<p title="&quot;&gt;&lt;script&gt;" hidden class="a b">&lt;b&gt;&quot;&amp;<input value="0" data-x=""></p>'
    )


def test_the_page_is_whole(tmp_path: Path) -> None:
    studio = Studio(tmp_path)
    _, text = draw(asyncio.run(studio.tab()), studio, "")
    found = Elements(text)
    assert found.open == ["html"]  # whose end may be left out
    ids = [given["id"] for _, given in found.found if "id" in given]
    assert len(ids) == len(set(ids)) > 100
    assert not any(name == "style" or name.startswith("on") for _, given in found.found for name in given)


def test_what_is_pressed_and_typed() -> None:
    done: list[object] = []
    page = Page()
    with page.current():
        button("a", lambda: done.append("pressed"))
        check_box("b", True, done.append)
        text_box("c", "", done.append)
    for number, value in zip(numbers("".join(page.out)), ("x", 0, 3), strict=True):
        page.hear(number, value)
    page.hear(99, "of an element that is gone")
    assert done == ["pressed", False, "3"]


def test_what_is_refused_is_a_notice_and_dialogs_open() -> None:
    told: list[int] = []
    page = Page(told=lambda: told.append(1))

    def refuse() -> None:
        notify("begun")
        raise ClscoError("a: must be b")

    with page.current():
        dialog = Dialog("A title")
        button("a", refuse)
    page.hear(numbers("".join(page.out))[-1], "")
    dialog.open()
    with dialog.filled():
        say("p", "second")
    dialog.close()
    place = re.search(r'id="(dialog-\d+)"', "".join(page.out))
    assert place is not None
    shown, hidden = {"show": f"#{place[1]}"}, {"close": f"#{place[1]}"}
    notices = [{"notice": "begun", "good": True}, {"notice": "a: must be b", "good": False}]
    *said, part, last = page.taken()
    assert said == [*notices, shown]
    assert (part["html"], last) == ("<p>second</p>", hidden)
    assert len(told) == 5
    assert page.taken() == []


def test_parts_are_drawn_again_and_what_was_in_them_is_gone() -> None:
    labels, done = ["a", "b"], list[str]()

    def inner() -> None:
        button("inner", lambda: done.append("inner"))

    def outer() -> None:
        for label in labels:
            button(label, lambda label=label: done.append(label))  # type: ignore[misc]
        within()

    page = Page()
    with page.current():
        within, part = PagePart(inner), PagePart(outer)
        part()
    first = numbers("".join(page.out))
    labels[:] = ["c"]
    part.refresh()
    within.refresh()
    part.refresh()
    (whole,) = (message for message in page.taken() if ">c<" in message["html"])  # the latest alone
    second = numbers(whole["html"])
    assert sorted(page.handlers) == second
    for number in (*first, *second):
        page.hear(number, "")
    assert done == ["c", "inner"]
    with page.current():
        PagePart().refresh()
    assert not page.taken()  # nothing is another


def test_any_value_of_any_element_is_heard(tmp_path: Path) -> None:
    said = Said(tmp_path)
    said.studio.tabs["one"] = said.tab
    said.tab.page, text = draw("one", said.studio, "")
    elements = re.findall(r'data-on="(?:change|input|toggle)" data-number="(\d+)"', text)
    assert len(elements) > 10

    async def hear() -> None:
        for number in (*map(int, elements), -1, 10**9, True):
            for value in BAD:
                await said.hear(json.dumps({"on": number, "value": value}))

    asyncio.run(hear())
    assert not [error for error in said.errors if "must not fail" in error]


def test_panels_are_folded_by_what_each_scene_uses(tmp_path: Path) -> None:
    for name, rest in (("plain", ""), ("lit", "[light]\ndirection = [0, 1, 1]\n")):
        (tmp_path / f"{name}.toml").write_text(f'{rest}[[object]]\nshape = "plane"\n')
    session, page = Document(tmp_path), Page()
    with page.current():
        draw_panels(session, Chosen())

    def opened(html: str) -> list[str]:
        return re.findall(r"<details.*?<h2>([^<]*)", html)

    thesis = opened("".join(page.out))
    session.open(tmp_path / "lit.toml")
    (drawn,) = (said["html"] for said in page.taken() if "<details" in said["html"])
    assert opened(drawn) == [*thesis, "Light"]
    (number,) = re.findall(r'data-number="(\d+)" class="chip"><svg[^>]*><use[^>]*></use></svg><span>Sensor', drawn)
    page.hear(int(number), True)
    (drawn,) = (said["html"] for said in page.taken() if "<details" in said["html"])
    assert opened(drawn) == [*thesis, "Light", "Sensor"]
    session.open(tmp_path / "plain.toml")
    (drawn,) = (said["html"] for said in page.taken() if "<details" in said["html"])
    assert opened(drawn) == thesis


def test_reset_is_of_the_object_that_is_shown(tmp_path: Path) -> None:
    studio = Studio(tmp_path)
    session = studio.tabs[name := asyncio.run(studio.tab())].session
    page, html = draw(name, studio, "http://127.0.0.1")
    (swatch,) = re.findall(r'data-number="(\d+)"[^>]*aria-label="Object 2,', html)
    (reset,) = re.findall(r'id="reset" data-on="click" data-number="(\d+)"', html)
    before = session.table["object"]
    page.hear(int(swatch), True)
    page.hear(int(reset), True)
    kept = {key: value for key, value in before[1].items() if key in ("name", "texture")}
    assert session.table["object"] == [before[0], {"shape": "plane"} | kept, *before[2:]]


def test_a_tab_has_one_page_and_those_that_are_forgotten_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MOST_TABS", 4)
    studio = Studio(tmp_path)
    app = application(studio, draw)

    async def load() -> list[tuple[str, str]]:
        async with app.router.lifespan_context(app):
            transport = httpx.ASGITransport(app)
            async with httpx.AsyncClient(transport=transport, base_url="http://studio") as client:
                found: list[tuple[str, str]] = []
                for k in range(10):
                    text = (await client.get(f"/?s={found[-1][0]}" if k % 2 else "/")).text
                    found += re.findall(r'data-tab="([\w-]+)" data-page="([\w-]+)"', text)
        return found

    collected: list[int] = []
    monkeypatch.setattr(gc, "collect", lambda: collected.append(len(studio.tabs)))
    loaded = asyncio.run(load())
    assert collected == [3]  # when the first tab was forgotten
    assert len({page for _, page in loaded}) == 10
    assert len({tab for tab, _ in loaded}) == 5
    assert all(studio.tabs[tab].page.key == page for tab, page in loaded[1::2] if tab in studio.tabs)
    assert len(studio.tabs) == 4
    assert len(studio.jobs._listeners) == len(studio.tabs)
