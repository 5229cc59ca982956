"""Textures, borders, sequences and outputs, from scene to frame, against the reference and each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco import reference
from clsco.files.images import read_image, write_png
from clsco.files.transfer import decode
from clsco.frame.files import write_frame
from clsco.frame.frame import Frame
from clsco.frame.outputs import TRUTH_NAMES
from clsco.plan.plan import Plan
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene
from tests.pipeline.common import PLAIN
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import combined, mostly_slow

CAMERA = {"resolution": [56, 40], "pixel_pitch": 0.08, "aperture_diameter": 30.0}
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0}
GOING = {"velocity": [4.0, 2.0, -3.0], "angular_velocity": [5.0, 20.0, 10.0]}
ODD: Any = np.random.default_rng(5)


scene = partial(scene_from, {"camera": CAMERA})


def assert_agrees(wanted: Scene, **options: Any) -> list[Any]:
    """All outputs of all frames agree with the reference's; gives the frames."""
    frames, exact = rendered(wanted, **options), reference_frames(wanted)
    assert len(exact) == wanted.sequence.frames
    assert_agree(frames, exact, least=0.0)
    return frames


@pytest.mark.parametrize(
    ("warp", "method"), combined(("inverse", "forward"), ("gather", "scatter"), kept=[("inverse", "gather")])
)
def test_color_is_three_gray_scenes(method: str, warp: str) -> None:
    """The image has another size than the frame."""
    picture = (ODD.random((30, 44, 3)) * [1.0, 0.5, 1.0]).astype(np.float32)
    item = {**BALL, "texture": picture, "motion": GOING}
    color = scene(item, motion={"warp": warp}, sequence={"samples": 3}, psf=PLAIN)
    (frame,) = assert_agrees(color, method=method)
    assert frame.color.shape == (40, 56, 3)
    assert frame.color[..., 0].mean() > 1.5 * frame.color[..., 1].mean()
    for channel in range(3):
        gray = {**item, "texture": picture[..., channel].copy()}
        (alone,) = rendered(color.model_copy(update={"objects": scene(gray).objects}), method=method)
        assert alone.color.shape == (40, 56)
        # The same sums, but for the fixed point of `scatter`, whose unit depends on the brightest light.
        atol = 0.0 if method == "gather" else 1e-6
        np.testing.assert_allclose(frame.color[..., channel], alone.color, rtol=0, atol=atol)
        for name in ("depth", "blur_radius", "mask", "normal", "flow", "filled", "object_id", "hidden"):
            np.testing.assert_array_equal(getattr(frame, name), getattr(alone, name), strict=True)


@pytest.mark.parametrize("shape", [(40, 56), (40, 56, 3)])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("transfer", ["srgb", "linear"])
def test_a_sharp_picture_comes_out_as_it_went_in(
    kind: str, transfer: str, shape: tuple[int, ...], tmp_path: Path
) -> None:
    # In focus and at rest every pixel shows its own texel; float32 keeps 16-bit codes, 256 steps each.
    if kind == "float32":
        data = ODD.random(shape).astype(np.float32)
        np.save(tmp_path / "texture.npy", data)
    else:
        data = ODD.integers(0, np.iinfo(kind).max, shape, endpoint=True).astype(kind)
        write_png(tmp_path / "texture.png", data)
    texture = str(tmp_path / ("texture.npy" if kind == "float32" else "texture.png"))
    camera = {"focus_distance": 250.0}
    sharp = parse_scene({"camera": camera, "image": {"transfer": transfer}, "psf": {"edge": "area"},
                         "object": [{"shape": "plane", "texture": texture}]})  # fmt: skip
    (frame,) = rendered(sharp)
    bits = 8 * data.dtype.itemsize
    assert frame.metadata["bits"] == bits
    write_frame(tmp_path, (frame,), bits, transfer)
    out = read_image(tmp_path / "frame_0000.png")
    assert out.bits == min(bits, 16)
    if kind == "float32":
        np.testing.assert_array_equal(frame.color, data, strict=True)
        np.testing.assert_allclose(decode(out.data, transfer), data, atol=1e-4)  # sRGB: 13 / 65535 per code at most
    else:
        np.testing.assert_array_equal(out.data, data, strict=True)


def test_light_above_white_is_kept() -> None:
    sun = np.where(ODD.random((40, 56)) > 0.99, 500.0, 0.2).astype(np.float32)
    bright = scene({**BALL, "texture": sun}, psf=PLAIN)
    exact = next(reference.render(bright)).color
    assert exact.max() > 5
    for method in ("gather", "scatter"):
        (frame,) = rendered(bright, method=method)
        # Sums of float32 relative to the brightest light, 500.
        np.testing.assert_allclose(frame.color, exact, rtol=0, atol=500 * 1e-6)


