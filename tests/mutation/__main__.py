"""Mutation test of the kernels: each mutant, a small fault, is run against the tests of its file, which must kill it.

    python -m tests.mutation --share 100 -o mutation.json

Works in copies of the tree, which are removed at the end. Fails where a mutant survives that survivors.toml has no
reason for. A mutant takes seconds to minutes, most of them of compilation, so a share of all is drawn at random. The
formulas of the host are for mutmut (`make mutation-host`).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from clsco.resources import processors
from tests.mutation.mutants import ROOT, Mutant, mutants

REASONS = Path(__file__).with_name("survivors.toml")
COPIED = ("clsco", "kernels", "tests", "examples", "benchmarks", "docs", "pyproject.toml", "README.md", "Makefile")
NOT_BUILT = ("must build on", "SyntaxError")  # what says that a mutant is no program
# Kernels of a few pixels take longer to optimize than to run; the device `basic` has no threads beside those of jobs.
ENVIRONMENT = {"PYOPENCL_BUILD_OPTIONS": "-cl-opt-disable", "POCL_DEVICES": "basic"}
OPTIONS = ["-x", "-q", "--tb=line", "-rf", "-n", "0", "-p", "no:cacheprovider"]
MARKS = {"quick": "not slow", "slow": "slow"}
TESTS = {
    "blur/accumulate.cl": "kernels/test_accumulate pipeline/test_scenes",
    "blur/vignetting.cl": "pipeline/test_real_lens",
    "blur/blur.cl": "kernels/test_blur_amid kernels/test_blur engine/test_defocus kernels/test_layered "
    "kernels/test_visibility pipeline/test_occlusion",
    "blur/prepare.cl": "kernels/test_blur_amid kernels/test_blur kernels/test_layered",
    "blur/pixel_sources.clh": "kernels/test_blur_amid kernels/test_blur kernels/test_visibility",
    "blur/convolve.cl": "kernels/test_convolve",
    "blur/tiles.cl": "kernels/test_tiles",
    "blur/cpu/spans.clh": "pipeline/test_occlusion kernels/test_visibility kernels/test_rims",
    "common/cpu/blocks.clh": "kernels/test_visibility_occluders kernels/test_visibility pipeline/test_occlusion "
    "kernels/test_rims",
    "blur/cpu/columns.clh": "kernels/test_blur_columns kernels/test_blur engine/test_defocus kernels/test_layered",
    "blur/cpu/gather.cl": "kernels/test_blur_amid kernels/test_blur engine/test_defocus pipeline/test_occlusion",
    "blur/cpu/gaussians.clh": "kernels/test_blur_amid kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "blur/cpu/many.clh": "kernels/test_blur_amid kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "blur/cpu/ellipses.clh": "pipeline/test_distortion kernels/test_rims",
    "common/chords.clh": "kernels/test_rims pipeline/test_distortion",
    "blur/cpu/taps.clh": "kernels/test_blur_columns kernels/test_blur kernels/test_pupils engine/test_defocus "
    "kernels/test_layered",
    "blur/cpu/vectors.clh": "kernels/test_blur_amid kernels/test_blur_columns kernels/test_blur engine/test_defocus",
    "common/builtins.clh": "kernels/test_tiles",
    "common/cpu/builtins.clh": "kernels/test_blur kernels/test_trace",
    "common/cpu/pocl.clh": "kernels/test_tiles",
    "common/cpu/tap_vectors.clh": "kernels/test_convolve kernels/test_layered",
    "common/distortion.clh": "kernels/test_geometry pipeline/test_distortion",
    "common/geometry.clh": "kernels/test_geometry kernels/test_ray_surface kernels/test_trace "
    "kernels/test_trace_kernels pipeline/test_views pipeline/test_strips",
    "common/lanes.clh": "kernels/test_tiles",
    "common/occluder.clh": "kernels/test_visibility_occluders kernels/test_visibility pipeline/test_occlusion",
    "common/rims.clh": "kernels/test_rims",
    "common/source_visibility.clh": "kernels/test_visibility pipeline/test_occlusion pipeline/test_occlusion_lenses",
    "common/psf.clh": "kernels/test_blur kernels/test_pupils kernels/test_tiles engine/test_defocus",
    "common/sources.clh": "kernels/test_blur kernels/test_trace kernels/test_visibility pipeline/test_occlusion",
    "common/tilt.clh": "kernels/test_geometry kernels/test_trace kernels/test_blur",
    "common/equation.clh": "kernels/test_visibility_occluders kernels/test_visibility pipeline/test_occlusion",
    "common/visibility.clh": "kernels/test_visibility_occluders kernels/test_visibility kernels/test_blur "
    "pipeline/test_occlusion kernels/test_rims",
    "common/visibility_test.clh": "kernels/test_visibility_occluders kernels/test_visibility pipeline/test_occlusion "
    "kernels/test_rims",
    "common/angles.clh": "kernels/test_geometry",
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
    "layered/sheets.cl": "kernels/test_layered engine/test_defocus",
    "layered/tiles.clh": "kernels/test_layered engine/test_defocus",
    "sensor/noise.clh": "kernels/test_sensor",
    "sensor/sensor.cl": "kernels/test_sensor pipeline/test_sensor",
    "trace/light.clh": "pipeline/test_light",
    "trace/mapping.clh": "pipeline/test_surface_textures",
    "trace/footprint.clh": "pipeline/test_surface_textures",
    "trace/detail.clh": "pipeline/test_surface_textures",
    "trace/outline.clh": "kernels/test_trace kernels/test_trace_kernels pipeline/test_outlines",
    "trace/small.clh": "pipeline/test_small_objects",
    "trace/texture.clh": "kernels/test_trace kernels/test_trace_kernels",
    "trace/bend.cl": "pipeline/test_distortion pipeline/test_real_lens",
    "trace/truth.cl": "kernels/test_trace kernels/test_trace_kernels",
    "trace/cast.cl": "kernels/test_trace_kernels kernels/test_trace pipeline/test_scenes",
    "trace/changes.clh": "pipeline/test_still_sources",
    "trace/aim.cl": "kernels/test_trace_kernels kernels/test_trace kernels/test_geometry pipeline/test_views",
    "trace/record.clh": "kernels/test_trace_kernels kernels/test_trace kernels/test_geometry pipeline/test_views",
    "trace/silhouettes.cl": "kernels/test_trace_kernels kernels/test_trace",
    "trace/subpixels.cl": "kernels/test_trace_kernels kernels/test_trace pipeline/test_surface_textures",
    "warp/warp.cl": "kernels/test_warp pipeline/test_scenes",
}
"""Kernel file -> tests that reach it, the quickest first."""
Result = dict[str, Any]


def kernel_files() -> list[str]:
    """All kernel files, each of which must have tests."""
    names = sorted(path.relative_to(ROOT / "kernels").as_posix() for path in (ROOT / "kernels").rglob("*.cl*"))
    assert set(names) == TESTS.keys(), "a kernel file without tests"
    return [f"kernels/{name}" for name in names]


def kernel_mutants(files: Iterable[str]) -> list[Mutant]:
    return [mutant for file in files for mutant in mutants((ROOT / file).read_text("utf-8"), file)]


def reasons() -> dict[str, dict[str, str]]:
    """Function -> mutant of it -> why it is no gap of the tests that it survives."""
    known: dict[str, dict[str, str]] = {}
    for owner, entries in tomllib.loads(REASONS.read_text("utf-8")).items():
        for key, why in entries.items():
            line, _, changes = key.rpartition(" # ")
            known.setdefault(owner, {}).update({f"{line} # {change}": why for change in changes.split(", ")})
    return known


def reason(mutant: Mutant, known: dict[str, dict[str, str]]) -> str | None:
    return known.get(mutant.owner.name, {}).get(mutant.change)


def unmatched(every: Iterable[Mutant], known: dict[str, dict[str, str]]) -> list[str]:
    """Reasons of which there is no mutant any more, by their names."""
    names = {mutant.name for mutant in every}
    explained = [f"{owner}: {change}" for owner, changes in known.items() for change in changes]
    return [name for name in explained if name not in names]


def copy_tree(target: Path) -> Path:
    """A copy of what tests read."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target / name, ignore=shutil.ignore_patterns("__pycache__", "results"))
        else:
            shutil.copy2(ROOT / name, target / name)
    return target


