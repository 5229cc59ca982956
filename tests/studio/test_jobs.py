"""Jobs: command lines that write what `clsco render` would, that are canceled, and that a restart finds."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from clsco import ClscoError, load_scene
from clsco.cli.main import main
from clsco.data.containers import CONTAINERS, DEFAULT
from clsco.frame.files import TRUTH_FORMATS
from clsco.studio import generate as generate_module
from clsco.studio import jobs as jobs_module
from clsco.studio.generate import (
    Wanted,
    clip,
    clip_name,
    clip_presets,
    data_set,
    distributions,
    first_format,
    focal_stack,
    free_folder,
    generate,
    sample_picture,
    set_formats,
    shipped_distributions,
    truth_formats,
)
from clsco.studio.jobs import LARGEST, LIST, CommandJob, Jobs
from clsco.studio.presets import load_preset, presets
from clsco.studio.session import Document

# In place of clsco: `work FOLDER COUNT SECONDS` writes files as frames are written, one after the other.
SLOW = """
import json, sys, time
from pathlib import Path
from clsco.files.atomic import atomic_write
_, folder, count, seconds, *_ = sys.argv[1:]
if count == "none":
    sys.exit("error: it cannot be")
for k in range(int(count)):
    with atomic_write(Path(folder) / f"frame_{k:04d}.json") as file:
        file.write(b"begun")
        file.flush()
        time.sleep(float(seconds))
        file.write(b" and done")
    said = {"progress": "files", "done": k + 1, "total": int(count)}
    print(json.dumps(said), file=sys.stderr, flush=True)
