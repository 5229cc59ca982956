"""The studio's server: page, routes and a WebSocket per tab, wrapped in a `Guard`."""

from __future__ import annotations

import asyncio
import gc
import json
import math
import os
import secrets
import threading
import traceback
import webbrowser
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from clsco.errors import ClscoError, FileError, SceneError
from clsco.scene.model import Scene
from clsco.studio.background import keep_running
from clsco.studio.generate import stack_scenes
from clsco.studio.guard import Guard, close_half_open
from clsco.studio.jobs import Jobs
from clsco.studio.keyframes import add_keyframe, remove_keyframe, tracks
from clsco.studio.lens import lens_line
from clsco.studio.listener import listen, own_address
from clsco.studio.moving import Pointer
from clsco.studio.pictures import EXACT
from clsco.studio.presets import FIRST, choose_method, load_preset, presets
from clsco.studio.preview import MEASURE, OVERVIEW, Preview
from clsco.studio.renderer import PictureJob
from clsco.studio.renderers import Renderers
from clsco.studio.routes import Addresses
from clsco.studio.session import Document, StateFolder
from clsco.studio.store import digest_of, from_link
from clsco.studio.tables import at, is_path, path_parts
from clsco.studio.widgets.html import Page

MAX_HEADER = 2**18  # bytes: browsers send the cookies of all servers of this machine
MAX_PATCH = 2**16  # bytes of a message of a tab
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
STATIC = Path(__file__).parent / "static"
MOST_TABS = 64
MOST_LEVELS = 12  # levels of lists and tables in a message; a scene has half of them
LEAVING = '{"leaving":true}'  # message of a page that is reloaded or left
GONE = 4404  # close code: the page is of a studio that ended, or was reloaded
MOST_WATCHED = 2000  # keys with a control
TICK = 2.0  # s between saves of changed scenes
KEPT = "kept_"  # prefix of the names of scenes in the state folder
SHOWN = "file_"  # prefix of the names of pictures of scene files, followed by their digest
MOST_SHOWN = 200
MOST_KEPT = 64
OPENING = "open.html"
# The browser opens this file, which only its user can read; all users of the machine see the browser's command line.
_OPENING = """<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><title>clsco studio</title>
<meta http-equiv="refresh" content="0; url={address}">
"""


class Tab:
    """A browser tab: its session, and its connection if open."""

    def __init__(self, session: Document) -> None:
        self.session = session
        self.preview: Preview | None = None
        self.watched: tuple[str, ...] = ()
        self.typed: set[str] = set()  # keys that the page has changed since it was last sent values
        self.told = asyncio.Event()  # set when there is something to send
        self.pictured = -1  # revision whose small picture was saved
        self.page = Page()


