"""Whether the tests notice small faults: each mutant of a file is run against the tests that look at it.

    python -m tests.mutation --share 20 --jobs 2 -o mutation.json

Works in copies of the tree, which are gone at the end, whatever ends it. Fails where a mutant survives that
survivors.toml does not give a reason for.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from tests.mutation.mutants import Mutant, mutants

ROOT = Path(__file__).resolve().parents[2]
REASONS = Path(__file__).with_name("survivors.toml")
COPIED = ("clsco", "kernels", "tests", "examples", "benchmarks", "docs", "pyproject.toml", "README.md", "Makefile")
NONE_SELECTED = 5  # pytest's status
MOST_FIRST = 4  # tests that noticed most other mutants of a file go before the others
NOT_BUILT = ("must build on", "SyntaxError")  # what says that a mutant is no program
TESTS = {
    "clsco/optics.py": "test_optics test_plan reference/test_geometry",
    "clsco/motion.py": "test_motion test_surfaces test_plan reference/test_geometry",
    "clsco/plan.py": "test_plan test_coarsening test_describe test_memory pipeline/test_strips pipeline/test_scenes",
    "accumulate.cl": "pipeline/test_examples",
    "biharmonic.cl": "kernels/test_biharmonic",
    "blur.cl": "kernels/test_blur test_defocus kernels/test_layer",
    "coarse.cl": "kernels/test_coarse",
    "convolve.cl": "kernels/test_convolve",
    "discs.clh": "kernels/test_blur test_defocus",
    "estimate.clh": "kernels/test_fill kernels/test_holes",
    "fill.cl": "kernels/test_fill kernels/test_forward",
    "gaussians.clh": "kernels/test_blur test_defocus",
    "geometry.clh": "kernels/test_geometry kernels/test_ray_surface kernels/test_trace",
    "holes.cl": "kernels/test_holes test_inpainting",
    "layer.cl": "kernels/test_layer test_defocus",
    "mean_median.cl": "kernels/test_fill kernels/test_forward",
    "near.clh": "kernels/test_blur test_defocus",
    "neighbors.clh": "kernels/test_blur test_defocus kernels/test_layer",
    "occlusion.clh": "kernels/test_occlusion pipeline/test_occlusion",
    "reproject.cl": "kernels/test_reproject kernels/test_forward pipeline/test_scenes",
    "rows.clh": "kernels/test_blur test_defocus",
    "score.cl": "kernels/test_holes kernels/test_fill",
    "sight.clh": "kernels/test_occlusion kernels/test_blur pipeline/test_occlusion",
    "sources.clh": "kernels/test_blur kernels/test_trace",
    "spread.clh": "kernels/test_blur kernels/test_tiles test_defocus",
    "texture.cl": "kernels/test_texture",
    "tiles.cl": "kernels/test_tiles",
    "trace.cl": "kernels/test_trace kernels/test_geometry pipeline/test_views pipeline/test_scenes",
    "wide.clh": "kernels/test_wide kernels/test_ray_surface",
}
"""File -> tests that look at it, the quickest first; kernels without their folder."""


def files() -> list[str]:
    """What is changed: all kernels, and the host's arithmetic."""
    kernels = sorted(path.name for path in (ROOT / "kernels").glob("*.cl*"))
    assert set(kernels) == {name for name in TESTS if "/" not in name}, "a kernel file without tests in TESTS"
    return [*(f"kernels/{name}" for name in kernels), *(name for name in TESTS if "/" in name)]


def tests_of(file: str) -> list[str]:
    return [f"tests/{name}.py" for name in TESTS[file.removeprefix("kernels/")].split()]


