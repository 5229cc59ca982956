"""Ways of objects over the image while a shutter is open, and the time samples that they need."""

from __future__ import annotations

from math import hypot, pi, sqrt
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.optics import image_motion
from clsco.optics.exposure import subframes_of
from clsco.optics.image_motion import EDGE_ERROR, MOST_SUBFRAMES, ImagePath, image_paths, motion_needs, motion_samples
from clsco.optics.lens import blur_radius
from clsco.optics.motion import poses_at
from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.circle import Circle
from clsco.scene.model import (
    Camera,
    Cylinder,
    DepthMap,
    Motion,
    ObjectMotion,
    Plane,
    Psf,
    Rectangle,
    Scene,
    Sequence,
    Sphere,
)
from tests.optics.test_resolved_view import SIDES, STEP
from tests.scenes import plan_of, plan_scene, scene_of
from tests.slow import mostly_slow

RIGHT = ObjectMotion(velocity=(10.0, 0.0, 0.0))
MAP = DepthMap(depth="map.npy")
LENS = PointSpread(Circle())


def path_of(given: Scene, number: int = 0, maps: Any = None, frame: int = 0, guard: int = 0) -> ImagePath:
    return image_paths(given, maps or (None,) * len(given.objects), frame, guard)[number]


# Ways


@pytest.mark.parametrize(("axis", "side"), SIDES)
def test_ways_are_looked_at_out_to_the_outermost_pixels(axis: str, side: int) -> None:
    """A tilted plane is nearest on one side, where its points go farthest: w = (1 - b x / s0) / a; a grows by -10 b."""
    item = Plane.model_validate({"distance": 280.0, axis: side * 1.5, "motion": RIGHT})
    out = 31.5 if axis == "slope_x" else 23.5
    nearest = (1.0 + 1.5 * out * STEP) / (265.0 if (axis, side) == ("slope_x", 1) else 280.0)
    assert path_of(scene_of(item)).speed == pytest.approx(10.0 * nearest / STEP, rel=1e-9)


@pytest.mark.parametrize(("distance", "expected"), [(250.0, 80.0), (285.0, 70.2)])
def test_displacement_of_the_thesis(distance: float, expected: float) -> None:
    """10 mm at 250 and 285 mm: 80 and 70 px (4.3.3; 70.175 exactly)."""
    item = Plane(distance=distance, motion=RIGHT)
    assert path_of(scene_of(item, size=(640, 480))).longest == pytest.approx(expected, abs=0.03)
    half = scene_of(item, size=(640, 480), sequence=Sequence(shutter=0.5))
    assert path_of(half).longest == pytest.approx(expected / 2, abs=0.03)


def test_a_uniform_motion_has_its_way_as_speed_and_variation() -> None:
    path = path_of(scene_of(Sphere(motion=RIGHT), size=(640, 480)))
    assert path.longest == pytest.approx(80.0, rel=1e-3)  # its nearest point, at 250 mm, goes 10 mm to the right
    assert path.speed == pytest.approx(path.longest, rel=1e-9)
    assert path.variation == pytest.approx(path.longest, rel=1e-9)


@pytest.mark.parametrize(
    ("speed", "opens", "closes"), [(20.0, 250.0, 260.0), (-20.0, 220.0, 210.0)], ids=["away", "towards"]
)
def test_the_largest_way_of_a_sequence_is_in_its_first_or_last_frame(speed: float, opens: float, closes: float) -> None:
    """The corner of a plane that goes along the axis, 10 mm per frame in four frames: near the lens it goes farther."""
    item = Plane(distance=250.0, motion=ObjectMotion(velocity=(0.0, 0.0, speed)))
    given = scene_of(item, sequence=Sequence(frames=4, interval=0.5))
    corner = hypot(31.5, 23.5)
    way = max(path_of(given, frame=frame, guard=9).longest for frame in image_motion.sampled_frames(given))
    near = min(opens, closes)
    assert way == pytest.approx(corner * 10.0 / near, rel=1e-9)  # of what comes into the frame, or leaves it
    (need,) = motion_needs(given, LENS, guard=9)
    assert need.speed == pytest.approx(corner * 10.0 / near * (near + 10.0) / near, rel=0.05)  # where it is nearest


