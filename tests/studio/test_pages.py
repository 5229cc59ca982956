"""Pages that are loaded, and that no browser shows."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="needs the extra clsco[studio]")

import httpx
from nicegui import Client

from clsco.studio.page import MOST_UNSHOWN, attach
from clsco.studio.server import Studio, application


def test_pages_that_nobody_looks_at_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # NiceGUI's storage
    studio = Studio(tmp_path)
    app = application(studio, attach)

    async def load() -> list[str]:
        async with app.router.lifespan_context(app):
            transport = httpx.ASGITransport(app)
            async with httpx.AsyncClient(transport=transport, base_url="http://studio") as client:
                found = []
                for _ in range(MOST_UNSHOWN + 6):
                    assert (await client.get("/")).status_code == 200
                    found.append(str(max(Client.instances.values(), key=lambda each: each.created).id))
        return found

    loaded = asyncio.run(load())
    studio.jobs.close()
    assert len(set(loaded)) == MOST_UNSHOWN + 6
    assert set(Client.instances) <= set(loaded[-MOST_UNSHOWN - 1 :])  # the latest are left
    assert len(studio.jobs._listeners) <= MOST_UNSHOWN + 1
