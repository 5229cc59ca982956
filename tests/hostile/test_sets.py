"""Data sets, folders and names of strangers: no traceback, no hang, nothing outside, nothing that a terminal obeys."""

from __future__ import annotations

import json
import os
import random
import shutil
import tomllib
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import clsco.data
from clsco.cli.tables import print_tables, table
from clsco.data.containers import CONTAINERS
from clsco.data.copies import convert
from clsco.data.manifest import part_key
from clsco.data.storage import open_storage
from clsco.errors import ClscoError, FileError, SceneError, visible
from clsco.files.strict_json import MOST_DEEP, strict_json
from clsco.scene.toml import toml_text
from tests.command import clsco_
from tests.data.samples import make_set, record
from tests.hostile.pictures import DAMAGES

ESCAPES = "\x1b[2J\x9b31m\u202e\u2066\x07\r\x7f\ud800\u200b"
REFUSED = "refused"


def obeyed(text: str) -> str:
    """Characters of a text that a terminal may obey."""
    return "".join(c for c in text if not c.isprintable() and c not in "\n\t\u00a0\u3000")


def read_json(path: Path) -> str:
    """Text of a JSON file, or of the meta.json in an NPZ."""
    if path.suffix != ".npz":
        return path.read_text()
    with zipfile.ZipFile(path) as archive:
        return archive.read("meta.json").decode()


def write_json(path: Path, text: str) -> None:
    """Replace the text of a JSON file, or of the meta.json in an NPZ."""
    if path.suffix != ".npz":
        path.write_text(text)
        return
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (members | {"meta.json": text.encode()}).items():
            archive.writestr(name, content)


def readers(folder: Path, spare: Path) -> dict[str, Callable[[], object]]:
    """Reading and converting of a set."""
    return {
        "open": lambda: [record.sha256() for record in clsco.data.open(folder)],
        "convert": lambda: convert(open_storage(folder), open_storage(spare), "npz", False, lambda _: lambda: None),
    }


def change_shard(seed: int, number: int, folder: Path) -> tuple[str, Path]:
    """Copy a shard, number by number of another format, and damage some of its bytes; its format and place."""
    forms = sorted(CONTAINERS)
    form, rng, path = forms[number % len(forms)], random.Random(f"{seed}:{number}"), folder / f"shard_{number}"
    whole = folder / f"whole_{form}"
    if not whole.exists():
        CONTAINERS[form].write(whole, (record(each, wanted=("color", "mask", "depth", "flow")) for each in (1, 2)))
    shutil.copytree(whole, path) if whole.is_dir() else shutil.copy(whole, path)
    file = rng.choice(sorted(each for each in path.rglob("*") if each.is_file())) if path.is_dir() else path
    content = file.read_bytes()
    for _ in range(rng.choice((1, 1, 3))):
        content = rng.choice(DAMAGES)(rng, content)
    file.write_bytes(content)
    return form, path


def outcome(read: Callable[[], object]) -> str:
    """ "" for what is read, REFUSED for an error of one line, else what it ended in."""
    try:
        read()
    except ClscoError as error:
        lines = str(error).split("\n")
        return REFUSED if all(line.isprintable() for line in lines) else f"not printable: {ascii(str(error))[:200]}"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {ascii(str(error))[:150]} at {last.filename}:{last.lineno}"
    return ""


@pytest.mark.parametrize("numbers", [range(96), pytest.param(range(96, 4400), marks=pytest.mark.soak)])
def test_damaged_shards_end_in_errors_of_a_line(numbers: range, tmp_path: Path) -> None:
    outcomes = Counter[str]()
    for number in numbers:
        form, path = change_shard(5, number, tmp_path)

        def read(form: str = form, path: Path = path) -> object:
            return [each.sha256() for each in CONTAINERS[form].read(path)]

        result = outcome(read)
        outcomes[result if result in ("", REFUSED) else f"{number} {form}: {result}"] += 1
    assert outcomes.keys() == {"", REFUSED}
    assert outcomes[REFUSED] > 40


@pytest.mark.parametrize("text", ["NaN", "[Infinity]", "[" * 70 + "]" * 70, '{"a":' * 5000, "[" * 100_000])
def test_json_that_no_set_has(text: str) -> None:
    for content in (text, text.encode()):
        with pytest.raises(ValueError, match=r"no number in JSON|nested too deeply|Expecting"):
            strict_json(content)
    deep = "[" * MOST_DEEP + "]" * MOST_DEEP
    assert strict_json(f"[{','.join(['[]'] * 100)}]") == [[]] * 100
    assert strict_json(deep) == json.loads(deep)