class Copy:
    """A copy of the tree in which one mutant at a time is tried."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.cache = folder / "tree", folder / "cache"
        self.running: subprocess.Popen[str] | None = None
        for name in COPIED:
            source, target = ROOT / name, self.tree / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "results"))
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)
        self.cache.mkdir()
        self.environ = {
            **os.environ,
            "PYTHONPATH": str(self.tree), "PYTHONDONTWRITEBYTECODE": "1", "POCL_CACHE_DIR": str(self.cache),
        }  # fmt: skip

    def tested(self, names: list[str], timeout: float, marked: str) -> tuple[int | None, str]:
        """Exit status of tests, 0 also where none is marked so, None past the time, and what they print."""
        options = ["-x", "-q", "--tb=short", "-rf", "-n", "0", "-p", "no:cacheprovider"]
        command = [sys.executable, "-m", "pytest", *options]
        piped: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = self.running = subprocess.Popen(
            [*command, "-m", marked, *names], cwd=self.tree, env=self.environ, start_new_session=True, **piped
        )
        try:
            out, _ = done.communicate(timeout=timeout)
            return (0 if done.returncode == NONE_SELECTED else done.returncode), out
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            self.stop()

    def stop(self) -> None:
        """End the tests that run, with all that they have started."""
        if self.running is not None and self.running.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self.running.pid, signal.SIGKILL)
            self.running.wait()

    def tried(self, mutant: Mutant, first: list[str], timeout: float, marks: tuple[str, ...]) -> tuple[str, float, str]:
        """What came of a mutant, the seconds that it took, and the test that failed; first: tests to begin with."""
        path, begun = self.tree / mutant.file, time.monotonic()
        text, known = path.read_text("utf-8"), set(self.cache.glob("*/*"))
        path.write_text(mutant.of(text), "utf-8")
        try:
            for marked in marks:
                status, out = self.tested([*first, *tests_of(mutant.file)], timeout, marked)
                if status != 0:
                    break
        finally:
            path.write_text(text, "utf-8")
            for entry in set(self.cache.glob("*/*")) - known:  # no other mutant has these kernels
                shutil.rmtree(entry, ignore_errors=True)
        outcome = "survived" if status == 0 else "timeout" if status is None else "killed"
        if outcome == "killed" and any(words in out for words in NOT_BUILT):
            outcome = "not built"
        assert "ERROR: not found:" not in out, out[-2000:]
        failed = re.search(r"^FAILED (tests/.+?::.+?)(?: - .*)?$", out, re.MULTILINE)
        return outcome, time.monotonic() - begun, failed[1] if failed else ""


def chosen(names: list[str], share: int, seed: int) -> list[Mutant]:
    """Every share-th mutant of the files, from all over them."""
    all_of_them = [mutant for name in names for mutant in mutants(ROOT, name)]
    count = -(-len(all_of_them) // share)
    return random.Random(seed).sample(all_of_them, count)


@contextmanager
def copies(count: int) -> Iterator[list[Copy]]:
    """Copies of the tree, removed at the end, by Ctrl-C and SIGTERM as well."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="clsco-mutation-", ignore_cleanup_errors=True) as folder:
        yield [Copy(Path(folder) / str(k)) for k in range(count)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", nargs="+", default=files(), metavar="FILE", help="by default all of them")
    parser.add_argument("--share", type=int, default=1, metavar="N", help="one of N mutants")
    parser.add_argument("--seed", type=int, default=1, help="which ones")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--timeout", type=float, default=60.0, metavar="SECONDS", help="of a mutant, at least")
    parser.add_argument("--slow", action="store_true", help="survivors against what is marked slow as well")
    parser.add_argument("--until", type=float, default=float("inf"), metavar="MINUTES", help="begin no mutant later")
    parser.add_argument("-o", "--output", type=Path, default=Path("mutation.json"))
    options = parser.parse_args()
    reasons = {entry["mutant"]: entry["reason"] for entry in tomllib.loads(REASONS.read_text("utf-8"))["survivor"]}
    selected, end = chosen(options.files, options.share, options.seed), time.monotonic() + 60 * options.until
    marks = ("not slow", "slow") if options.slow else ("not slow",)
    results: list[dict[str, object]] = []
    seconds: dict[str, float] = {}
    noticed: dict[str, Counter[str]] = {name: Counter() for name in options.files}  # by which tests
    checking, stopped = threading.Lock(), threading.Event()
    with copies(options.jobs) as made, ThreadPoolExecutor(options.jobs) as pool:
        free: SimpleQueue[Copy] = SimpleQueue()
        for each in made:
            free.put(each)

        def check(copy: Copy, names: list[str]) -> None:
            """That tests pass without a change, once each; kernels are compiled then."""
            with checking:
                for name in (name for name in names if name not in seconds):
                    begun = time.monotonic()
                    status, out = copy.tested([name], 10 * options.timeout, " or ".join(marks))
                    if status != 0:
                        raise RuntimeError(f"{name} must pass without a change; got {status}\n{out[-2000:]}")
                    seconds[name] = round(time.monotonic() - begun, 1)
                    print(f"without a change {seconds[name]:6} s  {name}", flush=True)

        def run(mutant: Mutant) -> dict[str, object] | None:
            if stopped.is_set() or time.monotonic() > end:
                return None
            copy = free.get()
            try:
                check(copy, tests_of(mutant.file))
                usual = sum(seconds[name] for name in tests_of(mutant.file))
                often = [test for test, _ in noticed[mutant.file].most_common(MOST_FIRST)]
                outcome, spent, test = copy.tried(mutant, often, max(options.timeout, 4 * usual), marks)
            finally:
                free.put(copy)
            if test:
                noticed[mutant.file][test] += 1
            return {
                "mutant": mutant.name, "row": mutant.row, "outcome": outcome, "seconds": round(spent, 1),
                "by": test, "reason": reasons.get(mutant.name) if outcome == "survived" else None,
            }  # fmt: skip

        try:
            for future in as_completed([pool.submit(run, mutant) for mutant in selected]):
                if (result := future.result()) is None:
                    continue
                results.append(result)
                print(f"{result['outcome']:9} {result['seconds']:6} s  {result['mutant']}", flush=True)
                _write(options, seconds, results)
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for each in made:
                each.stop()
            raise
    _write(options, seconds, results)
    survivors = [result for result in results if result["outcome"] == "survived"]
    unexplained = [result for result in survivors if result["reason"] is None]
    print(dict(Counter(str(result["outcome"]) for result in results)), f"{len(unexplained)} survive without a reason")
    for result in unexplained:
        print(f"{result['mutant']} (row {result['row']})")
    return 1 if unexplained else 0


def _write(options: argparse.Namespace, seconds: dict[str, float], results: list[dict[str, object]]) -> None:
    by_file: dict[str, Counter[str]] = {}
    for result in results:
        by_file.setdefault(str(result["mutant"]).split(":")[0], Counter())[str(result["outcome"])] += 1
    found = {
        "share": options.share,
        "seed": options.seed,
        "mutants": {name: len(mutants(ROOT, name)) for name in options.files},
        "seconds_without_a_change": seconds,
        "files": by_file,
        "results": sorted(results, key=lambda result: str(result["mutant"])),
    }
    partial = options.output.with_suffix(".part")
    partial.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    partial.replace(options.output)


if __name__ == "__main__":
    sys.exit(main())
