"""Whether the tests notice small faults: each mutant of a file is run against the tests that look at it.

    python -m tests.mutation --share 20 --jobs 2 -o mutation.json

Works in copies of the tree, which are gone at the end, whatever ends it. Of the tests of a kernel file those run that
have the mutant in what they launch. Fails where a mutant survives that survivors.toml does not give a reason for. All
of them take hours: noticed.json remembers which were noticed for as long as the code of their file stays the same, and
--new leaves these out, and those with a reason.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import threading
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from hashlib import sha256
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from tests.mutation import simulated
from tests.mutation.copies import Copy, copies
from tests.mutation.mutants import ROOT, Mutant, code_of, mutants
from tests.mutation.seen import Sight

AGAINST = ("quick", "slow", "simulator")  # tests by default, those marked slow, the cases of `make oclgrind`
SECONDS = 10.0  # between two times that results are written
MOST_CASES = 6  # of the simulator, the quickest that see a mutant
REASONS = Path(__file__).with_name("survivors.toml")
NOTICED = Path(__file__).with_name("noticed.json")
TESTS = {
    "clsco/optics.py": "test_optics test_plan reference/test_geometry",
    "clsco/motion.py": "test_motion test_surfaces test_plan reference/test_geometry",
    "clsco/plan.py": "test_plan test_coarsening test_describe test_memory pipeline/test_strips pipeline/test_scenes",
    "accumulate.cl": "pipeline/test_scenes",
    "biharmonic.cl": "kernels/test_biharmonic",
    "blur.cl": "kernels/test_blur test_defocus kernels/test_layer kernels/test_occlusion pipeline/test_occlusion",
    "coarse.cl": "kernels/test_coarse test_coarsening",
    "columns.clh": "kernels/test_blur test_defocus kernels/test_layer",
    "convolve.cl": "kernels/test_convolve",
    "discs.clh": "kernels/test_blur test_defocus",
    "estimate.clh": "kernels/test_fill kernels/test_holes",
    "fill.cl": "kernels/test_fill kernels/test_forward",
    "gaussians.clh": "kernels/test_blur test_defocus",
    "geometry.clh": "kernels/test_geometry kernels/test_ray_surface kernels/test_trace",
    "holes.cl": "kernels/test_holes test_inpainting",
    "layer.cl": "kernels/test_layer test_defocus",
    "many.clh": "kernels/test_blur test_defocus",
    "mean_median.cl": "kernels/test_fill kernels/test_forward",
    "near.clh": "kernels/test_blur test_defocus",
    "quadrants.clh": "kernels/test_blur test_defocus kernels/test_layer",
    "occlusion.clh": "kernels/test_occlusion pipeline/test_occlusion",
    "reproject.cl": "kernels/test_reproject kernels/test_forward pipeline/test_scenes",
    "rows.clh": "kernels/test_blur test_defocus",
    "score.cl": "kernels/test_holes kernels/test_fill",
    "sight.clh": "kernels/test_occlusion kernels/test_blur pipeline/test_occlusion",
    "sources.clh": "kernels/test_blur kernels/test_trace",
    "spread.clh": "kernels/test_blur kernels/test_tiles test_defocus kernels/test_occlusion",
    "texture.cl": "kernels/test_texture",
    "tiles.cl": "kernels/test_tiles",
    "trace.cl": "kernels/test_silhouettes kernels/test_trace kernels/test_geometry pipeline/test_views "
    "pipeline/test_scenes test_sweep",
    "wide.clh": "kernels/test_wide kernels/test_ray_surface kernels/test_geometry kernels/test_trace",
}
"""File -> tests that look at it, the quickest first; kernels without their folder."""


def files() -> list[str]:
    """What is changed: all kernels, and the host's arithmetic."""
    kernels = sorted(path.name for path in (ROOT / "kernels").glob("*.cl*"))
    assert set(kernels) == {name for name in TESTS if "/" not in name}, "a kernel file without tests in TESTS"
    return [*(f"kernels/{name}" for name in kernels), *(name for name in TESTS if "/" in name)]


def tests_of(file: str) -> list[str]:
    return [f"tests/{name}.py" for name in TESTS[file.removeprefix("kernels/")].split()]


def chosen(names: list[str], share: int, part: int) -> list[Mutant]:
    """Every share-th mutant of the files, from all over them; parts 0 to share - 1 are all of them, each once."""
    all_of_them = [mutant for name in names for mutant in mutants(ROOT, name)]
    random.Random(1).shuffle(all_of_them)
    return all_of_them[part::share]


