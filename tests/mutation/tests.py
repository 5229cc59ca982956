"""Tests by the files that they look at, and by the mutants that they can kill."""

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
from tests.mutation.reach import Reach
from tests.mutation.switched import Switches

SIMULATOR = "tests/oclgrind"
RECORDING = 1800.0  # seconds that the tests of a file may take without a change
MOST_CASES = 6  # of the simulator, the quickest that see a mutant
TESTS = {
    "clsco/optics/lens.py": "optics/test_lens plan/test_plan reference/test_geometry",
    "clsco/optics/rims.py": "kernels/test_rims",
    "clsco/optics/line_truth.py": "pipeline/test_line_truth",
    "clsco/optics/exposure.py": "optics/test_exposure plan/test_plan plan/test_predict plan/test_approximation",
    "clsco/optics/motion.py": "optics/test_motion optics/test_shake optics/test_quadrics plan/test_plan "
    "reference/test_geometry",
    "clsco/optics/keyframes.py": "optics/test_keyframes",
    "clsco/optics/lens_path.py": "optics/test_lens_path pipeline/test_lens_path pipeline/test_zoom",
    "clsco/plan/plan.py": "plan/test_plan plan/test_predict plan/test_structure plan/test_memory "
    "engine/test_allocation pipeline/test_strips pipeline/test_scenes",
    "clsco/plan/image_motion.py": "plan/test_image_motion",
    "clsco/plan/predict.py": "plan/test_predict plan/test_plan pipeline/test_scenes",
    "blur/accumulate.cl": "kernels/test_accumulate pipeline/test_scenes",
    "blur/vignetting.cl": "pipeline/test_real_lens",
    "blur/blur.cl": "kernels/test_blur_amid kernels/test_blur engine/test_defocus kernels/test_layered "
    "kernels/test_visibility pipeline/test_occlusion",
    "blur/convolve.cl": "kernels/test_convolve",
    "blur/tiles.cl": "kernels/test_tiles",
    "blur/cpu/spans.clh": "pipeline/test_occlusion kernels/test_visibility kernels/test_rims",
    "common/cpu/blocks.clh": "kernels/test_visibility_test kernels/test_visibility pipeline/test_occlusion "
    "kernels/test_rims",
    "blur/cpu/columns.clh": "kernels/test_blur_quadrants kernels/test_blur engine/test_defocus kernels/test_layered",
    "blur/cpu/discs.clh": "kernels/test_blur_tiles kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "blur/cpu/gather.cl": "kernels/test_blur_amid kernels/test_blur engine/test_defocus pipeline/test_occlusion",
    "blur/cpu/gaussians.clh": "kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "blur/cpu/many.clh": "kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "blur/cpu/quadrants.clh": "kernels/test_blur_quadrants kernels/test_blur engine/test_defocus kernels/test_layered",
    "blur/cpu/ellipses.clh": "pipeline/test_distortion kernels/test_rims",
    "common/chords.clh": "kernels/test_rims pipeline/test_distortion",
    "blur/cpu/shapes.clh": "kernels/test_blur_shapes kernels/test_pupils",
    "blur/cpu/vectors.clh": "kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "common/builtins.clh": "kernels/test_tiles",
    "common/cpu/builtins.clh": "kernels/test_blur kernels/test_trace",
    "common/cpu/pocl.clh": "kernels/test_tiles",
    "common/cpu/lanes.clh": "kernels/test_convolve kernels/test_layered",
    "common/distortion.clh": "kernels/test_geometry pipeline/test_distortion",
    "common/geometry.clh": "kernels/test_geometry kernels/test_bounds kernels/test_ray_surface "
    "kernels/test_trace kernels/test_trace_hidden pipeline/test_views pipeline/test_strips",
    "common/lanes.clh": "kernels/test_tiles",
    "common/occluder.clh": "kernels/test_visibility_occluders kernels/test_visibility pipeline/test_occlusion",
    "common/rims.clh": "kernels/test_rims",
    "common/source_visibility.clh": "kernels/test_visibility pipeline/test_occlusion pipeline/test_occlusion_lenses",
    "common/psf.clh": "kernels/test_blur kernels/test_pupils kernels/test_tiles engine/test_defocus",
    "common/sources.clh": "kernels/test_blur kernels/test_trace kernels/test_visibility pipeline/test_occlusion",
    "common/visibility.clh": "kernels/test_visibility_occluders kernels/test_visibility kernels/test_blur "
    "pipeline/test_occlusion kernels/test_rims",
    "common/visibility_test.clh": "kernels/test_visibility_test kernels/test_visibility pipeline/test_occlusion "
    "kernels/test_rims",
    "common/angles.clh": "kernels/test_angles",
    "inpainting/biharmonic.cl": "kernels/test_biharmonic",
    "inpainting/cpu/lanes.clh": "kernels/test_fill kernels/test_mean_median",
    "inpainting/estimate.clh": "kernels/test_fill kernels/test_mean_median",
    "inpainting/fill.cl": "kernels/test_fill kernels/test_warp",
    "inpainting/fill_mean_median.cl": "kernels/test_fill kernels/test_warp",
    "inpainting/fse.cl": "kernels/test_fse",
    "inpainting/lanes.clh": "kernels/test_fill",
    "inpainting/mean_median.cl": "kernels/test_mean_median inpainting/test_inpaint",
    "inpainting/score.cl": "kernels/test_mean_median kernels/test_fill",
    "layered/layered.cl": "kernels/test_layered engine/test_defocus",
    "sensor/noise.clh": "kernels/test_sensor",
    "sensor/sensor.cl": "kernels/test_sensor pipeline/test_sensor",
    "trace/light.clh": "pipeline/test_light",
    "trace/mapping.clh": "pipeline/test_surface_textures",
    "trace/footprint.clh": "pipeline/test_surface_textures",
    "trace/detail.clh": "pipeline/test_surface_textures",
    "trace/outline.clh": "kernels/test_trace kernels/test_trace_hidden pipeline/test_outlines",
    "trace/small.cl": "pipeline/test_small_objects",
    "trace/small.clh": "pipeline/test_small_objects",
    "trace/still.clh": "pipeline/test_still_sources kernels/test_trace",
    "trace/texture.clh": "kernels/test_trace kernels/test_trace_hidden",
    "trace/bend.cl": "pipeline/test_distortion pipeline/test_real_lens",
    "trace/merge.cl": "plan/test_approximation",
    "trace/truth.cl": "kernels/test_trace kernels/test_trace_bounds kernels/test_trace_hidden",
    "trace/trace.cl": "kernels/test_silhouettes kernels/test_trace_hidden kernels/test_trace_bounds "
    "kernels/test_trace kernels/test_geometry pipeline/test_views pipeline/test_scenes",
    "warp/warp.cl": "kernels/test_warp_kernels kernels/test_warp pipeline/test_scenes",
}
"""File -> tests that reach it, the quickest first; kernels by their folder there."""


