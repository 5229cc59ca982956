"""Creates the object that blurs a frame by the planned method."""

from __future__ import annotations

from clsco.frame.strips import Grid
from clsco.opencl.program import Target
from clsco.passes.blur import BlurredPlane, Scatter, Tiles
from clsco.passes.convolve import Convolve
from clsco.passes.gather import Gather
from clsco.plan.buffers import blur_buffers
from clsco.plan.methods import Blur, BlurSpec
from clsco.records import Struct

METHODS: dict[Blur, type[BlurredPlane]] = {"gather": Gather, "scatter": Scatter, "tiles": Tiles, "convolve": Convolve}


def make_blur(target: Target, spec: BlurSpec, tallest: Grid, grid: Struct) -> BlurredPlane:
    """The object that blurs the time samples of a frame or its strips; target: from `blur_target`."""
    sizes = blur_buffers(spec, tallest, target.session.device)
    return METHODS[spec.method](target, spec, tallest, grid, sizes)
