"""What `clsco bench` does: speed against error, or stability; each with its steps, files and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from rich.console import RenderableType

from clsco.cli.bench.cases import Grid, make_grid
from clsco.cli.bench.peers import require_peers
from clsco.errors import ClscoError
from clsco.opencl.device import Device

Advance = Callable[[], object]


@dataclass(frozen=True)
class Speed:
    """Speed against error of the blur, see `bench.measure`; tools: peers; missing: why others are not there."""

    grid: Grid
    tools: Sequence[str]
    missing: Mapping[str, str]

    def notices(self) -> list[str]:
        """What is left out, a line each. Raises ClscoError where plots could not be made."""
        from clsco.cli.bench import lens, report

        report.require_matplotlib()
        lines = [f"{tool}: left out, as {why}" for tool, why in self.missing.items()]
        if self.grid.lens_size and (absent := lens.missing()):
            lines.append(f"traced frames: left out, as they need {absent}: pip install 'clsco[bench]'")
        return lines

    def steps(self, device: Device) -> int:
        """How often `run` calls `advance`."""
        from clsco.cli.bench import measure

        return measure.steps(self.grid, device, self.tools)

    def run(self, device: Device, folder: Path, advance: Advance) -> tuple[list[RenderableType], str]:
        """Measure, and write the files: tables, and what falls short, which speed does not."""
        from clsco.cli.bench import measure, report

        measured = measure.run(self.grid, device, self.tools, advance)
        report.write(folder, measured)
        return report.tables(measured), ""


@dataclass(frozen=True)
class Stability:
    """Errors of hard cases of numerics, see `clsco.cli.bench.stabilityreport`."""

    quick: bool

    def notices(self) -> list[str]:
        """As of Speed; nothing is left out. Raises ClscoError where the oracle or plots are missing."""
        from clsco.cli.bench import report

        report.require_matplotlib()
        if find_spec("mpmath") is None:
            raise ClscoError("--stability: needs mpmath: pip install 'clsco[bench]'; got no such module")
        return []

    def steps(self, device: Device) -> int:
        """How often `run` calls `advance`."""
        from clsco.cli.bench import stabilityreport

        del device
        return stabilityreport.steps(self.quick)

    def run(self, device: Device, folder: Path, advance: Advance) -> tuple[list[RenderableType], str]:
        """Measure, and write the files: tables, and what falls short of its bound in one line."""
        from clsco.cli.bench import stabilityreport

        found = stabilityreport.run(device, self.quick, advance)
        stabilityreport.write(folder, found)
        short = found.shortfalls()
        line = f"stability: every error must be within its bound; got {len(short)} beyond: {short[0]}" if short else ""
        return stabilityreport.tables(found), line


def make_task(
    stability: bool, quick: bool, compare: bool, sizes: Sequence[int], radii: Sequence[float], minutes: float | None
) -> Speed | Stability:
    """What the command's options ask for. Raises ClscoError where they do not go together, or a peer is missing."""
    if stability:
        if compare or sizes or radii or minutes is not None:
            rule = "must stand without --compare, --size, --radius and --minutes"
            raise ClscoError(f"--stability: {rule}; got one of them")
        return Stability(quick)
    grid = make_grid(quick, sizes, radii, minutes)
    tools, missing = require_peers() if compare else ([], {})
    return Speed(grid, tools, missing)
