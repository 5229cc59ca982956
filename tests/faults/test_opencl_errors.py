"""An error of OpenCL at every call: the same bits from smaller strips, or one error reported, and no torn file."""

from __future__ import annotations

import json
import multiprocessing
from collections import Counter as Tally
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from click.testing import CliRunner

import clsco
from clsco.cli.main import main
from clsco.errors import DeviceError, KernelError
from clsco.files.atomic import sha256
from clsco.frame.files import read_complete
from clsco.opencl.session import session_on
from tests.faults.opencl import ERRORS, Counter, failing
from tests.scenes import scene_file

CAMERA = "[camera]\nresolution = [20, 150]\n"
SPHERE = '[[object]]\nshape = "sphere"\nradius = 30.0\n'
SCENES = {
    "sphere": CAMERA + "f_number = 4\n" + SPHERE,
    "two frames": CAMERA + "[sequence]\nframes = 2\nsamples = 2\n" + SPHERE + "motion.velocity = [9, 0, 0]\n",
    "stereo": CAMERA + "[stereo]\nbaseline = 9\n" + SPHERE,
    "lenses": CAMERA + "f_number = [3, 4]\n" + SPHERE,
    "forward": CAMERA + '[motion]\nwarp = "forward"\n' + SPHERE + "motion.velocity = [9, 0, 0]\n",
    "depth map": '[camera]\nf_number = 4\n[[object]]\nshape = "depth_map"\ntexture = "i.npy"\ndepth = "z.npy"\n',
    "layered": CAMERA + '[psf]\nocclusion = "layered"\n' + SPHERE + '[[object]]\nshape = "plane"\ndistance = 400\n',
}


RNG = np.random.default_rng(3)
IMAGE, COC = RNG.random((150, 20), np.float32), RNG.random((150, 20)) * 3


@pytest.fixture
def scene(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    np.save(tmp_path / "i.npy", IMAGE)
    np.save(tmp_path / "z.npy", 300.0 + 20.0 * COC)
    return scene_file(tmp_path / "scene.toml", SCENES[request.param])


def rendered(scene: Path, out: Path, counter: Counter) -> tuple[int, dict[str, str]]:
    """Exit status of `clsco render` with that failing call, and the SHA-256 of its images; checks all else."""
    words = ["render", str(scene), "-o", str(out), "--format", "npz", "--quiet"]
    session_on.cache_clear()  # contexts, queues and builds are to fail, too
    with failing(counter):
        result = CliRunner().invoke(main, words)
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code in (0, 1, 3)
    assert bool(result.stderr) == (result.exit_code != 0)
    if result.exit_code == 3:  # else a kernel does not build, and the compiler's log is reported
        assert len(result.stderr.splitlines()) == 1
        assert result.stderr.startswith("error: device ")
        assert "; got " in result.stderr
    files = [path for path in sorted(out.rglob("*")) if path.is_file()]
    for path in files:
        if path.suffix == ".json":
            assert read_complete(path.parent, int(path.stem[-4:])) is not None
    described = [path for path in files if path.suffix == ".json"]
    whole = {path.parent / name for path in described for name in json.loads(path.read_text())["files"]}
    assert whole == {path for path in files if path.suffix != ".json"}  # no file besides those of whole frames
    return result.exit_code, {str(path.relative_to(out)): sha256(path) for path in sorted(whole)}


Attempt: TypeAlias = tuple[Path, Path, Counter]  # scene, folder, which call fails


def attempted(attempt: Attempt) -> tuple[int, dict[str, str], Counter]:
    """Results of `rendered`, and the calls."""
    return *rendered(*attempt), attempt[-1]


def in_other_processes(function: Callable[[Attempt], Any], attempts: Iterable[Attempt]) -> Iterator[Any]:
    """`map` in processes that end now and then: each attempt builds programs, whose memory PoCL keeps."""
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=100) as pool:
        yield from pool.imap(function, attempts)


def check_every(scene: Path, folder: Path, step: int, after: bool, run: Callable[..., Iterator[Any]]) -> Tally[int]:
    """Let every `step`-th call fail, in turn with every error, and `run` the attempts; the exit statuses."""
    count = Counter()
    assert rendered(scene, folder / "whole", count)[0] == 0
    status, wanted = rendered(scene, folder / "again", Counter())
    assert status == 0
    assert wanted
    assert {"Buffer", "build", "launch", "finish", "enqueue_copy"} <= set(count.names)
    attempts = []
    for number in range(0, len(count.names), step):
        error = list(ERRORS)[number // step % len(ERRORS)]
        for kind in ERRORS if step == 1 else [error]:
            attempts.append((scene, folder / f"{number} {kind}", Counter(number, kind, after)))
    statuses: Tally[int] = Tally()
    for status, files, counter in run(attempted, attempts):
        which = (counter.fails_at, count.names[counter.fails_at], counter.error)
        assert counter.has_failed, which
        assert files.items() <= wanted.items(), which
        assert status != 0 or files == wanted, which
        assert not (after and status == 0), which
        statuses[status] += 1
    assert statuses.total() == len(attempts)
    return statuses


@pytest.mark.parametrize("scene", ["sphere"], indirect=True)
def test_an_error_at_some_calls(scene: Path, tmp_path: Path) -> None:
    statuses = check_every(scene, tmp_path, 19, after=False, run=map)
    assert statuses[0] > 0
    assert statuses[3] > 0


@pytest.mark.soak
@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("scene", SCENES, indirect=True)
def test_an_error_at_every_call(scene: Path, tmp_path: Path, after: bool) -> None:
    statuses = check_every(scene, tmp_path, 1, after, in_other_processes)
    print(statuses)
    assert statuses[3] > 0
    assert after or statuses[0] > 0 or 'warp = "forward"' in scene.read_text()


HOLES = RNG.random((150, 20)) < 0.1
CALLS: dict[str, Any] = {
    "defocus": lambda: clsco.defocus(IMAGE, COC),
    "layered": lambda: clsco.defocus(IMAGE, COC, {"occlusion": "layered"}),
    "convolve": lambda: clsco.defocus(IMAGE, np.full_like(COC, 3)),
    "mean-median": lambda: clsco.inpaint(IMAGE, HOLES, method="mean-median"),
    "biharmonic": lambda: clsco.inpaint(IMAGE, HOLES, method="biharmonic"),
    "texture": lambda: clsco.inpaint(IMAGE, HOLES, method="texture"),
}


def check_calls(call: Any, step: int) -> None:
    session_on.cache_clear()
    wanted = call()
    count = Counter()
    with failing(count):
        np.testing.assert_array_equal(call(), wanted)
    assert count.names
    for number in range(0, len(count.names), step):
        short, recorded = True, ""
        kind = list(ERRORS)[number // step % len(ERRORS)]
        with failing(Counter(number, kind)):
            try:
                np.testing.assert_array_equal(call(), wanted)
            except (DeviceError, KernelError) as error:
                short = getattr(error, "short_of_memory", True)
                recorded = f"{number} {count.names[number]} {kind}: {error}"
        assert short or kind in ("gone", "invalid"), recorded
        np.testing.assert_array_equal(call(), wanted)  # the session is as good as before


@pytest.mark.parametrize("name", ["defocus", "mean-median"])
def test_an_error_at_some_calls_of_an_engine(name: str) -> None:
    check_calls(CALLS[name], 17)


@pytest.mark.soak
@pytest.mark.parametrize("name", CALLS)
def test_an_error_at_every_call_of_an_engine(name: str) -> None:
    check_calls(CALLS[name], 1)
