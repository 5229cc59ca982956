"""Kernels of warp.cl on planes of numbers that stand amid others: what they look at, and what they leave alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import NO_WINNER, OWNED_PIXELS
from clsco.opencl.buffers import empty
from clsco.opencl.program import build, kernel
from clsco.opencl.session import Program, Session
from clsco.optics.motion import Pose
from clsco.passes.pack import pose_structs, surface_structs
from clsco.passes.warp import forward_features
from clsco.records import structs
from clsco.reference.warp.warp import (
    SAME_DEPTH,
    extend_border,
    fill_entered,
    mark_entered,
    reproject_depth,
    reproject_gaps,
    reproject_gather,
    reproject_rest,
    reproject_targets,
    reproject_winner,
)
from clsco.scene.model import Fill, Sphere
from tests.kernels import launches
from tests.kernels.launches import Amid
from tests.kernels.numbers import whole

Array = NDArray[Any]
LOCAL = (8, 4)  # beyond the grid in both directions
PLANES = ("value", "w", "coc", "valid")

Maker = Callable[..., Any]
CUT = Sphere(center=(0.0, 0.0, 280.0), radius=4.0, bounds=((-4.0, 4.0), (-4.0, 4.0), (0.5, 4.0)))


def built(session: Session, case: Any) -> Program:
    return build(session, ["warp/warp.cl"], forward_features(case.plan, True), structs(case.real), case.real)


def run(session: Session, case: Any, name: str, size: tuple[int, ...], local: tuple[int, ...], **given: Any) -> None:
    launches.run(session, built(session, case), name, size, local, grid=case.grid, lens=case.lens, **given)


def surfaces(case: Any) -> Array:
    """surface_t of every object; the last has the first texture."""
    known = [k for k, surface in enumerate(case.rest) if surface is not None]
    array = np.zeros(len(case.items), structs(case.real)["surface_t"])
    array[known] = surface_structs([case.items[k] for k in known], [case.rest[k] for k in known], case.real)
    array["texture"] = np.arange(len(case.items))[::-1]
    return array


@pytest.fixture
def mapped(make_case: Maker, warps: dict[str, Any]) -> Any:
    """A ball and a depth map on a grid of 11 x 70 pixels; lines of the frame are as long as a segment."""
    return make_case(warps["map and ball"][0], (5, OWNED_PIXELS), channels=3)


def random_winners(case: Any) -> tuple[Array, Array]:
    """Winners that were often neighbors, or nearly, and depths with ties."""
    rng, (height, width) = np.random.default_rng(5), case.shape
    depth = rng.choice(np.array([0.0, 0.5, 1.0, SAME_DEPTH, 1.5], np.float32), (height, width))
    winner = rng.choice(np.array([0, 1, 2, 63, 64, 65, 128, 191]), (height, width))
    # The first pixel is one side of a gap, (1, 1), which nothing else shows to be one.
    depth[:5, :5], winner[:5, :5] = 0.5, 0
    depth[0, 0] = depth[0, 1] = depth[2, 2] = 1.5
    return np.where(depth > 0, winner, NO_WINNER), depth


def single_gaps(case: Any) -> tuple[Array, Array]:
    """Gaps between two near pixels before a far plane, far from each other, at the ends of rows, columns, segments."""
    depth = np.full(case.shape, 0.5, np.float32)
    winner = np.zeros(case.shape, np.int64)
    bottom, right = case.shape[0] - 1, case.shape[1] - 1
    for places in (
        [(0, 20), (0, 22)],
        [(0, 40), (0, 46)],
        [(10, 0), (12, 0)],
        [(20, OWNED_PIXELS - 3), (20, OWNED_PIXELS - 1)],
        [(30, 10), (36, 10)],
        [(35, right - 1), (36, 0)],
        [(40, 10), (44, 14)],
        [(45, OWNED_PIXELS - 1), (45, OWNED_PIXELS + 1)],
        [(50, 10), (50, 18)],
        [(56, right - 2), (56, right)],
        [(bottom, 20), (bottom, 22)],
    ):
        for place in places:
            depth[place] = 1.5
    return winner, depth


@pytest.mark.parametrize("made", [random_winners, single_gaps])
def test_gaps_are_those_within_the_grid(
    session: Session, make_case: Maker, mapped: Any, made: Callable[[Any], tuple[Array, Array]]
) -> None:
    """Whatever is before and after the planes: near pixels that were neighbors of those in it. Each writes its own."""
    case = make_case(mapped.items, (60, OWNED_PIXELS), channels=3) if made is single_gaps else mapped
    winner, depth = made(case)
    expected = reproject_gaps(winner, depth, OWNED_PIXELS)
    assert 5 < ((winner != NO_WINNER) & ~expected).sum() < 0.5 * winner.size
    inputs = {"depth": Amid(session, depth, 1.5), "winner": Amid(session, winner.astype(np.int32), 0)}
    for segments in (1, 2):
        valid = Amid(session, np.full(case.shape, 9, np.uint8), 7)
        run(session, case, "reproject_gaps", (segments, case.shape[0]), (1, 8), valid=valid, **inputs)
        found, end = valid.now(), segments * OWNED_PIXELS
        assert (found[:, :end] == expected[:, :end]).all()
        assert (found[:, end:] == 9).all()


def test_each_band_writes_its_own_rows(session: Session, mapped: Any) -> None:
    (height, width), rng, band = mapped.shape, np.random.default_rng(3), 2
    target = np.sort(rng.integers(-40, height * width, 5 * OWNED_PIXELS)).clip(-1).reshape(5, OWNED_PIXELS)
    target[:, ::7] = width * np.array([2, 4, 6, 8, 10])[:, None]  # where bands begin
    bounds = [(row[row >= 0].min(), row.max()) for row in target]
    moved = rng.uniform(0.003, 0.005, target.size)
    moved[0] = 0.002  # any other source would take a pixel from the first, which stands around the band
    key, pixels = moved.astype(np.float32), height * width
    depth = reproject_depth(target.ravel(), key, pixels)
    expected = reproject_winner(target.ravel(), key, depth)
    inputs = {"grid": mapped.grid, "target": target.astype(np.int32), "moved": moved}
    inputs["bounds"] = Amid(session, np.array(bounds, np.int32), -1)
    for k in range(-(-height // band)):
        own = slice(k * band * width, (k + 1) * band * width)
        found, near = (Amid(session, np.full(pixels, around, np.int32), around) for around in (0, -7))
        nearest = kernel(built(session, mapped), "reproject_nearest")
        args = launches.arguments(session, nearest, band=band, winner=found, depth=near, **inputs)
        nearest(session.queue, (1,), (1,), *args, global_offset=(k,))
        for plane, values in ((found, expected.astype(np.int32)), (near, depth.view(np.int32))):
            only = np.full(pixels, plane.held[0])
            only[own] = values[own]
            assert (plane.now() == only).all()


def test_gather_takes_each_object_from_its_texture(session: Session, mapped: Any) -> None:
    """Pixels that are not valid have nothing, winner or not."""
    rng, shape, sources = np.random.default_rng(7), mapped.shape, 5 * OWNED_PIXELS
    winner, valid = rng.integers(0, sources, shape), rng.random(shape) < 0.6
    moved, whose = rng.uniform(0.003, 0.005, sources), rng.integers(0, 2, sources).astype(np.uint8)
    planes = (((3, *shape), "f4"), (shape, "f8"), (shape, "f8"), (shape, "u1"), (shape, "u1"))
    value, w, coc, status, seen = (Amid(session, np.full(of, 9, dtype), 9) for of, dtype in planes)
    before = Amid(session, valid.astype(np.uint8), 1)
    stack = np.ascontiguousarray(np.moveaxis(mapped.textures, -1, 1))
    inputs: dict[str, Any] = {"texture": stack, "moved": moved, "surfaces": surfaces(mapped), "object": whose}
    inputs |= {"winner": Amid(session, winner.astype(np.int32), 0)}
    outputs = {"value": value, "w": w, "coc": coc, "valid": before, "status": status, "seen": seen}
    run(session, mapped, "reproject_gather", shape[::-1], LOCAL, **inputs, **outputs)
    radiance = mapped.textures.reshape(2, sources, 3)[1 - whose, np.arange(sources)]
    values = np.concatenate([radiance, moved[:, None], whose[:, None]], axis=1)
    known, expected = reproject_gather(np.where(valid, winner, NO_WINNER).ravel(), values)
    expected, known = expected.reshape(*shape, 5), known.reshape(shape)
    assert (np.moveaxis(value.now(), 0, -1) == expected[..., :3].astype(np.float32)).all()
    assert (w.now() == expected[..., 3]).all()
    radius = mapped.lens["blur_scale"] * (mapped.lens["focus_power"] - expected[..., 3])
    np.testing.assert_allclose(coc.now(), np.where(known, radius, 0.0), rtol=1e-12)
    assert (before.now() == known).all()
    assert not status.now().any()
    assert (seen.now() == np.where(known, expected[..., 4], 255)).all()


def test_border_is_the_mirror_image_of_the_frame(session: Session, mapped: Any) -> None:
    rng, shape, guard = np.random.default_rng(11), mapped.shape, mapped.guard
    value, w, coc = rng.random((4, *shape)).astype(np.float32), rng.random(shape), rng.random(shape)  # one more plane
    known = rng.random(shape) < 0.3
    known[guard:-guard, guard:-guard] = rng.random((5, OWNED_PIXELS)) < 0.7
    expected, after = extend_border(np.stack([*value[:3], w, coc], axis=-1), known, guard)
    assert known.sum() + 100 < after.sum() < known.size - 100
    planes = [Amid(session, plane, 0) for plane in (value, w, coc, known.astype(np.uint8))]
    run(session, mapped, "extend_border", shape[::-1], LOCAL, **dict(zip(PLANES, planes, strict=True)))
    found = [plane.now() for plane in planes]
    assert (np.stack([*found[0][:3], *found[1:3]], axis=-1) == expected).all()
    assert (found[0][3] == value[3]).all()
    assert (found[3] == after).all()


def test_what_enters_the_frame_is_its_mirror_image(session: Session, mapped: Any) -> None:
    """Winners and what is known at random, and mostly near the frame's edges, so that lines begin with what entered."""
    rng, shape, guard = np.random.default_rng(13), mapped.shape, mapped.guard
    filled = mapped.plan.scene.model_copy(update={"fill": Fill(method="ait")})
    case = replace(mapped, plan=replace(mapped.plan, scene=filled))
    rows, columns = 5, OWNED_PIXELS
    entering = filling = 0
    for share in (0.05, 0.3, 0.6, 0.9):
        row, column = rng.integers(0, rows, shape), rng.choice([0, 1, 2, columns - 3, columns - 2, columns - 1], shape)
        winner, known = row * columns + column, rng.random(shape) < share
        marked, halves = Amid(session, np.zeros(shape, np.uint8), 0), ((0, rows), (rows, rows + columns))
        given = {"winner": Amid(session, winner.astype(np.int32), 0), "valid": Amid(session, known.astype(np.uint8), 0)}
        for first, end in halves:
            run(session, case, "mark_entered", (end - first,), (8,), first=first, end=end, status=marked, **given)
        entered = mark_entered(winner, known, guard)
        assert (marked.now() == entered).all()
        value, w, coc = rng.random((4, *shape)).astype(np.float32), rng.random(shape), rng.random(shape)
        seen = rng.integers(0, 2, shape).astype(np.uint8)
        planes = [Amid(session, plane, 0) for plane in (value, w, coc, known.astype(np.uint8))]
        objects = Amid(session, seen, 0)
        for first, end in halves:
            lines = {"first": first, "end": end, "status": marked, "seen": objects}
            run(session, case, "fill_entered", (end - first,), (8,), **lines, **dict(zip(PLANES, planes, strict=True)))
        values = np.stack([*value[:3], w, coc], axis=-1)
        expected, whose, valid = fill_entered(values, seen, known, entered, guard)
        found = [plane.now() for plane in planes]
        assert (np.stack([*found[0][:3], *found[1:3]], axis=-1) == expected).all()
        assert (objects.now() == whose).all()
        assert (found[3] == valid).all()
        assert (marked.now() == np.where(entered, np.where(valid, 1, 2), 0)).all()
        entering, filling = entering + int(entered.sum()), filling + int((valid & ~known).sum())
    assert entering > filling > 50