def try_mutant(tree: Path, mutant: Mutant, marks: str, timeout: float) -> Result:
    """Result of a mutant: `outcome` is killed, survived, timeout or not built; `by`: the test that killed it."""
    path, cache = tree / mutant.file, tree / "cache"
    text = path.read_text("utf-8")
    path.write_text(mutant.apply(text), "utf-8")
    tests = [f"tests/{name}.py" for name in TESTS[mutant.file.removeprefix("kernels/")].split()]
    environment = os.environ | ENVIRONMENT | {"POCL_CACHE_DIR": str(cache), "PYTHONPATH": str(tree)}
    try:
        command = [sys.executable, "-m", "pytest", *OPTIONS, "-m", marks, *tests]
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=timeout)
        outcome = {0: "survived", 5: "survived"}.get(done.returncode, "killed")  # 5: there are no such tests
        output = done.stdout + done.stderr
    except subprocess.TimeoutExpired:
        outcome, output = "timeout", ""
    finally:
        path.write_text(text, "utf-8")
        shutil.rmtree(cache, ignore_errors=True)  # no other mutant has these programs
    if outcome == "killed" and any(words in output for words in NOT_BUILT):
        outcome = "not built"
    failed = re.search(r"^FAILED (tests/.+?::.+?)(?: - .*)?$", output, re.MULTILINE)
    return {
        "mutant": mutant.name, "file": mutant.file, "row": mutant.row, "outcome": outcome,
        "by": failed[1] if failed else "", "reason": reason(mutant, reasons()) if outcome == "survived" else None,
    }  # fmt: skip