def files() -> list[str]:
    """Files that are changed: all kernels, and the host's arithmetic."""
    folder = ROOT / "kernels"
    kernels = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.cl*"))
    assert set(kernels) == {name for name in TESTS if not name.startswith("clsco/")}, "a kernel file without tests"
    return [*(f"kernels/{name}" for name in kernels), *(name for name in TESTS if name.startswith("clsco/"))]


def tests_of(file: str) -> list[str]:
    return [f"tests/{name}.py" for name in TESTS[file.removeprefix("kernels/")].split()]


class Tests:
    """Tests that can kill a mutant, as they were seen to run without a change."""

    def __init__(self, switches: Switches) -> None:
        self.switches = switches
        self.seconds: dict[str, float] = {}
        self.killers: dict[str, Counter[str]] = {name: Counter() for name in files()}  # by which tests
        self._reaching: dict[str, dict[Mutant, list[str]]] = {}  # test file -> mutant -> tests
        self._tests: dict[str, list[str]] = {}  # test file -> tests
        self._slow: set[str] = set()
        self._reach = Reach(ROOT, [name for name in files() if name.startswith("kernels/")])
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
        """Tests in the order in which they are to run: those first that killed most of the file in their time."""
        found = []
        for file in tests_of(mutant.file):
            found += self._reaching[file].get(mutant, []) if mutant.file.startswith("kernels/") else self._tests[file]
        return self._often_first(mutant, sorted(found, key=self._slow.__contains__))

    def cases(self, mutant: Mutant) -> list[str]:
        """Some cases of the simulator that see a mutant, in the order in which they are to run."""
        with self._lock:
            if SIMULATOR not in self._reaching:
                self._keep(SIMULATOR, simulated.recorded())
        found = sorted(self._reaching[SIMULATOR].get(mutant, []), key=self.seconds.__getitem__)
        return self._often_first(mutant, found)[:MOST_CASES]

    def _often_first(self, mutant: Mutant, found: list[str]) -> list[str]:
        often = {test: count / (0.5 + self.seconds[test]) for test, count in self.killers[mutant.file].items()}
        return sorted(found, key=lambda test: -often.get(test, 0.0))

    def _keep(self, file: str, recorded: dict[str, Any]) -> None:
        self.seconds |= {name: what["seconds"] for name, what in recorded["tests"].items()}
        self._slow |= {name for name, what in recorded["tests"].items() if what["slow"]}
        self._reaching[file], self._tests[file] = self._reach.tests(recorded), list(recorded["tests"])
