"""Jobs: command lines that write what `clsco render` would, one at a time, until they are canceled."""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
import threading
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from clsco import ClscoError, load_scene
from clsco.cli.main import main
from clsco.data.containers import CONTAINERS, DEFAULT
from clsco.frame.files import TRUTH_FORMATS
from clsco.studio import generate
from clsco.studio import jobs as jobs_module
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.presets import load_preset, presets
from clsco.studio.session import Document
from tests.cli.test_dataset import DISTRIBUTION

# In place of clsco: `work FOLDER COUNT SECONDS` writes files as frames are written, one after the other.
SLOW = """
import json, signal, sys, time
from pathlib import Path
from clsco.files.atomic import atomic_write
signal.signal(signal.SIGTERM, signal.default_int_handler)
_, folder, count, seconds, *_ = sys.argv[1:]
if count == "none":
    sys.exit("error: it cannot be")
for k in range(int(count)):
    with atomic_write(Path(folder) / f"frame_{k:04d}.json") as file:
        file.write(b"begun")
        file.flush()
        time.sleep(float(seconds))
        file.write(b" and done")
    print(json.dumps({"progress": "files", "done": k + 1, "total": int(count)}), file=sys.stderr, flush=True)
"""


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs_module, "_COMMAND", (sys.executable, "-c", SLOW))


