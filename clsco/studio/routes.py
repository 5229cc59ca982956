"""Addresses that the page requests: results of jobs, small pictures of textures, images and masks of inpainting."""

from __future__ import annotations

import json
import re
from collections.abc import Callable

import numpy as np
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, JSONResponse, Response

from clsco.errors import ClscoError, ImageError, SceneError
from clsco.files.png import png_parts
from clsco.files.transfer import encode
from clsco.inputs.textures import load_texture
from clsco.scene.file import FILE_KEYS
from clsco.studio.generate import sample_picture
from clsco.studio.inpainting import Inpainting, inpainting_of
from clsco.studio.jobs import Jobs
from clsco.studio.pictures import SMALL
from clsco.studio.session import Document

Sessions = Callable[[str], Document | None]
LARGEST_PICTURE = 2**18  # bytes
_PICTURE = re.compile(r"(kept|file)_[A-Za-z0-9_-]{1,80}\.jpg")
_TYPES = {".png": "image/png", ".mp4": "video/mp4", ".webm": "video/webm"}


def add_routes(app: FastAPI, jobs: Jobs, session_of: Sessions) -> None:
    """Add the routes to the server.

    Parameters
    ----------
    app : FastAPI
        Behind the guard.
    jobs : Jobs
    session_of : function of str
        The session of a tab; None where there is no such tab.
    """
    _add_results(app, jobs)
    _add_scene(app, session_of)
    _add_inpainting(app, session_of)


def _add_results(app: FastAPI, jobs: Jobs) -> None:
    """Add what jobs have made."""

    @app.get("/result")
    def result(job: int, name: str) -> Response:
        """A file that a job has made, by its name in the job's folder."""
        try:
            folder = jobs.root / jobs.job(job).folder
            found = [path for path in jobs.files(job) if path.relative_to(folder).as_posix() == name]
        except (KeyError, OSError):
            found = []
        if not found or not found[0].is_file() or not found[0].resolve().is_relative_to(jobs.root):
            return Response("no such result\n", 404, media_type="text/plain")
        return FileResponse(found[0], media_type=_TYPES[found[0].suffix], headers={"cache-control": "no-cache"})

    @app.get("/sample")
    def sample(job: int, part: int, parts: int) -> Response:
        """A small picture of a sample of a data set: the first of one of equal parts of the set."""
        try:
            folder = jobs.root / jobs.job(job).folder
            content = sample_picture(folder, part, parts) if 0 <= part < parts else b""
        except (ClscoError, KeyError, IndexError, OSError, StopIteration):
            content = b""
        if not content:
            return Response("no such sample\n", 404, media_type="text/plain")
        kept = {"cache-control": "private, max-age=86400"}  # a set that is made anew has another address
        return Response(content, media_type="image/png", headers=kept)

    @app.get("/scene-picture")
    def scene_picture(name: str) -> Response:
        """A small picture of a scene that was shown, by the name that it has in the folder of the state."""
        try:
            content = jobs.state.read(name, LARGEST_PICTURE) if _PICTURE.fullmatch(name) else b""
        except OSError:
            content = b""
        if not content:
            return Response("no such picture\n", 404, media_type="text/plain")
        return Response(content, media_type="image/jpeg", headers={"cache-control": "no-cache"})


def _add_scene(app: FastAPI, session_of: Sessions) -> None:
    """Add textures of the scene, and scenes of links."""

    @app.get("/thumbnail")
    def thumbnail(tab: str, path: str) -> Response:
        """A small picture of a texture of the scene, by the path of its key."""
        session = session_of(tab)
        try:
            content, about = small_picture(session, path) if session is not None else (b"", "")
        except ClscoError:
            content = b""
        if not content:
            return Response("no such picture\n", 404, media_type="text/plain")
        return Response(content, media_type="image/png", headers={"cache-control": "no-store", "x-about": about})

    @app.post("/share")
    async def share(request: Request, tab: str) -> JSONResponse:
        """Go to the scene of a link, which is the fragment of the page's address."""
        session = session_of(tab)
        if session is None:
            return _none()
        try:
            session.load_share((await request.body()).decode("ascii", "replace"))
        except SceneError as error:
            return JSONResponse({"error": "\n".join(error.messages)}, 400)
        return JSONResponse({})


def _add_inpainting(app: FastAPI, session_of: Sessions) -> None:
    """Add images and masks of inpainting."""

    @app.get("/inpainting/picture")
    def picture(tab: str, which: str) -> Response:
        """The image that is inpainted, or what a method has made of it."""
        session = session_of(tab)
        content = inpainting_of(session).picture(which) if session is not None else b""
        if not content:
            return Response("no such picture\n", 404, media_type="text/plain")
        return Response(content, media_type="image/png", headers={"cache-control": "no-store"})

    @app.get("/inpainting/mask")
    def mask(tab: str) -> JSONResponse:
        """The mask as runs."""
        session = session_of(tab)
        return _mask(inpainting_of(session)) if session is not None else _none()

    @app.post("/inpainting/mask")
    async def paint(request: Request, tab: str) -> JSONResponse:
        """Take a mask as runs, or add the pixels of a color to it; the guard bounds the request."""
        session = session_of(tab)
        if session is None:
            return _none()
        inpainting = inpainting_of(session)
        try:
            match json.loads(await request.body()):
                case {"columns": int(columns), "rows": int(rows), "runs": list(runs)}:
                    inpainting.paint(columns, rows, runs)
                case {"column": int(column), "row": int(row), "tolerance": int() | float() as tolerance, **rest}:
                    inpainting.add_color(column, row, tolerance, erase=rest.get("erase") is True)
                case _:
                    return JSONResponse({"error": "mask: must be runs or a color"}, 400)
        except (ImageError, ValueError, RecursionError) as error:
            return JSONResponse({"error": str(error)}, 400)
        return _mask(inpainting)


def _mask(inpainting: Inpainting) -> JSONResponse:
    rows, columns = inpainting.mask.shape
    return JSONResponse({"columns": columns, "rows": rows, "runs": inpainting.runs()})


def _none() -> JSONResponse:
    return JSONResponse({"error": "no such tab"}, 404)


def small_picture(session: Document, path: str) -> tuple[bytes, str]:
    """A PNG of at most 160 x 160 px of a texture with its size and bits in words; nothing where the path is not of one.

    Raises ClscoError.
    """
    name = session.known(path) if path.rpartition(".")[2] in FILE_KEYS and not path.endswith(".depth") else None
    if not isinstance(name, str):
        return b"", ""
    texture = load_texture(session.source(name), session.scene.image.transfer)
    radiance = texture.radiance
    step = max(1, -(-max(radiance.shape[:2]) // SMALL))
    codes = encode(np.ascontiguousarray(radiance[::step, ::step]), 8, "srgb").astype(np.uint8)
    about = f"{radiance.shape[1]} x {radiance.shape[0]} px, {texture.bits} bits"
    return b"".join(png_parts(codes)), about