def test_a_full_turn_is_as_long_as_its_circle() -> None:
    item = Plane(distance=280.0, motion=ObjectMotion(angular_velocity=(0.0, 0.0, 360.0)))
    path = path_of(scene_of(item), guard=16)
    circle = 2.0 * pi * hypot(31.5, 23.5)
    assert path.longest == pytest.approx(circle, rel=5e-3)
    assert path.speed == pytest.approx(circle, rel=5e-3)
    assert path.variation == pytest.approx(circle * (1.0 + pi), rel=0.05)


@pytest.mark.parametrize("turns", [16, 32, 40])
def test_what_turns_in_step_with_the_times_is_seen_to_turn(turns: int) -> None:
    """A rod that turns, about the middle of the frame, once for each step of even times."""
    item = Rectangle(
        center=(0.0, 0.0, 280.0), size=(6.0, 1.0), motion=ObjectMotion(angular_velocity=(0.0, 0.0, 360.0 * turns))
    )
    circle = 2.0 * pi * hypot(3.0, 0.5) / 280.0 / STEP
    assert path_of(scene_of(item)).longest == pytest.approx(turns * circle, rel=0.06)


def test_a_way_there_and_back_counts_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    given = scene_of(Plane(distance=250.0, motion=RIGHT), size=(640, 480))
    monkeypatch.setattr(image_motion, "poses_at", lambda scene, time: poses_at(scene, abs(time - 0.5)))
    path = path_of(given)
    assert path.longest == pytest.approx(80.0, rel=0.05)
    assert path.speed == pytest.approx(80.0, rel=1e-9)
    assert path.variation == pytest.approx(160.0, rel=0.05)


def test_what_comes_into_the_frame_while_the_shutter_is_open_is_seen() -> None:
    """A ball that crosses the frame in the middle of the exposure, and is outside of it at both ends."""
    item = Sphere(center=(-30.0, 0.0, 250.0), radius=1.0, motion=ObjectMotion(velocity=(60.0, 0.0, 0.0)))
    assert path_of(scene_of(item)).speed == pytest.approx(60.0 / 249.0 / STEP, rel=1e-3)


def test_a_thing_that_no_ray_meets_goes_as_its_middle_does() -> None:
    ends = ((-10.0, 10.0), (-10.0, 10.0), (-10.0, 10.0))
    item = Cylinder(
        center=(0.31, 0.0, 250.0), radius=0.01, axis=(1.0, 1.9, 0.0), bounds=ends, motion=RIGHT
    )  # fmt: skip
    assert path_of(scene_of(item)).speed == pytest.approx(80.0, rel=0.01)


def test_what_is_not_in_sight_or_stands_still_needs_nothing() -> None:
    hidden = Sphere(center=(900.0, 0.0, 280.0), motion=RIGHT)
    assert motion_needs(scene_of(hidden, Plane(distance=300.0)), LENS) == []
    assert plan_of(hidden).samples == 1
    assert plan_of(hidden).choices.motion.reason == "from the motion: none is seen"


def test_what_lights_the_frame_from_beside_it_is_in_sight() -> None:
    beside = Sphere(center=(6.0, 0.0, 280.0), radius=1.0, motion=ObjectMotion(velocity=(0.0, 1.0, 0.0)))
    given = scene_of(beside)  # its middle is 43 px from the middle of the frame
    assert path_of(given).speed == 0.0
    assert path_of(given, guard=24).speed == pytest.approx(1.0 / 280.0 / STEP, rel=0.01)


# Time samples


