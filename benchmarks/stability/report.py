"""Report of `python -m benchmarks stability`: tables, JSON, CSV, and one plot of error against conditioning."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from benchmarks.blur.measure import described, versions
from benchmarks.blur.report import rounded, write_csv
from benchmarks.stability import degenerate, hardgeometry, hardimages, survey
from benchmarks.stability.degenerate import Outcome
from benchmarks.stability.hardcase import FORMS, HardCase
from benchmarks.stability.rays import FAMILIES
from clsco.files.atomic import atomic_folder
from clsco.opencl.device import Device
from clsco.opencl.session import Session

COLORS = {"naive": "#d55e00", "single": "#0072b2", "double": "#000000"}
LABELS = {"naive": "textbook, float32", "single": "clsco, single", "double": "clsco, double"}
LEAST = 1e-18  # errors below are none
ACROSS = 5  # panels


@dataclass(frozen=True)
class Stability:
    """A whole run: hard cases, random rays against the oracle, and degenerate cases, cast and rendered."""

    device: dict[str, Any]
    versions: dict[str, str]
    cases: list[HardCase]
    rays: list[survey.Surveyed]
    degenerate: list[Outcome]
    rendered: list[Outcome]

    def shortfalls(self) -> list[str]:
        """Cases that are beyond their bounds, a line each."""
        lines = [f"{case.name}: beyond its bound" for case in self.cases if not case.reached]
        lines += [
            f"{found.family}, {found.precision}: {found.worst_ulp:.3g} ULP, {found.misclassified} misclassified"
            for found in self.rays
            if not found.reached
        ]
        lines += [
            f"{one.name}, {one.precision}: {one.not_finite} not finite, {one.other_class} of another class"
            for one in (*self.degenerate, *self.rendered)
            if not one.reached
        ]
        return lines


def steps(quick: bool) -> int:
    """Number of times that `run` calls `advance`."""
    return len(hardgeometry.CASES) + len(FAMILIES) + 1 + (0 if quick else len(hardimages.CASES) + 1)


def run(device: Device, quick: bool, advance: Callable[[], object]) -> Stability:
    """Measure all cases; quick: those of geometry, coarsely, and 10^5 rays instead of 10^7.

    Raises DeviceError, KernelError.
    """
    targets = degenerate.cases()
    rendered: list[Outcome] = []
    with Session(device) as session:
        cases = []
        rays = hardgeometry.Rays(session)
        for geometric in hardgeometry.CASES:
            cases.append(geometric(rays, quick))
            advance()
        for other in () if quick else hardimages.CASES:
            cases.append(other(session))
            advance()
        found = survey.run(session, survey.QUICK_RAYS if quick else survey.ALL_RAYS, advance)
        outcomes = degenerate.cast(session, targets)
        advance()
    if not quick:
        rendered = degenerate.rendered(degenerate.distinct(targets), device)
        advance()
    return Stability(described(device), versions(()), cases, found, outcomes, rendered)


def write(folder: Path, stability: Stability) -> None:
    """Write stability.json, three CSV files and stability.png: all or none. Raises FileError where that fails."""
    content = rounded(_finite(asdict(stability)))
    with atomic_folder(folder, "stability") as made:
        (made / "stability.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
        rows = [_row(case) for case in stability.cases]
        write_csv(made / "stability.csv", list(rows[0]), rounded(_finite(rows)))
        write_csv(made / "rays.csv", list(content["rays"][0]), content["rays"])
        write_csv(made / "degenerate.csv", list(content["degenerate"][0]), content["degenerate"] + content["rendered"])
        plot(stability.cases).savefig(made / "stability.png", dpi=100)


def _finite(value: Any) -> Any:
    """A tree of values with None for nan, and "inf" for infinity, which JSON has no word for."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf"
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value


def _row(case: HardCase) -> dict[str, Any]:
    """A line of the CSV."""
    row: dict[str, Any] = {"case": case.name, "unit": case.unit, "values": case.values}
    row |= {form: case.worst(form) for form in FORMS}
    row |= {f"bound_{form}": bound for form, bound in zip(FORMS[1:], case.bounds, strict=True)}
    row |= {f"wrong_{form}": case.wrong[k] if case.wrong else None for k, form in enumerate(FORMS)}
    row |= {f"ns_{form}": case.ns[k] for k, form in enumerate(FORMS)}
    return row | {"reached": case.reached, "remedy": case.remedy}