class Studio:
    """State that all tabs share; new tabs begin with `scene`."""

    def __init__(self, root: Path, scene: Path | None = None, device: str | None = None) -> None:
        self.root, self.scene, self.device = root.resolve(), scene, device
        self.renderer = Renderers(device)
        self.jobs, self.state = Jobs(self.root), StateFolder(self.root)
        self.tabs: dict[str, Tab] = {}
        self.proof_key = ""  # see `Guard`
        old = self.kept_scenes()[MOST_KEPT:]
        pictures = sorted(self.state.path.glob(f"{SHOWN}*.jpg"), key=_changed_at)[:-MOST_SHOWN]
        self.state.remove(*(name for path in old for name in (path.name, f"{path.stem}.jpg")))
        self.state.remove(*(path.name for path in pictures))

    def new_session(self) -> Document:
        """A session with the scene of the command line, or the first preset."""
        session = Document(self.root)
        if self.scene is not None:
            session.open(self.scene.absolute())
        else:
            load_preset(session, FIRST)
        session.forget_past()
        return session

    async def tab(self, name: str = "") -> str:
        """Name of the tab for a page: `name`, if this tab exists and no page has it open; else the name of a new tab.

        A page that is reloaded announces that it leaves. A duplicated page does not, and therefore gets a new tab.
        """
        known = self.tabs.get(name)
        for _ in range(10):
            if known is None or known.preview is None:
                break
            await asyncio.sleep(0.05)
        if known is not None and known.preview is None:
            return name
        forgotten = [name for name, tab in self.tabs.items() if tab.preview is None]
        excess = forgotten[: max(len(self.tabs) - MOST_TABS + 1, 0)]
        for old in excess:
            self.tabs.pop(old).page.end()
        if excess:
            gc.collect()  # pages have reference cycles, and automatic collection is rare in commands
        new = secrets.token_urlsafe(12)
        self.tabs[new] = Tab(self.new_session())
        return new

    def kept_scenes(self) -> list[Path]:
        """Files of scenes that former studios saved for recovery, latest first."""
        ours = {self._kept(name) for name in self.tabs}
        found = [path for path in self.state.path.glob(f"{KEPT}*.json") if path not in ours]
        return sorted(found, key=_changed_at, reverse=True)

    def picture_of(self, path: Path) -> str:
        """URL of the small picture of a scene file, a copy of a preset, or a recoverable scene; "" without one."""
        name = f"{path.stem}.jpg" if path.parent == self.state.path else _shown_name(path)
        if (self.state.path / name).is_file():
            return f"scene-picture?name={name}"
        named = (each for each in presets() if each.path.name == path.name)
        return next((each.picture for each in named if digest_of(each.path) == digest_of(path)), "")

    def keep(self) -> None:
        """Save all changed scenes for recovery, and pictures of scenes as displayed."""
        for name, tab in self.tabs.items():
            session, path = tab.session, self._kept(name)
            revision, small = tab.preview.small if tab.preview is not None else (-1, b"")
            is_kept = session.can_undo and not session.is_saved
            with suppress(FileError):
                if is_kept:
                    session.keep(path)
                if revision != session.revision or tab.pictured == revision or not (is_kept or session.path):
                    continue
                tab.pictured = revision
                target = f"{path.stem}.jpg" if is_kept or session.path is None else _shown_name(session.path)
                self.state.write(target, small)

    def _kept(self, name: str) -> Path:
        return self.state.path / f"{KEPT}{name}.json"

    async def watch(self) -> None:
        """Wait for TICK, and save the scenes for recovery."""
        await asyncio.sleep(TICK)
        self.keep()

    async def report(self, messages: list[str]) -> None:
        """Show messages in all open tabs."""
        for tab in tuple(self.tabs.values()):
            if tab.preview is not None:
                with suppress(WebSocketDisconnect):
                    await tab.preview.tell(error=messages)

    async def frames(self, socket: WebSocket) -> None:
        """Serve a tab's socket: receive changes, send pictures."""
        tab = self.tabs.get(socket.query_params.get("tab", ""))
        if tab is not None and tab.preview is not None:
            await socket.close(1008)
            return
        await socket.accept()
        if tab is None or socket.query_params.get("page", tab.page.key) != tab.page.key:
            await socket.close(GONE)
            return
        sending = asyncio.Lock()

        async def send(data: bytes) -> None:
            async with sending:
                try:
                    await socket.send_bytes(data)
                except RuntimeError as error:  # as Starlette says that the tab is closed
                    raise WebSocketDisconnect from error

        preview = tab.preview = Preview(tab.session, self.renderer, send)
        pointer = Pointer(tab.session, preview)
        endings = [tab.session.subscribe(listener) for listener in (preview.edited, tab.told.set)]

        async def report(messages: list[str]) -> None:
            with suppress(WebSocketDisconnect):
                await preview.tell(error=messages)

        loops = (preview.run, partial(_tell, tab, preview))
        tasks = [asyncio.create_task(keep_running(loop, report, (WebSocketDisconnect,))) for loop in loops]
        try:
            with suppress(WebSocketDisconnect, RuntimeError, asyncio.CancelledError):  # CancelledError: the studio ends
                while True:
                    text = (await socket.receive()).get("text")
                    if text is None:  # the end, or bytes, which our page never sends
                        break
                    if text == LEAVING:
                        await socket.close()
                        break
                    await self.hear(tab, preview, pointer, text)
        finally:
            for end in endings:
                end()
            tab.preview = None
            for task in tasks:
                task.cancel()
            with suppress(asyncio.CancelledError):
                await asyncio.gather(*tasks, return_exceptions=True)

    async def hear(self, tab: Tab, preview: Preview, pointer: Pointer, text: str) -> None:
        """Handle a message of a tab, or send an error; the tab stays open in any case."""
        try:
            said = json.loads(text)
            is_flat = _is_flat(said, MOST_LEVELS)
        except (ValueError, RecursionError):
            is_flat = False
        if not is_flat:
            await preview.tell(error=[f"message: must be JSON of at most {MOST_LEVELS} levels; got something else"])
            return
        try:
            match said:  # no part of it is executed as code, and unknown messages are ignored
                case {"on": int(number)}:
                    tab.page.hear(number, said.get("value"))
                case dict() if not (_point(pointer, said) or await _look(tab.session, preview, said)):
                    await self._change(tab, preview, said)
        except SceneError as error:
            await preview.tell(error=error.messages)
        except WebSocketDisconnect:  # the tab is closed
            raise
        except Exception as error:  # a bug: the tab stays open
            traceback.print_exc()
            await preview.tell(error=[f"studio: must not fail; got {type(error).__name__}"])

    async def _change(self, tab: Tab, preview: Preview, said: dict[str, Any]) -> None:
        match said:
            case {"path": str(path), "value": value}:
                drag = said.get("drag")
                try:
                    tab.typed.add(path)
                    tab.session.patch(path, value, drag if isinstance(drag, int) else None)
                finally:
                    if isinstance(count := said.get("count"), int):  # tells the page which change its pictures show
                        await preview.tell(heard=count, faults=dict(tab.session.faults))
            case {"watch": list(paths)}:
                tab.watched = tuple(path for path in paths[:MOST_WATCHED] if isinstance(path, str) and is_path(path))
                tab.told.set()
            case {"keyframe": str(path), "add": int() | float() as time}:
                add_keyframe(tab.session, path, time)
            case {"keyframe": str(path), "remove": int(index)}:
                remove_keyframe(tab.session, path, index)
            case {"link": str(link)}:
                tab.session.load_share(await asyncio.to_thread(from_link, link, tab.session.readable))
            case {"do": "keep"}:
                await preview.tell(kept=tab.session.remembered())
            case {"resume": {"scene": str(link), "file": str(file), "digest": str(digest)}, "tab": str(before)}:
                if before not in self.tabs:  # else that tab still exists, and this page is a duplicate
                    tab.session.resume(await asyncio.to_thread(from_link, link, tab.session.readable), file, digest)
                    await preview.tell(resumed=True)
            case {"do": "undo" | "redo" as what}:
                getattr(tab.session, what)()


