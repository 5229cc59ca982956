"""The pass that darkens the blurred plane of a time sample."""

from __future__ import annotations

from clsco.plan.passes import Pass
from clsco.scene.model import Scene


def vignetting_pass(scene: Scene, rows: int, columns: int) -> Pass:
    """The vignetting pass for a frame of `rows` x `columns` px."""
    kind = "none" if scene.lens is None else scene.lens.vignetting
    text = "cos^4 of the angle from the axis" if kind == "natural" else f"a1, a2, a3 = {kind}"
    return Pass("vignetting", (("share", text),), {"vignetting": 4 * rows * columns}, ("plane",), ("plane",))
