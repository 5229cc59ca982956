"""Shards are a function of the set and their number, and what fails is told."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.data.containers import container_named
from clsco.data.distribution import Sample, load_distribution
from clsco.data.failures import failure_of
from clsco.data.manifest import part_bytes, part_key
from clsco.data.sets import DataSet, Status, check_resumable, finish, open_set, ranges, status_of
from clsco.data.shards import SampleRenderer, SetJob, ShardMaker, prefetch, statistics
from clsco.data.storage import open_storage
from clsco.data.verify import verify_samples
from clsco.errors import DeviceError, FileError, KernelError, MissingDependencyError, SceneError
from clsco.files.png import png_parts
from clsco.opencl.device import choose
from clsco.scene.sweep import parse_sweep
from tests.data.fakes import Fake, job_of, make_here

ROOT = Path(__file__).resolve().parents[2]
SPLITS = (("train", 0.6), ("test", 0.4))
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "texture": "#808080"}


def files(folder: Path) -> dict[str, bytes]:
    """Content of all files but those of the log."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.relative_to(folder).parts[0] != "log"
    }


def set_of(job: SetJob) -> DataSet:
    return DataSet(open_storage(job.where), job.identity, job.samples)


def test_bytes_depend_on_nothing_but_the_set(tmp_path: Path) -> None:
    bad: dict[str, Any] = {"undrawable": frozenset({2}), "unrenderable": frozenset({6}), "splits": SPLITS}
    job = job_of(tmp_path / "one", 10, **bad)
    make_here(job)
    other = replace(job, where=str(tmp_path / "two"))
    storage = open_storage(other.where)
    maker = ShardMaker(other, storage, choose(), overlapped=True)
    for shard in (2, 0, 1, 0):  # in another order, one twice, encoded in another thread
        maker.deliver(maker.make(shard), {"pid": shard})
    storage.close()
    assert files(tmp_path / "one") == files(tmp_path / "two")
    found = status_of(set_of(job), hashes=True)
    assert (found.is_whole, found.made, found.failed, found.faults) == (True, 8, 2, ())
    rows, failures = set_of(job).lines(0)
    assert [(row["number"], row["split"], row["file"], row["offset"]) for row in rows] == [
        (0, "test", "test/000000.tar", 0), (1, "train", "train/000000.tar", 0), (3, "test", "test/000000.tar", 1),
    ]  # fmt: skip
    assert [row["error"] for row in failures] == ["fake.toml: must be accepted; got sample 2"]
    (failure,) = set_of(job).lines(1)[1]
    assert failure["error"].startswith("object[0].texture: /no/6.png: must be a file that can be read")
    assert parse_sweep(failure["scene"]).scenes
    record = container_named("webdataset").read(tmp_path / "one" / "test" / "000000.tar")[1]
    arrays = clsco.render_frame(clsco.parse_scene(record.meta["scene"]), truth=("depth", "flow")).arrays()
    assert all(np.array_equal(record[name], arrays[name]) for name in ("depth", "flow"))


def test_bytes_do_not_depend_on_where_the_distribution_is(tmp_path: Path) -> None:
    made = []
    for place in ("one", "other/place"):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        (folder / "gray.png").write_bytes(b"".join(png_parts(np.full((4, 4), 99, np.uint8))))
        (folder / "bad.png").write_bytes(b"no image")
        (folder / "set.toml").write_text(
            "[camera]\nresolution = [24, 16]\n[[object]]\nshape = 'plane'\ndistance = 250.0\n"
            "[[vary.object]]\nindex = 0\ntexture = { choice = ['gray.png', 'bad.png'] }\n"
        )
        distribution = load_distribution(folder / "set.toml")
        job = job_of(folder / "data", 6)
        make_here(replace(job, distribution=distribution))
        made.append(files(folder / "data"))
    assert made[0] == made[1]
    job = replace(job, distribution=distribution)
    rows, failures = set_of(job).lines(0)
    assert {row["parameters"]["object.0.texture"] for row in rows} == {"gray.png"}
    assert {row["error"].partition(": ")[2].partition(":")[0] for row in failures} == {"bad.png"}
    assert verify_samples(set_of(job), [row["number"] for row in rows], None, lambda: None, folder) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["blurred_video", "charts", "defocus_pairs", "focal_stacks", "stereo"])
def test_the_sets_of_the_package_are_made(name: str, tmp_path: Path) -> None:
    distribution = load_distribution(ROOT / "examples" / "sets" / f"{name}.toml")
    job = job_of(tmp_path / "data", 2)
    make_here(replace(job, distribution=distribution, identity=replace(job.identity, arrays=("color", "sharp", "coc"))))
    rows, failures = set_of(job).lines(0)
    assert (len(rows), failures) == (2, [])
    assert sum(row["attempts"] for row in rows) < 20


