"""Random bad scenes, a million of them on request: python -m tests.hostile.fuzz --cases 1000000

Each case is an example with a few changes (`mutate.py`), validated in this process; it has to give a scene or a
SceneError whose messages have the form that all messages have and name what was changed, within 5 s, with nothing
written. One in PLANNED of the scenes that are valid is planned as well, as `clsco validate` does. A case that does not
is reported with its seed and number, which repeat it: --seed S --first N --cases 1.
--what pictures: small images of every format, damaged, read as images and as depths.
"""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

from clsco.errors import ClscoError, FileError, SceneError
from clsco.files.images import read_image
from clsco.inputs.depth_files import read_depth
from clsco.plan.prepare import prepare_sweep
from clsco.resources import processors
from clsco.scene.sweep import Sweep, load_sweep, parse_sweep
from clsco.scene.text import key_name
from tests.hostile.mutate import Case, make_case
from tests.hostile.pictures import damaged
from tests.hostile.watch import faults_of, keys_of, start_watching, watched

PLANNED = 4
MOST_PIXELS = 2**22  # of scenes that are planned here: the work of a plan grows with the frame
MOST_KIB = 200 * 1024  # that reading a small image may take
CHUNK = 500  # cases of a process at a time
TALLY = ("cases", "refused", "valid", "planned", "failures")


def main() -> int:
    """Run cases, tell of those that fail; 1 where there are any."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--what", choices=("scenes", "pictures"), default="scenes")
    options = parser.parse_args()
    start, total, status = time.monotonic(), Counter[str](), 0
    last = options.first + options.cases
    chunks = [range(first, min(first + CHUNK, last)) for first in range(options.first, last, CHUNK)]
    run = partial(work, what=options.what, seed=options.seed, end=time.time() + options.seconds)
    with ProcessPoolExecutor(processors(), multiprocessing.get_context("spawn"), prepare_process) as pool:
        try:
            for tally, lines in pool.map(run, chunks):
                total.update(tally)
                print(*lines, sep="\n", end="\n" if lines else "", flush=True)
        except BrokenProcessPool:
            print("a process ended by itself; its stack is above")
            status = 1
    print(f"seed {options.seed}: {', '.join(f'{total[name]} {name}' for name in TALLY)}", end="")
    print(f" in {time.monotonic() - start:.0f} s")
    return int(status or total["failures"] > 0)


def prepare_process() -> None:
    """Have warnings be errors, crashes print their stack, and hangs be interrupted."""
    warnings.simplefilter("error")
    faulthandler.enable()
    start_watching()


def work(numbers: range, what: str, seed: int, end: float) -> tuple[Counter[str], list[str]]:
    """Run cases until a time; a tally, and a line for each failure."""
    tally, lines = Counter[str](), list[str]()
    with tempfile.TemporaryDirectory(prefix="clsco-fuzz-") as folder:
        for number in numbers:
            if time.time() > end:
                break
            if what == "scenes":
                faults = outcome(make_case(seed, number), Path(folder), number, tally)
            else:
                faults = picture_outcome(damaged(seed, number), Path(folder), tally)
            lines += [f"seed {seed}, case {number}: {fault}" for fault in faults]
    tally["failures"] = len(lines)
    return tally, lines


def outcome(case: Case, folder: Path, number: int, tally: Counter[str]) -> list[str]:
    """Faults in the outcome of a case, which is counted."""
    where, path = "scene", folder / f"case{case.suffix}"
    if case.text is not None:
        path.write_bytes(case.text)
        where = str(path)
    faults: list[str] = []
    planned = False
    with watched() as written:
        try:
            sweep = load_sweep(path) if case.text is not None else parse_sweep(case.mapping or {})
            if number // 64 % PLANNED == 0 and (planned := _is_small(sweep)):
                where = ""
                prepare_sweep(Sweep(sweep.labels[:2], sweep.scenes[:2]))
            tally["valid"] += 1
        except SceneError as error:
            tally["refused"] += 1
            if not planned:
                faults += faults_of(error, where) + _unnamed(error, where, case)
        except ClscoError as error:
            faults.append(f"{type(error).__name__}, which only files and devices give: {error}")
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__}: {ascii(str(error))[:200]}"
            faults.append(f"{case.base}: {what} at {last.filename}:{last.lineno}")
    tally["cases"] += 1
    tally["planned"] += planned
    return faults + [f"written: {what}" for what in written]


def picture_outcome(picture: tuple[str, str, bytes], folder: Path, tally: Counter[str]) -> list[str]:
    """Faults in the outcome of a damaged image, read as an image and as depths; counts it."""
    name, suffix, content = picture
    path = folder / f"picture{suffix}"
    path.write_bytes(content)
    faults: list[str] = []
    readers: list[Callable[[Path], object]] = [read_image, read_depth]
    for read in {".jpg": readers[:1], ".npz": readers[1:]}.get(suffix, readers):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with watched() as written:
            try:
                read(path)
                tally["valid"] += 1
            except FileError as error:
                tally["refused"] += 1
                faults += faults_of(error, str(path))
            except BaseException as error:
                faults.append(f"{name}: {type(error).__name__}: {ascii(str(error))[:200]}")
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        faults += [f"{name}: {grown >> 10} MiB more"] if grown > MOST_KIB else []
        faults += [f"{name}: written: {what}" for what in written]
        tally["cases"] += 1
    return faults


def _is_small(sweep: Sweep) -> bool:
    """False also for waves: their tables of weights may take longer than a case may."""
    scene = sweep.scenes[0]
    columns, rows = scene.camera.resolution or (512, 512)
    return columns * rows <= MOST_PIXELS and scene.psf.model != "wave"


def _unnamed(error: SceneError, where: str, case: Case) -> list[str]:
    """Fault if no message of a single change names its key, one of its table, or one that depends on that."""
    if not case.changed:
        return []
    path = list(case.changed)
    while len(path) > 1 and isinstance(path[-1], int):  # a component is of its key
        path.pop()
    table, recorded = key_name(path[:-1] or path), keys_of(error, where)
    others = {"motion": ("fill", "psf"), "object": ("psf",), "camera": ("psf", "aperture"), "group": ("object",)}
    others["lens"] = ("lens",)  # keyframes follow one another
    dependent = others.get(str(case.changed[0]), ())
    near = any(key.startswith((table, *dependent)) or table.startswith(key) or table in key for key in recorded)
    near |= case.changed[-1] == "name" and any(key.endswith(".name") for key in recorded)  # which must differ
    return [] if near else [f"changed {key_name(case.changed)}, but the messages name {recorded[:5]}"]


if __name__ == "__main__":
    sys.exit(main())
