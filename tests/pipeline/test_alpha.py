"""Coverage: what surfaces contribute to a pixel's light, blurred as the color is."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.frame.channels import exr_channels
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.pipeline.common import PLAIN, assert_strips_agree
from tests.pipeline.test_background import SKY, SMALL
from tests.pipeline.test_scenes import BALL, GOING
from tests.pipeline.test_scenes import scene as scene_of
from tests.slow import mostly_slow

scene = partial(scene_of, camera=SMALL)
NEAR = {"shape": "sphere", "center": [12.0, 6.0, 240.0], "radius": 10.0, "texture": "#c06020"}
MOVING = {"sequence": {"frames": 1, "samples": 2, "interval": 0.2}}
LAYERED = {"occlusion": "layered", "silhouette_samples": 1}
CASES: dict[str, Any] = {
    "gray": ((BALL,), {}),
    "color, visibility": ((BALL, NEAR), {}),
    "moving": ((BALL | {"motion": GOING}, NEAR), MOVING | {"psf": PLAIN}),
    "background": ((NEAR, SKY), {"psf": {"model": "gaussian"}}),
    "layered": ((NEAR, BALL), {"psf": LAYERED}),
    "forward": ((BALL | {"motion": GOING},), MOVING | {"motion": {"warp": "forward"}, "psf": PLAIN}),
    "stereo": ((BALL, NEAR), {"stereo": {"baseline": 6.0}, "psf": PLAIN}),
}


def white(item: Any) -> Any:
    """The object in white; a background in black."""
    return item | {"texture": "#000000" if item["shape"] == "background" else "#ffffff"}


def frames_of(wanted: Scene, *truth: str, **options: Any) -> list[Any]:
    return list(clsco.render(wanted, truth=truth, **options))


@pytest.mark.parametrize("method", mostly_slow(["auto", "scatter"], ["auto"]))
@pytest.mark.parametrize(("items", "sections"), mostly_slow(list(CASES.values()), list(CASES.values())[:1]))
def test_it_is_the_image_of_white_surfaces(items: Any, sections: Any, method: str) -> None:
    """And color and truth are what they are without it."""
    how = {} if "layered" in str(sections) and method != "auto" else {"method": method}
    found = frames_of(scene(*items, **sections), "alpha", "sharp", **how)
    alone = frames_of(scene(*items, **sections), "sharp", **how)
    covered = frames_of(scene(*map(white, items), **sections), **how)
    for frame, without, expected in zip(found, alone, covered, strict=True):
        assert frame.alpha.dtype == np.float32
        np.testing.assert_allclose(frame.alpha, expected.color, atol=2e-6)
        np.testing.assert_allclose(
            frame.color, without.color, atol=2e-6 if frame.metadata["blur_method"] == "scatter" else 0.0
        )
        np.testing.assert_array_equal(frame.sharp, without.sharp)
        assert frame.alpha.min() < 0.1 < 0.9 < frame.alpha.max()
        assert frame.color.flags.c_contiguous


def test_over_another_image_it_is_the_image_before_that() -> None:
    """Associated alpha: color + (1 - alpha) background, where the background is as far away as it can be."""
    (over,) = frames_of(scene(BALL), "alpha")
    (before,) = frames_of(scene(BALL, {"shape": "background", "texture": "#808080"}))
    gray = float(frames_of(scene({"shape": "background", "texture": "#808080"}))[0].color[20, 20])
    inside = (slice(8, -8), slice(8, -8))
    np.testing.assert_allclose((over.color + (1 - over.alpha) * gray)[inside], before.color[inside], atol=0.02)


def test_it_is_asked_for_by_name() -> None:
    (frame,) = clsco.render(scene(BALL), truth="all")
    assert frame.alpha is None
    assert (exr_channels(frame.arrays())["A"] == 1).all()
    (frame,) = frames_of(scene(BALL), "alpha")
    assert frame.mask is None
    np.testing.assert_array_equal(exr_channels(frame.arrays())["A"], frame.alpha)
    with pytest.raises(clsco.SceneError, match=r"truth: must be .*, saturated, alpha, subframes; got 'alfa'"):
        frames_of(scene(BALL), "alfa")


@pytest.mark.parametrize("truth", [("alpha",), ("alpha", "depth")])
def test_the_plan_knows_it(truth: tuple[str, ...]) -> None:
    wanted = scene(BALL, NEAR)
    plan = prepare(wanted, Request(truth)).plan
    assert (plan.channels, plan.colors, plan.alpha) == (4, 3, True)
    assert plan.truth == tuple(name for name in truth if name != "alpha")
    assert any(("alpha", "a channel of what surfaces cover") in step.parameters for step in plan.passes)
    without = prepare(wanted, Request(plan.truth)).plan
    assert (without.channels, without.alpha) == (3, False)


def test_in_strips() -> None:
    wanted = scene_of(BALL, camera=SMALL | {"resolution": [56, 100]})
    assert assert_strips_agree(wanted, ("alpha",)).alpha is not None
