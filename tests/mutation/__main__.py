"""Mutation test: each mutant of a file, a small fault, is run against the tests that reach it, which have to kill it.

    python -m tests.mutation --against quick slow simulator --share 20 -o mutation.json

Works in copies of the tree, which are gone at the end, whatever ends it. Of the tests of a kernel file those run that
have the mutant in what they launch. Fails where a mutant survives that survivors.toml does not give a reason for. All
of them take hours: `.mutation`, outside of git, keeps which were killed for as long as the code of their function stays
the same, and --new leaves these out, and those with a reason.
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
from collections import Counter
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from clsco.resources import processors
from tests.mutation import simulated
from tests.mutation.copies import Copy, copies
from tests.mutation.memory import Killed, reason, reasons
from tests.mutation.mutants import ROOT, Mutant, mutants
from tests.mutation.switched import Switches
from tests.mutation.tests import Tests, files, tests_of
from tests.oclgrind import simulator

AGAINST = {"quick": "not slow", "slow": "slow", "simulator": ""}  # pytest's -m; the cases of `make oclgrind`
SECONDS = 10.0  # between two times that results are written
COMPILING = 60.0  # seconds more for a mutant whose programs are not built yet
Result = dict[str, Any]


def chosen(names: list[str], share: int, part: int) -> list[Mutant]:
    """Every share-th mutant of the files, from all over them; parts 0 to share - 1 are all of them, each once."""
    all_of_them = [mutant for name in names for mutant in mutants(ROOT, name)]
    random.Random(1).shuffle(all_of_them)
    return all_of_them[part::share]


def asked() -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", nargs="+", default=files(), metavar="FILE", help="by default all of them")
    parser.add_argument("--share", type=int, default=1, metavar="N", help="one of N mutants")
    parser.add_argument("--part", type=int, default=0, metavar="K", help="which ones: 0 to N - 1")
    parser.add_argument("--jobs", type=int, default=processors())
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
    if "simulator" in options.against and not simulator.LIBRARIES:
        parser.error(simulator.INSTALL)
    return options


def selected(options: argparse.Namespace, killed: Killed) -> list[Mutant]:
    """Mutants that the options ask for, those of a file together."""
    found = chosen(options.files, options.share, options.part)
    if options.survivors:
        earlier = json.loads(options.survivors.read_text("utf-8"))["results"]
        survived = {result["mutant"] for result in earlier if result["outcome"] == "survived"}
        found = [mutant for mutant in found if mutant.name in survived]
    if options.new:
        known = reasons()
        found = [mutant for mutant in found if not killed.has(mutant) and reason(mutant, known) is None]
    return sorted(found, key=lambda mutant: options.files.index(mutant.file))  # tests are collected once for each


class Trial:
    """Tries mutants, as many at a time as there are copies of the tree."""

    def __init__(self, made: Sequence[Copy], against: Sequence[str], switches: Switches, timeout: float) -> None:
        self.made, self.against, self.timeout = made, against, timeout
        self.tests, self.reasons, self.stopped = Tests(switches), reasons(), threading.Event()
        self.free: SimpleQueue[Copy] = SimpleQueue()
        for copy in made:
            self.free.put(copy)

    def results(self, wanted: Sequence[Mutant], end: float) -> Generator[tuple[Mutant, Result], None, None]:
        """Results of the mutants, as they end; none begins after `end`, of time.monotonic()."""
        if {"quick", "slow"} & set(self.against):
            self.tests.record({mutant.file for mutant in wanted}, self.made)
            wanted = sorted(wanted, key=self.tests.switches.has, reverse=True)  # the others have texts of their own
        pool = ThreadPoolExecutor(len(self.made))
        try:
            futures = {pool.submit(self.tried, mutant, end): mutant for mutant in wanted}
            for future in as_completed(futures):
                if (result := future.result()) is not None:
                    yield futures[future], result
        except BaseException:
            self.stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for copy in self.made:
                copy.stop()
            raise
        pool.shutdown()

    def tried(self, mutant: Mutant, end: float) -> Result | None:
        """Result of one mutant: `outcome` is killed, survived, timeout or not built; `by`: the test that killed it."""
        if self.stopped.is_set() or time.monotonic() > end:
            return None
        copy, begun = self.free.get(), time.monotonic()
        try:
            seeing = self.tests.seeing(mutant) if {"quick", "slow"} & set(self.against) else []
            most = max(self.timeout, 3 * sum(self.tests.seconds[test] for test in seeing))
            most += 0.0 if self.tests.switches.has(mutant) else COMPILING
            outcome, test = copy.tried(mutant, tests_of(mutant.file), seeing, most)
        finally:
            self.free.put(copy)
        if outcome == "survived" and "simulator" in self.against and mutant.file.startswith("kernels/"):
            cases = self.tests.cases(mutant)
            seeing = [*seeing, *cases]
            outcome, test = simulated.tried(mutant, cases, self.timeout) if cases else (outcome, "")
        if test:
            self.tests.killers[mutant.file][test] += 1
        return {
            "mutant": mutant.name, "file": mutant.file, "row": mutant.row, "outcome": outcome, "by": test,
            "tests": len(seeing), "seconds": round(time.monotonic() - begun, 1),
            "reason": reason(mutant, self.reasons) if outcome == "survived" else None,
        }  # fmt: skip


def main() -> int:
    options, killed = asked(), Killed()
    # Kernels of a few pixels take longer to optimize than to run.
    os.environ["PYOPENCL_BUILD_OPTIONS"] = "-cl-opt-disable"
    wanted, end = selected(options, killed), time.monotonic() + 60 * options.until
    marked = " or ".join(AGAINST[name] for name in options.against if AGAINST[name])
    found: list[Result] = []
    written = time.monotonic()
    try:
        switches = Switches(ROOT, [mutant for mutant in wanted if mutant.file.startswith("kernels/")])
        with copies(options.jobs, f"({marked}) and not soak and not laws and not oclgrind", switches) as made:
            trial = Trial(made, options.against, switches, options.timeout)
            with closing(trial.results(wanted, end)) as results:
                for mutant, result in results:
                    if result["outcome"] != "survived":
                        killed.keep(mutant)
                    found.append(result)
                    print(f"{result['outcome']:9} {result['seconds']:6} s  {result['mutant']}", flush=True)
                    if time.monotonic() > written + SECONDS:
                        write(options, found)
                        killed.write()
                        written = time.monotonic()
    finally:
        write(options, found)
        killed.write()
    return report(found, killed)


def report(found: Sequence[Result], killed: Killed) -> int:
    """Prints what came of all; exit status, 1 where some survive without a reason."""
    unexplained = [result for result in found if result["outcome"] == "survived" and result["reason"] is None]
    print(dict(Counter(result["outcome"] for result in found)), f"{len(unexplained)} survive without a reason")
    everything, known = [mutant for name in files() for mutant in mutants(ROOT, name)], reasons()
    others = [mutant for mutant in everything if not killed.has(mutant)]
    dead, explained = len(everything) - len(others), sum(reason(mutant, known) is not None for mutant in others)
    print(f"of all {len(everything)} mutants {dead} are known to be killed, and {explained} others have a reason")
    for result in unexplained:
        print(f"{result['file']}, row {result['row']}: {result['mutant']}")
    return 1 if unexplained else 0


def write(options: argparse.Namespace, found: Sequence[Result]) -> None:
    by_file: dict[str, Counter[str]] = {}
    for result in found:
        by_file.setdefault(result["file"], Counter())[result["outcome"]] += 1
    table = {
        "share": options.share,
        "part": options.part,
        "mutants": {name: len(mutants(ROOT, name)) for name in options.files},
        "files": by_file,
        "results": sorted(found, key=lambda result: str(result["mutant"])),
    }
    partial = options.output.with_suffix(".part")
    partial.write_text(json.dumps(table, indent=1) + "\n", "utf-8")
    partial.replace(options.output)


if __name__ == "__main__":
    sys.exit(main())
