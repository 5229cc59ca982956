"""Which tests look at which file, and which of them can notice a mutant."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any

from tests.mutation import simulated
from tests.mutation.copies import Copy
from tests.mutation.mutants import ROOT, Mutant
from tests.mutation.seen import Sight
from tests.mutation.switched import Switches

SIMULATOR = "tests/oclgrind"
RECORDING = 1800.0  # seconds that the tests of a file may take without a change
MOST_CASES = 6  # of the simulator, the quickest that see a mutant
TESTS = {
    "clsco/optics.py": "test_optics test_plan reference/test_geometry",
    "clsco/motion.py": "test_motion test_surfaces test_plan reference/test_geometry",
    "clsco/plan.py": "test_plan test_plan_prediction test_plan_structure test_coarsening test_describe test_memory "
    "pipeline/test_strips pipeline/test_scenes",
    "accumulate.cl": "kernels/test_accumulate pipeline/test_scenes",
    "biharmonic.cl": "kernels/test_biharmonic",
    "blur.cl": "kernels/test_blur_amid kernels/test_blur test_defocus kernels/test_layer kernels/test_occlusion "
    "pipeline/test_occlusion",
    "coarse.cl": "kernels/test_coarse_edges kernels/test_coarse test_coarsening",
    "columns.clh": "kernels/test_blur_quadrants kernels/test_blur test_defocus kernels/test_layer",
    "convolve.cl": "kernels/test_convolve",
    "discs.clh": "kernels/test_blur_tiles kernels/test_blur test_defocus",
    "estimate.clh": "kernels/test_fill kernels/test_holes",
    "fill.cl": "kernels/test_fill kernels/test_forward",
    "gaussians.clh": "kernels/test_blur_columns kernels/test_blur test_defocus",
    "geometry.clh": "kernels/test_geometry kernels/test_bounds kernels/test_ray_surface kernels/test_trace "
    "kernels/test_trace_hidden pipeline/test_views pipeline/test_strips",
    "holes.cl": "kernels/test_holes test_inpainting",
    "layer.cl": "kernels/test_layer_amid kernels/test_layer test_defocus",
    "many.clh": "kernels/test_blur_columns kernels/test_blur test_defocus",
    "mean_median.cl": "kernels/test_fill kernels/test_forward",
    "near.clh": "kernels/test_blur_tiles kernels/test_blur_columns kernels/test_blur test_defocus",
    "quadrants.clh": "kernels/test_blur_quadrants kernels/test_blur test_defocus kernels/test_layer",
    "occlusion.clh": "kernels/test_occlusion_shares kernels/test_occlusion_blockers kernels/test_occlusion "
    "pipeline/test_occlusion",
    "reproject.cl": "kernels/test_reproject_planes kernels/test_reproject kernels/test_forward pipeline/test_scenes",
    "rows.clh": "kernels/test_blur test_defocus",
    "score.cl": "kernels/test_holes kernels/test_fill",
    "sight.clh": "kernels/test_sight kernels/test_occlusion kernels/test_blur pipeline/test_occlusion",
    "sources.clh": "kernels/test_blur kernels/test_trace kernels/test_occlusion pipeline/test_occlusion",
    "spread.clh": "kernels/test_blur kernels/test_tiles test_defocus kernels/test_occlusion",
    "texture.cl": "kernels/test_texture",
    "tiles.cl": "kernels/test_tiles",
    "trace.cl": "kernels/test_silhouettes kernels/test_trace_hidden kernels/test_trace_bounds kernels/test_trace "
    "kernels/test_geometry pipeline/test_views pipeline/test_scenes",
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


class Tests:
    """Which tests can notice a mutant, as they were seen to run without a change."""

    def __init__(self, switches: Switches) -> None:
        self.switches = switches
        self.seconds: dict[str, float] = {}
        self.noticed: dict[str, Counter[str]] = {name: Counter() for name in files()}  # by which tests
        self._seen: dict[str, dict[Mutant, list[str]]] = {}  # test file -> mutant -> tests
        self._tests: dict[str, list[str]] = {}  # test file -> tests
        self._slow: set[str] = set()
        self._sight = Sight(ROOT, [name for name in files() if name.startswith("kernels/")])
        self._lock = threading.Lock()

    def record(self, changed: Iterable[str], made: Sequence[Copy]) -> None:
        """Run the tests of files without a change, in copies side by side; with switches, until all programs are built.

        So the times are those of tests that have nothing to compile.
        """
        kinds = {(test, file.startswith("kernels/")) for file in changed for test in tests_of(file)}
        free: SimpleQueue[Copy] = SimpleQueue()
        for copy in made:
            free.put(copy)

        def recorded(test: str, switched: bool) -> dict[str, Any]:
            copy, begun = free.get(), time.monotonic()
            try:
                return copy.recorded(test, switched, RECORDING)
            finally:
                free.put(copy)
                print(f"without a change {time.monotonic() - begun:6.1f} s  {test}", flush=True)

        with ThreadPoolExecutor(len(made)) as pool:
            times = most = 1 + any(switched for _, switched in kinds)
            while times:
                before = len(self.switches.left_out)
                found = dict(zip(sorted(kinds), pool.map(recorded, *zip(*sorted(kinds), strict=True)), strict=True))
                self.switches.leave_out(number for what in found.values() for number in what["left_out"])
                times = times - 1 if len(self.switches.left_out) == before else most
        for (test, _), what in found.items():
            self._keep(test, what)

    def seeing(self, mutant: Mutant) -> list[str]:
        """Tests in the order in which they are to run: those first that noticed most of the file in their time."""
        found = []
        for file in tests_of(mutant.file):
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

    def _keep(self, file: str, recorded: dict[str, Any]) -> None:
        self.seconds |= {name: what["seconds"] for name, what in recorded["tests"].items()}
        self._slow |= {name for name, what in recorded["tests"].items() if what["slow"]}
        self._seen[file], self._tests[file] = self._sight.seen(recorded), list(recorded["tests"])