@pytest.mark.parametrize(
    ("shape", "method"), combined(("plane", "sphere"), ("gather", "scatter"), kept=[("plane", "scatter")])
)
def test_renormalizing_gives_all_light_back(shape: str, method: str) -> None:
    item = {"shape": "plane", "slope_x": 1.0} if shape == "plane" else BALL
    flat = {**item, "texture": np.full((40, 56), 0.5, np.float32)}
    psf = {"border": "renormalize", "tilt": False}
    assert_agrees(scene({**item}, psf=psf), method=method)
    (frame,) = rendered(scene(flat, psf=psf), method=method)
    # As much light as the focused image, since all weights of a source sum to 1, to rounding. Sub-pixel sources
    # at a silhouette light the share of a pixel that the surface covers, and the mask says all or nothing: half
    # of each of the 130 pixels around the sphere at most.
    share = 0.5 * 130 / frame.color.size if item is BALL else 0.0
    assert frame.color.mean() == pytest.approx(frame.sharp.mean(), rel=1e-5, abs=0.5 * share)
    if item is not BALL:
        np.testing.assert_allclose(frame.color.sum(), 0.5 * frame.color.size, rtol=1e-5)
        (losing,) = rendered(scene(flat, psf={"tilt": False}), method=method)
        assert not np.array_equal(frame.color, losing.color)


@pytest.mark.slow
def test_a_silhouette_at_the_border_renormalized() -> None:
    assert_agrees(scene({**BALL, "center": [30.0, 20.0, 280.0]}, psf={"border": "renormalize"}))


@pytest.mark.parametrize(
    ("sampling", "rotation", "warp"),
    combined(
        ("midpoint", "endpoint"),
        ("euler", "axis"),
        ("inverse", "forward"),
        kept=[("endpoint", "axis", "inverse"), ("midpoint", "euler", "forward")],
    ),
)
def test_motion(warp: str, rotation: str, sampling: str) -> None:
    sequence = {"frames": 2, "interval": 0.8, "shutter": 0.5, "samples": 4, "sampling": sampling}
    motion = {"warp": warp, "rotation": rotation}
    first, second = assert_agrees(scene({**BALL, "motion": GOING}, sequence=sequence, motion=motion, psf=PLAIN))
    assert not np.array_equal(first.color, second.color)
    start = [0.0, 0.8] if sampling == "endpoint" else [-0.0625, 0.7375]
    for frame, open_ in zip((first, second), start, strict=True):
        times = [moment["time"] for moment in frame.metadata["intermediate"]]
        assert times == pytest.approx([open_ + (i + 1) * 0.125 for i in range(4)])


@pytest.mark.parametrize("texture_filter", mostly_slow(["bicubic", "bilinear", "nearest"], ["nearest"]))
def test_texture_filters(texture_filter: str) -> None:
    assert_agrees(scene({**BALL, "motion": GOING}, motion={"texture_filter": texture_filter}, psf=PLAIN))


@pytest.mark.parametrize(
    ("domain", "method"),
    combined(("surface", "span"), ("ait", "mean_median", "none"), kept=[("surface", "ait"), ("span", "none")]),
)
def test_filling(method: str, domain: str) -> None:
    item = {**BALL, "motion": {"velocity": [0.0, 0.0, -40.0], "angular_velocity": [0.0, 0.0, 30.0]}}
    fill, motion = {"method": method, "domain": domain}, {"warp": "forward"}
    (frame,) = assert_agrees(scene(item, motion=motion, fill=fill, sequence={"samples": 3}, psf=PLAIN))
    missing = [moment["missing_pixels"] for moment in frame.metadata["intermediate"]]
    filled = [moment["filled_pixels"] for moment in frame.metadata["intermediate"]]
    assert max(missing) > 20
    assert (max(filled) > 0) == (method != "none")
    assert frame.filled.any()


SEQUENCE = {"frames": 4, "samples": 2}


def same(one: Frame, other: Frame, names: Sequence[str] = ("color", *TRUTH_NAMES)) -> None:
    for name in names:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), strict=True)