class TestTerminal:
    """Foreign text is printed with escapes in place of what a terminal obeys."""

    def test_visible(self) -> None:
        assert visible(ESCAPES) == "\\x1b[2J\\x9b31m\\u202e\\u2066\\x07\\r\\x7f\\ud800\\u200b"
        assert visible("a\n\tb", lines=True) == "a\n\tb"
        assert visible("a\n\tb") == "a\\n\\tb"
        assert visible("\u96ea \u2603 \u00a0e\u0301\U0001f600") == "\u96ea \u2603 \u00a0e\u0301\U0001f600"
        for error in (ClscoError(ESCAPES), SceneError([ESCAPES])):
            assert not obeyed(str(error))

    def test_toml_of_a_foreign_scene(self) -> None:
        text = ESCAPES.replace("\ud800", "")
        table = {"title": text, f"a{text}": 1, "b c": {"d.e\n[f]": [text, 2]}, "g": [{"h": text}]}
        written = toml_text(table)
        assert not obeyed(written)
        assert tomllib.loads(written) == table

    def test_tables(self, capsys: pytest.CaptureFixture[str]) -> None:
        print_tables(table(f"Plan: {ESCAPES}", ("what", "how much"), [(ESCAPES, ESCAPES)]), f"a {ESCAPES}")
        shown = capsys.readouterr().out
        assert not obeyed(shown)
        assert shown.count("\\x1b[2J") == 4

    @pytest.mark.parametrize("words", [
        "dataset status SET", "dataset verify SET --sample 0", "dataset show SET 0", "dataset show SET 5",
        "validate SCENE",
        "plan SCENE", "validate NAME", "dataset convert SET OUT --format npz", "dataset verify NAME", "NAME",
        "render SCENE -o OUT --NAME", "plan SCENE --set NAME=1",
    ])  # fmt: skip
    def test_commands(self, words: str, tmp_path: Path) -> None:
        folder = make_set(tmp_path / "set", form="npz+raw")
        text = ESCAPES.replace("\ud800", "")
        card = json.loads((folder / "dataset.json").read_text())
        (folder / "dataset.json").write_text(json.dumps({**card, "license": text, "samples": [0, 11]}))
        part = folder / part_key(1)
        part.write_text(part.read_text().replace('"error":"e"', json.dumps({"error": text})[1:-1]))
        (folder / f"train/{text}").write_text("")
        meta = folder / "train/000000/000000000.npz"
        write_json(meta, read_json(meta).replace('"sphere"', json.dumps(text)))
        scene = tmp_path / "scene.json"
        shape = {"shape": "sphere", "center": [0, 0, 300], "radius": 9, "name": "ball"}
        scene.write_text(json.dumps({"title": text, "object": [shape]}))
        places = {"SET": folder, "SCENE": scene, "OUT": tmp_path / "out", "NAME": text}
        given = words.split()
        for name, place in places.items():
            given = [word.replace(name, str(place)) for word in given]
        result = clsco_(*given)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        assert not obeyed(result.output), ascii(result.output)


@pytest.fixture(scope="module")
def one_set(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A set of a format, made once."""
    return cache(lambda form: make_set(tmp_path_factory.mktemp("made") / "set", form=form))


class TestNoRegularFiles:
    """Pipes and links in place of files of sets are refused, and do not hang."""

    @staticmethod
    def replaced(path: Path, kind: str) -> None:
        path.unlink()
        if kind == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to("/etc/passwd")

    @pytest.mark.parametrize("kind", ["pipe", "link"])
    @pytest.mark.parametrize(
        ("form", "name"),
        [
            ("webdataset", "dataset.json"), ("webdataset", part_key(0)), ("webdataset", "train/000000.tar"),
            ("npz", "train/000000/000000000.npz"), ("hdf5", "train/000000.h5"),
            ("zarr", "train/000000.zarr/zarr.json"), ("zarr", "train/000000.zarr/depth/zarr.json"),
            ("zarr", "train/000000.zarr/depth/c/0/0/0"), ("zarr", "train/000000.zarr/keys/c/0"),
        ],
    )  # fmt: skip
    def test_sets(self, form: str, name: str, kind: str, tmp_path: Path, one_set: Callable[[str], Path]) -> None:
        folder = tmp_path / "set"
        shutil.copytree(one_set(form), folder)
        self.replaced(folder / name, kind)
        calls = readers(folder, tmp_path / "spare")
        for what in ("open", "convert") if name != part_key(0) else ("convert",):
            with pytest.raises(ClscoError):
                calls[what]()

    def test_a_set_does_not_reach_outside_of_its_folder(self, tmp_path: Path) -> None:
        (tmp_path / "set").mkdir()
        outside = tmp_path / "outside"
        outside.mkdir()
        (outside / "file").write_text("mine")
        (tmp_path / "set/train").symlink_to(outside)
        storage = open_storage(tmp_path / "set")
        (storage.scratch() / "new").write_text("theirs")
        for call in (
            lambda: storage.write("train/file", b"theirs"), lambda: storage.read("train/file"),
            lambda: storage.put("train/file", storage.scratch() / "new"), lambda: storage.remove("train/file"),
            lambda: storage.digest("train/file"), lambda: storage.local("train/file"),
        ):  # fmt: skip
            with pytest.raises(FileError, match="must lie in the folder of the data set; got a link that leaves it"):
                call()
        assert (outside / "file").read_text() == "mine"
        storage.close()