def tables(stability: Stability) -> list[RenderableType]:
    """Hard cases, rays and degenerate cases, for the terminal."""
    device = f"{stability.device['name']} ({stability.device['platform']})"
    cases = _table(f"{device}: largest error of float32 as the thesis has it, and of clsco", [
        "hard case", "unit", "values", "naive", "single", "double", "bounds", "wrong", "ns", "",
    ])  # fmt: skip
    for case in stability.cases:
        cases.add_row(
            case.name, case.unit, f"{case.values}", *(_number(case.worst(form)) for form in FORMS),
            " ".join(f"{bound:.3g}" for bound in case.bounds),
            " ".join(map(str, case.wrong)) if case.wrong else "",
            " ".join(_number(ns, ".0f") for ns in case.ns if not math.isnan(ns)), "ok" if case.reached else "SHORT",
        )  # fmt: skip
    rays = _table("Random rays against an oracle of 106 bits; errors of depth in ULP of float32", [
        "shape", "precision", "rays", "hits", "worst", "figure", "wrong", "in the band", "oracle, bits", "",
    ])  # fmt: skip
    for one in stability.rays:
        rays.add_row(
            one.family, one.precision, f"{one.rays}", f"{one.hits}", f"{one.worst_ulp:.3f}", f"{one.figure:g}",
            f"{one.misclassified}", f"{one.misclassified_in_band}", f"{one.oracle_bits:.0f}",
            "ok" if one.reached else "SHORT",
        )  # fmt: skip
    return [cases, rays, Text("\n".join(_notes(stability)))]


def _notes(stability: Stability) -> Iterable[str]:
    for how, found in (("cast", stability.degenerate), ("rendered", stability.rendered)):
        if found:
            refused = sum(bool(one.refused) for one in found)
            yield (
                f"{len({one.name for one in found})} degenerate cases, {how} in each precision: "
                f"{sum(one.not_finite for one in found)} numbers not finite, {sum(one.other_class for one in found)} "
                f"pixels of another class than the reference, {refused} refused for their blur"
            )
    yield from stability.shortfalls()


def _table(title: str, columns: Sequence[str]) -> Table:
    table = Table(title=Text(title), title_justify="left", box=SIMPLE, pad_edge=False)
    for number, name in enumerate(columns):
        table.add_column(name, justify="left" if number < 2 else "right", no_wrap=True)
    return table


def _number(value: float, form: str = ".2g") -> str:
    return "" if math.isnan(value) else f"{value:{form}}"


def plot(cases: Sequence[HardCase]) -> Any:
    """Error against what makes a case hard, a panel for each."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    down = -(-len(cases) // ACROSS)
    figure = Figure(figsize=(3.2 * ACROSS, 2.7 * down + 0.8), layout="constrained")
    panels = figure.subplots(down, ACROSS, squeeze=False).ravel()
    for case, panel in zip(cases, panels, strict=False):
        _panel(panel, case)
    for panel in panels[len(cases) :]:
        panel.set_axis_off()
    handles = [Line2D([], [], color=COLORS[form], marker="o", linewidth=0.8, label=LABELS[form]) for form in FORMS]
    handles.append(Line2D([], [], color="0.3", marker="v", linestyle="none", label="no error at all"))
    handles.append(Line2D([], [], color="0.3", linestyle="--", linewidth=0.6, label="bound"))
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=9)
    return figure


def _panel(panel: Any, case: HardCase) -> None:
    """One case; errors of 0, which a logarithm cannot show, as triangles at the bottom."""
    shown = {form: sorted((p.condition, getattr(p, form)) for p in case.points) for form in FORMS}
    shown = {form: [(x, y) for x, y in points if math.isfinite(y)] for form, points in shown.items()}
    positive = [y for points in shown.values() for _, y in points if y > LEAST]
    floor = 0.2 * min(positive, default=1.0)
    for form, points in shown.items():
        style = {"color": COLORS[form], "markersize": 3 if form == "double" else 4.5, "linewidth": 0.8}
        some, none = [p for p in points if p[1] > LEAST], [(x, floor) for x, y in points if y <= LEAST]
        in_order = len({x for x, _ in some}) == len(some) <= 50
        for marker, group in (("o-" if in_order else "o", some), ("v", none)):
            if group:
                panel.plot(*zip(*group, strict=True), marker, **style)
    for bound, form in zip(case.bounds, FORMS[1:], strict=True):
        if 0.0 < bound < math.inf:
            panel.axhline(bound, color=COLORS[form], linewidth=0.6, linestyle="--")
    ends = [point.condition for point in case.points]
    panel.set_xscale("log" if min(ends) > 0.0 and max(ends) > 20.0 * min(ends) else "linear")
    panel.set(yscale="log", xlabel=case.condition, ylabel=case.unit)
    share = f"\ntextbook: {case.wrong[0] / case.values:.1%} of another class" if case.wrong else ""
    panel.set_title(case.name + share, fontsize=9)
    panel.tick_params(labelsize=7)
    panel.grid(alpha=0.3)