def _changed_at(path: Path) -> float:
    return path.lstat().st_mtime


def _shown_name(path: Path) -> str:
    return f"{SHOWN}{digest_of(path)[:32]}.jpg"


def _point(pointer: Pointer, said: dict[str, Any]) -> bool:
    """Handle a message about the pointer; False for other messages."""
    match said:
        case {"at": [int(x), int(y)]} if min(x, y) >= 0:
            pointer.ask(x, y)
        case {"at": None}:
            pointer.ask(-1, -1)
        case {"measure": [int(x), int(y)]} if min(x, y) >= 0:
            pointer.ask(x, y, MEASURE)
        case {"overview": True}:
            pointer.ask(0, 0, OVERVIEW)
        case {"focus": [int(x), int(y)], "drag": int(drag)} if min(x, y) >= 0:
            pointer.focus(x, y, drag)
        case {"grab": [int(x), int(y)], "drag": int(drag)} if min(x, y) >= 0:
            pointer.grab(x, y, drag)
        case {"pull": [int() | float() as across, int() | float() as down], "along": bool(along), "drag": int(drag)}:
            pointer.pull(across, down, along, drag)
        case _:
            return False
    return True


async def _look(session: Document, preview: Preview, said: dict[str, Any]) -> bool:
    """Handle a message about the pictures; False for other messages."""
    match said:
        case {"ack": [int(revision), int(rung)]}:
            preview.acknowledge(revision, rung)
        case {"hidden": bool(is_hidden)}:
            preview.hide(is_hidden)
        case {"outline": bool(is_wanted)}:
            preview.outline(is_wanted)
        case {"do": "pin thesis"}:
            preview.pin(as_the_thesis(session))
        case {"do": "cancel"}:
            preview.stop()
            await preview.tell(stopped=True)
        case {"view": str(view)}:
            preview.look(view=view)
        case {"frame": int(index), "time": int() | float() | None as time}:
            eye = said.get("eye")
            preview.look(index=index, time=time, eye=eye if eye in ("left", "right") else None)
            if said.get("again"):
                preview.changed()
        case {"stack": [int() | float() as nearest, int() | float() as farthest, int(steps)]}:
            scenes = stack_scenes(session, nearest, farthest, steps)
            await preview.tell(stack=[scene.camera.focused_distance for scene in scenes])
            preview.stack(scenes)
        case _:
            return False
    return True


def _is_flat(value: Any, levels: int) -> bool:
    """True if lists and tables are nested at most `levels` deep."""
    if not isinstance(value, list | dict):
        return True
    inner = value.values() if isinstance(value, dict) else value
    return levels > 0 and all(_is_flat(each, levels - 1) for each in inner)


def as_the_thesis(session: Document) -> Scene:
    """The scene with PSF and method of the thesis; the session is not changed."""
    other = Document(session.root)
    other.take(session.state)
    choose_method(other, True)
    return other.scene