def test_where_nothing_is_the_first_object_stands(session: Session, mapped: Any) -> None:
    depth = np.where(np.arange(5 * OWNED_PIXELS).reshape(5, OWNED_PIXELS) % 3 == 0, 1 / 260.0, 0.0)
    expected, whose = reproject_rest(mapped.plan.scene, mapped.rest, [None, depth])
    assert (expected == 0).any()
    assert set(whose.ravel().tolist()) == {0, 1}
    rest, of = Amid(session, np.full(whose.shape, 9.0), 9), Amid(session, np.full(whose.shape, 9, np.uint8), 9)
    members = np.uint64(1)  # the ball
    inputs = {"surfaces": surfaces(mapped), "count": 2, "members": members, "maps": depth}
    run(session, mapped, "reproject_rest", whose.shape[::-1], LOCAL, rest=rest, object=of, **inputs)
    np.testing.assert_allclose(rest.now(), expected, rtol=1e-12)  # some eps
    assert (of.now() == whose).all()


def test_far_side_of_a_cut_surface_is_seen(session: Session, make_case: Maker) -> None:
    case = replace(make_case((CUT,), (5, 9)), real="float")
    expected = reproject_rest(case.plan.scene, case.rest, case.maps)[0]
    assert (expected < 1 / 283.0).all()
    rest = empty(session, 8 * expected.size)
    inputs = {"surfaces": surfaces(case), "count": 1, "members": np.uint64(1)}
    run(session, case, "reproject_rest", (9, 5), LOCAL, rest=rest, **inputs)
    np.testing.assert_allclose(whole(session, rest, (5, 9), "float"), expected, rtol=1e-6)


