"""Open, save, share and recover."""

from __future__ import annotations

import base64
import json
import shutil
import tomllib
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from clsco import SceneError, load_scene, load_sweep
from clsco.scene.sweep import parse_sweep
from clsco.studio import store
from clsco.studio.session import ConflictError, Document
from clsco.studio.store import digest_of, from_link, link_of
from tests.scenes import bare

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENES = [*sorted(EXAMPLES.glob("*.toml")), *sorted(EXAMPLES.glob("thesis/*.toml"))]

COMMENTED = """\
# A ball before a wall.
title = "Ball"          # its name

[camera]
# where it is sharp
focus_distance = 250.0  # mm
focal_length = 20.0     # the default, written out

# The wall is far away.
[[object]]
name = "wall"
shape = "plane"
distance = 400.0

# The ball
[[object]]
name = "ball"           # round
shape = "sphere"
center = [0.0, 0.0, 280.0]
radius = 30.0           # mm
texture = "a.png"

[object.motion]
velocity = [1.0, 0.0, 0.0]  # to the right
"""


@pytest.fixture
def session(tmp_path: Path) -> Document:
    shutil.copy(EXAMPLES / "depth_map_image.png", tmp_path / "a.png")
    (tmp_path / "ball.toml").write_text(COMMENTED)
    session = Document(tmp_path)
    session.open(Path("ball.toml"))
    return session


@pytest.fixture
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder beside that of the session."""
    return tmp_path_factory.mktemp("elsewhere")


def test_keyframes_are_opened_shown_and_saved_as_they_were(session: Document) -> None:
    text = (EXAMPLES / "hand_held.toml").read_text("utf-8")
    (session.folder / "held.toml").write_text(text)
    session.open(Path("held.toml"))
    assert session.shown("object.0.motion.keyframe.1.position") == [1.0, 1.5, 0.0]
    session.save()
    assert (session.folder / "held.toml").read_text("utf-8") == text
    assert session.patch("object.0.motion.keyframe.1.position.1", 2.5)
    session.save()
    again = (session.folder / "held.toml").read_text("utf-8")
    assert again == text.replace("position = [1.0, 1.5, 0.0]", "position = [1.0, 2.5, 0.0]")


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_examples_come_back_from_a_link_and_from_a_file(tmp_path: Path, path: Path) -> None:
    session = Document(EXAMPLES)
    session.open(path)
    scene, table = session.scene, session.table
    assert scene == load_sweep(path).scenes[0]
    link = session.share()
    assert 40 < len(link) < 1100
    other = Document(EXAMPLES)
    other.load_share(from_link(link, other.readable))
    assert other.scene == scene
    assert not other.faults
    moved = Document(tmp_path)
    moved.load_table(table, path.parent)
    moved.save(Path("saved.toml"))
    saved, original = (map(bare, load_sweep(each).scenes) for each in (tmp_path / "saved.toml", path))
    assert list(saved) == list(original)
    moved.open(Path("saved.toml"))
    moved.save()


def test_a_file_keeps_its_comments_and_order(session: Document) -> None:
    session.patch("object.1.radius", 31.0)
    session.patch("camera.f_number", 4.0)
    session.patch("camera.focus_distance", 260.0)
    session.patch("object.0.slope_x", 0.0)  # the default, and not in the file
    assert not session.is_saved
    session.save()
    assert session.is_saved
    expected = COMMENTED.replace("radius = 30.0", "radius = 31.0").replace("= 250.0 ", "= 260.0 ")
    expected = expected.replace("written out\n", "written out\nf_number = 4.0\n")
    assert (session.root / "ball.toml").read_text() == expected


WALL = COMMENTED[COMMENTED.index("# The wall") : COMMENTED.index("\n# The ball")]
BALL = COMMENTED[COMMENTED.index("# The ball") :]
HEAD = COMMENTED[: COMMENTED.index("# The wall")]


def saved(session: Document) -> str:
    session.save()
    assert load_scene(session.root / "ball.toml") == session.scene
    return (session.root / "ball.toml").read_text()


def test_comments_go_with_their_objects(session: Document) -> None:
    session.move_object(1, 0)
    assert saved(session) == f"{HEAD}{BALL}\n{WALL}"
    session.move_object(1, 0)
    assert saved(session) == COMMENTED
    session.delete_object(0)
    assert saved(session) == f"{HEAD}{BALL}"


def test_comments_stay_where_objects_are_added(session: Document) -> None:
    session.move_object(1, 0)
    session.copy_object(0)
    session.patch("object.0.motion", None)
    session.patch("title", None)
    text = saved(session)
    assert "# where it is sharp" in text
    assert text.index("# The ball") < text.index("# round") < text.index("# The wall") < text.index('"wall"')
    assert text.count("[[object]]") == 3
    assert text.count("#") == COMMENTED.count("#") - 2  # those of the title and of the motion
    session.delete_object(2)
    assert '"wall"' not in saved(session)


def test_objects_between_other_tables_keep_their_comments(session: Document) -> None:
    text = """\
