"""Keys of a scene file that have no effect on its frames."""

from __future__ import annotations

from clsco.plan.plan import Plan
from clsco.scene.model import Scene

SECTIONS = ("aperture", "psf", "sequence", "motion", "fill")


def unused_keys(plan: Plan) -> list[tuple[str, str]]:
    """Keys that the scene sets although they have no effect, as pairs of key and reason."""
    scene, reasons = plan.scene, plan.choices.unused | _idle_keys(plan.scene)
    tables = [(name, getattr(scene, name)) for name in SECTIONS]
    tables += [(f"object[{k}]", item) for k, item in enumerate(scene.objects)]
    tables += [(f"group[{k}]", group) for k, group in enumerate(scene.groups)]
    keys = [f"{place}.{key}" for place, table in tables for key in sorted(table.model_fields_set)]
    return [(key, reasons[key]) for key in keys if key in reasons]


def _idle_keys(scene: Scene) -> dict[str, str]:
    """Reasons for keys that have no effect whatever is requested, by key."""
    reasons = {}
    motions = [scene.camera.motion, *(motion for item in scene.objects for motion in scene.motions(item))]
    if scene.moves and all(sum(motion.turns) < 2 for motion in motions):
        reasons["motion.rotation"] = "euler and axis differ only for turns about several axes"
    for k, item in enumerate(scene.objects):
        if not item.is_analytic and item.group is None and not any(item.motion.turns):
            reasons[f"object[{k}].center"] = "the depth map does not turn"
    for k, group in enumerate(scene.groups):
        if all(item.group != group.name for item in scene.objects):
            reasons |= {f"group[{k}].{key}": "no object is in it" for key in type(group).model_fields}
    return reasons