def test_a_shard_counts_when_it_is_whole(tmp_path: Path) -> None:
    job = job_of(tmp_path, 8)
    make_here(job)
    there = set_of(job)
    assert ranges(there.done(there.shards, True, [])) == "0-1"
    tar = tmp_path / "data" / "000001.tar"
    content = bytearray(tar.read_bytes())
    content[700] ^= 1
    tar.write_bytes(content)
    faults: list[str] = []
    assert list(there.done(there.shards, True, faults)) == [0]
    assert faults == ["data/000001.tar: must have the SHA-256 that manifest/000001.jsonl names; got another"]
    assert list(there.done(there.shards, False, [])) == [0, 1]  # by sizes alone
    tar.unlink()
    faults = []
    assert list(there.done(there.shards, False, faults)) == [0]
    assert faults == ["data/000001.tar: must be there, as manifest/000001.jsonl names it; got no such file"]
    grown = replace(there, samples=range(6))
    assert list(grown.done(grown.shards, False, [])) == [0]


def test_a_set_is_gone_on_with_only_as_it_was_begun(tmp_path: Path) -> None:
    wanted = set_of(job_of(tmp_path, 8))
    assert not check_resumable(wanted, resumes=False)
    wanted.write({"license": "CC0"})
    assert open_set(wanted.storage) == wanted or open_set(wanted.storage).identity == wanted.identity
    failed = [{"number": number, "error": "e", "scene": None} for number in wanted.numbers(0)]
    wanted.storage.write(part_key(0), part_bytes(0, wanted.identity.digest, wanted.numbers(0), {}, [], failed))
    assert not check_resumable(wanted, resumes=False)  # of which nothing was made
    assert not wanted.part_keys()
    rows = [{"number": number} for number in wanted.numbers(0)]
    wanted.storage.write(part_key(0), part_bytes(0, wanted.identity.digest, wanted.numbers(0), {}, rows, []))
    with pytest.raises(SceneError, match="must hold no data set, unless it is continued with resume; got one"):
        check_resumable(wanted, resumes=False)
    assert check_resumable(wanted, resumes=True)
    assert check_resumable(replace(wanted, samples=range(20)), resumes=True)
    with pytest.raises(SceneError, match="count must be at least 8, as in the set; got 4"):
        check_resumable(replace(wanted, samples=range(4)), resumes=True)
    other = replace(wanted, identity=replace(wanted.identity, seed=5, device_family="gpu"))
    with pytest.raises(SceneError) as raised:
        check_resumable(other, resumes=True)
    assert [message.partition(": ")[2] for message in raised.value.messages] == [
        "seed must be 1, as in the set; got 5",
        f"device family must be {wanted.identity.device_family}, as in the set; got gpu",
    ]


def test_other_files_and_damaged_cards_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.pdf").write_bytes(b"")
    wanted = set_of(job_of(tmp_path, 8))
    with pytest.raises(SceneError, match="must be an empty folder, or hold a data set; got other files"):
        check_resumable(wanted, resumes=True)
    with pytest.raises(FileError, match=r"must hold a data set that clsco dataset make made; got no dataset\.json"):
        open_set(wanted.storage)
    for text in ("", "[]", '{"identity": {}}', json.dumps({"identity": wanted.identity.record(), "samples": [5, 2]})):
        (tmp_path / "dataset.json").write_text(text)
        with pytest.raises(FileError, match=r"dataset\.json: must describe a data set; got"):
            open_set(wanted.storage)


