"""`clsco dataset make`: sets made, gone on with, in parts, looked at and checked; one line for what is wrong."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import Result

import clsco
import clsco.data
from clsco.cli.main import ENDINGS
from clsco.data import pool
from clsco.data.shards import ShardMaker
from clsco.data.storage import open_storage
from clsco.files.images import read_image
from clsco.opencl.device import choose
from tests.command import clsco_
from tests.data.test_shards import files

DISTRIBUTION = """
[camera]
resolution = [24, 16]
pixel_pitch = 0.2
[vary.camera]
focus_distance = { uniform = [220, 320] }
[[object]]
shape = "sphere"
center = [0.0, 0.0, 280.0]
radius = 30.0
"""
BEFORE, NOW = '["color", "sharp", "depth", "coc"]', '["color", "depth"]'


class HerePool(pool._Pool):
    """Does all tasks in this process, and handles their results as those of other processes."""

    def run(self) -> None:
        storage, child = open_storage(self.job.where), SimpleNamespace(send=lambda _: None)
        maker, worker = ShardMaker(self.job, storage, choose(), False), pool._Worker(child, self.where[0])  # type: ignore[arg-type]
        try:
            while self.schedule.waiting:
                worker.task = self.schedule.waiting.popleft()
                self._handle_message(worker, pool._answer(maker, worker.task, child))  # type: ignore[arg-type]
        finally:
            storage.close()


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(pool, "_Pool", HerePool)
    monkeypatch.chdir(tmp_path)
    Path("set.toml").write_text(DISTRIBUTION)
    return tmp_path


def dataset(*words: object) -> Result:
    return clsco_("dataset", *words)


def make(*words: object) -> Result:
    return dataset("make", "set.toml", "--shard-size", 4, *words)


def fault(result: Result, status: int = 1) -> list[str]:
    assert (result.exit_code, result.stdout) == (status, ""), result.output
    return result.stderr.splitlines()


def test_a_set_is_made_looked_at_and_checked(place: Path) -> None:
    result = make("-o", "one", "--count", 10, "--seed", 5, "--license", "CC0-1.0")
    assert (result.exit_code, result.stdout) == (0, f"one: 10 samples in 3 shards, {size(place / 'one')}\n")
    for k in (2, 0, 1):
        result = make("-o", "parts", "--count", 10, "--seed", 5, "--part", f"{k}/3", "--license", "CC0-1.0")
        assert result.exit_code == 0
        if k == 2:
            assert result.stdout.startswith("parts: 2 samples in 1 shard of 3, as far as it is made, ")
            shown = dataset("status", "parts").stdout.splitlines()
            assert shown[:2] == ["shards: 1 of 3", f"samples: 2 made, 0 failed, of 10; {size(place / 'parts')}"]
            assert shown[2].startswith("rate: ")
            assert shown[3:] == ["missing: 0-1"]
    assert files(place / "one") == files(place / "parts")
    assert not list(place.glob("*/.*"))
    assert dataset("status", "one").stdout.startswith("shards: 3 of 3\nsamples: 10 made, 0 failed, of 10; ")
    assert dataset("verify", "one", "--sample", 2).stdout == "one: 10 samples as recorded, 2 rendered again\n"
    assert clsco.parse_scene(dataset("show", "one", 7).stdout).camera.resolution == (24, 16)
    (place / "one" / "data" / "000002.tar").unlink()
    result = dataset("verify", "one", "--sample", 0)
    assert result.exit_code == 1
    assert result.stdout == "data/000002.tar: must be there, as manifest/000002.jsonl names it; got no such file\n"
    assert "incomplete: data/000002.tar: must be there" in dataset("status", "one").stdout


def size(folder: Path) -> str:
    return f"{sum(path.stat().st_size for path in (folder / 'data').iterdir()) / 1024:.1f} KiB"


@pytest.mark.parametrize(("textures", "failed"), [('"none.png"', 6), ('"bricks", "none.png"', None)])
def test_failed_samples_are_the_exit_status(place: Path, textures: str, failed: int | None) -> None:
    """The exit status counts samples that this command was to make, now or before."""
    vary = f"[[vary.object]]\nindex = 0\ntexture = {{ choice = [{textures}] }}\n[[object]]"
    Path("set.toml").write_text(DISTRIBUTION.replace("[[object]]", vary))
    Path("none.png").write_text("no image")
    for options in ((), ("--resume",)):
        result = make("-o", "one", "--count", 6, *options)
        assert (place / "one" / "failed.jsonl").is_file(), result.output
        rows = [json.loads(line) for line in (place / "one" / "failed.jsonl").read_text().splitlines()]
        assert len(rows) == (failed or len(rows))
        assert 0 < len(rows) < 6 + (failed is not None)
        first = f"the first, sample {rows[0]['number']}: {rows[0]['error']}"
        line = f"error: one: every sample must be made; got {len(rows)} of 6 that failed; {first}\n"
        assert (result.exit_code, result.stderr) == (1, line)
        assert f"{6 - len(rows)} samples in 2 shards, {len(rows)} failed" in result.stdout
    for k in (0, 1):
        numbers = range(4 * k, min(4 * k + 4, 6))
        result = make("-o", "parts", "--count", 6, "--part", f"{k}/2")
        assert result.exit_code == any(row["number"] in numbers for row in rows)


def test_a_set_is_gone_on_with_and_grows(place: Path) -> None:
    assert make("-o", "whole", "--count", 10).exit_code == 0
    assert make("-o", "grown", "--count", 6).exit_code == 0
    before = (place / "grown" / "data" / "000000.tar").stat().st_mtime_ns
    (line,) = fault(make("-o", "grown", "--count", 10))
    assert line == f"error: {place}/grown: must hold no data set, unless it is continued with resume; got one"
    host = open_storage(place).scratch().name.split(".")[2].split("-")[0]
    (place / "grown" / f".work.{host}-999999999-0.part").mkdir()
    assert make("-o", "grown", "--count", 10, "--resume").exit_code == 0
    assert files(place / "whole") == files(place / "grown")
    assert (place / "grown" / "data" / "000000.tar").stat().st_mtime_ns == before
    assert fault(make("-o", "grown", "--count", 10, "--seed", 1, "--truth", "depth", "--resume")) == [
        f"error: {place}/grown: seed must be 0, as in the set; got 1",
        f"error: {place}/grown: arrays must be {BEFORE}, as in the set; got {NOW}",
    ]
    (line,) = fault(make("-o", "grown", "--count", 3, "--resume"))
    assert line == f"error: {place}/grown: count must be at least 10, as in the set; got 3"
    (place / "set.toml").write_text(DISTRIBUTION.replace("320", "321"))
    (line,) = fault(make("-o", "grown", "--count", 10, "--resume"))
    assert "distribution must be " in line
    assert make("-o", "some", "--count", 10, "--only", "3:6").stdout.startswith("some: 3 samples in 2 shards, ")
    assert dataset("verify", "some", "--sample", 1).exit_code == 0


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        ("--count 4 --format nosuch", 1, "error: format: must be one of webdataset, "),
        ("--count 0", 2, "0 is not in the range"),
        ("", 2, "count: must be an integer between 1 and 1000000000000; got nothing"),
        ("--count 4 --part 3/3", 2, "must be I/N, with I from 0 to N - 1; got 3/3"),
        ("--count 4 --only 2:5", 2, "only: must lie within 0:4; got 2:5"),
        ("--count 4 --only 5:2", 2, "must be A:B, samples A to B - 1 counted from 0; got 5:2"),
        ("--count 4 --truth blur", 2, "some of color, sharp, depth, coc"),
        ("--count 4 --device nosuch", 3, "error: device: must be a part of the name"),
        ("--count 4 --split log=0.5,test=0.5", 1, "error: split: names must be others than manifest, log"),
        ("--count 4 --scheduler tcp://h:1 --workers 2", 2, "--scheduler: its workers have devices"),
    ],
)
def test_what_cannot_be_is_told_before_anything_is_written(place: Path, words: str, status: int, message: str) -> None:
    assert message in "\n".join(fault(make("-o", "set", *words.split()), status))
    assert sorted(path.name for path in place.iterdir()) == ["set.toml"]


def test_a_set_can_have_truth_alone(place: Path) -> None:
    assert make("-o", "alone", "--count", 2, "--truth", "depth", "--no-color", "--device", "all").exit_code == 0
    assert make("-o", "both", "--count", 2, "--truth", "depth").exit_code == 0
    (alone, _), (both, _) = (clsco.data.open(str(place / name)) for name in ("alone", "both"))
    assert (list(alone.arrays), list(both.arrays)) == (["depth"], ["color", "depth"])
    np.testing.assert_array_equal(alone["depth"], both["depth"], strict=True)
    assert dataset("verify", "alone", "--sample", 2).stdout == "alone: 2 samples as recorded, 2 rendered again\n"
    for words, message in (("alpha", "must be without alpha"), ("", "truth: must name arrays")):
        result = make("-o", "none", "--count", 2, "--no-color", "--truth", words)
        assert result.exit_code == 2
        assert message in result.stderr


def test_a_folder_without_a_set_is_no_set(place: Path) -> None:
    for words in (("status", "no"), ("verify", "no"), ("show", "no", 1)):
        (line,) = fault(dataset(*words))
        assert line == f"error: {place}/no: must hold a data set that clsco dataset make made; got no dataset.json"
    assert sorted(path.name for path in place.iterdir()) == ["set.toml"]


def test_a_set_is_made_again_from_its_card(place: Path) -> None:
    Path("base.toml").write_text(DISTRIBUTION)
    Path("set.toml").write_text('base = "base.toml"\n[vary.camera]\nf_number = { choice = [2, 4] }\n')
    words = ("--set", "object.0.radius=25", "--split", "a=0.5,b=0.5", "--truth", "depth", "--types", "color=uint8")
    assert make("-o", "one", "--count", 6, "--seed", 3, "--license", "MIT", *words).exit_code == 0
    for name in ("set.toml", "base.toml"):
        (place / name).unlink()
    result = dataset("remake", "one", "-o", "two")
    assert (result.exit_code, result.stdout) == (0, "one: made again, all bytes are the same\n")
    assert files(place / "one") == files(place / "two")
    card = (place / "one" / "dataset.json").read_text()
    (place / "one" / "dataset.json").write_text(card.replace('"radius": 25', '"radius": 24'))
    result = dataset("remake", "one")
    lines = result.stdout.splitlines()
    assert result.exit_code == 1
    assert lines[0].startswith("distribution must be ")
    assert "manifest/000000.jsonl: samples 0-3 must be what is made again; got others" in lines
    assert result.stderr == f"error: one: must be what is made again; got {len(lines)} differences\n"


def test_a_set_is_opened(place: Path) -> None:
    make("-o", "one", "--count", 5, "--split", "a=0.5,b=0.5")
    result = dataset("open", "one", "--sheet", "sheet.png")
    assert result.exit_code == 0
    assert result.stdout.startswith("one: 5 samples (")
    for text in ("depth", "float32", "16 x 24", "mm", 'clsco.data.open("one", ', "sheet.png: pictures of 5 samples"):
        assert text in result.stdout
    assert read_image(Path("sheet.png")).data.ndim == 3


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_asked_to_end_leaves_no_stray_files(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "set.toml").write_text(DISTRIBUTION)
    out, words = tmp_path / "out", ["--count", "4000", "--shard-size", "4", "--workers", "2"]
    command = [sys.executable, "-c", "from clsco.cli.process import run; run()", "dataset", "make"]
    command += [str(tmp_path / "set.toml"), "-o", str(out), *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while not list(out.glob("manifest/*")):
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (128 + number, f"{ENDINGS[number]}\n")
    assert not list(out.glob(".*"))
    assert all((out / "data" / f"{path.stem}.tar").exists() for path in out.glob("manifest/*"))
    shutil.rmtree(out)