def short(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:12]


SIMULATOR = "tests/oclgrind"


class Memory:
    """Which mutants were noticed: of each file a hash of its code, and hashes of their names."""

    def __init__(self, path: Path) -> None:
        self.path = path
        found = json.loads(path.read_text("utf-8")) if path.exists() else {}
        self.code = {name: short(code_of(ROOT, name)) for name in files()}
        self.noticed = {
            name: set(found[name]["noticed"]) if found.get(name, {}).get("code") == code else set[str]()
            for name, code in self.code.items()
        }

    def has(self, mutant: Mutant) -> bool:
        return short(mutant.name) in self.noticed[mutant.file]

    def keep(self, mutant: Mutant) -> None:
        self.noticed[mutant.file].add(short(mutant.name))

    def write(self) -> None:
        kept = {
            name: {"code": self.code[name], "noticed": sorted(hashes)}
            for name, hashes in self.noticed.items()
            if hashes
        }
        partial = self.path.with_suffix(".part")
        partial.write_text(json.dumps(kept, indent=0) + "\n", "utf-8")
        partial.replace(self.path)


class Tests:
    """Which tests can notice a mutant, as they were seen to run without a change."""

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self.seconds: dict[str, float] = {}
        self.noticed: dict[str, Counter[str]] = {name: Counter() for name in files()}  # by which tests
        self._seen: dict[str, dict[Mutant, list[str]]] = {}  # test file -> mutant -> tests
        self._tests: dict[str, list[str]] = {}  # test file -> tests
        self._slow: set[str] = set()
        self._sight = Sight(ROOT, [name for name in files() if name.startswith("kernels/")])
        self._lock = threading.Lock()

    def seeing(self, mutant: Mutant, copy: Copy) -> list[str]:
        """Tests in the order in which they are to run: those first that noticed most of the file in their time."""
        found = []
        for file in tests_of(mutant.file):
            with self._lock:
                if file not in self._tests:
                    self._record(file, copy)
            found += self._seen[file].get(mutant, []) if mutant.file.startswith("kernels/") else self._tests[file]
        return self._often_first(mutant, sorted(found, key=self._slow.__contains__))

    def cases(self, mutant: Mutant) -> list[str]:
        """Some cases of the simulator that see a mutant, in the order in which they are to run."""
        with self._lock:
            if SIMULATOR not in self._seen:
                self._keep(SIMULATOR, simulated.recorded())
        found = sorted(self._seen[SIMULATOR].get(mutant, []), key=self.seconds.__getitem__)
        return self._often_first(mutant, found)[:MOST_CASES]

    def _often_first(self, mutant: Mutant, found: list[str]) -> list[str]:
        often = {test: count / (0.5 + self.seconds[test]) for test, count in self.noticed[mutant.file].items()}
        return sorted(found, key=lambda test: -often.get(test, 0.0))

    def _record(self, file: str, copy: Copy) -> None:
        begun = time.monotonic()
        self._keep(file, copy.recorded(file, self.timeout))
        print(f"without a change {time.monotonic() - begun:6.1f} s  {file}", flush=True)

    def _keep(self, file: str, recorded: dict[str, Any]) -> None:
        self.seconds |= {name: what["seconds"] for name, what in recorded["tests"].items()}
        self._slow |= {name for name, what in recorded["tests"].items() if what["slow"]}
        self._seen[file], self._tests[file] = self._sight.seen(recorded), list(recorded["tests"])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", nargs="+", default=files(), metavar="FILE", help="by default all of them")
    parser.add_argument("--share", type=int, default=1, metavar="N", help="one of N mutants")
    parser.add_argument("--part", type=int, default=0, metavar="K", help="which ones: 0 to N - 1")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--timeout", type=float, default=60.0, metavar="SECONDS", help="of a mutant, at least")
    parser.add_argument(
        "--against", nargs="+", choices=AGAINST, default=["quick"], help="which tests, by default quick"
    )
    parser.add_argument("--until", type=float, default=float("inf"), metavar="MINUTES", help="begin no mutant later")
    parser.add_argument("--new", action="store_true", help="only those that nothing is known of yet")
    parser.add_argument("--survivors", type=Path, metavar="FILE", help="only those of an earlier output")
    parser.add_argument("-o", "--output", type=Path, default=Path("mutation.json"))
    options = parser.parse_args()
    if shutil.which("cpp") is None:
        parser.error("cpp: must be installed, the preprocessor of C; on Debian and Ubuntu by apt-get install cpp")
    # Kernels of a few pixels take longer to optimize than to run.
    os.environ["PYOPENCL_BUILD_OPTIONS"] = "-cl-opt-disable"
    reasons = {entry["mutant"]: entry["reason"] for entry in tomllib.loads(REASONS.read_text("utf-8"))["survivor"]}
    selected, end = chosen(options.files, options.share, options.part), time.monotonic() + 60 * options.until
    selected.sort(key=lambda mutant: options.files.index(mutant.file))  # tests are collected once for each
    memory = Memory(NOTICED)
    if options.survivors:
        earlier = json.loads(options.survivors.read_text("utf-8"))["results"]
        survived = {result["mutant"] for result in earlier if result["outcome"] == "survived"}
        selected = [mutant for mutant in selected if mutant.name in survived]
    if options.new:
        selected = [mutant for mutant in selected if not memory.has(mutant) and mutant.name not in reasons]
    results: list[dict[str, object]] = []
    tests = Tests(10 * options.timeout)
    simulator = "simulator" in options.against
    marked = " or ".join({"quick": "not slow", "slow": "slow"}[name] for name in options.against if name != "simulator")
    stopped, written = threading.Event(), time.monotonic()
    with (
        copies(options.jobs, f"({marked}) and not soak and not laws and not oclgrind") as made,
        ThreadPoolExecutor(options.jobs) as pool,
    ):
        free: SimpleQueue[Copy] = SimpleQueue()
        for each in made:
            free.put(each)

        def run(mutant: Mutant) -> dict[str, object] | None:
            if stopped.is_set() or time.monotonic() > end:
                return None
            copy = free.get()
            try:
                begun = time.monotonic()
                seeing = tests.seeing(mutant, copy) if marked else []
                usual = sum(tests.seconds[test] for test in seeing)
                outcome, test = copy.tried(mutant, tests_of(mutant.file), seeing, max(options.timeout, 10 * usual))
                if outcome == "survived" and simulator and mutant.file.startswith("kernels/"):
                    cases = tests.cases(mutant)
                    seeing = [*seeing, *cases]
                    outcome, test = simulated.tried(mutant, cases, options.timeout) if cases else (outcome, "")
            finally:
                free.put(copy)
            if test:
                tests.noticed[mutant.file][test.removeprefix("oclgrind: ")] += 1
            return {
                "mutant": mutant.name, "row": mutant.row, "outcome": outcome,
                "seconds": round(time.monotonic() - begun, 1), "tests": len(seeing), "by": test,
                "reason": reasons.get(mutant.name) if outcome == "survived" else None,
            }  # fmt: skip

        try:
            futures = {pool.submit(run, mutant): mutant for mutant in selected}
            for future in as_completed(futures):
                if (result := future.result()) is None:
                    continue
                if result["outcome"] != "survived":
                    memory.keep(futures[future])
                results.append(result)
                print(f"{result['outcome']:9} {result['seconds']:6} s  {result['mutant']}", flush=True)
                if time.monotonic() > written + SECONDS:
                    _write(options, results)
                    memory.write()
                    written = time.monotonic()
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for each in made:
                each.stop()
            raise
        finally:
            _write(options, results)
            memory.write()
    survivors = [result for result in results if result["outcome"] == "survived"]
    unexplained = [result for result in survivors if result["reason"] is None]
    print(dict(Counter(str(result["outcome"]) for result in results)), f"{len(unexplained)} survive without a reason")
    everything = [mutant for name in files() for mutant in mutants(ROOT, name)]
    known = sum(memory.has(mutant) for mutant in everything), sum(mutant.name in reasons for mutant in everything)
    print(f"of all {len(everything)} mutants {known[0]} are known to be noticed, and {known[1]} have a reason")
    for result in unexplained:
        print(f"{result['mutant']} (row {result['row']})")
    return 1 if unexplained else 0


def _write(options: argparse.Namespace, results: list[dict[str, object]]) -> None:
    by_file: dict[str, Counter[str]] = {}
    for result in results:
        by_file.setdefault(str(result["mutant"]).split(":")[0], Counter())[str(result["outcome"])] += 1
    found = {
        "share": options.share,
        "part": options.part,
        "mutants": {name: len(mutants(ROOT, name)) for name in options.files},
        "files": by_file,
        "results": sorted(results, key=lambda result: str(result["mutant"])),
    }
    partial = options.output.with_suffix(".part")
    partial.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    partial.replace(options.output)


if __name__ == "__main__":
    sys.exit(main())