def try_all(chosen: Iterable[Mutant], jobs: int, marks: str, timeout: float) -> list[Result]:
    """Results of mutants, in as many copies of the tree at a time as there are jobs."""
    results: list[Result] = []
    with tempfile.TemporaryDirectory(prefix="clsco-mutation-", ignore_cleanup_errors=True) as folder:
        trees: SimpleQueue[Path] = SimpleQueue()
        for number in range(jobs):
            (place := Path(folder, str(number))).mkdir()
            trees.put(copy_tree(place))

        def try_in_a_copy(mutant: Mutant) -> Result:
            tree = trees.get()
            try:
                return try_mutant(tree, mutant, marks, timeout)
            finally:
                trees.put(tree)

        with ThreadPoolExecutor(jobs) as pool:
            for future in as_completed([pool.submit(try_in_a_copy, mutant) for mutant in chosen]):
                results.append(future.result())
                print(f"{results[-1]['outcome']:9}  {results[-1]['mutant']}", flush=True)
    return results


def main() -> int:
    """Try mutants; 1 where some survive without a reason."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", nargs="+", default=kernel_files(), metavar="FILE", help="by default all kernels")
    parser.add_argument("--share", type=int, default=1, metavar="N", help="one of N mutants")
    parser.add_argument("--part", type=int, default=0, metavar="K", help="which ones: 0 to N - 1")
    parser.add_argument("--jobs", type=int, default=processors())
    parser.add_argument("--timeout", type=float, default=600.0, metavar="SECONDS", help="of a mutant")
    parser.add_argument("--against", nargs="+", choices=MARKS, default=["quick"], help="which tests, by default quick")
    parser.add_argument("-o", "--output", type=Path, default=Path("mutation.json"))
    options = parser.parse_args()
    every = kernel_mutants(options.files)
    random.Random(1).shuffle(every)
    marks = " or ".join(MARKS[name] for name in options.against)
    marks = f"({marks}) and not soak and not laws and not oclgrind"
    results = try_all(every[options.part :: options.share], options.jobs, marks, options.timeout)
    results.sort(key=lambda result: str(result["mutant"]))
    options.output.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
    unexplained = [result for result in results if result["outcome"] == "survived" and result["reason"] is None]
    print(dict(Counter(result["outcome"] for result in results)), f"{len(unexplained)} survive without a reason")
    for result in unexplained:
        print(f"{result['file']}, row {result['row']}: {result['mutant']}")
    return 1 if unexplained else 0


if __name__ == "__main__":
    sys.exit(main())
