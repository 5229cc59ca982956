"""Passes, the steps of a frame, and the order in which they run."""

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
ONCE_A_FRAME: tuple[Kind, ...] = ("sensor", "ground truth")  # other passes run for each time sample


@dataclass(frozen=True)
class Pass:
    """A step of a frame: the engine runs it, `clsco plan` prints its parameters, and the memory estimate adds up its
    buffers.

    buffers: size in bytes of each buffer on the device, by name; passes share buffers of equal name. takes, gives:
    names of the inputs, which are outputs of earlier passes, and of the outputs. These are the "moved" pixels of a
    forward warp; an "image" with its radii; "sources"; depth "layers"; the blurred "plane" of a time sample; the
    "colors" joined so far, if colors are blurred separately; the "frame" summed so far; the sensor's "codes" of the
    complete frame; the "counts" of a filling, and the mask of pixels that were "missing"; the number of "depth_layers".
    color: color that the pass processes, 0 to 2; by default all colors.
    """

    kind: Kind
    parameters: Parameters
    buffers: Sizes
    takes: tuple[str, ...] = ()
    gives: tuple[str, ...] = ()
    group: OcclusionGroup = NO_GROUP
    color: int | None = None


def run_passes(passes: Iterable[Pass], run: Callable[..., Iterable[Any]]) -> Mapping[str, Any]:
    """Run passes in the given order; returns all outputs by name, for a name that several passes give the latest
    output.

    run: called with a pass and its inputs, in the order of `takes`; returns its outputs, in the order of `gives`.

    >>> from clsco.plan.passes import Pass, run_passes
    >>> passes = Pass("pinhole", (), {}, gives=("image",)), Pass("blur", (), {}, ("image",), ("plane",))
    >>> run_passes(passes, lambda step, *inputs: [f"{step.kind} of {inputs}"])["plane"]
    "blur of (\'pinhole of ()\',)"
    """
    outputs: dict[str, Any] = {}
    for step in passes:
        outputs |= zip(step.gives, run(step, *(outputs[name] for name in step.takes)), strict=True)
    return outputs
