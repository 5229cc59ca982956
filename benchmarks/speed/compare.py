"""Peers of `python -m benchmarks blur --compare`: the blur beside numba and OpenCV, whole frames beside a traced lens
and Mitsuba, and the forward warp beside numba."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from rich.console import RenderableType

from benchmarks.blur import measure, report
from benchmarks.blur.cases import BenchGrid, Peer
from benchmarks.blur.measure import Bench
from benchmarks.speed import lens, peers, warp
from benchmarks.speed.lens import Lens, LensRow
from benchmarks.speed.lensreport import lens_plot, lens_table
from benchmarks.speed.warp import WarpRow, warp_table
from clsco.errors import require_extra
from clsco.opencl.device import Device

Advance = Callable[[], object]


@dataclass(frozen=True)
class Frames:
    """Sizes of what is made beside the grid.

    Attributes
    ----------
    lens_size : int
        Side of the frames that are compared with a traced one, px.
    samples : tuple of int
        Rays per pixel of Mitsuba: errors of 0.04 to 0.0005.
    warp_size : int
        Side of the frames that are warped, px.
    """

    lens_size: int = 512
    samples: tuple[int, ...] = (1, 4, 16, 64, 256, 1024, 2500)
    warp_size: int = 2048


QUICK = Frames(samples=(4, 16, 64, 256))


@dataclass(frozen=True)
class Compared(Bench):
    """A run beside the peers; lens, warp: whole frames and forward warps, where they were made."""

    lens: Lens | None
    warp: list[WarpRow]


@dataclass(frozen=True)
class Comparison:
    """A run of `python -m benchmarks blur --compare`; frames: None where only some sizes or radii are measured."""

    grid: BenchGrid
    frames: Frames | None
    tools: Sequence[str]
    missing: dict[str, str]

    def notices(self) -> list[str]:
        """Notes on peers that are left out, a line each. Raises ClscoError where plots could not be made."""
        require_extra("bench", "matplotlib", "bench")
        lines = [f"{tool}: left out, as {why}" for tool, why in self.missing.items()]
        if self.frames and (absent := lens.missing()):
            lines.append(f"traced frames: left out, as they need {absent}: pip install 'clsco[bench]'")
        return lines

    @property
    def _peers(self) -> list[Peer]:
        return [peer for peer in peers.PEERS if peer.tool in self.tools]

    @property
    def _traced(self) -> Frames | None:
        return self.frames if lens.missing() is None else None

    def _warped(self, device: Device) -> Frames | None:
        """By CPU time, on processors only."""
        return self.frames if "numba" in self.tools and device.kind == "cpu" else None

    @property
    def _samples(self) -> tuple[int, ...]:
        return self.frames.samples if self.frames and "Mitsuba" in self.tools else ()

    def steps(self, device: Device) -> int:
        """Number of times that `run` calls `advance`."""
        count = measure.steps(self.grid, device, self._peers)
        count += lens.steps(self._samples) if self._traced else 0
        return count + (warp.steps() if self._warped(device) else 0)

    def run(self, device: Device, folder: Path, advance: Advance) -> tuple[list[RenderableType], str]:
        """Measure, and write the files: tables, and what falls short, which speed does not."""
        bench = self.measured(device, advance)
        write(folder, bench)
        return tables(bench), ""

    def measured(self, device: Device, advance: Advance) -> Compared:
        """Measure all. Raises DeviceError, KernelError."""
        base = measure.run(self.grid, device, self._peers, advance)
        versions = measure.versions([name for tool in self.tools for name in peers.PACKAGES[tool]])
        settings = base.settings | {"compare": list(self.tools)} | (asdict(self.frames) if self.frames else {})
        frames, warps = None, []
        if traced := self._traced:
            frames = lens.run(device, traced.lens_size, self._samples, advance, lens.cache_folder())
        if warped := self._warped(device):
            warps = warp.run(device, warped.warp_size, advance)
        return Compared(**vars(replace(base, versions=versions, settings=settings)), lens=frames, warp=warps)


def comparison(grid: BenchGrid, quick: bool, whole: bool) -> Comparison:
    """Make the comparison that the command's options ask for.

    Parameters
    ----------
    grid : BenchGrid
        Grid of the blur.
    quick : bool
        Mitsuba gets fewer rays.
    whole : bool
        Whole frames and warps are made, too.

    Raises
    ------
    ClscoError
        No peer is installed.
    """
    tools, missing = peers.require_peers()
    frames = QUICK if quick else Frames()
    return Comparison(grid, frames if whole else None, tools, missing)


def write(folder: Path, bench: Compared) -> None:
    """Write bench.json, bench.csv, plots, and of frames and warps lens.csv, lens.png, warp.csv: all or none."""

    def also(made: Path) -> None:
        content = report.rounded(asdict(bench))
        if bench.lens is not None:
            report.write_csv(made / "lens.csv", [field.name for field in fields(LensRow)], content["lens"]["rows"])
            lens_plot(bench.lens).savefig(made / "lens.png", dpi=100)
        if bench.warp:
            report.write_csv(made / "warp.csv", [field.name for field in fields(WarpRow)], content["warp"])

    report.write(folder, bench, also)


def tables(bench: Compared) -> list[RenderableType]:
    """Tables of the blur, of whole frames, and of warps."""
    frames = [lens_table(bench.lens)] if bench.lens else []
    return [*report.tables(bench), *frames, *([warp_table(bench.warp)] if bench.warp else [])]
