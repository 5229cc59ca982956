"""A process on Oclgrind: runs some of the cases, tells of each what was launched and what was reported.

    python -m tests.oclgrind.worker FIRST STEP [NAME ...]

Prints a line of JSON for each case. Names: those of the cases, by default all.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

from clsco import program
from clsco.device import Device
from tests.oclgrind import simulator
from tests.oclgrind.cases import Case, all_cases, depth_of, textures_of

LAUNCHING = ("spread", "convolution", "coarse", "forward", "layers", "renderer")
CHOOSING = ("render", "arrays")


def reported(log: Path, before: int) -> str:
    """What has come into a log since it had so many characters."""
    return log.read_text("utf-8", "replace")[before:] if log.exists() else ""


def run(case: Case, log: Path) -> dict[str, Any]:
    """A case by itself; launched: names of kernels."""
    before, begun = len(reported(log, 0)), time.process_time()
    launched: set[str] = set()
    enqueue = program.cl.Kernel.__call__

    def noted(kernel: Any, *args: Any, **options: Any) -> Any:
        launched.add(kernel.function_name)
        return enqueue(kernel, *args, **options)

    with ExitStack() as stack:
        device: Device = stack.enter_context(simulator.device(**case.device))
        stack.enter_context(patch.object(program.cl.Kernel, "__call__", noted))
        for name in CHOOSING:
            stack.enter_context(patch.object(importlib.import_module(f"clsco.{name}"), "choose", lambda _: device))
        if case.name.startswith("scene"):
            drawn = ast.literal_eval(case.about.replace("range", ""))
            rendering = importlib.import_module("clsco.render")
            stack.enter_context(
                patch.object(rendering, "load_scene_textures", lambda scene: textures_of(scene, drawn["channels"]))
            )
            stack.enter_context(
                patch.object(
                    rendering,
                    "load_scene_depths",
                    lambda scene: tuple(depth_of(drawn) if i.shape == "depth_map" else None for i in scene.objects),
                )
            )
        case.run()
    return {
        "case": case.name,
        "about": case.about,
        "launched": sorted(launched),
        "seconds": round(time.process_time() - begun, 2),
        "report": reported(log, before),
    }


def main(first: int, step: int, names: list[str]) -> None:
    simulator.without_intrinsics()
    log = Path(os.environ["OCLGRIND_LOG"])
    chosen = [case for case in all_cases()[0] if not names or case.name in names]
    for case in chosen[first::step]:
        try:
            result = run(case, log)
        except Exception as error:
            result = {"case": case.name, "about": case.about, "launched": [], "seconds": 0.0, "report": f"{type(error).__name__}: {error}"[:3000]}
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
