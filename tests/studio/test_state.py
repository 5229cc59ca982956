"""A studio in a folder of strangers: its state is elsewhere, and what they planted is not followed, nor waited for."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("starlette", reason="needs the extra studio")

from starlette.applications import Starlette

from clsco import SceneError
from clsco.files.images import write_png
from clsco.studio.folder import keep_image, listed
from clsco.studio.generate import distributions
from clsco.studio.presets import load_preset
from clsco.studio.routes import Addresses
from clsco.studio.server import Studio, Tab
from clsco.studio.session import Document, StateFolder
from clsco.studio.store import digest_of
from tests.studio.browser import EXAMPLES
from tests.studio.test_routes import Client

NAMES = ("kept", "kept_one.json", "key")


def plant(place: Path, how: str, outside: Path) -> None:
    """Something in place of each file that a studio has."""
    for name in NAMES:
        links = {"link": outside / name, "dangling": outside / "none" / name, "zero": Path("/dev/zero")}
        if how in links:
            (place / name).symlink_to(links[how])
        elif how == "pipe":
            os.mkfifo(place / name)
        else:
            (place / name).mkdir()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    folder = tmp_path / "outside"
    folder.mkdir()
    for name in NAMES:
        (folder / name).write_bytes(b"[]")
    return folder


@pytest.mark.parametrize("how", ["link", "dangling", "zero", "pipe", "folder"])
def test_a_planted_state(tmp_path: Path, outside: Path, how: str) -> None:
    root = tmp_path / "root"
    root.mkdir()
    before = contents(outside)
    plant(Studio(root).state.path, how, outside)  # as a backup might have it, or who has the user's rights
    opened = Studio(root)
    for name in NAMES:
        with pytest.raises(OSError, match=name):
            opened.state.read(name, 100)
    (kept,) = opened.kept_scenes()
    assert kept.name == "kept_one.json"
    with pytest.raises(SceneError):
        Document(opened.root).recover(kept)
    opened.keep()
    assert len(opened.state.key()) == 32
    assert contents(outside) == before
    assert not list(root.iterdir())


def test_scenes_that_were_shown_have_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    root = tmp_path / "root"
    root.mkdir()
    studio = Studio(root)
    tab = studio.tabs["one"] = Tab(studio.new_session())
    session = tab.session
    session.save(Path("scene.toml"))
    assert (session.file, session.is_saved, studio.picture_of(root / "scene.toml")) == ("scene.toml", True, "")
    (root / "sphere.toml").write_bytes((EXAMPLES / "sphere.toml").read_bytes())
    assert studio.picture_of(root / "sphere.toml") == "static/presets/sphere.webp"
    tab.preview = SimpleNamespace(small=(session.revision, b"saved"))  # type: ignore[assignment]
    studio.keep()
    name = studio.picture_of(root / "scene.toml").partition("=")[2]
    assert studio.state.read(name, 100) == b"saved"
    session.patch("camera.f_number", 5.0)
    studio.keep()  # the picture is of values before these
    assert not session.is_saved
    assert not list(studio.state.path.glob("kept_*.jpg"))
    tab.preview = SimpleNamespace(small=(session.revision, b"kept"))  # type: ignore[assignment]
    studio.keep()
    del studio.tabs["one"]
    (kept,) = studio.kept_scenes()
    assert studio.picture_of(kept) == "scene-picture?name=kept_one.jpg"
    assert studio.state.read("kept_one.jpg", 100) == b"kept"
    client = Client(Starlette(routes=Addresses(studio.jobs, studio.state, lambda _: None).routes()))
    names = ("kept_one.jpg", "key", "kept_one.json", "../kept_one.jpg", "kept_two.jpg")
    answers = [client.get("/scene-picture", params={"name": name}).content for name in names]
    assert answers == [b"kept", *[b"no such picture"] * 4]


def test_the_state_is_the_users_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    root = tmp_path / "root"
    root.mkdir()
    (tmp_path / "link").symlink_to("root")
    state = StateFolder(root)
    state.write("a", b"1")
    assert state.path.is_relative_to(tmp_path / "state" / "clsco" / "studio")
    assert stat.S_IMODE(state.path.stat().st_mode) == 0o700
    assert not list(root.iterdir())
    assert StateFolder(tmp_path / "link").read("a", 10) == b"1"  # of the same folder
    assert StateFolder(root).key() == state.key()
    with pytest.raises(FileNotFoundError):
        StateFolder(tmp_path).read("a", 10)


@pytest.mark.parametrize("why", ["no home", "a file", "exposed", "link"])
def test_without_a_private_place_the_state_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str) -> None:
    home = tmp_path / "home"
    monkeypatch.setenv("XDG_STATE_HOME", str(home))
    match why:
        case "no home":
            monkeypatch.setenv("XDG_STATE_HOME", "/proc/none")
        case "a file":
            home.write_text("")
        case "exposed":
            (home / "clsco").mkdir(parents=True)
            (home / "clsco").chmod(0o777)
        case "link":
            home.mkdir()
            (home / "clsco").symlink_to(tmp_path)
    state = StateFolder(tmp_path)
    assert not state.path.is_relative_to(tmp_path)
    assert stat.S_IMODE(state.path.stat().st_mode) == 0o700
    state.write("a", b"1")
    assert state.read("a", 10) == b"1"


@pytest.mark.parametrize("name", ["uploads", "images"])
def test_what_comes_in_stays_below_the_root(tmp_path: Path, outside: Path, name: str) -> None:
    image = tmp_path / "a.png"
    write_png(image, np.zeros((2, 3), np.uint8))
    root, before = tmp_path / "root", contents(outside)
    root.mkdir()
    (root / name).symlink_to(outside)

    document = Document(root)
    load_preset(document, "depth_map")  # its images are copied when the scene is saved
    come: dict[str, Callable[[], object]] = {
        "uploads": lambda: keep_image(root, image.read_bytes(), "png"),
        "images": lambda: document.save(root / "scene.toml"),
    }
    with pytest.raises(SceneError, match="below the folder"):
        come[name]()
    assert contents(outside) == before


def test_a_pipe_in_place_of_an_upload_is_replaced(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((2, 3), np.uint8))
    content = (tmp_path / "a.png").read_bytes()
    name = keep_image(tmp_path, content, "png")
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    assert keep_image(tmp_path, content, "png") == name
    assert (tmp_path / name).read_bytes() == content


def test_pipes_and_growth_among_the_files_of_the_folder(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "set.toml")
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    with open(tmp_path / "large.png", "wb") as file:
        file.truncate(2**40)
    assert not any(name.endswith(("set.toml", "zero.toml")) for name in distributions(tmp_path) if "/" not in name)
    assert [digest_of(tmp_path / name) for name in ("set.toml", "zero.toml", "large.png", "x" * 5000, "\0")] == [""] * 5


def test_data_sets_and_folders_of_frames_are_not_searched(tmp_path: Path) -> None:
    for name in ("scene.toml", "set/dataset.json", "set/train/a.json", "frames/frame_0000.json", "frames/deep/a.toml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    assert listed(tmp_path, (".toml", ".json")) == ["scene.toml"]
