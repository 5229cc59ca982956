"""Tasks of `clsco dev bench` and `clsco dev stability`; each with its steps, files and tables."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from rich.console import RenderableType

import clsco
from clsco.cli.bench.cases import BenchGrid, make_grid
from clsco.cli.options import BenchExtent
from clsco.errors import ClscoError
from clsco.files.plots import require_matplotlib
from clsco.opencl.device import Device

Advance = Callable[[], object]


class BenchTask(Protocol):
    """A run of the command."""

    def notices(self) -> list[str]:
        """Notes on cases that are left out, a line each. Raises ClscoError where an extra is missing."""

    def steps(self, device: Device) -> int:
        """Number of times that `run` calls `advance`."""

    def run(self, device: Device, folder: Path, advance: Advance) -> tuple[list[RenderableType], str]:
        """Measure, and write the files: tables, and what falls short of its bound in one line, or ""."""


@dataclass(frozen=True)
class Speed:
    """Speed against error of the blur, see `clsco.cli.bench.measure`."""

    grid: BenchGrid

    def notices(self) -> list[str]:
        require_matplotlib("bench", "bench")
        return []

    def steps(self, device: Device) -> int:
        from clsco.cli.bench import measure

        return measure.steps(self.grid, device, ())

    def run(self, device: Device, folder: Path, advance: Advance) -> tuple[list[RenderableType], str]:
        from clsco.cli.bench import measure, report

        measured = measure.run(self.grid, device, (), advance)
        report.write(folder, measured)
        return report.tables(measured), ""


@dataclass(frozen=True)
class StabilityTask:
    """Errors of hard cases of numerics, see `clsco.cli.bench.stabilityreport`."""

    quick: bool

    def notices(self) -> list[str]:
        require_matplotlib("bench", "bench")
        if find_spec("mpmath") is None:
            raise ClscoError("stability: needs mpmath: pip install 'clsco[bench]'; got no such module")
        return []

    def steps(self, device: Device) -> int:
        from clsco.cli.bench import stabilityreport

        del device
        return stabilityreport.steps(self.quick)

    def run(self, device: Device, folder: Path, advance: Advance) -> tuple[list[RenderableType], str]:
        from clsco.cli.bench import stabilityreport

        found = stabilityreport.run(device, self.quick, advance)
        stabilityreport.write(folder, found)
        short = found.shortfalls()
        line = f"stability: every error must be within its bound; got {len(short)} beyond: {short[0]}" if short else ""
        return stabilityreport.tables(found), line


def speed_task(extent: BenchExtent) -> BenchTask:
    """Make the task that the options of `clsco dev bench` ask for. Raises ClscoError for what cannot be measured, or
    where a peer is missing."""
    grid = make_grid(extent.quick, extent.sizes, extent.radii, extent.minutes)
    if not extent.compare:
        return Speed(grid)
    task: BenchTask = _comparison().comparison(grid, extent.quick, not (extent.sizes or extent.radii))
    return task


def _comparison() -> Any:
    """The module of the developers' benchmarks, which are no part of the package. Raises ClscoError without them."""
    root = Path(clsco.__file__).resolve().parents[1]
    if not (root / "benchmarks" / "speed" / "compare.py").is_file():
        raise ClscoError("--compare: needs a checkout of clsco, with its folder benchmarks; got an installed package")
    if str(root) not in sys.path:
        sys.path.append(str(root))
    try:
        return import_module("benchmarks.speed.compare")
    except ModuleNotFoundError as error:
        raise ClscoError(f"--compare: needs {error.name}: pip install 'clsco[bench]'; got no such module") from None
