"""Compile-time features that the shapes of a scene need."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from clsco.constants import CURVED_FIELD, CURVED_IMAGE, CURVED_SPHERE
from clsco.optics.quadrics import canonical, cutting_bounds
from clsco.scene.model import Scene
from clsco.scene.objects import Object


def curvature_of(scene: Scene) -> int:
    """Feature CURVED: bits for each property of the lens that curves the surface in focus or the image; 0 for none."""
    lens = scene.lens
    if lens is None:
        return 0
    focus = CURVED_FIELD * (lens.field_curvature != 0.0) | CURVED_SPHERE * (lens.focus_surface == "sphere")
    return focus | CURVED_IMAGE * lens.distorts


def shape_features(objects: Sequence[Object]) -> dict[str, int]:
    """Geometry features (kernels/common/geometry.clh) that objects need.

    LINEAR is also on for several objects if any of them is curved, and NAPPE is on if any object has bounds, even if
    the kernels do not need these features. This takes a few operations and changes no bit of a frame, but fewer
    programs then serve all scenes.
    """
    analytic = [item for item in objects if item.is_analytic]
    shapes, several = [canonical(item) for item in analytic], len(objects) > 1
    quadratic = any(shape.q.any() for shape in shapes)
    bounded = any(cutting_bounds(item) is not None for item in analytic) or any(shape.radius < inf for shape in shapes)
    return {
        "SEVERAL": int(several),
        "QUADRATIC": int(quadratic),
        "LINEAR": int(quadratic and (several or any(shape.l.any() for shape in shapes))),
        "NAPPE": int(bounded or any(shape.nappe != 0 for shape in shapes)),
        "BOUNDED": int(bounded),
    }