async def _tell(tab: Tab, preview: Preview) -> None:
    """Send the consequences of each change: values, messages at fields, length of the clip."""
    before: dict[str, Any] = {}
    values: dict[str, Any] = {}
    keys: list[dict[str, Any]] = []
    while True:
        tab.told.clear()
        session = tab.session
        for message in tab.page.taken():
            await preview.tell(**message)
        state = {
            "revision": session.revision,  # tells the page which revision of the scene has these values
            "title": session.scene.title, "file": session.file, "saved": session.is_saved,
            "faults": dict(session.faults), "undo": session.can_undo, "redo": session.can_redo,
            "frames": session.scene.sequence.frames, "interval": session.scene.sequence.interval,
            "pair": session.scene.stereo is not None, "sensor": session.scene.sensor is not None,
            "moves": session.scene.moves, "lens": lens_line(session.scene),
            "given": [path for path in tab.watched if at(session.table, path_parts(path)) is not None],
        }  # fmt: skip
        shown = ((path, session.shown(path)) for path in tab.watched)
        now = {path: "inf" if value == math.inf else value for path, value in shown}  # JSON has no infinity
        known = {path: value for path, value in values.items() if path not in tab.typed}
        changed = {path: value for path, value in now.items() if path not in known or known[path] != value}
        tab.typed.clear()
        found = [asdict(track) for track in tracks(session)]
        if state != before or changed or found != keys:
            rest = ({"values": changed} if changed else {}) | ({"tracks": found} if found != keys else {})
            await preview.tell(**state, **rest)
        before, values, keys = state, now, found
        await tab.told.wait()
        await asyncio.sleep(0.03)  # sends simultaneous changes together


Draw = Callable[[str, Studio, str], tuple[Page, str]]


def application(studio: Studio, draw: Draw) -> Starlette:
    """The routes of the studio, without the guard."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(keep_running(studio.watch, studio.report))
        yield
        watching.cancel()
        await studio.jobs.close()
        studio.keep()

    async def page(request: Request) -> HTMLResponse:
        """The page; a reloaded page keeps its tab."""
        name = await studio.tab(request.query_params.get("s", ""))
        studio.tabs[name].page.end()
        studio.tabs[name].page, content = draw(name, studio, str(request.base_url))
        return HTMLResponse(content, headers={"cache-control": "no-store"})

    def session_of(name: str) -> Document | None:
        return studio.tabs[name].session if name in studio.tabs else None

    ours = [Route("/", page), WebSocketRoute("/frames", studio.frames), Mount("/static", StaticFiles(directory=STATIC))]
    return Starlette(routes=[*ours, *Addresses(studio.jobs, studio.state, session_of).routes()], lifespan=lifespan)


def serve(studio: Studio, host: str, port: int, draw: Draw, show: Callable[[str], None], opens_browser: bool) -> None:
    """Serve the studio until interrupted; `show` is called with the address.

    host: if it is empty, `own_address` is used, or 127.0.0.1 if a port is given. port: 0 for any free port. Raises
    ArgumentError if the port is in use.
    """
    host = host or ("127.0.0.1" if port else own_address())
    listener = listen(host, port)
    port = listener.getsockname()[1]
    token = secrets.token_urlsafe(32)
    shown = f"[{host}]" if ":" in host else host
    state = studio.state
    hosts = [f"{name}:{port}" for name in ((shown, *LOOPBACK) if shown in LOOPBACK else (shown,))]
    guard = Guard(application(studio, draw), hosts, token, state.key())
    studio.proof_key = guard.proof_key
    os.environ["WEBSOCKETS_MAX_LINE_LENGTH"] = str(MAX_HEADER)  # read by websockets, which uvicorn imports below
    config = uvicorn.Config(
        guard, log_level="warning", access_log=False, server_header=False, proxy_headers=False, http="h11",
        h11_max_incomplete_event_size=MAX_HEADER, ws_max_size=MAX_PATCH, ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = uvicorn.Server(config)

    async def open_browser() -> None:
        """Open the browser once the first scene is compiled, so that it opens with a picture."""
        with suppress(ClscoError):  # pictures report faults of the scene
            job = PictureJob(studio.new_session().scene, 0, "color", EXACT)
            _ = [picture async for picture in studio.renderer.pictures(job)]
        state.write(OPENING, _OPENING.format(address=f"http://{shown}:{port}/?c={guard.new_code()}").encode())
        address = (state.path / OPENING).as_uri()
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # never awaited

    async def run() -> None:
        serving = asyncio.create_task(server.serve([listener]))
        while not (server.started or serving.done()):
            await asyncio.sleep(0.01)
        show(f"http://{shown}:{port}/?t={token}")  # from here on Ctrl-C is the server's
        opening = asyncio.create_task(open_browser() if opens_browser else asyncio.sleep(0))
        connections = server.server_state.connections
        closing = asyncio.create_task(keep_running(partial(close_half_open, connections), studio.report))
        await serving
        closing.cancel()
        opening.cancel()

    gc.collect()
    gc.freeze()  # later collections skip all permanent objects
    try:
        with suppress(KeyboardInterrupt):
            asyncio.run(run())
    finally:
        state.remove(OPENING)
        studio.renderer.close()
        listener.close()
