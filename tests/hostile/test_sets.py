"""Data sets, folders and names of strangers: no traceback, no hang, nothing outside, nothing that a terminal obeys."""

from __future__ import annotations

import json
import os
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

import clsco.data
from clsco.cli.main import main
from clsco.cli.tables import print_tables, table
from clsco.data.manifest import part_key
from clsco.data.storage import open_storage
from clsco.errors import ClscoError, FileError, SceneError, visible
from clsco.files.strict_json import MOST_DEEP, strict_json
from clsco.scene.toml import toml_text
from tests.data.samples import make_set
from tests.hostile import sets

ESCAPES = "\x1b[2J\x9b31m\u202e\u2066\x07\r\x7f\ud800\u200b"


def obeyed(text: str) -> str:
    """Characters of a text that a terminal may obey."""
    return "".join(c for c in text if not c.isprintable() and c not in "\n\t\u00a0\u3000")


def test_changed_sets_end_in_errors_of_a_line(tmp_path: Path) -> None:
    found, refused = sets.faults(3, range(12), tmp_path)
    assert found == []
    assert refused > 5


def test_damaged_shards_end_in_errors_of_a_line(tmp_path: Path) -> None:
    found, refused = sets.shard_faults(5, range(96), tmp_path / "shards")
    assert found == []
    assert refused > 40


def test_the_fuzzer_of_sets_finds_what_is_planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_it(folder: Path) -> None:
        raise KeyError("identity")

    monkeypatch.setattr(clsco.data, "open", open_it)
    found, _ = sets.faults(1, range(1), tmp_path)
    assert len(found) == 1
    assert "KeyError" in found[0]


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
        folder = make_set(tmp_path / "set", form="folders+raw")
        text = ESCAPES.replace("\ud800", "")
        card = json.loads((folder / "dataset.json").read_text())
        (folder / "dataset.json").write_text(json.dumps({**card, "license": text, "samples": [0, 11]}))
        part = folder / part_key(1)
        part.write_text(part.read_text().replace('"error":"e"', json.dumps({"error": text})[1:-1]))
        (folder / f"train/{text}").write_text("")
        meta = folder / "train/000000/000000000/meta.json"
        meta.write_text(meta.read_text().replace('"sphere"', json.dumps(text)))
        scene = tmp_path / "scene.json"
        shape = {"shape": "sphere", "center": [0, 0, 300], "radius": 9, "name": "ball"}
        scene.write_text(json.dumps({"title": text, "object": [shape]}))
        places = {"SET": folder, "SCENE": scene, "OUT": tmp_path / "out", "NAME": text}
        given = words.split()
        for name, place in places.items():
            given = [word.replace(name, str(place)) for word in given]
        result = CliRunner().invoke(main, given)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        assert not obeyed(result.output), ascii(result.output)


@pytest.fixture(scope="module")
def one_set(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A set of a format, made once."""
    made: dict[str, Path] = {}

    def get(form: str) -> Path:
        if form not in made:
            made[form] = make_set(tmp_path_factory.mktemp("made") / "set", form=form)
        return made[form]

    return get


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
            ("folders+raw", "train/000000/000000000/meta.json"), ("folders+raw", "train/000000/000000000/depth.npy"),
            ("zarr", "train/000000.zarr/zarr.json"), ("zarr", "train/000000.zarr/depth/zarr.json"),
            ("zarr", "train/000000.zarr/depth/c/0/0/0"), ("zarr", "train/000000.zarr/keys/c/0"),
        ],
    )  # fmt: skip
    def test_sets(self, form: str, name: str, kind: str, tmp_path: Path, one_set: Callable[[str], Path]) -> None:
        folder = tmp_path / "set"
        shutil.copytree(one_set(form), folder)
        self.replaced(folder / name, kind)
        readers = sets.readers(folder, tmp_path / "spare")
        for what in ("open", "convert") if name != part_key(0) else ("convert",):
            with pytest.raises(ClscoError):
                readers[what]()

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
