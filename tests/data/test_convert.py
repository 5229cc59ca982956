"""`clsco dataset convert` and data cards."""

from __future__ import annotations

import errno
import itertools
import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import clsco.data
from clsco.cli.main import main
from clsco.data.card import readme
from clsco.data.containers import CONTAINERS
from clsco.data.record import Record
from clsco.data.sets import open_set
from clsco.data.storage import open_storage
from tests.data.samples import contents, make_set, record, same


def convert(source: Path, target: Path, form: str, *more: str) -> Result:
    return CliRunner().invoke(main, ["dataset", "convert", str(source), "-o", str(target), "--format", form, *more])


@pytest.mark.parametrize(
    ("one", "other"),
    [("hdf5", "webdataset"), ("webdataset+raw", "hdf5+raw"), pytest.param("zarr", "npz+raw", marks=pytest.mark.slow)],
)
def test_a_converted_set_is_as_if_made_so(one: str, other: str, tmp_path: Path) -> None:
    source, wanted = make_set(tmp_path / "source", one), make_set(tmp_path / "wanted", other)
    run = convert(source, tmp_path / "out", other)
    assert re.fullmatch(rf"{tmp_path}/out: 9 samples in 3 shards, 1 failed, .*B, as {re.escape(other)}\n", run.output)
    assert contents(tmp_path / "out") == contents(wanted)
    opened = clsco.data.open(tmp_path / "out")
    assert all(same(each, record(each.meta["number"])) for each in opened)


def test_a_conversion_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = make_set(tmp_path / "source")
    wanted = contents(make_set(tmp_path / "wanted", "npz"))
    count, write = itertools.count(1), CONTAINERS["npz"].write

    def full(path: Path, records: Iterable[Record]) -> None:
        """Fill the disk at the third shard file."""
        if next(count) == 3:
            path.mkdir()  # half of it is there
            raise OSError(errno.ENOSPC, "No space")
        write(path, records)

    monkeypatch.setitem(CONTAINERS, "npz", replace(CONTAINERS["npz"], write=full))
    run = convert(source, tmp_path / "out", "npz")
    rule = "the disk must work, and memory must suffice"
    assert (run.exit_code, run.output) == (1, f"error: {tmp_path}/out: {rule}; got No space\n")
    with pytest.raises(KeyError):
        json.loads((tmp_path / "out/dataset.json").read_text())["files"]
    assert sorted(each.name for each in (tmp_path / "out/manifest").iterdir()) == ["000000.jsonl"]
    monkeypatch.undo()
    run = convert(source, tmp_path / "out", "npz")
    assert "must hold no data set, unless it is continued with resume; got one" in run.output
    kept = (tmp_path / "out/manifest/000000.jsonl").stat().st_ino
    assert convert(source, tmp_path / "out", "npz", "--resume").exit_code == 0
    assert contents(tmp_path / "out") == wanted
    assert (tmp_path / "out/manifest/000000.jsonl").stat().st_ino == kept


def test_what_is_not_converted(tmp_path: Path) -> None:
    source = make_set(tmp_path / "source")
    assert "error: format: must be one of webdataset, " in convert(source, tmp_path / "out", "tar").output
    assert "must hold a data set" in convert(tmp_path, tmp_path / "out", "npz").output
    (tmp_path / "other").mkdir()
    (tmp_path / "other/file").write_text("mine")
    assert "must be an empty folder" in convert(source, tmp_path / "other", "npz").output
    assert [each.name for each in (tmp_path / "other").iterdir()] == ["file"]
    flipped = bytearray((source / "train/000001.tar").read_bytes())
    at = flipped.find(b"IDAT") + 8
    flipped[at] ^= 1
    (source / "train/000001.tar").write_bytes(flipped)
    run = convert(source, tmp_path / "out", "npz")
    assert run.exit_code == 1
    assert "000001.tar: must be a whole tar; got" in run.output
    (source / "train/000001.tar").unlink()
    run = convert(source, tmp_path / "again", "npz")
    assert run.exit_code == 1
    assert "all 3 shards must be whole; got train/000001.tar: must be there" in run.output
    assert not (tmp_path / "again").exists() or not contents(tmp_path / "again")


def test_arrays_must_be_those_of_the_manifest(tmp_path: Path) -> None:
    source, other = make_set(tmp_path / "source", "npz+raw"), record(1)
    other["depth"][3, 3] += 1
    path = source / "train/000000/000000001.npz"
    CONTAINERS["npz+raw"].write(tmp_path / "shard", iter([other]))
    path.write_bytes((tmp_path / "shard/000000001.npz").read_bytes())
    run = convert(source, tmp_path / "out", "hdf5")
    assert run.output == "error: train/000000: sample 1 must have the arrays of the manifest; got others\n"


def test_cards_say_what_is_in_a_set(tmp_path: Path) -> None:
    folder = make_set(tmp_path / "set")
    card, text = json.loads((folder / "dataset.json").read_text()), (folder / "README.md").read_text()
    assert card["counts"] == {"samples": 9, "failed": 1, "splits": {"train": 7, "val": 2}}
    assert card["license"] == "CC-BY-4.0"
    assert card["files"]["val"] == [["val/000000.tar", 1], ["val/000002.tar", 1]]
    depth = card["arrays"]["depth"]
    assert (depth["dtype"], depth["shape"], depth["unit"], depth["encoding"]) == ("float32", [9, 12], "mm", "npy.zst")
    assert card["arrays"]["color"]["encoding"] == "png"
    assert card["arrays"]["color"]["transfer"] == "srgb"
    assert "clipped" not in card["arrays"]["color"]
    assert "seed 7" in card["cite"]
    assert card["identity"]["device_family"] == "cpu, some"
    head = text.split("---\n")[1].splitlines()
    assert head[0] == "license: cc-by-4.0"
    assert head[-4:] == ['  - split: "train"', '    path: "train/*.tar"', '  - split: "val"', '    path: "val/*.tar"']
    assert '```toml\nbase = "sphere.toml"\n```' in text


def test_licenses_as_the_hub_knows_them(tmp_path: Path) -> None:
    card = json.loads((make_set(tmp_path / "set") / "dataset.json").read_text())
    for name, lines in (
        ("unspecified", "license: unknown\n"),
        ("My own: 1", 'license: other\nlicense_name: "My own: 1"\n'),
        ("MIT", "license: mit\n"),
    ):
        assert readme({**card, "license": name}).startswith(f"---\n{lines}task_categories:")


def test_types_are_part_of_what_a_set_is(tmp_path: Path) -> None:
    there = open_set(open_storage(make_set(tmp_path / "set")))
    assert there.identity.types == (("color", "uint16"),)
    assert there.identity.digest != replace(there.identity, types=()).digest