@pytest.mark.parametrize("warp", ["inverse", "forward"])
def test_frames_by_themselves_are_those_of_the_sequence(warp: str) -> None:
    moving = scene({**BALL, "motion": GOING}, sequence=SEQUENCE, motion={"warp": warp}, psf=PLAIN)
    whole = rendered(moving)
    some = rendered(moving, frames=[3, 1])
    assert [frame.index for frame in some] == [3, 1]
    for frame in some:
        same(frame, whole[frame.index])
    assert rendered(moving, frames=[]) == []


def test_nothing_moves_by_no_velocity() -> None:
    still = scene(BALL, sequence={"frames": 2, "samples": 9})
    first, second = rendered(still)
    assert first.metadata["samples"] == 1
    same(first, second)
    # A column below 64 is rounded to 2^-47, and few roundings lie between it and its difference from itself.
    assert np.abs(first.flow).max() < 16 * 2.0**-47


@pytest.mark.parametrize(
    ("wanted", "warp"),
    combined(
        ("", "depth", "mask object_id", "sharp flow", "filled hidden"),
        ("inverse", "forward"),
        kept=[("sharp flow", "inverse"), ("filled hidden", "forward")],
    ),
)
def test_outputs_that_nobody_asked_for_are_not_computed(wanted: str, warp: str) -> None:
    truth = tuple(wanted.split())
    moving = scene({**BALL, "motion": GOING}, motion={"warp": warp}, sequence={"samples": 2}, psf=PLAIN)
    (whole,) = rendered(moving)
    (frame,) = rendered(moving, truth=truth)
    same(frame, whole, ("color", *truth))
    assert [name for name in TRUTH_NAMES if getattr(frame, name) is not None] == [n for n in TRUTH_NAMES if n in truth]
    assert ("ground_truth" in frame.metadata["seconds"]) == bool(truth)
    assert "ground_truth" in whole.metadata["seconds"]


@pytest.mark.processor
def test_passes_that_a_scene_has_no_use_for_are_not_run() -> None:
    def passes(wanted: Scene) -> set[str]:
        (frame,) = rendered(wanted, truth=())
        return set(frame.metadata["seconds"]) - {"host"}

    in_focus = {"focus_distance": 250.0}
    sharp = scene({"shape": "plane"}, camera=in_focus, psf={"edge": "area"})
    assert passes(sharp) == {"cast", "aim"}
    assert passes(scene({"shape": "plane", "distance": 260.0})) == {"cast", "aim", "convolve"}
    assert passes(scene({"shape": "plane", "slope_x": 1.0}, psf=PLAIN)) == {"cast", "aim", "gather"}
    finer = {"mark_silhouettes", "label_subpixels", "trace_subpixels"}
    assert passes(scene(BALL)) == {"cast", "aim", "gather"} | finer
    forward = passes(scene({**BALL, "motion": GOING}, motion={"warp": "forward"}, psf=PLAIN))
    assert not forward & ({"cast", "aim"} | finer)
    assert any(name.startswith("reproject") for name in forward)


def test_radii_beyond_the_prediction_are_rendered_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are built anew where a wider blur needs others; buffers and tables grow."""
    rendering = import_module("clsco.plan.prepare")
    predict = rendering.make_plan

    def too_little(*args: Any, **options: Any) -> Plan:
        plan = predict(*args, **options)
        assert plan.largest_blur > 13.0
        return replace(plan, smallest_blur=1.0, largest_blur=3.0, guard_px=4)

    monkeypatch.setattr(rendering, "make_plan", too_little)
    wide = {"aperture_diameter": 80.0}
    plane = {"shape": "plane", "distance": 380.0, "slope_x": 0.4, "texture": "slanted_edge"}
    (frame,) = assert_agrees(scene(plane, camera=wide, psf=PLAIN))
    assert frame.metadata["guard_px"] > 13


def test_pixels_near_silhouettes_beyond_the_prediction_get_room_where_they_are_met(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Buffers of slots grow within a time sample: no pixel loses its mark, and no time sample is made twice."""
    crowded = scene(BALL)
    (enough,) = rendered(crowded)
    tracing, taken = import_module("clsco.passes.trace"), list[int]()
    make_room = tracing.Tracer._make_room

    def counted(tracer: Any, slots: int) -> None:
        taken.append(slots)
        make_room(tracer, slots)

    monkeypatch.setattr(tracing.Tracer, "_make_room", counted)
    monkeypatch.setattr("clsco.plan.plan.SILHOUETTE_SLOTS", 1)
    (grown,) = rendered(crowded)
    assert len(taken) == 1
    assert taken[0] > 56 + 40
    np.testing.assert_array_equal(grown.color, enough.color, strict=True)
