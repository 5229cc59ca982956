"""Plans as tables for the terminal, and as figures for programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from clsco.cli.tables import table
from clsco.optics.point_spread import exposure_factor
from clsco.plan.buffers import Sizes
from clsco.plan.memory import device_bytes
from clsco.plan.notes import unused_keys
from clsco.plan.passes import ONCE_A_FRAME, Kind, Pass
from clsco.plan.plan import Plan

if TYPE_CHECKING:  # this module needs OpenCL
    from clsco.engine.probe import FrameTime


def plan_tables(plans: Sequence[Plan], device: str, time: FrameTime | None) -> list[RenderableType]:
    """Tables of the plan of a frame, or of both views: costs, passes, omitted features, and unused keys of the scene.

    device: name of the device, or the reason why there is none; time: time of a frame, None if unknown.
    """
    plan = plans[0]
    scene = plan.scene
    samples, motion = f"{plan.subframes} per frame", plan.choices.motion
    samples += f", {motion.reason}" if motion.reason and not motion.left_out else ""
    samples += _of_lines(plan) if scene.rolls else ""
    kind = "gray" if plan.colors == 1 else "color"
    figures = [("frames", f"{scene.sequence.frames}, {plan.columns} x {plan.rows} px, {kind}")]
    if scene.stereo is not None:
        turned = f", each turned inwards by {scene.stereo.toe_in:g} deg" if scene.stereo.toe_in else ""
        figures.append(("views", f"left and right, {scene.stereo.baseline:g} mm apart{turned}"))
    figures.append(("intermediate frames", samples))
    figures += _of_views([_figures(each) for each in plans])
    figures += [("device", device), ("predicted time", _time(time))]
    columns = ("pass", "times", "MiB", "time", "what", "how")
    tables: list[RenderableType] = [
        table(f"Plan: {scene.title or scene.objects[0].name}", ("what", "how much"), figures),
        table("Passes, in order", columns, _passes(plans, time), ("times", "MiB", "time")),
        table("Left out", ("pass", "why"), _of_views([each.choices.left_out for each in plans])),
    ]
    if unused := unused_keys(plan):
        tables.append(table("Keys that this scene has no use for", ("key", "why"), unused))
    return tables


def planned_values(plans: Sequence[Plan], device: str, time: FrameTime | None) -> dict[str, Any]:
    """The figures of `plan_tables` for programs: bytes, px, seconds per frame; null if unknown."""
    first = plans[0]
    views = []
    for plan, seconds in zip(plans, ({},) * len(plans) if time is None else time.views, strict=True):
        kinds = dict.fromkeys(each.kind for each in plan.passes)
        passes = [{"pass": kind, "times": _times(plan, kind), "seconds": seconds.get(kind)} for kind in kinds]
        blur = {"method": plan.blur, "smallest_px": plan.smallest_blur, "largest_px": plan.largest_blur}
        views.append({"view": plan.eye, "blur": blur, "bytes": device_bytes(plan), "passes": passes})
    return {
        "frames": first.scene.sequence.frames,
        **{name: getattr(first, name) for name in ("columns", "rows", "channels", "samples", "subframes")},
        "seconds": None if time is None else time.seconds,
        "device": None if time is None else device,
        "views": views,
    }


def duration(seconds: float) -> str:
    """A predicted time with two digits and a unit."""
    for unit, size in (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3)):
        if seconds >= 1.5 * size or unit == "ms":
            break
    value = seconds / size
    return f"{value:.2g} {unit}" if value < 99.5 else f"{value:.0f} {unit}"


def _of_lines(plan: Plan) -> str:
    """Text that follows the number of time samples: how many each line has, with a rolling shutter."""
    sequence = plan.scene.sequence
    line = "column" if sequence.by_columns else "row"
    text = f": {plan.samples} while a {line} is exposed"
    text += f", each in the {line}s that are exposed then" if plan.narrows else ""
    beyond = sequence.readout + sequence.shutter - sequence.interval
    return f"{text}; the last {line}s are exposed {beyond:.3g} s into the next frame" if beyond > 0 else text


def _times(plan: Plan, kind: Kind) -> int:
    members = sum(each.kind == kind for each in plan.passes)
    return members if kind in ONCE_A_FRAME else members * plan.subframes


def _time(time: FrameTime | None) -> str:
    if time is None:
        return "not measured"
    kind, share = time.longest
    line = f"{duration(time.seconds)} per frame, {share:.0%} of it in the pass {kind}"
    return line if time.share == 1.0 else f"{line}; measured on {time.share:.1%} of a frame"


def _passes(plans: Sequence[Plan], time: FrameTime | None) -> list[tuple[str, ...]]:
    """Rows of passes, all views and occlusion groups together. Buffers count for the first pass that uses them."""
    rows: list[tuple[str, ...]] = []
    views = ({},) * len(plans) if time is None else time.views
    for plan, seconds in zip(plans, views, strict=True):
        counted: Sizes = {}
        view = f" ({plan.eye})" if plan.scene.stereo is not None else ""
        groups: dict[Kind, list[Pass]] = {}
        for each in plan.passes:
            groups.setdefault(each.kind, []).append(each)
        for kind, members in groups.items():
            sizes = {name: size for each in members for name, size in each.buffers.items() if name not in counted}
            counted |= sizes
            spent = duration(seconds[kind]) if kind in seconds else ""
            names = (
                (f"{kind}{view}", f"{_times(plan, kind)}", f"{sum(sizes.values()) / 2**20:.1f}", spent),
                *(("", "", "", ""),) * (len(members[0].parameters) - 1),
            )
            rows += [(*name, *row) for name, row in zip(names, members[0].parameters, strict=True)]
    return rows


def _figures(plan: Plan) -> list[tuple[str, str]]:
    memory = f"{device_bytes(plan) / 2**20:.1f} MiB"
    aperture, exposure = plan.scene.aperture, list[tuple[str, str]]()
    if aperture.exposure != "normalized":
        factor = exposure_factor(aperture, plan.psf)
        exposure.append(("exposure", f"{factor:.4g} of the light through an open circle"))
    return [
        ("blur radius |R|", f"{plan.smallest_blur:.2f} to {plan.largest_blur:.2f} px, predicted with a margin"),
        ("guard band", f"{plan.guard_px} px on every side"),
        *exposure,
        ("blur method", plan.blur if plan.color else "none, as there is no image"),
        ("memory on the device", memory + (" for each view" if plan.scene.stereo else "")),
        ("strips", _strips(plan)),
        ("predicted work", f"{plan.taps:.3g} weights per frame"),
    ]


def _strips(plan: Plan) -> str:
    count = len(plan.strips)
    if count == 1:
        return "1, the whole frame"
    beside = max(max(strip.above, strip.below) for strip in plan.strips)
    return f"{count} of up to {plan.strips[0].rows} rows, with up to {beside} more on either side"


def _of_views(rows: Sequence[Sequence[tuple[str, str]]]) -> list[tuple[str, str]]:
    """Merge the rows of all views: a row that is equal in all is listed once, others with the view's name."""
    if len(rows) == 1:
        return list(rows[0])
    views = [dict(one) for one in rows]
    merged = []
    for name in dict.fromkeys(name for one in rows for name, _ in one):
        texts = [view.get(name) for view in views]
        same = len(set(texts)) == 1
        for eye, text in zip(("left", "right"), texts, strict=True):
            if text is not None and (eye == "left" or not same):
                merged.append((name if same else f"{name} ({eye})", text))
    return merged
