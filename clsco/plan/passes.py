"""A pass: a step of a frame, as a value that is run, printed and summed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from clsco.optics.visibility import OcclusionGroup
from clsco.plan.buffers import Sizes

Parameters = tuple[tuple[str, str], ...]
Kind = Literal[
    "static image", "trace", "silhouettes", "pinhole", "reproject", "fill", "count missing", "sources", "depth layers",
    "blur", "accumulate", "ground truth",
]  # fmt: skip


@dataclass(frozen=True)
class Pass:
    """A step of a frame: what the engine runs, `clsco plan` prints, and memory sums.

    Attributes
    ----------
    kind : Kind
    parameters : tuple of (str, str)
        Parameters of the pass, for reports.
    buffers : dict
        Bytes of its buffers on the device by their names; one name is one buffer in all passes.
    group : OcclusionGroup, optional
        The occlusion group that it is for.
    """

    kind: Kind
    parameters: Parameters
    buffers: Sizes
    group: OcclusionGroup | None = None
