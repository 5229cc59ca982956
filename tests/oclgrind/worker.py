"""A process on Oclgrind: runs cases, or faults, and prints of each a line of JSON: what was launched and reported.

python -m tests.oclgrind.worker cases FIRST STEP
python -m tests.oclgrind.worker faults CHECK
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.resources import as_file
from itertools import islice
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pyopencl as cl

from clsco.inputs.files import InputFiles
from clsco.opencl import program, source_text
from clsco.plan import prepare
from clsco.resources import folder
from tests.oclgrind import simulator
from tests.oclgrind.cases import Case, all_cases, depths_of, fault_cases, textures_of
from tests.oclgrind.faults import FAULTS, Fault


def run(case: Case, log: Path) -> dict[str, Any]:
    """A case by itself: kernels launched, processor time in s, and what has come into the log."""
    before, begun = len(_read(log)), time.process_time()
    launched: set[str] = set()
    launch = cl.Kernel.__call__

    def noted(kernel: Any, *args: Any, **options: Any) -> Any:
        launched.add(kernel.function_name)
        return launch(kernel, *args, **options)

    report = ""
    with ExitStack() as stack:
        stack.enter_context(simulator.sessions(**case.device))
        stack.enter_context(patch.object(cl.Kernel, "__call__", noted))
        stack.enter_context(patch.object(prepare, "_channels", lambda *_: case.channels))
        stack.enter_context(patch.object(prepare, "_maps", lambda scene, _: depths_of(scene)))
        stack.enter_context(patch.object(InputFiles, "textures", lambda _, scene: textures_of(scene, case.channels)[1]))
        stack.enter_context(patch.object(InputFiles, "maps", lambda _, scene: depths_of(scene)))
        try:
            case.run()
        except Exception as error:
            report = f"{type(error).__name__}: {error}\n"
    seconds = round(time.process_time() - begun, 2)
    now = _read(log)
    report += now[before:] if len(now) >= before else now
    about = {"name": case.name, "about": case.about, "launched": sorted(launched - {"put"})}
    return about | {"seconds": seconds, "report": report}


@contextmanager
def with_kernel(file: str, text: str) -> Iterator[None]:
    """Has programs built of a copy of the kernels in which a file has this text."""
    with tempfile.TemporaryDirectory(prefix="clsco-fault-") as place:
        with as_file(folder("kernels")) as kernels:
            shutil.copytree(kernels, place, dirs_exist_ok=True)
        (Path(place) / file).write_text(text, "utf-8")
        with ExitStack() as stack:
            for module in (program, source_text):  # the key of a program, and its text
                stack.enter_context(patch.object(module, "folder", lambda _: Path(place)))
            yield


def run_fault(fault: Fault, log: Path) -> dict[str, Any]:
    """The case of a fault, with a copy of the kernels that has it."""
    case = next(one for one in fault_cases() if one.name == fault.case)
    text = (folder("kernels") / fault.file).read_text("utf-8")
    if fault.old not in text:
        raise ValueError(f"fault {fault.name}: {fault.file} must hold its text; got none of\n{fault.old}")
    with with_kernel(fault.file, text.replace(fault.old, fault.new, 1)):
        return run(case, log) | {"name": fault.name}


def _read(log: Path) -> str:
    return log.read_text("utf-8", "replace") if log.exists() else ""


def main(what: str, *given: str) -> None:
    simulator.without_intrinsics()
    log = Path(os.environ["OCLGRIND_LOG"])
    results: Iterator[dict[str, Any]]
    if what == "faults":
        results = (run_fault(fault, log) for fault in FAULTS if fault.check == given[0])
    else:
        results = (run(case, log) for case in islice(all_cases(), int(given[0]), None, int(given[1])))
    for result in results:
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
