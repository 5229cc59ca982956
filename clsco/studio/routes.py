"""HTTP routes for the page: scenes, results of jobs, small pictures, images and masks of inpainting."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from clsco.errors import ClscoError, FileError
from clsco.inputs.textures import load_texture
from clsco.scene.file import FILE_KEYS
from clsco.studio.folder import keep_image
from clsco.studio.generate import sample_picture
from clsco.studio.inpainting import Inpainting, inpainting_of
from clsco.studio.jobs import Jobs
from clsco.studio.pictures import small_png
from clsco.studio.session import Document, StateFolder

LARGEST_PICTURE = 2**18  # bytes
_PICTURE = re.compile(r"(kept|file)_[A-Za-z0-9_-]{1,80}\.jpg")
_TYPES = {".png": "image/png", ".mp4": "video/mp4", ".webm": "video/webm", ".jpg": "image/jpeg"}


class Addresses:
    """HTTP handlers of a server behind the guard; `session_of` returns the session of a tab, or None."""

    def __init__(self, jobs: Jobs, state: StateFolder, session_of: Callable[[str], Document | None]) -> None:
        self._jobs, self._state, self._session_of = jobs, state, session_of

    def routes(self) -> list[Route]:
        """Routes of a Starlette application."""
        return [
            Route("/texture", self.texture, methods=["POST"]), Route("/thumbnail", self.thumbnail),
            Route("/result", self.result), Route("/sample", self.sample), Route("/scene-picture", self.scene_picture),
            Route("/inpainting/picture", self.picture), Route("/inpainting/mask", self.mask),
            Route("/inpainting/mask", self.paint, methods=["POST"]),
        ]  # fmt: skip

    def _session(self, request: Request) -> Document:
        session = self._session_of(request.query_params.get("tab", ""))
        if session is None:
            raise HTTPException(404, "no such tab")
        return session

    async def texture(self, request: Request) -> JSONResponse:
        """Save a dropped image under a name derived from its content, and return the name."""
        content = await request.body()  # the guard bounds it
        root, kind = self._session(request).root, request.query_params.get("kind", "")
        try:
            return JSONResponse({"name": await asyncio.to_thread(keep_image, root, content, kind)})
        except ClscoError as error:
            return _refused(str(error))

    def thumbnail(self, request: Request) -> Response:
        """A small picture of a texture, given the path of its key."""
        try:
            content, about = small_picture(self._session(request), request.query_params.get("path", ""))
        except ClscoError:
            content, about = b"", ""
        return _picture(content, **{"cache-control": "no-store", "x-about": about})

    def result(self, request: Request) -> Response:
        """A file of a job's results, by its name in the job's folder."""
        jobs, name = self._jobs, request.query_params.get("name")
        try:
            job = jobs.job(int(request.query_params["job"]))
            folder = jobs.root / job.output
            (path,) = (path for path in jobs.results(job) if path.relative_to(folder).as_posix() == name)
            if not path.is_file() or not path.resolve().is_relative_to(jobs.root):
                raise FileNotFoundError
        except (KeyError, ValueError, OSError):
            raise HTTPException(404, "no such result") from None
        return FileResponse(path, media_type=_TYPES[path.suffix], headers={"cache-control": "no-cache"})

    def sample(self, request: Request) -> Response:
        """A small picture of the first sample of a data set."""
        try:
            job = self._jobs.job(int(request.query_params["job"]))
            content = sample_picture(self._jobs.root / job.output)
        except (ClscoError, KeyError, ValueError, IndexError, OSError, StopIteration):
            content = b""
        return _picture(content, **{"cache-control": "private, max-age=86400"})  # a new set has another address

    def scene_picture(self, request: Request) -> Response:
        """A small picture of a scene as displayed, by its name in the state folder."""
        name = request.query_params.get("name", "")
        try:
            content = self._state.read(name, LARGEST_PICTURE) if _PICTURE.fullmatch(name) else b""
        except OSError:
            content = b""
        return _picture(content, ".jpg", **{"cache-control": "no-cache"})

    def picture(self, request: Request) -> Response:
        """The image to inpaint, or the result of a method."""
        inpainting = inpainting_of(self._session(request))
        return _picture(inpainting.picture(request.query_params.get("which", "")), **{"cache-control": "no-store"})

    def mask(self, request: Request) -> JSONResponse:
        """The mask as runs."""
        return _mask(inpainting_of(self._session(request)))

    async def paint(self, request: Request) -> JSONResponse:
        """Set the mask from runs, or add the pixels of a color to it; the guard limits the size of the request."""
        content = await request.body()
        inpainting = inpainting_of(self._session(request))
        try:
            match json.loads(content):
                case {"columns": int(columns), "rows": int(rows), "runs": list(runs)}:
                    inpainting.paint(columns, rows, runs)
                case {"column": int(column), "row": int(row), "tolerance": int() | float() as tolerance, **rest}:
                    inpainting.add_color(column, row, tolerance, erase=rest.get("erase") is True)
                case _:
                    return _refused("mask: must be runs or a color")
        except (FileError, ValueError, RecursionError) as error:
            return _refused(str(error))
        return _mask(inpainting)


def _picture(content: bytes, suffix: str = ".png", **headers: str) -> Response:
    if not content:
        raise HTTPException(404, "no such picture")
    return Response(content, media_type=_TYPES[suffix], headers=headers)


def _mask(inpainting: Inpainting) -> JSONResponse:
    rows, columns = inpainting.mask.shape
    return JSONResponse({"columns": columns, "rows": rows, "runs": inpainting.runs(), "name": inpainting.title})


def _refused(message: str) -> JSONResponse:
    return JSONResponse({"error": message}, 400)


def small_picture(session: Document, path: str) -> tuple[bytes, str]:
    """A PNG of at most 160 x 160 px of the texture at a key, and a text with its size and bits; else both are empty."""
    name = session.known(path) if path.rpartition(".")[2] in FILE_KEYS and not path.endswith(".depth") else None
    if not isinstance(name, str):
        return b"", ""
    texture = load_texture(session.source(name), session.scene.image.transfer)
    radiance = texture.radiance
    about = f"{radiance.shape[1]} x {radiance.shape[0]} px, {texture.bits} bits"
    return small_png(radiance), about
