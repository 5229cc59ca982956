"""Keys that a scene gives although nothing depends on them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from clsco.plan.left_out import left_out
from clsco.plan.plan import Plan


def unused_keys(plan: Plan) -> list[tuple[str, str]]:
    """Keys that the scene gives although nothing depends on them, and why: (key, reason)."""
    scene = plan.scene
    reasons: dict[str, str] = {}

    def give(section: str, keys: Iterable[str], why: str) -> None:
        reasons.update({f"{section}.{key}": why for key in keys})

    motions = [scene.camera.motion, *(motion for item in scene.objects for motion in scene.motions(item))]
    if not plan.moves:
        give("sequence", ("samples", "sampling", "shutter"), "nothing moves")
        mapped = plan.forward or plan.static_map
        used = ["warp"] * mapped + ["texture_filter"] * (scene.stereo is not None or plan.mapped > 0)
        give("motion", [key for key in type(scene.motion).model_fields if key not in used], "nothing moves")
        if not mapped:
            give("fill", type(scene.fill).model_fields, "nothing moves")
    elif all(sum(map(bool, motion.angular_velocity)) < 2 for motion in motions):
        give("motion", ("rotation",), "euler and axis differ only for turns about several axes")
    if plan.static_map:
        give("fill", ("domain",), "nothing moves")
    if plan.forward and scene.fill.method == "none":
        give("fill", ("domain",), "fill.method is none")
    if plan.blur == "none":
        keys = [key for key in type(scene.psf).model_fields if key != "silhouette_samples"]
        give("psf", keys, "everything is in focus")
        give("aperture", type(scene.aperture).model_fields, "everything is in focus")
    unneeded = dict(left_out(plan))
    if not plan.tilt and scene.psf.tilt:
        give("psf", ("tilt",), unneeded["tilt"])
    if not plan.silhouettes and scene.psf.silhouette_samples > 1:
        give("psf", ("silhouette_samples",), unneeded["silhouettes"])
    if "occlusion" in unneeded:
        give("psf", ("occlusion",), unneeded["occlusion"])
    named = ("aperture", "psf", "sequence", "motion", "fill")
    sections: list[tuple[str, Any]] = [(name, getattr(scene, name)) for name in named]
    for index, item in enumerate(scene.objects):
        if not item.is_analytic and item.group is None and not any(item.motion.angular_velocity):
            give(f"object[{index}]", ("center",), "the depth map does not turn")
            sections.append((f"object[{index}]", item))
    for index, group in enumerate(scene.groups):
        if all(item.group != group.name for item in scene.objects):
            give(f"group[{index}]", type(group).model_fields, "no object is in it")
            sections.append((f"group[{index}]", group))
    given = [f"{place}.{key}" for place, model in sections for key in sorted(model.model_fields_set)]
    return [(key, reasons[key]) for key in given if key in reasons]