def test_the_fastest_of_several_objects_decides() -> None:
    still, moving = Plane(distance=300.0), Plane(distance=250.0, motion=RIGHT)
    for items in ((still, moving), (moving, still)):
        (need,) = motion_needs(scene_of(*items), LENS)
        assert need.number == items.index(moving)
        assert need.samples == need.speed == pytest.approx(80.0, rel=1e-9)


def test_a_map_of_which_little_is_seen_has_a_sample_per_pixel() -> None:
    """One pixel in 300 has a surface, at 250 mm: 10 mm are 80 px there."""
    inverse_depth = np.zeros((48, 64))
    inverse_depth[20, 10:20] = 1.0 / 250.0
    item = MAP.model_copy(update={"motion": RIGHT})
    (need,) = motion_needs(scene_of(item), LENS, (inverse_depth,))
    assert need.samples == need.speed == pytest.approx(80.0, rel=1e-9)


@pytest.mark.parametrize("speed", [0.05, 0.2, 0.3, 0.5, 1.0, 3.3, 10.0])
def test_what_is_in_focus_has_a_sample_for_each_pixel_of_its_motion(speed: float) -> None:
    item, ends = Plane(distance=280.0, motion=ObjectMotion(velocity=(speed, 0.0, 0.0))), {"focus_distance": 280.0}
    given, way = plan_of(item, camera=ends), speed / 280.0 / STEP
    assert given.samples % 2 == 1
    assert way <= given.samples < way + 2


def test_what_is_blurred_needs_fewer() -> None:
    """A plane across the axis that moves by 40 px has a single R: the bound of the module's head."""
    item = Plane(distance=500.0, motion=ObjectMotion(velocity=(10.0, 0.0, 0.0)))
    given = scene_of(item, size=(640, 480))
    (need,) = motion_needs(given, LENS)
    radius = abs(float(blur_radius(given.camera, 1.0 / 500.0)))
    assert need.radius == pytest.approx(image_motion.BETWEEN * radius, rel=1e-9)
    assert need.samples == pytest.approx(sqrt(2.0 / pi * 40.0 / (24.0 * need.radius * EDGE_ERROR)), rel=0.01)
    assert need.samples < 0.5 * need.speed
    assert str(need) == f"11 (40 px, R from {need.radius:.3g} px)"


ACROSS = Plane(distance=500.0, motion=RIGHT)


@pytest.mark.parametrize(
    ("item", "sections"),
    [
        (Plane(distance=270.0, slope_x=6.0, motion=RIGHT), {}),
        (Plane(distance=240.0, motion=ObjectMotion(velocity=(10.0, 0.0, 20.0))), {}),
        (ACROSS, {"sequence": Sequence(sampling="endpoint")}),
        (ACROSS, {"motion": Motion(warp="forward")}),
    ],
    ids=["tilted through the focus", "moves through the focus", "endpoint", "forward"],
)  # fmt: skip
def test_a_sample_for_each_pixel_where_blur_does_not_even_out_the_steps(item: Plane, sections: Any) -> None:
    given = plan_of(item, size=(640, 480), **sections)
    way = path_of(given.scene).speed
    assert given.samples >= way


def test_what_is_hidden_without_visibility_tests_has_a_sample_for_each_pixel() -> None:
    """Its outline is as sharp as it is, whatever passes before it; where nothing else is, blur evens the steps out."""
    plain = Psf(occlusion="none")
    alone, pair = (
        plan_of(*items, size=(640, 480), psf=plain) for items in ((ACROSS,), (ACROSS, Plane(distance=900.0)))
    )
    assert pair.samples >= path_of(pair.scene).speed > 1.5 * alone.samples
    assert alone.samples == plan_of(ACROSS, size=(640, 480)).samples


