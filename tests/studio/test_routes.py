"""Addresses that the page asks for: each tab gets only its own."""

from __future__ import annotations

import asyncio
import io
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="needs the extra studio")
import httpx
from PIL import Image
from starlette.applications import Starlette

from clsco.files.images import write_png
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.routes import Addresses
from clsco.studio.session import Document, StateFolder

EXAMPLES = Path(__file__).parents[2] / "examples"


class Client:
    """Requests to an application without a socket."""

    def __init__(self, app: Starlette) -> None:
        self.app = app

    def get(self, place: str, **options: Any) -> httpx.Response:
        return asyncio.run(self._ask("GET", place, options))

    def post(self, place: str, **options: Any) -> httpx.Response:
        return asyncio.run(self._ask("POST", place, options))

    async def _ask(self, method: str, place: str, options: dict[str, Any]) -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(self.app), base_url="http://studio") as client:
            return await client.request(method, place, **options)


@pytest.fixture
def client(tmp_path: Path) -> Client:
    shutil.copy(EXAMPLES / "depth_map_image.png", tmp_path / "a.png")
    (tmp_path / "frames").mkdir()
    write_png(tmp_path / "frames" / "frame_0000.png", np.zeros((2, 3), np.uint8))
    session, jobs = Document(tmp_path), Jobs(tmp_path)
    jobs.listed.append(CommandJob(1, "one", ("render",), "frames", "done"))
    session.patch("object.0.texture", "a.png")
    return Client(Starlette(routes=Addresses(jobs, StateFolder(tmp_path), {"t": session}.get).routes()))


def test_results_are_those_of_jobs_alone(client: Client) -> None:
    answer = client.get("/result", params={"job": 1, "name": "frame_0000.png"})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "image/png"
    for job, name in ((2, "frame_0000.png"), (1, "../a.png"), (1, "/etc/passwd"), (1, "a.png"), (1, "")):
        assert client.get("/result", params={"job": job, "name": name}).status_code == 404


def test_small_pictures_of_textures(client: Client) -> None:
    answer = client.get("/thumbnail", params={"tab": "t", "path": "object.0.texture"})
    with Image.open(io.BytesIO(answer.content)) as image:
        assert image.size == (160, 160)
    assert answer.headers["x-about"] == "320 x 320 px, 8 bits"
    for tab, path in (("x", "object.0.texture"), ("t", "object.0.shape"), ("t", "object.9.texture"), ("t", "title")):
        assert client.get("/thumbnail", params={"tab": tab, "path": path}).status_code == 404


def test_masks_by_address(client: Client) -> None:
    mask = client.get("/inpainting/mask", params={"tab": "t"}).json()
    assert mask == {"columns": 1, "rows": 1, "runs": [1], "name": ""}
    place = "/inpainting/mask?tab=t"
    assert client.post(place, json={"columns": 1, "rows": 1, "runs": [0, 1]}).json()["runs"] == [0, 1]
    assert client.post(place, json={"column": 0, "row": 0, "tolerance": 0.1}).status_code == 200
    for body in (b"", b"[]", b"{}", b"[" * 100000, b'{"columns": 1, "rows": 1, "runs": [2]}', b'{"columns": 1e9}'):
        answer = client.post(place, content=body)
        assert answer.status_code == 400
        assert answer.json()["error"]
    assert client.post("/inpainting/mask?tab=x", json={}).status_code == 404
    assert client.get("/inpainting/picture?tab=t&which=image").content.startswith(b"\x89PNG")
    assert client.get("/inpainting/picture?tab=t&which=../a").status_code == 404