def in_place(entry: int, point: Array, center: Array) -> Pose:
    """A large multiple of one coordinate is added to another, and taken away again where it is that of the point."""
    turn = np.eye(3)
    turn.flat[entry] += 1e6 / 3 if entry % 3 == 2 else 1e9 / 3
    return Pose(turn, point - center - turn @ (point - center))


def test_targets_have_all_digits_of_a_pose(session: Session, make_case: Maker) -> None:
    """A place beyond the grid on any side by a pixel is no target."""
    case = make_case((CUT,), (2, 2), guard=0)
    rest, whose = np.full((2, 2), 1 / 256.0), np.zeros((2, 2), np.uint8)
    step = float(case.grid["step"])
    pixel, center = 256.0 * step, np.array([0.0, 0.0, 280.0])
    first = np.array([-0.5 * pixel, 0.5 * pixel, 256.0])
    poses = [in_place(entry, first, center) for entry in range(9)]
    poses += [Pose(np.eye(3), np.array([x, y, 0.0]) * pixel) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    bounds = empty(session, 16)
    for pose in poses:
        expected, depth = reproject_targets(case.plan.scene, [pose], rest, whose, 0)
        target, moved = Amid(session, np.full(4, 9, np.int32), 9), empty(session, 32)
        inputs = {"surfaces": surfaces(case), "poses": pose_structs([pose], "double"), "rest": rest}
        run(session, case, "reproject_targets", (2,), (8,), target=target, moved=moved, bounds=bounds, **inputs)
        assert (target.now() == expected).all()
        np.testing.assert_allclose(whole(session, moved, (4,), "double"), depth, rtol=1e-6)