def test_a_set_in_a_store_has_the_bytes_of_one_in_a_folder(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    jobs = [job_of(where, 6) for where in (tmp_path, "memory://bucket/set")]
    for job in jobs:
        there = set_of(job)
        check_resumable(there, resumes=False)
        there.write({})
        make_here(job)
        finish(there)
    stored = {path.removeprefix("/bucket/set/"): memory.cat_file(path) for path in memory.find("/bucket/set")}
    assert {key: data for key, data in stored.items() if not key.startswith("log/")} == files(tmp_path)


@pytest.mark.parametrize("pair", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_frames_of_variants_and_of_pairs_are_those_of_render(pair: bool) -> None:
    table: dict[str, Any] = {
        "camera": {"resolution": [24, 16], "pixel_pitch": 0.2, "focus_distance": [240.0, 300.0]},
        "object": [{**BALL, "motion": {"velocity": [3.0, 0.0, 0.0]}}],
        "sequence": {"frames": 2, "samples": 2 if pair else 1},
    }
    if pair:
        table["stereo"] = {"baseline": 5.0}
    sweep = parse_sweep(table)
    sample = Sample(0, "", 1, {}, table, sweep.labels, sweep.scenes)
    renderer = SampleRenderer(choose(), ("color", "depth", "flow"), "double")
    for _ in range(3):  # what is kept changes nothing
        found = renderer.render(sample)
        for frames, scene in zip(found, sweep.scenes, strict=True):
            expected = list(clsco.render(scene, truth=("depth", "flow")))
            views = ("left", "right") if pair else ("",)
            assert [(frame.index, frame.eye) for frame in frames] == [(k, eye) for k in range(2) for eye in views]
            for frame, other in zip(frames, expected, strict=True):
                pairs = ((frame.arrays()[name], other.arrays()[name]) for name in ("color", "depth"))
                assert all(np.array_equal(one, another) for one, another in pairs)


def caused(error: Exception, number: int) -> Exception:
    """An error with an error of the system as its cause."""
    error.__cause__ = OSError(number, os.strerror(number))
    return error


def broken_maker(error: Exception, folder: Path, monkeypatch: pytest.MonkeyPatch, overlapped: bool) -> ShardMaker:
    """A maker of a set of four samples, whose renderer fails."""
    job = job_of(folder, 4)
    maker = ShardMaker(job, open_storage(job.where), choose(), overlapped)

    def broken(sample: Sample) -> None:
        raise error

    monkeypatch.setattr(maker.renderer, "render", broken)
    return maker


@pytest.mark.parametrize("overlapped", [False, True])
@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (DeviceError("device: must go on; got CL_DEVICE_NOT_AVAILABLE"), "failed"),  # tried in a fresh process
        (KernelError("cast.cl: must build"), "fatal"),
        (MissingDependencyError("a.exr: needs OpenEXR"), "fatal"),
        (MemoryError(), "fatal"),
        (OSError(errno.ENOSPC, "No space left on device"), "fatal"),
        (caused(FileError("a.png: cannot be read"), errno.EIO), "fatal"),
        (caused(SceneError("a.png: cannot be read"), errno.EMFILE), "fatal"),
    ],
)
def test_a_fault_of_the_machine_is_no_failure_of_a_sample(
    error: Exception, kind: str, overlapped: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(type(error)) as caught:
        broken_maker(error, tmp_path, monkeypatch, overlapped).make(0)
    failure_kind, text = failure_of(caught.value, "DATA")
    assert failure_kind == kind
    assert "sample" not in text


@pytest.mark.parametrize("error", [SceneError("R"), caused(FileError("a.png: must exist"), errno.ENOENT)])
def test_a_fault_of_a_scene_is_a_failure_of_its_sample(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = broken_maker(error, tmp_path, monkeypatch, overlapped=False).make(0)
    assert (made.samples, made.failed) == (0, 4)


def test_two_that_make_a_shard_otherwise_are_told_and_both_are_kept(tmp_path: Path) -> None:
    job = job_of(tmp_path, 4)
    make_here(job)
    before = files(tmp_path)
    other: Any = Fake(unrenderable=frozenset({2}))
    maker = ShardMaker(replace(job, distribution=other), open_storage(job.where), choose(), False)
    with pytest.raises(FileError, match="all that make a shard must make the same bytes; got others, which are in"):
        maker.deliver(maker.make(0), {})
    maker.storage.close()
    after = files(tmp_path)
    assert {key: after.pop(key) for key in before} == before
    assert [key.partition("/")[0] for key in after] == ["conflict"] * 2
    (tmp_path / "data" / "000000.tar").write_bytes(b"damaged")
    maker.deliver(maker.make(0), {})  # no conflict with that
    assert files(tmp_path)["data/000000.tar"] != b"damaged"
    maker.storage.close()


def test_values_come_in_order_and_errors_arrive() -> None:
    assert list(prefetch(each for each in range(5))) == [0, 1, 2, 3, 4]
    found = prefetch(each for each in range(100))
    assert next(found) == 0
    found.close()
    with pytest.raises(ZeroDivisionError):
        list(prefetch(1 / (3 - each) for each in range(5)))


def test_a_set_without_color_makes_no_image() -> None:
    assert not SampleRenderer(choose(), ("depth",), "double").request.color
    assert SampleRenderer(choose(), ("color", "depth"), "double").request.color


def test_statistics_have_the_share_of_finite_values_and_lengths_of_the_flow() -> None:
    arrays = {"flow": np.array([[[3.0, -4.0], [np.inf, 0.0]]]), "v00.depth": np.array([[2.0, np.inf]])}
    expected = {"flow": [0.5] + 5 * [5.0], "v00.depth": [0.5] + 5 * [2.0]}
    assert statistics({**arrays, "mask": np.ones((1, 2))}) == expected


def test_seconds_left_are_for_samples_that_are_neither_made_nor_failed() -> None:
    part: Any = SimpleNamespace(made=3, failed=1)
    assert Status(shards=2, samples=10, done={0: part}, faults=(), rate=2.0).seconds_left == 3.0
