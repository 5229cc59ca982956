"""A pass: a step of a frame, described by a value."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from clsco.optics.visibility import NO_GROUP, OcclusionGroup
from clsco.plan.buffers import Sizes

Parameters = tuple[tuple[str, str], ...]
Kind = Literal[
    "static image", "trace", "silhouettes", "pinhole", "reproject", "fill", "count missing", "sources", "cluster",
    "depth layers", "blur", "join colors", "vignetting", "accumulate", "sensor", "ground truth",
]  # fmt: skip
ONCE_A_FRAME: tuple[Kind, ...] = ("sensor", "ground truth")  # all others: for each time sample


@dataclass(frozen=True)
class Pass:
    """A step of a frame: the engine runs it, `clsco plan` prints it, and the memory estimate adds it up.

    Attributes
    ----------
    kind : Kind
    parameters : tuple of (str, str)
        Parameters of the pass, for reports.
    buffers : dict
        Size in bytes of each buffer on the device, by name; passes share buffers of equal name.
    takes, gives : tuple of str
        Names of its inputs from earlier passes, and of its outputs: "moved" pixels, an "image" with its radii,
        "sources", "layers", the blurred "plane" of a time sample, its "colors" so far if each is blurred separately,
        the "frame" so far, its "codes" when it is complete; "counts" and "missing" of a filling, the number of
        "depth_layers".
    group : OcclusionGroup
        Its occlusion group.
    color : int, optional
        Its color, 0 to 2; by default all.
    """

    kind: Kind
    parameters: Parameters
    buffers: Sizes
    takes: tuple[str, ...] = ()
    gives: tuple[str, ...] = ()
    group: OcclusionGroup = NO_GROUP
    color: int | None = None


def run_passes(passes: Iterable[Pass], run: Callable[..., Iterable[Any]]) -> Mapping[str, Any]:
    """Run passes in their order.

    Parameters
    ----------
    passes : iterable of Pass
    run : callable
        Runs a pass, given the pass and its inputs; returns its outputs.

    Returns
    -------
    dict
        All outputs by name; for equal names, the latest.

    Examples
    --------
    >>> from clsco.plan.passes import Pass, run_passes
    >>> passes = Pass("pinhole", (), {}, gives=("image",)), Pass("blur", (), {}, ("image",), ("plane",))
    >>> run_passes(passes, lambda step, *inputs: [f"{step.kind} of {inputs}"])["plane"]
    "blur of (\'pinhole of ()\',)"
    """
    outputs: dict[str, Any] = {}
    for step in passes:
        outputs |= zip(step.gives, run(step, *(outputs[name] for name in step.takes)), strict=True)
    return outputs