"""


@pytest.fixture
def jobs(tmp_path: Path) -> Iterator[Jobs]:
    opened = Jobs(tmp_path)
    yield opened
    for job in opened.listed:
        opened.cancel(job.number)
    until(opened, lambda: not any(job.is_unfinished for job in opened.listed))
    opened.close()


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs_module, "_PYTHON", (sys.executable, "-c", SLOW))


def until(jobs: Jobs, holds: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait for what comes by itself."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, jobs.listed
        jobs.poll()
        time.sleep(0.02)


def work(jobs: Jobs, name: str, count: object, seconds: float = 0.0) -> CommandJob:
    (jobs.root / name).mkdir(exist_ok=True)
    return jobs.add(
        name, ["work", name, str(count), str(seconds)], name, "frame_*.json", int(str(count).replace("none", "0"))
    )


def written(folder: Path) -> dict[str, bytes]:
    """Images, and JSON files but for the seconds that passes took; the way to an image depends on the place."""
    found = {path.name: path.read_bytes() for path in sorted(folder.rglob("frame_*.png"))}
    for path in folder.rglob("frame_*.json"):
        content = json.loads(path.read_text())
        views = [content, *content.get("views", {}).values()]
        for view in views:
            view.pop("seconds", None)
        found[path.name] = re.sub(r"(/[^/\"]+){2}/\.\./\.\./", "/", json.dumps(content)).encode()
    return found


def same_as_the_command(session: Document, jobs: Jobs) -> None:
    """Generate, save, and render what was saved."""
    folder = free_folder(session)
    job = generate(session, jobs, folder)
    until(jobs, lambda: not jobs.job(job.number).is_unfinished, 300.0)
    job = jobs.job(job.number)
    assert job.status == "done", job.message
    assert job.done == job.total
    session.save(Path("saved.toml"), overwrite=True)
    out = jobs.root / "by_command"
    result = CliRunner().invoke(main, ["render", str(jobs.root / "saved.toml"), "-o", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    ours, theirs = written(jobs.root / folder), written(out)
    assert ours == theirs
    assert len([name for name in ours if name.endswith(".png")]) >= 1


def test_generated_files_are_those_of_the_command(tmp_path: Path, jobs: Jobs) -> None:
    session = Document(tmp_path)
    for path, value in {"title": "A; b $(c)", "camera.resolution": [24, 16], "sequence.frames": 2}.items():
        session.patch(path, value)
    session.patch("object.0.motion.velocity.0", 1.0)
    assert free_folder(session) == "frames/a_b_c"
    same_as_the_command(session, jobs)
    assert jobs.listed[0].line == "clsco render frames/a_b_c/scene.toml -o frames/a_b_c"
    assert [path.name for path in jobs.files(1)] == ["frame_0000.png", "frame_0001.png"]
    assert free_folder(session) == "frames/saved"


def test_images_are_found_from_a_folder_that_is_made_for_the_frames(jobs: Jobs, slow: None) -> None:
    session = Document(jobs.root)
    load_preset(session, "depth_map")
    job = generate(session, jobs, "new/frames")
    scene = load_scene(jobs.root / job.folder / "scene.toml")
    assert all(Path(str(source)).is_file() for item in scene.objects for source in item.inputs().values())


@pytest.mark.slow
@pytest.mark.parametrize("name", [preset.name for preset in presets()])
def test_presets_generated_are_those_of_the_command(tmp_path: Path, jobs: Jobs, name: str) -> None:
    session = Document(tmp_path)
    load_preset(session, name)
    if session.scene.is_analytic:  # a depth map has its size
        session.patch("camera.resolution", [64, 48])
    same_as_the_command(session, jobs)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["plane", "cylinder", "sphere", "cone", "ellipsoid"])
def test_shapes_generated_are_those_of_the_command(tmp_path: Path, jobs: Jobs, shape: str) -> None:
    session = Document(tmp_path)
    session.patch("object.0.shape", shape)
    session.patch("camera.resolution", [64, 48])
    same_as_the_command(session, jobs)


def test_jobs_wait_for_each_other_and_tell_how_far_they_are(jobs: Jobs, slow: None) -> None:
    told: list[int] = []
    jobs.subscribe(lambda: told.append(len(jobs.listed)))
    first, second, third = work(jobs, "a", 3, 0.2), work(jobs, "b", 1), work(jobs, "c", "none")
    assert [job.status for job in jobs.listed] == ["waiting", "waiting", "running"]
    until(jobs, lambda: jobs.job(first.number).done == 1)
    running = jobs.job(first.number)
    left = running.seconds_left(time.time())
    assert left is not None
    assert 0.0 < left < 60.0
    with pytest.raises(ClscoError, match="job 1 writes to it already"):
        work(jobs, "a", 1)
    until(jobs, lambda: not any(job.is_unfinished for job in jobs.listed))
    assert [(job.status, job.done) for job in jobs.listed] == [("failed", 0), ("done", 1), ("done", 3)]
    assert jobs.job(third.number).message == "error: it cannot be"
    assert told
    jobs.forget(second.number)
    assert [job.number for job in jobs.listed] == [3, 1]


def test_what_is_canceled_leaves_nothing_half_written(jobs: Jobs, slow: None) -> None:
    job, waiting = work(jobs, "a", 50, 0.15), work(jobs, "b", 1)
    jobs.cancel(waiting.number)
    until(jobs, lambda: jobs.job(job.number).done >= 1)
    process = jobs.job(job.number).process
    jobs.cancel(job.number)
    until(jobs, lambda: not jobs.job(job.number).is_unfinished)
    assert [each.status for each in jobs.listed] == ["canceled", "canceled"]
    with pytest.raises(ProcessLookupError):
        os.killpg(process, 0)
    files = list((jobs.root / "a").iterdir())
    assert files
    assert all(path.name.startswith("frame_") and path.read_bytes() == b"begun and done" for path in files)


def test_what_does_not_listen_is_killed(jobs: Jobs, slow: None, monkeypatch: pytest.MonkeyPatch) -> None:
    deaf = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)" + SLOW
    monkeypatch.setattr(jobs_module, "_PYTHON", (sys.executable, "-c", deaf))
    monkeypatch.setattr(jobs_module, "GRACE", 0.2)
    job = work(jobs, "a", 50, 5.0)
    until(jobs, lambda: any((jobs.root / "a").iterdir()))
    jobs.cancel(job.number)
    until(jobs, lambda: not jobs.job(job.number).is_unfinished)
    assert jobs.job(job.number).status == "canceled"
    assert not list((jobs.root / "a").iterdir())


def test_a_restart_finds_what_runs_and_what_is_done(tmp_path: Path, slow: None) -> None:
    program = f"""