async def until(holds: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait for what comes by itself."""
    async with asyncio.timeout(seconds):
        while not holds():
            await asyncio.sleep(0.02)


async def finish(jobs: Jobs, seconds: float = 120.0) -> CommandJob:
    """Wait for the end of all jobs; returns the last one."""
    await until(lambda: not any(job.is_unfinished for job in jobs.listed), seconds)
    return jobs.listed[0]


def work(jobs: Jobs, name: str, count: object, seconds: float = 0.0) -> CommandJob:
    (jobs.root / name).mkdir(exist_ok=True)
    return jobs.add(name, ["work", name, str(count), str(seconds)], name)


def written(folder: Path) -> dict[str, bytes]:
    """Images, and JSON files but for the seconds that passes took; the way to an image depends on the place."""
    files = {path.name: path.read_bytes() for path in sorted(folder.rglob("frame_*.png"))}
    for path in folder.rglob("frame_*.json"):
        content = json.loads(path.read_text())
        for view in [content, *content.get("views", {}).values()]:
            view.pop("seconds", None)
        files[path.name] = re.sub(r"(/[^/\"]+){2}/\.\./\.\./", "/", json.dumps(content)).encode()
    return files


def rendered(session: Document, jobs: Jobs, folder: str, *options: str) -> CommandJob:
    async def run() -> CommandJob:
        generate.render_frames(session, jobs, folder, options)
        return await finish(jobs, 300.0)

    job = asyncio.run(run())
    assert job.status == "done", job.message
    return job


def assert_same_as_the_command(session: Document) -> Jobs:
    """Generate, save, and render what was saved."""
    jobs, folder = Jobs(session.root), generate.free_folder(session)
    job = rendered(session, jobs, folder)
    assert job.done == job.total >= 1
    session.save(Path("saved.toml"), overwrite=True)
    out = jobs.root / "by_command"
    result = CliRunner().invoke(main, ["render", str(jobs.root / "saved.toml"), "-o", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    files = written(jobs.root / folder)
    assert files == written(out)
    assert any(name.endswith(".png") for name in files)
    return jobs


def test_generated_files_are_those_of_the_command(tmp_path: Path) -> None:
    session = Document(tmp_path)
    for path, value in {"title": "A; b $(c)", "camera.resolution": [24, 16], "sequence.frames": 2}.items():
        session.patch(path, value)
    session.patch("object.0.motion.velocity.0", 1.0)
    assert generate.free_folder(session) == "frames/a_b_c"
    jobs = assert_same_as_the_command(session)
    assert jobs.listed[0].line == "clsco render frames/a_b_c/scene.toml -o frames/a_b_c"
    assert [path.name for path in jobs.results(jobs.job(1))] == ["frame_0000.png", "frame_0001.png"]
    assert generate.free_folder(session) == "frames/saved"


@pytest.mark.slow
@pytest.mark.parametrize("name", [preset.name for preset in presets()])
def test_presets_generated_are_those_of_the_command(tmp_path: Path, name: str) -> None:
    session = Document(tmp_path)
    load_preset(session, name)
    if session.scene.is_analytic:  # a depth map has its size
        session.patch("camera.resolution", [64, 48])
    assert_same_as_the_command(session)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*generate.truth_formats()])
def test_all_formats_of_truth_are_written(tmp_path: Path, name: str) -> None:
    session = Document(tmp_path)
    load_preset(session, {"kitti_disparity": "stereo", "png": "night", "tiff": "night"}.get(name, "sphere_moving"))
    session.patch("camera.resolution", [48, 32])
    rendered(session, Jobs(tmp_path), "out", "--format", name)
    plain = {"frame_0000.png", "frame_0000.json", "frame_0000_left.png", "frame_0000_right.png", "scene.toml"}
    assert {path.name for path in (tmp_path / "out").rglob("*")} - plain


@pytest.mark.slow
@pytest.mark.parametrize("recipe", generate.RECIPES, ids=lambda recipe: recipe.title)
def test_recipes_write_what_their_command_writes(tmp_path: Path, recipe: generate.Recipe) -> None:
    session, folders = Document(tmp_path), [tmp_path / "out", tmp_path / "by"]
    for path, value in {"camera.resolution": [24, 16], "object.0.texture": "#c08040"}.items():
        session.patch(path, value)
    options = generate.recipe_options([recipe])
    job = rendered(session, Jobs(tmp_path), "out", *options)
    assert list(job.arguments) == [*generate.render_command(session, "out"), *options]
    words = ["render", str(folders[0] / "scene.toml"), "-o", str(folders[1]), *options]
    assert CliRunner().invoke(main, words).exit_code == 0
    files = [{path.name: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()} for folder in folders]
    names = {name for name in files[0] if not name.endswith((".json", ".toml"))}  # those have paths and seconds
    assert {name: files[0][name] for name in names} == {name: files[1][name] for name in names} != {}
    if recipe.formats == ("npz",):
        with np.load(tmp_path / "out/frame_0000.npz") as arrays:
            assert generate.frame_bytes(session.scene, [recipe]) == sum(arrays[name].nbytes for name in arrays)


def test_jobs_wait_for_each_other_and_tell_how_far_they_are(tmp_path: Path, slow: None) -> None:
    async def run() -> None:
        jobs, told = Jobs(tmp_path), list[int]()
        jobs.subscribe(lambda: told.append(len(jobs.listed)))
        first, second, third = work(jobs, "a", 3, 0.2), work(jobs, "b", 1), work(jobs, "c", "none")
        await until(lambda: first.done == 1)
        assert [job.status for job in jobs.listed] == ["waiting", "waiting", "running"]
        assert first.seconds_left(first.began + 1.0) == pytest.approx(2.0)
        with pytest.raises(ClscoError, match="job 1 writes to it already"):
            work(jobs, "a", 1)
        await finish(jobs)
        assert [(job.status, job.done) for job in jobs.listed] == [("failed", 0), ("done", 1), ("done", 3)]
        assert third.message == "error: it cannot be"
        jobs.forget(second)
        assert jobs.listed == [third, first]
        jobs.run_again(third)
        assert (third.status, third.message, third.arguments[-1]) == ("waiting", "", "--resume")
        jobs.forget(third)  # is not done
        await finish(jobs)
        assert (third.status, third.message) == ("failed", "error: it cannot be")
        assert told

    asyncio.run(run())


def test_what_is_canceled_leaves_nothing_half_written(tmp_path: Path, slow: None) -> None:
    async def run() -> None:
        jobs = Jobs(tmp_path)
        job, waiting = work(jobs, "a", 50, 0.15), work(jobs, "b", 1)
        jobs.cancel(waiting)
        await until(lambda: job.done >= 1)
        jobs.cancel(job)
        jobs.cancel(job)
        await finish(jobs)
        assert [each.status for each in jobs.listed] == ["canceled", "canceled"]
        last = work(jobs, "c", 50, 5.0)
        await until(lambda: any((tmp_path / "c").iterdir()))
        await jobs.close()  # the studio ends
        assert last.status == "canceled"

    asyncio.run(run())
    files = [*(tmp_path / "a").iterdir(), *(tmp_path / "c").iterdir()]
    assert files
    assert all(path.name.startswith("frame_") and path.read_bytes() == b"begun and done" for path in files)


def is_alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_what_does_not_listen_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deaf = "import os, sys; print(os.getpid(), file=sys.stderr)" + SLOW.replace(
        "default_int_handler", "SIG_IGN"
    ).replace("_, folder", "open(sys.argv[2] + '/pid', 'w').write(str(os.getpid())); _, folder")
    monkeypatch.setattr(jobs_module, "_COMMAND", (sys.executable, "-c", deaf))
    monkeypatch.setattr(jobs_module, "GRACE", 0.2)

    async def run() -> CommandJob:
        jobs = Jobs(tmp_path)
        job = work(jobs, "a", 50, 5.0)
        await until(lambda: len(list((tmp_path / "a").iterdir())) > 1)
        jobs.cancel(job)
        await finish(jobs)
        await until(lambda: not is_alive(int((tmp_path / "a" / "pid").read_text())))
        return job

    assert asyncio.run(run()).status == "canceled"


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("import os; os.kill(os.getpid(), 9)", "clsco: must not fail; got signal 9"),
        ("import sys; sys.exit(3)", "clsco: must not fail; got status 3"),
        ("import sys; sys.stderr.write('x' * 2 ** 22)", "clsco: must run; got Separator is not found"),
        ("print(*'abc', sep='\\n', file=__import__('sys').stderr); 1 / 0", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_command_that_fails_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, message: str
) -> None:
    monkeypatch.setattr(jobs_module, "_COMMAND", (sys.executable, "-c", program))

    async def run() -> CommandJob:
        jobs = Jobs(tmp_path)
        work(jobs, "a", 1)
        return await finish(jobs)

    job = asyncio.run(run())
    assert job.status == "failed"
    assert message in job.message
    assert len(job.message) < 1000


def test_the_oldest_of_many_jobs_go(tmp_path: Path, slow: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs_module, "MOST", 2)

    async def run() -> list[int]:
        jobs = Jobs(tmp_path)
        for folder in "abcd":
            work(jobs, folder, "none")
            await finish(jobs)
        return [job.number for job in jobs.listed]

    assert asyncio.run(run()) == [4, 3]


def test_results_are_listed_while_folders_of_unfinished_work_come_and_go(tmp_path: Path) -> None:
    (tmp_path / "a" / "deep").mkdir(parents=True)
    for name in ("deep/b.png", "a.png", "c.txt", ".d.png"):
        (tmp_path / "a" / name).write_bytes(b"")
    going, ended = threading.Event(), threading.Event()

    def come_and_go() -> None:
        while not ended.is_set():
            for k in range(20):
                (tmp_path / "a" / f".unfinished{k}").mkdir()
            going.set()
            for k in range(20):
                (tmp_path / "a" / f".unfinished{k}").rmdir()

    thread = threading.Thread(target=come_and_go)
    thread.start()
    try:
        going.wait()
        for _ in range(300):
            paths = Jobs(tmp_path).results(CommandJob(1, "a", ("render",), "a"))
            assert [path.name for path in paths] == ["a.png", "b.png"]
    finally:
        ended.set()
        thread.join()


def test_nothing_is_written_elsewhere(tmp_path: Path) -> None:
    jobs = Jobs(tmp_path)
    for folder, rule in (
        ("../x", "below the folder of the studio"),
        ("x" * 300, "must be a folder that can be written"),
    ):
        with pytest.raises(ClscoError, match=rule):
            generate.render_frames(Document(tmp_path), jobs, folder)
    with pytest.raises(ClscoError, match="below the folder of the studio"):
        jobs.add("x", ["render"], "../x")
    assert not jobs.listed


def test_scenes_that_cannot_be_rendered_are_refused_before_a_job_begins(tmp_path: Path) -> None:
    session, jobs = Document(tmp_path), Jobs(tmp_path)
    session.patch("object.0.distance", -1.0)
    with pytest.raises(ClscoError, match=r"object\.0\.distance: must be valid before frames"):
        generate.render_frames(session, jobs, "out")
    session.undo()
    session.patch("camera.pixel_pitch", 1e-4)
    session.patch("camera.focus_distance", 30.0)
    with pytest.raises(ClscoError, match="the blur radius must be at most 512 px"):
        generate.render_frames(session, jobs, "out")
    with pytest.raises(ClscoError, match=r"at most 512 px.*\(with focus_distance_30\)"):
        generate.render_frames(session, jobs, "out", table=generate.stack_table(session, 30.0, 250.0, 3))
    assert not jobs.listed
    assert not (tmp_path / "out").exists()


def test_command_lines(tmp_path: Path, slow: None) -> None:
    (tmp_path / "mine.toml").write_text(DISTRIBUTION)
    (tmp_path / "scene.toml").write_text('[[object]]\nshape = "plane"\n')
    (tmp_path / "broken.toml").write_text("[vary")
    names = generate.distributions(tmp_path)
    assert names == ["mine.toml", *generate.shipped_distributions()]
    session = Document(tmp_path)
    load_preset(session, "depth_map")
    (tmp_path / names[1]).parent.mkdir()
    (tmp_path / names[1]).write_text(DISTRIBUTION)  # what is there is not overwritten

    async def run() -> list[str]:
        jobs = Jobs(tmp_path)
        generate.render_frames(session, jobs, "-o/x", ["--video", "mp4"])
        session.patch("object.0.shape", "plane")
        generate.render_frames(session, jobs, "stack", table=generate.stack_table(session, 200.0, 300.0, 5))
        generate.make_data_set(session, jobs, "mine.toml", "data", 100, ["--seed", "7"])
        for number, name in enumerate(names[1:3]):
            generate.make_data_set(session, jobs, name, f"other{number}", 5)
        with pytest.raises(ClscoError, match=r"distribution: must be an existing file; got 'none\.toml'"):
            generate.make_data_set(session, jobs, "none.toml", "none", 5)
        lines = [job.line for job in reversed(jobs.listed)]
        await jobs.close()
        return lines

    assert asyncio.run(run())[:3] == [
        "clsco render ./-o/x/scene.toml -o ./-o/x --video mp4",
        "clsco render stack/scene.toml -o stack",
        "clsco dataset make mine.toml -o data --count 100 --shard-size 7 --seed 7 --resume --quiet",
    ]
    assert (tmp_path / names[1]).read_text() == DISTRIBUTION
    assert (tmp_path / names[2]).read_bytes() == generate.shipped_distributions()[names[2]].read_bytes()
    scene = load_scene(tmp_path / "-o/x/scene.toml")  # whose images are found from its folder
    assert all(Path(str(source)).is_file() for item in scene.objects for source in item.inputs().values())
    stack = tomllib.loads((tmp_path / "stack/scene.toml").read_text())
    assert stack["camera"]["focus_distance"] == {"from": 200.0, "to": 300.0, "steps": 5}


@pytest.mark.slow
def test_a_data_set_counts_its_samples_and_goes_on_after_a_cancel(tmp_path: Path) -> None:
    (tmp_path / "d.toml").write_text(DISTRIBUTION)

    async def run() -> None:
        jobs = Jobs(tmp_path)
        job = generate.make_data_set(Document(tmp_path), jobs, "d.toml", "data", 40, ["--device", "pocl"])
        await until(lambda: job.done > 0, 120.0)
        jobs.cancel(job)
        await finish(jobs)
        assert [each.status for each in jobs.listed] == ["canceled"], job.message
        assert 0 < job.done < job.total == 40
        jobs.run_again(job)
        await finish(jobs)
        assert [each.status for each in jobs.listed] == ["done"], job.message
        assert job.done == job.total

    asyncio.run(run())
    assert generate.sample_picture(tmp_path / "data").startswith(b"\x89PNG")
    result = CliRunner().invoke(main, ["dataset", "verify", str(tmp_path / "data"), "--sample", "2", "--quiet"])
    assert result.exit_code == 0, result.output


def test_what_is_not_installed_is_said_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(generate.truth_formats()) >= {"npz", "exr", "flo", "kitti_depth", "colmap"}
    assert set(generate.clip_presets()) >= {"mp4", "webm", "ffv1-16", "prores-hq"}
    assert set(generate.truth_formats().values()) == {""}
    monkeypatch.setattr(generate, "find_spec", lambda name: None)
    assert generate.truth_formats()["exr"] == "needs OpenEXR: pip install 'clsco[exr]'"
    assert generate.truth_formats()["npz"] == ""
    assert generate.clip_presets()["mp4"] == "needs av: pip install 'clsco[video]'"
    assert generate.set_formats()["webdataset"] == "needs imagecodecs: pip install 'clsco[formats]'"
    assert generate.first_format() == "webdataset+raw"


def test_the_extra_of_the_studio_brings_what_its_forms_offer_first() -> None:
    assert generate.first_format() == DEFAULT
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    (own,) = (line for line in project["optional-dependencies"]["studio"] if line.startswith("clsco["))
    needed = [CONTAINERS[DEFAULT].needs, TRUTH_FORMATS["exr"].needs, ("av", "video")]
    assert {extra for _, extra in filter(None, needed)} <= set(own[6:-1].split(","))