def test_a_plan_says_which_objects_need_how_many() -> None:
    items = [
        Sphere(name=name, center=(0.0, 0.0, 380.0), radius=9.0, motion=ObjectMotion(velocity=(speed, 0.0, 0.0)))
        for name, speed in (("a", 1.0), ("b", 3.0), ("c", 5.0), ("d", 7.0))
    ]
    reason = plan_of(*items, size=(640, 480)).choices.motion.reason
    assert [word for word in reason.split() if word in "abcd"] == ["d", "c", "b"]
    assert reason.endswith(", 1 more")


EDGE: dict[str, Any] = {
    "camera": {"resolution": [96, 12], "pixel_pitch": 0.05, "aperture_diameter": 80.0},
    "sequence": {"frames": 1},
    "object": [
        {"shape": "rectangle", "center": [-40.0, 0.0, 400.0], "size": [80.0, 200.0], "texture": "#ffffff",
         "motion": {"velocity": [10.0, 0.0, 0.0]}},
    ],
}  # fmt: skip
LIGHT_BEHIND = {"shape": "plane", "distance": 600.0, "texture": "#ffffff"}


LENSES: dict[str, Any] = {
    "disc": {}, "Gaussian": {"psf": {"model": "gaussian"}}, "hexagon": {"aperture": {"shape": "polygon", "blades": 6}},
}  # fmt: skip


@pytest.mark.parametrize("behind", mostly_slow([[], [LIGHT_BEHIND]], [[]]), ids=["a light edge", "what it hides"])
@pytest.mark.parametrize("name", mostly_slow(list(LENSES), ["disc"]))
def test_the_error_at_an_edge_is_within_the_bound_and_not_far_from_it(name: str, behind: Any) -> None:
    (card,) = EDGE["object"]
    if behind:
        card = card | {"texture": "#000000"}
    given = EDGE | LENSES[name] | {"object": [card, *behind]}
    found = clsco.render_frame(given, truth=())
    exact = clsco.render_frame(given | {"sequence": {"frames": 1, "samples": 129}}, truth=())
    samples = found.metadata["samples"]
    assert 3 <= samples < 0.8 * path_of(clsco.parse_scene(given)).speed
    error = float(np.abs(found.color - exact.color).max())
    assert 0.2 * EDGE_ERROR < error <= EDGE_ERROR


# Rolling shutters


def rolling_scene(speed: float, shutter: float, readout: float, samples: Any = "auto") -> Scene:
    """A plane whose image moves at so many px/s."""
    camera = Camera(resolution=(64, 48), pixel_pitch=0.1)
    motion = ObjectMotion(velocity=(speed * 0.1 * 280.0 / 20.0, 0.0, 0.0))
    sequence = Sequence(interval=9.0, shutter=shutter, readout=readout, samples=samples)
    return Scene(camera=camera, objects=(Plane(distance=280.0, motion=motion),), sequence=sequence)


def chosen(scene: Scene) -> int:
    return motion_samples(scene, motion_needs(scene, LENS))


@pytest.mark.parametrize(
    ("speed", "shutter", "readout", "samples"),
    [
        (24.3, 1.0, 1.0, 25),  # one for a px
        (24.0, 0.1, 1.0, 11),  # shared by rows: enough that their ends matter little
        (1.5, 0.1, 1.0, 3),
        (24.0, 1e-3, 1.0, 1),  # of each row alone
        (24.0, 1.0, 0.0, 25),
    ],
)
def test_samples_while_a_row_is_exposed(speed: float, shutter: float, readout: float, samples: int) -> None:
    assert chosen(rolling_scene(speed, shutter, readout)) == samples


def test_subframes_are_bounded() -> None:
    """Fewer by themselves; of a number that is given a message says so."""
    scene = rolling_scene(24e6, 1e-3, 1.0)
    assert subframes_of(scene, chosen(scene)) <= MOST_SUBFRAMES
    rule = r"sequence.readout: must give at most 8192 sub-frames; got 9600 \(fewer samples, a shorter readout or a"
    with pytest.raises(SceneError, match=rule):
        plan_scene(rolling_scene(24.0, 1e-3, 1.0, 200), 1)
