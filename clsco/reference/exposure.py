"""Time samples of a frame and their weights.

The number of time samples affects a frame with motion. The device's samples are used if their intervals cover the
exposure of each line, and if there are enough of them: the number that the scene sets or, for "auto", the number that
the displacement measured in this module requires. The weights of samples depend only on the shutter curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from clsco.optics.exposure import frame_exposure, jump_times
from clsco.optics.lens import Lens
from clsco.optics.lens_path import camera_at, lenses_at, reference_camera
from clsco.optics.motion import AT_REST, Eye, Pose, poses_at, rest_center
from clsco.optics.quadrics import cutting_bounds, place
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import Array, blur_radius, nearest_surface, pixel_ray, project
from clsco.reference.trace.trace import padded_grid
from clsco.scene.model import Camera, Object, Scene
from clsco.scene.sequence import CURVES

CLOSED = 1e-6  # share of an exposure; intervals that end this close to the end of the exposure cover it
STEPS = 64  # number of steps of an exposure, for paths in the image
LOOKS = (0, STEPS // 2, STEPS)  # steps at whose times rays sample the objects
# Error allowed at a moving edge, 1 = white; lower bound of the share of a lens's light that an edge crosses per radius.
EDGE_ERROR, CHORD = 5e-4, 0.5
MEASURED = 0.8  # share of the samples needed by points on a grid of rays that counts as sufficient
NEAREST = 1e-3  # least depth in mm, and least blur radius in px
MOST = 4095  # largest number of time samples while a line is exposed


def exposure_of(scene: Scene, index: int, claimed: int, least: float) -> tuple[Array, Array]:
    """Times (samples,) of a frame in s, and weights (samples, lines) for its rows or columns.

    Weights are (samples, 1) if they are equal for all lines. claimed: number of time samples on the device while a line
    is exposed; least: the number that is sufficient.
    """
    if not scene.moves:
        return np.zeros(1), np.ones((1, 1))
    sequence = scene.sequence
    shutter, opens, begin = sequence.shutter, np.zeros(1), index * sequence.interval + sequence.shutter_start
    if sequence.rolls:
        columns, rows = scene.camera.frame_size
        opens = np.linspace(0.0, sequence.readout, columns if sequence.by_columns else rows)
        opens = opens[::-1] if sequence.scan in ("bottom_to_top", "right_to_left") else opens
    alone = len(opens) > 1 and shutter * (len(opens) - 1) <= sequence.readout  # no two lines are open at once
    starts, length = (np.sort(opens), shutter) if alone else (np.zeros(1), sequence.readout + shutter)
    times = (frame_exposure(scene, index, claimed).times - begin).reshape(len(starts), -1)
    ends = [starts]
    for time in times.T:  # the middle of an interval, or its end
        ends.append(2.0 * time - ends[-1] if sequence.sampling == "midpoint" else time)
    shares, count = np.stack(ends, axis=1), ceil(least * length / shutter * (1.0 - 1e-9))
    covers = (np.abs(shares[:, -1] - starts - length) <= CLOSED * length).all() and (np.diff(shares) > 0.0).all()
    if not covers or times.shape[1] < count:
        shares = starts[:, None] + length * np.linspace(0.0, 1.0, count + 1)
        times = 0.5 * (shares[:, 1:] + shares[:, :-1]) if sequence.sampling == "midpoint" else shares[:, 1:]
    curve = CURVES[sequence.shutter_curve] if isinstance(sequence.shutter_curve, str) else sequence.shutter_curve
    weights = np.diff(light_passed(curve, (shares[..., None] - opens) / shutter), axis=1)
    return begin + times.ravel(), weights.reshape(times.size, -1)


def light_passed(curve: ArrayLike, time: Array) -> Array:
    """Fraction of an exposure's light that has passed at times from 0 to 1, by the trapezoidal rule.

    curve: weights of the shutter curve at equal time steps.
    """
    heights = np.asarray(curve, np.float64) / np.max(curve)
    nodes, inside = np.linspace(0.0, 1.0, len(heights)), np.clip(time, 0.0, 1.0)
    passed = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(nodes) * (heights[1:] + heights[:-1]))])
    last = np.minimum(np.searchsorted(nodes, inside, side="right") - 1, len(nodes) - 2)
    height = np.interp(inside, nodes, heights)
    return np.asarray((passed[last] + 0.5 * (inside - nodes[last]) * (heights[last] + height)) / passed[-1])


def least_samples(scene: Scene, maps: Sequence[Array | None], eye: Eye, index: int, guard: int) -> float:
    """Sufficient number of time samples while a line of a frame is exposed.

    It is the scene's number or, for "auto", the number that points of the objects need, including points up to `guard`
    px outside of the frame. maps: inverse depths of each object's depth map, or None.
    """
    sequence = scene.sequence
    if sequence.samples != "auto" or not scene.moves:
        return 1.0 if sequence.samples == "auto" else float(sequence.samples)
    begin, length = index * sequence.interval + sequence.shutter_start, sequence.shutter + sequence.readout
    times = (begin + length * np.linspace(0.0, 1.0, STEPS + 1)).tolist()
    jumps = np.searchsorted(times, jump_times(scene, index)) - 1  # steps with a jump, which is no motion
    cameras, poses = [camera_at(scene, t) for t in times], [poses_at(scene, t, eye) for t in times]
    lenses, line, needed = [lenses_at(scene, t) for t in times], sequence.shutter / length, 0.0
    for k, item in enumerate(scene.objects):
        center = rest_center(item)
        for look in LOOKS:
            camera, pose = (cameras[look], poses[look][k]) if maps[k] is None else (reference_camera(scene), AT_REST)
            rays, w = _seen_points(camera, item, pose, maps[k], guard)
            body = (rays / w[:, None] - center - pose.shift) @ pose.rotation
            places, radii = np.empty((STEPS + 1, len(w), 2)), np.empty((STEPS + 1, len(w)))
            for n, (camera, now) in enumerate(zip(cameras, poses, strict=True)):
                point = body @ now[k].rotation.T + center + now[k].shift
                point[:, 2] = np.maximum(point[:, 2], NEAREST)
                places[n] = np.stack(project(camera, point), axis=-1)
                radii[n] = _radii(lenses[n], point / point[:, 2:], 1.0 / point[:, 2])
            rows_columns = np.array(scene.camera.frame_size[::-1])
            inside = np.all((places >= -guard - 0.5) & (places <= rows_columns + guard - 0.5), axis=-1)
            steps = np.linalg.norm(np.diff(places, axis=0), axis=-1) * np.logical_and(inside[1:], inside[:-1])
            steps[jumps] = 0.0
            travel = line * steps.sum(axis=0)
            if sequence.sampling == "midpoint":
                blur = np.maximum(radii.min(axis=0), NEAREST)
                travel = np.minimum(travel, np.sqrt(CHORD * travel / (24.0 * blur * EDGE_ERROR)))
            needed = max(needed, float(travel.max(initial=0.0)))
            if scene.lens_moves:
                changes = np.abs(np.diff([_radii(lens, rays, w) for lens in lenses], axis=0))
                changes[jumps] = 0.0
                needed = max(needed, line * float(changes.sum(axis=0).max(initial=0.0)))
    return min(max(MEASURED * needed, 1.0), MOST)


def _seen_points(camera: Camera, item: Object, pose: Pose, depth: Array | None, guard: int) -> tuple[Array, Array]:
    """Rays (n, 3) and inverse depths (n,) of an object seen alone, at every second pixel, or at all pixels of a map."""
    row, column = (place[:: 1 + (depth is None), :: 1 + (depth is None)] for place in padded_grid(camera, guard))
    rays = pixel_ray(camera, row, column)
    if depth is None:
        alone = OcclusionGroup(1, 0)
        depth, _, _ = nearest_surface([place(item, pose)], [cutting_bounds(item)], alone, rays)
    else:
        depth = np.pad(depth, guard)
    return rays[depth > 0.0], depth[depth > 0.0]


def _radii(lenses: tuple[Lens, ...], rays: Array, w: Array) -> Array:
    """For each point, the smallest |R| in px over the colors of a lens, (n,)."""
    return np.asarray(np.min([np.abs(blur_radius(lens, rays, w)) for lens in lenses], axis=0))
