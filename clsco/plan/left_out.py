"""Parts of the pipeline that a scene has no use for, with reasons."""

from __future__ import annotations

from clsco.frame.frame import MOTION_NAMES, TRUTH_NAMES
from clsco.plan.plan import Plan


def left_out(plan: Plan) -> tuple[tuple[str, str], ...]:
    """List the parts of the pipeline that a scene has no use for.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    tuple of (str, str)
        Name of a pass or an option, and the reason.
    """
    scene, psf, forward, static = plan.scene, plan.scene.psf, plan.forward, plan.static_map
    if not plan.color:
        return (("image", "nobody asked for the color: neither its rays nor its blur"),)
    wide = "the forward warp moves whole pixels"
    only_warp = "only a forward warp leaves pixels missing"
    no_rays = "a static depth map: its own pixels" if static else "replaced by the forward warp"
    alike = "nothing moves: every pixel shows its own texel"
    whole = "a depth map has whole pixels" if static else wide if forward else "no silhouette in sight"
    hidden = "one object" if len(scene.objects) == 1 else "no object hides another within its blur"
    hidden = "everything is in focus" if plan.blur == "none" else hidden
    reasons = {
        "motion": None if plan.moves else "nothing moves: one sample, in the reference pose",
        "trace": no_rays if forward or static else None,
        "texture sampling": None if plan.features()["MOVED"] or plan.mapped else wide if forward else alike,
        "reproject": None if forward else "no forward warp",
        "fill": (None if scene.fill.method != "none" else "fill.method is none") if forward else only_warp,
        "silhouettes": None if plan.silhouettes else "silhouette_samples = 1" if psf.silhouette_samples == 1 else whole,
        "tilt": None if plan.tilt else "one radius for all pixels, or none" if psf.tilt else "tilt = false",
        "blur": None if plan.blur != "none" else f"in focus: R up to {plan.largest_blur:.3g} px stays within its pixel",
        "renormalize": None if psf.border == "renormalize" else 'border = "lose"',
        "guard band": None if psf.border == "lose" else "light stays inside the frame",
        "color": None if plan.colors > 1 else "gray texture: one channel",
        "occlusion": None if plan.occlusion != "none" else 'occlusion = "none"' if psf.occlusion == "none" else hidden,
        "ground truth": None if plan.truth else "nobody asked for it",
    }
    possible = (*TRUTH_NAMES, *(MOTION_NAMES if plan.moves else ()))
    missing = [name for name in possible if name not in plan.truth]
    if plan.truth and missing:
        reasons["other outputs"] = f"nobody asked for {', '.join(missing)}"
    return tuple((name, why) for name, why in reasons.items() if why is not None)