import sys
from clsco.studio import jobs
jobs._PYTHON = (sys.executable, "-c", {SLOW!r})
opened = jobs.Jobs(jobs.Path({str(tmp_path)!r}))
(opened.root / "a").mkdir()
opened.add("one", ["work", "a", "3", "0.4"], "a", "frame_*.json", 3)
opened.add("two", ["work", "b", "none", "0"], "b", "frame_*.json", 3)
import os, signal
os.kill(os.getpid(), signal.SIGKILL)
"""
    ended = subprocess.run([sys.executable, "-c", program], check=False)
    assert ended.returncode == -signal.SIGKILL
    jobs = Jobs(tmp_path)
    with pytest.raises(ClscoError, match="another studio is at work"):
        Jobs(tmp_path)
    assert [job.status for job in jobs.listed] == ["waiting", "running"]
    until(jobs, lambda: not any(job.is_unfinished for job in jobs.listed))
    assert [(job.status, job.done) for job in jobs.listed] == [("failed", 0), ("done", 3)]
    jobs.close()
    again = Jobs(tmp_path)
    assert [job.status for job in again.listed] == ["failed", "done"]
    again.close()


def test_a_machine_that_stopped_leaves_an_interrupted_job(jobs: Jobs, slow: None) -> None:
    job = work(jobs, "a", 50, 5.0)
    until(jobs, lambda: any((jobs.root / "a").iterdir()))
    os.killpg(jobs.job(job.number).process, signal.SIGKILL)
    until(jobs, lambda: not jobs.job(job.number).is_unfinished)
    assert jobs.job(job.number).status == "interrupted"
    assert not list((jobs.root / "a").iterdir())


def test_a_broken_list_is_an_empty_one(tmp_path: Path) -> None:
    for text in ("", "[1]", '[{"number": 1}]', "{}", "[" * 10**5, " " * (LARGEST + 1)):
        jobs = Jobs(tmp_path)
        (jobs.state.path / LIST).write_text(text)
        jobs.close()
        jobs = Jobs(tmp_path)
        assert jobs.listed == ()
        jobs.close()


def test_the_oldest_of_many_jobs_go(jobs: Jobs, slow: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs_module, "MOST", 2)
    for folder in "abcd":
        work(jobs, folder, 1)
        until(jobs, lambda: not any(job.is_unfinished for job in jobs.listed))
    assert [job.number for job in jobs.listed] == [4, 3]
    assert not (jobs.state.path / "job_2.log").exists()


def test_results_are_listed_while_folders_of_unfinished_work_come_and_go(jobs: Jobs, slow: None) -> None:
    job = work(jobs, "a", 1)
    until(jobs, lambda: not jobs.job(job.number).is_unfinished)
    folder = jobs.root / "a"
    (folder / "deep").mkdir()
    for name in ("deep/b.png", "a.png", "c.txt", ".d.png"):
        (folder / name).write_bytes(b"")
    going, ended = threading.Event(), threading.Event()

    def come_and_go() -> None:
        while not ended.is_set():
            for k in range(20):
                (folder / f".unfinished{k}").mkdir()
            going.set()
            for k in range(20):
                (folder / f".unfinished{k}").rmdir()

    thread = threading.Thread(target=come_and_go)
    thread.start()
    try:
        going.wait()
        for _ in range(300):
            assert [path.name for path in jobs.files(job.number)] == ["a.png", "b.png"]
    finally:
        ended.set()
        thread.join()


@pytest.mark.parametrize("folder", ["..", "../x", "/etc/x", ".", "", "link/x"])
def test_nothing_is_written_elsewhere(jobs: Jobs, tmp_path_factory: pytest.TempPathFactory, folder: str) -> None:
    outside = tmp_path_factory.mktemp("outside")
    (jobs.root / "link").symlink_to(outside)
    session = Document(jobs.root)
    with pytest.raises(ClscoError, match="below the folder of the studio"):
        generate(session, jobs, folder)
    with pytest.raises(ClscoError, match="below the folder of the studio"):
        jobs.add("x", ["render"], folder, "*", 1)
    assert not jobs.listed
    assert not list(outside.iterdir())


def test_values_that_are_not_valid_are_not_left_out_silently(jobs: Jobs) -> None:
    session = Document(jobs.root)
    session.patch("object.0.distance", -1.0)
    with pytest.raises(ClscoError, match=r"object\.0\.distance: must be valid before frames"):
        generate(session, jobs, "out")


def test_what_is_beyond_the_limits_is_said_before_it_is_begun(jobs: Jobs) -> None:
    session = Document(jobs.root)
    session.patch("camera.pixel_pitch", 1e-4)
    session.patch("camera.focus_distance", 30.0)
    with pytest.raises(ClscoError, match="the blur radius must be at most 512 px"):
        generate(session, jobs, "out")
    with pytest.raises(ClscoError, match=r"at most 512 px.*\(with focus_distance_30\)"):
        focal_stack(session, jobs, "out", 30.0, 250.0, 3)
    assert not jobs.listed
    assert not (jobs.root / "out").exists()


def test_command_lines(jobs: Jobs, slow: None) -> None:
    session = Document(jobs.root)
    (jobs.root / "d.toml").write_text("")
    work(jobs, "busy", 1, 30.0)
    options = Wanted(formats="npz", subframes=True, preset="mp4", device="pocl")
    made = [
        generate(session, jobs, "-o/x", options),
        focal_stack(session, jobs, "stack", 200.0, 300.0, 5),
        clip(session, jobs, "stack", "clips/a b.mp4", "depth", "mp4"),
        data_set(session, jobs, "d.toml", "data", 100, 7, "npz"),
    ]
    assert [job.line for job in made] == [
        "clsco render ./-o/x/scene.toml -o ./-o/x --format npz --subframes --video mp4 --device pocl",
        "clsco render stack/scene.toml -o stack",
        "clsco video stack -o 'clips/a b.mp4' --view depth --preset mp4",
        "clsco dataset make d.toml -o data --count 100 --seed 7 --shard-size 7 --format npz --resume --quiet",
    ]
    assert made[1].total == 5
    stack = tomllib.loads((jobs.root / "stack/scene.toml").read_text())
    assert stack["camera"] == {"focus_distance": {"from": 200.0, "to": 300.0, "steps": 5}}


DISTRIBUTION = """
camera.resolution = [24, 16]
[[object]]
shape = "sphere"
[[vary.object]]
index = 0
radius = { uniform = [20, 40] }
"""


@pytest.mark.slow
def test_a_data_set_counts_its_samples_and_goes_on_after_a_cancel(jobs: Jobs) -> None:
    session = Document(jobs.root)
    (jobs.root / "d.toml").write_text(DISTRIBUTION)
    job = data_set(session, jobs, "d.toml", "data", 40, 3, device="pocl")
    assert job.total == 40
    until(jobs, lambda: jobs.job(job.number).done > 0, 120.0)
    jobs.cancel(job.number)
    until(jobs, lambda: not jobs.job(job.number).is_unfinished)
    canceled = jobs.job(job.number)
    assert canceled.status == "canceled", canceled.message
    assert 0 < canceled.done < 40
    again = jobs.again(job.number)
    until(jobs, lambda: not jobs.job(again.number).is_unfinished, 120.0)
    done = jobs.job(again.number)
    assert (done.status, done.done) == ("done", 40), done.message
    assert sample_picture(jobs.root / "data", 11, 12).startswith(b"\x89PNG")
    result = CliRunner().invoke(main, ["dataset", "verify", str(jobs.root / "data"), "--sample", "2", "--quiet"])
    assert result.exit_code == 0, result.output


def test_distributions_of_the_folder_and_of_the_package_are_offered(jobs: Jobs, slow: None) -> None:
    (jobs.root / "mine.toml").write_text(DISTRIBUTION)
    (jobs.root / "scene.toml").write_text('[[object]]\nshape = "plane"\n')
    (jobs.root / "broken.toml").write_text("[vary")
    names = distributions(jobs.root)
    assert names[0] == "mine.toml"
    assert {"scene.toml", "broken.toml"}.isdisjoint(names)
    assert names[1:] == list(shipped_distributions())
    work(jobs, "busy", 1, 30.0)
    session = Document(jobs.root)
    job = data_set(session, jobs, names[1], "data", 5)
    assert job.arguments[2] == names[1]
    copied = jobs.root / names[1]
    assert copied.read_bytes() == shipped_distributions()[names[1]].read_bytes()
    copied.write_text(DISTRIBUTION)  # what is there is not overwritten
    data_set(session, jobs, names[1], "other", 5)
    assert copied.read_text() == DISTRIBUTION
    assert names[1] in distributions(jobs.root)


def test_what_is_not_installed_is_said_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(truth_formats()) >= {"npz", "exr", "flo", "kitti_depth", "colmap"}
    assert set(clip_presets()) >= {"mp4", "webm", "ffv1-16", "prores-hq"}
    assert clip_name("ffv1") == "clip.mkv"
    assert set(truth_formats().values()) == {""}
    monkeypatch.setattr(generate_module, "find_spec", lambda name: None)
    assert truth_formats()["exr"] == "needs OpenEXR: pip install 'clsco[exr]'"
    assert truth_formats()["npz"] == ""
    assert clip_presets()["mp4"] == "needs av: pip install 'clsco[video]'"
    assert set_formats()["webdataset"] == "needs imagecodecs: pip install 'clsco[formats]'"
    assert first_format() == "webdataset+raw"


def test_the_extra_of_the_studio_brings_what_its_forms_offer_first() -> None:
    assert first_format() == DEFAULT
    needed = [CONTAINERS[DEFAULT].needs, TRUTH_FORMATS["exr"].needs, generate_module._VIDEO]
    extras = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    (own,) = (line for line in extras["studio"] if line.startswith("clsco["))
    assert {extra for _, extra in filter(None, needed)} <= set(own[6:-1].split(","))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*truth_formats()])
def test_all_formats_of_truth_are_written(tmp_path: Path, jobs: Jobs, name: str) -> None:
    session = Document(tmp_path)
    load_preset(session, "stereo" if name == "kitti_disparity" else "sphere_moving")
    session.patch("camera.resolution", [48, 32])
    job = generate(session, jobs, "out", Wanted(formats=name))
    until(jobs, lambda: not jobs.job(job.number).is_unfinished, 120.0)
    assert jobs.job(job.number).status == "done", jobs.job(job.number).message
    plain = {"frame_0000.png", "frame_0000.json", "frame_0000_left.png", "frame_0000_right.png", "scene.toml"}
    assert {path.name for path in (tmp_path / "out").rglob("*")} - plain
