"""Compiles the kernels of a scene, and of similar scenes, ahead of time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from clsco.engine.renderer import Renderer, expose
from clsco.engine.sequence import casts_for_lenses
from clsco.errors import ClscoError
from clsco.frame.outputs import ALL_TRUTH
from clsco.inputs.files import InputFiles
from clsco.opencl.session import Session
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.trace import CachedHits
from clsco.plan.memory import limit_of
from clsco.plan.methods import Choice, Occlusion
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared, prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene

SIDE = 16  # px, side of the frames for which kernels are run


def warm(session: Session, scene: Scene, files: InputFiles) -> None:
    """Compile the kernels that a scene and similar ones need.

    They are first compiled in a separate context, which fills the cache on disk, then in the session. Faults of the
    scene are ignored here; rendering raises them.
    """
    with suppress(ClscoError):
        prepared = prepare(scene, Request(ALL_TRUTH), session.device, files)
        with Session(session.device) as alone:
            run_plausible_plans(alone, prepared)
        run_plausible_plans(session, prepared)


def run_plausible_plans(session: Session, prepared: Prepared) -> int:
    """Run the kernels of a scene and of similar ones on small frames, so that they are compiled; returns the number of
    plans.
    """
    small, count = _small(prepared), 0
    columns, rows = small.scene.camera.resolution or (SIDE, SIDE)
    for plan in plausible_next_plans(prepared.plan):
        tiny = replace(plan, scene=small.scene, rows=rows, columns=columns, strip_rows=0)
        for hits in (None, CachedHits(session)) if casts_for_lenses(plan) else (None,):
            renderer = Renderer(session, tiny, small, limit_of(None, session.device), hits)
            (film,) = expose([renderer], 0)
            renderer.finish(film)
        count += 1
    return count


def plausible_next_plans(plan: Plan) -> Iterator[Plan]:
    """The plan itself, and plans of similar scenes, with silhouettes or occluders added or removed."""
    yield plan
    if not casts_for_lenses(plan):
        return
    psf, count = plan.scene.psf, len(plan.scene.objects)
    everything = (1 << count) - 1
    if psf.silhouette_samples > 1:
        toggled = Choice(0 if plan.silhouettes else psf.silhouette_samples)
        yield replace(plan, choices=replace(plan.choices, silhouettes=toggled))
    if plan.occlusion == "visibility":
        yield _occluded(plan, "none", OcclusionGroup(everything, 0))
    elif count > 1 and psf.occlusion == "visibility":
        yield _occluded(plan, "visibility", OcclusionGroup(everything, everything))


def _occluded(plan: Plan, occlusion: Occlusion, group: OcclusionGroup) -> Plan:
    """The plan with another method of occlusion, and `group` as its only occlusion group."""
    return replace(plan, choices=replace(plan.choices, occlusion=Choice(occlusion)), groups=(group,))


def _small(prepared: Prepared) -> Prepared:
    """The scene in a frame of SIDE x SIDE px, with the same blur; unchanged with depth maps, which fix the size."""
    if not prepared.scene.is_analytic:
        return prepared
    camera = prepared.scene.camera.model_copy(update={"resolution": (SIDE, SIDE)})
    scene = prepared.scene.model_copy(update={"camera": camera})
    return Prepared(scene, prepared.plans, prepared.request, prepared.files)