[[object]]
shape = "sphere"  # first
name = "a"

# of the camera
[camera]
f_number = 4.0  # bright

# second, above
[[object]]
shape = "plane"
name = "b"
distance = 400.0
# at the end
"""
    (session.root / "between.toml").write_text(text)
    session.open(Path("between.toml"))
    session.move_object(0, 1)
    session.add_object("cone")
    session.save()
    lines = (session.root / "between.toml").read_text().splitlines()
    assert load_scene(session.root / "between.toml") == session.scene
    expected = [
        "# of the camera", "[camera]", "# second, above", 'shape = "plane"', "# at the end",
        'shape = "sphere"  # first', 'shape = "cone"',
    ]  # fmt: skip
    places = [lines.index(line) for line in expected]
    assert places == sorted(places)


def test_objects_in_one_line_are_put_into_another_order(session: Document) -> None:
    text = '# one line\nobject = [{name = "a", shape = "plane", distance = 400.0}, {shape = "sphere"}]\n'
    (session.root / "line.toml").write_text(text)
    session.open(Path("line.toml"))
    session.move_object(0, 1)
    session.save()
    assert load_scene(session.root / "line.toml") == session.scene
    assert (session.root / "line.toml").read_text().startswith("# one line\n")


def test_only_what_differs_from_defaults_is_written(tmp_path: Path) -> None:
    session = Document(tmp_path)
    for path, value in {
        "object.0.distance": 250.0, "object.0.texture": "bricks", "camera.f_number": 2.5, "camera.pixel_pitch": 0.01,
        "psf.tilt": False, "sequence.shutter": 1.0, "sequence.frames": 2,
    }.items():  # fmt: skip
        assert session.patch(path, value)
    session.save(Path("new.toml"))
    assert tomllib.loads((tmp_path / "new.toml").read_text()) == {
        "object": [{"shape": "plane"}],
        "camera": {"f_number": 2.5},
        "psf": {"tilt": False},
        "sequence": {"frames": 2},
    }
    session.save(Path("new.json"))
    assert json.loads((tmp_path / "new.json").read_text())["camera"] == {"f_number": 2.5}
    session.open(Path("new.json"))
    session.patch("camera.f_number", None)
    session.save()
    assert load_scene(tmp_path / "new.json") == session.scene


def test_a_file_that_changed_meanwhile_is_not_overwritten(session: Document) -> None:
    file = session.root / "ball.toml"
    session.patch("object.1.radius", 31.0)
    file.write_text(COMMENTED.replace("Ball", "Other"))
    with pytest.raises(ConflictError, match=r"ball\.toml: is on the disk with other content"):
        session.save()
    assert "Other" in file.read_text()
    shown = session.difference()
    assert "-radius = 30.0           # mm" in shown
    assert "+radius = 31.0           # mm" in shown
    session.save(overwrite=True)
    session.save()
    assert load_scene(file) == session.scene
    (session.root / "there.toml").write_text("")
    with pytest.raises(ConflictError, match="is there already"):
        session.save(Path("there.toml"))
    file.write_text("not toml [")
    session.patch("title", "New")
    session.save(overwrite=True)
    assert load_scene(file) == session.scene


def test_saved_elsewhere_the_images_are_still_found(session: Document) -> None:
    (session.root / "sub").mkdir()
    session.save(Path("sub/copy.toml"))
    assert session.table["object"][1]["texture"] == "../a.png"
    assert load_scene(session.root / "sub/copy.toml").objects[1].files() == {
        "texture": str(session.root / "sub/../a.png")
    }
    assert session.path == session.root / "sub/copy.toml"


@pytest.mark.parametrize(
    ("path", "rule"),
    [
        ("../out.toml", "below the folder of the studio"),
        ("/etc/out.toml", "below the folder of the studio"),
        ("link/out.toml", "below the folder of the studio"),
        ("", "below the folder of the studio"),
        ("a\0.toml", "below the folder of the studio"),
        ("a.txt", r"must end in \.toml or \.json"),
    ],
)
def test_nothing_is_written_or_read_elsewhere(session: Document, elsewhere: Path, path: str, rule: str) -> None:
    (session.root / "link").symlink_to(elsewhere)
    (elsewhere / "out.toml").write_text(COMMENTED)
    for action in (session.save, session.open):
        with pytest.raises(SceneError, match=rule):
            action(Path(path))
    assert [entry.name for entry in elsewhere.iterdir()] == ["out.toml"]


def test_a_scene_that_names_files_elsewhere_is_not_opened(session: Document, elsewhere: Path) -> None:
    secret = elsewhere / "secret.png"
    shutil.copy(EXAMPLES / "depth_map_image.png", secret)
    before = session.table
    for name in (str(secret), f"../{elsewhere.name}/secret.png"):
        (session.root / "bad.toml").write_text(f'[[object]]\nshape = "plane"\ntexture = "{name}"\n')
        with pytest.raises(SceneError, match="must be a file below the folder of the studio"):
            session.open(Path("bad.toml"))
    assert session.table == before
    assert session.path == session.root / "ball.toml"


def test_open_is_a_step_of_undo(session: Document) -> None:
    session.patch("title", "x")
    (session.root / "other.toml").write_text('[[object]]\nshape = "sphere"\n')
    session.open(Path("other.toml"))
    session.undo()
    assert session.known("title") == "x"
    assert session.path == session.root / "ball.toml"
    session.save()
    assert load_scene(session.root / "ball.toml").title == "x"


def test_a_link_asks_for_images_that_are_not_there(session: Document, elsewhere: Path) -> None:
    link = session.share()
    other = Document(elsewhere)
    other.load_share(from_link(link, other.readable))
    assert other.scene.objects[1].texture == "bricks"
    assert other.refused == {"object.1.texture": "a.png"}
    assert "needs the file a.png" in other.faults["object.1.texture"]
    shutil.copy(EXAMPLES / "damaged.png", other.root / "a.png")  # another image of this name
    other.load_share(from_link(link, other.readable))
    assert other.refused
    shutil.copy(session.root / "a.png", other.root / "a.png")
    assert other.patch("object.1.texture", "a.png")
    assert not other.faults
    assert other.table == {key: value for key, value in session.table.items() if key != "camera"} | {
        "camera": {"focus_distance": 250.0},
        "object": [session.table["object"][0], {**other.table["object"][1]}],
    }


def linked(content: bytes) -> str:
    pressed = zlib.compressobj(9, zlib.DEFLATED, -15)
    return "#s=" + base64.urlsafe_b64encode(pressed.compress(content) + pressed.flush()).decode()


@pytest.mark.parametrize(
    ("link", "rule"),
    [
        (linked(b" " * (2**20 + 1)), "must hold at most 1 MiB"),
        ("#s=" + "A" * (2**21 + 1), "must hold at most 1 MiB"),
        (linked(b"[" * 2**19), "must be one that the studio made"),
        (linked(b"[]"), "must hold a scene"),
        (linked(b'{"object": [{"shape": "plane", "distance": NaN}]}'), "finite"),
        (linked(b'{"object": [{"shape": "plane", "texture": "/etc/passwd"}]}'), "must not be an absolute path"),
        (linked(b'{"object": [{"shape": "depth_map", "depth": "d.png"}]}'), "needs the file d.png"),
        (linked(b'{"object": [{"shape": "plane"}]}')[:-6], "must be"),
        (linked(json.dumps({"object": [{"texture": "a.png"}] * 513}).encode()), "at most 512 files; got 513"),
    ],
)
def test_bad_links_are_refused(session: Document, link: str, rule: str) -> None:
    before = session.table
    with pytest.raises(SceneError, match=rule):
        session.load_share(from_link(link, session.readable))
    assert session.table is before


def test_a_file_that_many_objects_name_is_hashed_once(
    session: Document, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(session.root / "a.png", elsewhere / "a.png")
    plane = {"shape": "plane", "distance": 300.0, "texture": "a.png"}
    link = link_of({"object": [plane] * 60}, session.root, session.root)
    hashed, walked = list[Path](), list[Path]()

    def digest(path: Path) -> str:
        hashed.append(path)
        return digest_of(path)

    def walk(folder: Path, pattern: str) -> Iterator[Path]:
        walked.append(folder)
        return rglob(folder, pattern)

    rglob = Path.rglob
    monkeypatch.setattr(store, "digest_of", digest)
    monkeypatch.setattr(Path, "rglob", walk)
    for here, other in ((elsewhere, tmp := elsewhere / "empty"), (tmp, elsewhere)):
        table, missing = from_link(link, [here, other])
        assert (len(table["object"]), missing) == (60, {})
    assert hashed == [elsewhere / "a.png", tmp / "a.png", elsewhere / "a.png"]
    assert walked == [elsewhere]


def test_what_was_kept_is_recovered(session: Document) -> None:
    session.patch("object.1.radius", 33.0)
    file = session.root / "one.json"
    session.keep(file)
    written = file.stat().st_mtime_ns
    session.keep(file)
    assert file.stat().st_mtime_ns == written
    other = Document(session.root)
    other.recover(file)
    assert other.scene == session.scene
    file.write_text("{")
    with pytest.raises(SceneError, match="must be what the studio kept"):
        other.recover(file)


def test_a_link_without_its_image_has_no_layer_of_it(tmp_path: Path) -> None:
    """A default stands in for the image, and has no layers; where the image is there, so is its layer."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "a.exr").write_bytes(b"v/1")
    table = {"object": [{"shape": "plane", "texture": "a.exr", "texture_layer": "albedo"}]}
    link = link_of(table, tmp_path / "here", tmp_path / "here")
    assert from_link(link, [tmp_path / "here"]) == (table, {})
    content, missing = from_link(link, [tmp_path])
    assert list(missing) == ["object.0.texture"]
    assert parse_sweep(content).scenes[0].objects[0].texture == "bricks"
