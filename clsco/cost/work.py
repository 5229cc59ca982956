"""Work of the passes of a frame: rays, tests, sources and their taps, from a lattice of pixels (float64, pure).

What rays hit, and what hides the lens from it, is found as by the reference, at one pixel of each cell of a lattice
over frame and apron, in the middle of the exposure of the first frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import ceil

import numpy as np
from numpy.typing import NDArray

from clsco.constants import BAND, MAP_TRIPLANAR, TAP_LANES
from clsco.inputs.focus import find_visible
from clsco.inputs.textures import mapped_size
from clsco.optics.exposure import frame_exposure, middle_time
from clsco.optics.lens import Lens
from clsco.optics.lens_path import lens_at, reference_camera
from clsco.optics.motion import poses_at
from clsco.optics.psf_grid import row_lanes
from clsco.optics.quadrics import cutting_bounds, place
from clsco.optics.still import exposed, numbers
from clsco.optics.texture_mapping import detail_least, texture_map, texture_spread
from clsco.optics.visibility import NO_GROUP, OcclusionGroup
from clsco.plan.buffers import has_spans
from clsco.plan.passes import ONCE_A_FRAME, Pass
from clsco.plan.plan import Plan
from clsco.plan.predict import Maps
from clsco.reference.common.equation import WIDE_LENS, Points, division_of
from clsco.reference.common.geometry import (
    along_rays,
    blur_radius,
    nearest_surface,
    pixel_ray,
)
from clsco.reference.common.visibility import CLEAR, HIDDEN, PARTLY, meet_occluder, meet_rims, out_of_the_way
from clsco.reference.trace.footprint import parts_of
from clsco.reference.trace.mapping import MappedTexture, along_axis, mapped_point, texel_change
from clsco.reference.trace.trace import SILHOUETTE_RANGE, gradient_of, view_at
from clsco.reference.trace.view import View

Array = NDArray[np.float64]
Work = dict[str, float]
"""Operation (a name in `clsco.cost.rates.RATES`) -> how many of them."""

LATTICE, LEAST_LATTICE = 96, 32  # cells along the longer side, in scenes of some objects and of many
FEW_TESTS = 24  # of objects by rays and of occluders by points, from which on there are fewer cells
MANY_TESTS = 96  # and from which on occluders count as unbounded in what they hide, which takes far less
DEPTH_LAYERS = 4  # that are reckoned with: there are up to 8, as the image has discontinuities
MOST_PLACES = 9  # of what moves, that are looked at
REFLECTIONS = 3  # images of a triplanar mapping


@dataclass(frozen=True, eq=False)
class Lattice:
    """Pixels of frame and apron at equal steps.

    Attributes
    ----------
    row, column : ndarray of float64, (n,) and (m,)
        Positions in the frame, px.
    step_y, step_x : float
        Between them, px.
    """

    row: Array
    column: Array
    step_y: float
    step_x: float

    def total(self, values: NDArray[np.generic]) -> float:
        """Sum over all pixels of values (n, m) of those of the lattice."""
        return float(np.sum(values, dtype=np.float64)) * self.step_y * self.step_x


def lattice_of(plan: Plan) -> Lattice:
    """Lattice over the frame and the apron of a plan."""
    longer = max(LEAST_LATTICE, LATTICE * min(1.0, FEW_TESTS / _tests(plan)) ** 0.5)
    found = list[tuple[Array, float]]()
    for size in (plan.height, plan.width):
        count = min(size, max(1, round(size * longer / max(plan.height, plan.width))))
        found.append(((np.arange(count) + 0.5) * size / count - 0.5 - plan.guard_px, size / count))
    (row, step_y), (column, step_x) = found
    return Lattice(row, column, step_y, step_x)


def _tests(plan: Plan) -> int:
    """Objects that rays of all occlusion groups are cast at, and occluders that are tested for what they hit."""
    return sum(group.members.bit_count() + group.occluders.bit_count() for group in plan.groups)


def frame_work(plan: Plan, maps: Maps) -> list[tuple[Pass, Work]]:
    """Work of every pass of a plan for one frame.

    Parameters
    ----------
    plan : Plan
    maps : sequence of ndarray of float64 (rows, columns) or None
        As for `clsco.plan.plan.make_plan`.

    Returns
    -------
    list of (Pass, dict)
        In the order of `Plan.passes`.
    """
    lattice, light = lattice_of(plan), plan.apart[0] if plan.apart else plan
    of_kind: dict[str, Work] = {}
    groups: dict[OcclusionGroup, dict[str, Work]] = {NO_GROUP: of_kind}
    if any(each.kind == "trace" for each in plan.passes):
        groups |= {group: _of_group(light, group, lattice) for group in plan.groups}
    else:
        of_kind |= _of_image(light, lattice, maps)
    of_kind["ground truth"] = _of_truth(plan)
    planes = plan.channels * plan.rows * plan.columns * (1.0 + plan.divided / plan.repeats)
    of_kind["join colors"] = {"accumulated": float(plan.rows * plan.columns)}
    of_kind["vignetting"] = {"accumulated": float(plan.colors * plan.rows * plan.columns)}
    of_kind["accumulate"] = {"accumulated": planes}
    if plan.sensor_model is not None:
        codes = float(len(plan.sensor_model.filters) * plan.rows * plan.columns)
        of_kind["sensor"] = {"sensed": codes, "patterned": codes * plan.sensor_model.has_pattern}
    shared = sum(strip.height for strip in plan.strips) / plan.height  # strips have rows of sources in common
    found = []
    for each in plan.passes:
        often = 1.0 if each.kind in ONCE_A_FRAME else plan.repeats * shared
        work = groups[each.group][each.kind]
        found.append((each, {name: often * count for name, count in work.items() if count}))
    return found


@dataclass(frozen=True, eq=False)
class Hits:
    """Hits of rays through a lattice at an occlusion group, (n, m) each.

    number: object, -1 for none; label: with the sides of other surfaces, as `trace` has it; radius: signed, px; state:
    CLEAR, PARTLY or HIDDEN; tests, cuts: occluders that are looked at, and those of them that are curved and bounded;
    edges: occluders that are tested for taps, and `cut_edges` those of them that are curved and bounded; rims: those of
    the lens that cut the light.
    """

    rays: Array
    w: Array
    number: NDArray[np.int32]
    label: NDArray[np.uint8]
    radius: Array
    state: NDArray[np.uint8]
    tests: Array
    cuts: Array
    edges: Array
    cut_edges: Array
    rims: Array


def _hits(plan: Plan, view: View, group: OcclusionGroup, lattice: Lattice) -> Hits:
    scene, camera = plan.scene, view.scene.camera
    bounds = [cutting_bounds(item) for item in scene.objects]
    rays = pixel_ray(camera, lattice.row[:, None], lattice.column[None, :])
    w, label, number = nearest_surface(view.surfaces, bounds, group, rays)
    hit = w > 0.0
    radius, state = np.where(hit, blur_radius(view.lens, rays, w), 0.0), np.full(w.shape, CLEAR)
    tests, cuts, edges, cut_edges = (np.zeros(w.shape) for _ in range(4))
    gradient = np.zeros((*w.shape, 2))
    for k in np.flatnonzero(np.bincount(number[hit])).tolist() if scene.psf.tilt else ():
        here = hit & (number == k)
        gradient[here] = gradient_of(view, view.surfaces[k], rays[here], w[here])
    label, many = label.copy(), _tests(plan) > MANY_TESTS
    for k, surface in enumerate(view.surfaces):
        own = k == group.own
        if not group.occluders >> k & 1 or (own and group.root == (2 if surface.constant < 0 else 1)):
            continue
        near = hit.copy()
        near[hit] = ~out_of_the_way(view.lens, surface, rays[hit], w[hit], plan.psf.extent)
        size = radius[near]
        if not size.size:
            continue
        points = Points(rays[near], w[near], size, 0 * size, 0 * size, 1.0, gradient[near])
        division = division_of(size, plan.psf.extent, points.width, points.gradient)
        cut = bounds[k] is not None and bool(surface.canonical.q.any())
        found, edge, *_ = meet_occluder(view.lens, surface, None if many and cut else bounds[k], points, division, own)
        label[near] ^= edge.astype(np.uint8) << 7
        state[near] = np.maximum(state[near], found)
        tests[near] += 1.0
        cuts[near] += cut
        edges[near] += found == PARTLY
        cut_edges[near] += cut & (found == PARTLY)
    rims = np.zeros(w.shape)
    if plan.psf.rims and hit.any():
        found, rims[hit] = _cut(plan, view.lens, rays[hit], w[hit], radius[hit], gradient[hit])
        state[hit] = np.maximum(state[hit], found)
    return Hits(rays, w, number, label, radius, state, tests, cuts, edges, cut_edges, rims)


def _cut(
    plan: Plan, lens: Lens, rays: Array, w: Array, radius: Array, gradient: Array
) -> tuple[NDArray[np.uint8], Array]:
    """State of points (N,) whose light rims cut, as `meet_rims` gives it, and the number of rims that do."""
    points = Points(rays, w, radius, 0 * radius, 0 * radius, 1.0, gradient)
    found, circles = meet_rims(lens, plan.psf, points, division_of(radius, plan.psf.extent, 1.0, gradient))
    return found, np.asarray(sum(circle.cuts for circle in circles) * (found == PARTLY))


def _of_group(plan: Plan, group: OcclusionGroup, lattice: Lattice) -> dict[str, Work]:
    """Work of the passes of an occlusion group at a time sample, by their kinds; of a divided frame the mean."""
    scene = plan.scene
    time = middle_time(scene.sequence, 0) if plan.moves else 0.0
    view = view_at(scene, (), time, plan.eye, scene.is_displaced or plan.eye_moved)
    hits = _hits(plan, view, group, lattice)
    every = np.ones(hits.w.shape, np.bool_)
    if not plan.divided:
        return _of_part(plan, group, lattice, view, hits, (every, every))
    changed, window = _changed(plan, group, hits, lattice)
    found = _of_part(plan, group, lattice, view, hits, (changed, window))
    for kind, work in _of_part(plan, group, lattice, view, hits, (~changed, every)).items():
        for name, count in work.items():
            found[kind][name] = found[kind].get(name, 0.0) + count / plan.repeats
    return found


def _changed(
    plan: Plan, group: OcclusionGroup, hits: Hits, lattice: Lattice
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # fmt: skip
    """Sources that are not the same at all time samples (n, m), and pixels whose rays are cast for them."""
    scene, camera = plan.scene, plan.scene.camera
    times = frame_exposure(scene, 0, min(plan.samples, MOST_PLACES)).times.tolist()
    posed = [zip(scene.objects, poses_at(scene, time, plan.eye), strict=True) for time in times]
    found = exposed(scene.objects, [[place(item, pose) for item, pose in each] for each in posed])
    ends = found.window(group, camera, plan.psf.extent, plan.guard_px, -plan.guard_px, plan.height)
    if ends is None:
        return np.zeros(hits.w.shape, np.bool_), np.zeros(hits.w.shape, np.bool_)
    down, across = ((at + plan.guard_px)[:, None] for at in (lattice.row, lattice.column))
    window = (down >= ends[1]) & (down < ends[3]) & ((across >= ends[0]) & (across < ends[2])).T
    changed = np.isin(hits.number, numbers(found.changing))
    x, y = hits.rays[..., 0], hits.rays[..., 1]
    for k in numbers(found.moving & group.occluders):
        for left, right, low, high, _, near, *_ in found.places[:, k]:
            way = Lens.of(camera).radius * plan.psf.extent * np.maximum(near - hits.w, 0.0)
            changed |= (way > 0.0) & (x + way >= left) & (x - way <= right) & (y + way >= low) & (y - way <= high)
    return changed & window, window


def _of_part(
    plan: Plan, group: OcclusionGroup, lattice: Lattice, view: View, hits: Hits,
    part: tuple[NDArray[np.bool_], NDArray[np.bool_]],
) -> dict[str, Work]:  # fmt: skip
    """Work of a part of the sources, by masks of where they are and where their rays are cast (n, m)."""
    total, (made, cast) = lattice.total, part
    found = {"trace": _of_rays(plan, group, hits.number, lattice, cast)}
    found["trace"] |= {"test": total(cast * hits.tests), "cut test": total(cast * hits.cuts)}
    finer = alike = np.zeros(hits.w.shape)
    if plan.silhouettes:
        marked, rays = cast * _near_silhouettes(hits.label, lattice), plan.silhouettes**2
        detailed = cast * (1.0 - marked) * (_parts(plan, view, hits) > 0)
        images = made * _images(plan, hits.number)
        found["silhouettes"] = {
            "marked": total(cast),
            "sub-pixel ray": rays * total(marked + detailed) * group.members.bit_count(),
            "sub-pixel mapped": rays * total(marked * images),
            "sub-pixel test": rays * total(made * marked * hits.tests),
            "detail": total(detailed * images),
        }
        finer, alike = np.maximum(marked, detailed), np.where(detailed > marked, detailed, 0.0)
    lit = made & (hits.w > 0.0) & (hits.state != HIDDEN)
    found["blur"] = _of_blur(plan, lattice, hits.radius, lit, finer, hits, alike)
    return found


def _of_rays(
    plan: Plan, group: OcclusionGroup, number: NDArray[np.int32], lattice: Lattice, cast: NDArray[np.bool_]
) -> Work:  # fmt: skip
    """Work of rays that hit objects of these numbers, -1 for none, where they are cast."""
    images, moved = cast * _images(plan, number), bool(plan.features()["MOVED"])
    return {
        "ray": group.members.bit_count() * lattice.total(cast),
        "moved": plan.channels * lattice.total(cast & (number >= 0) & (images == 0)) if moved else 0.0,
        "mapped": lattice.total(images),
        "lit": lattice.total(cast & (number >= 0)) if plan.scene.light is not None else 0.0,
    }


def _images(plan: Plan, number: NDArray[np.int32]) -> Array:
    """Images on the surface that is hit: of a mapped texture 1, of a triplanar mapping REFLECTIONS, else 0."""
    kinds = {None: 0.0, "triplanar": float(REFLECTIONS)}
    each = np.array([kinds.get(item.mapped, 1.0) for item in plan.scene.objects] + [0.0])
    return np.asarray(each[number])


def _near_silhouettes(label: NDArray[np.uint8], lattice: Lattice) -> Array:
    """Share (n, m) of each cell that is near a silhouette, which crosses the line between two neighbors."""
    found = np.zeros(label.shape)
    for own, labels, step in ((found, label, lattice.step_y), (found.T, label.T, lattice.step_x)):
        reach = SILHOUETTE_RANGE / step  # cells
        crossed = labels[1:] != labels[:-1]
        for away in range(min(ceil(reach), len(crossed))):
            share = min(reach - away, 1.0)
            own[1 + away :] += share * crossed[: len(crossed) - away]
            own[: len(crossed) - away] += share * crossed[away:]
    return np.minimum(found, 1.0)


def _parts(plan: Plan, view: View, hits: Hits) -> NDArray[np.intp]:
    """Parts (n, m) per axis into which textures on surfaces cut pixels, 0 where they do not."""
    scene, found = plan.scene, np.zeros(hits.w.shape, np.intp)
    for k, item in enumerate(scene.objects):
        here = (hits.number == k) & (hits.state != HIDDEN)
        if item.mapped is None or not here.any():
            continue
        placed = texture_map(item, *mapped_size(item.textures()))
        spread, least = texture_spread(plan.psf), detail_least(plan.psf)
        texture = MappedTexture((), placed, spread, least, scene.motion.texture_filter)
        point = mapped_point(view.surfaces[k], placed, view.scene.camera, hits.rays[here], hits.w[here])
        texels = np.zeros(len(point.at))
        sides = [partial(along_axis, axis=axis) for axis in range(REFLECTIONS)]
        for side in sides if placed.kind == MAP_TRIPLANAR else [np.asarray]:
            for step in (point.right, point.down):
                column, row = texel_change(placed, side(point.at), side(step))
                texels = np.maximum(texels, column**2 + row**2)
        found[here] = parts_of(texture, texels, hits.radius[here], scene.psf.silhouette_samples)
    return found


def _of_image(plan: Plan, lattice: Lattice, maps: Maps) -> dict[str, Work]:
    """Work of passes that take an image with its radii, by their kinds: depth maps, forward warp, layered occlusion."""
    sizes = zip(plan.scene.camera.frame_size[::-1], (lattice.row, lattice.column), strict=True)
    i, j = (np.clip(at.round().astype(np.intp), 0, size - 1) for size, at in sizes)
    w, number = find_visible(plan.scene, maps, i, j)
    lit, rays = w > 0.0, pixel_ray(reference_camera(plan.scene), i[:, None], j[None, :])
    radius = np.where(lit, blur_radius(lens_at(plan.scene, 0.0, plan.only), rays, w), 0.0)
    pixels = lattice.total(np.ones(w.shape))
    none, hits = np.zeros(w.shape), None
    if plan.psf.rims and lit.any():
        state, rims = np.zeros(w.shape, np.uint8), none.copy()
        lens, flat = along_rays(lens_at(plan.scene, 0.0, plan.only), rays[lit]), np.zeros((int(lit.sum()), 2))
        state[lit], rims[lit] = _cut(plan, lens, rays[lit], w[lit], radius[lit], flat)
        hits = Hits(rays, w, number.astype(np.int32), state, radius, state, none, none, none, none, rims)
    blur = _of_blur(plan, lattice, radius, lit, none, hits)
    layers: Work = {}
    for name, count in blur.items():
        layers[name] = count * (DEPTH_LAYERS if name == "walked" else (plan.channels + 1) / plan.channels)
    everything = OcclusionGroup((1 << len(plan.scene.objects)) - 1, 0)
    return {
        "pinhole": _of_rays(plan, everything, number.astype(np.int32), lattice, np.ones(w.shape, np.bool_)),
        "static image": {"sent": pixels * plan.channels},
        "reproject": {"reprojected": pixels * len(plan.scene.objects)},
        "fill": {"filled": pixels},
        "count missing": {"filled": pixels},
        "sources": {"sent": pixels},
        "cluster": {"layer pixel": DEPTH_LAYERS * pixels * (plan.channels + 1)},
        "depth layers": layers,
        "blur": blur,
    }


def _of_truth(plan: Plan) -> Work:
    pixels, objects = plan.rows * plan.columns, len(plan.scene.objects)
    return {"truth ray": float(pixels * objects), "truth image": float(pixels * plan.channels * (plan.mapped > 0))}


def _of_blur(
    plan: Plan, lattice: Lattice, radius: Array, lit: NDArray[np.bool_], finer: Array, hits: Hits | None = None,
    alike: Array | float = 0.0,
) -> Work:  # fmt: skip
    """Work of the blur of sources (n, m) of signed radii in px.

    finer: the share with sub-pixel sources; alike: that of which those are of one surface, which may share what hides
    the lens.
    """
    if plan.blur == "none":
        return {}
    psf, channels, total = plan.psf, plan.channels, lattice.total
    size = np.abs(radius)
    if plan.blur == "convolve":
        wide = 1.0 + 2.0 * float(psf.reaches(size).max())
        return {"convolved row": plan.rows * plan.columns * channels * wide}
    (visits, rows, taps), (fine_visits, fine_rows, fine_taps) = (_taps(plan, size, fine) for fine in (False, True))
    kind, planes = ("shape" if psf.has_runs else str(psf.layout)), channels
    if psf.stretched:  # of which chords take the time, whatever they are multiplied by
        kind, planes = "ellipse", 1
    subs = plan.silhouettes**2
    partly = np.zeros(lit.shape, np.bool_) if hits is None else hits.state == PARTLY
    whole, sub = lit & ~partly, (lit & ~partly) * finer * subs
    bands = -(-plan.rows // BAND)
    found = {
        "walked": float(bands * min(BAND + 2 * plan.spec.reach, plan.height) * plan.width),
        f"{kind} row": planes * total(whole * (1.0 - finer) * visits * rows),
        f"{kind} taps": planes * total(whole * (1.0 - finer) * taps),
        "sub-pixel source": total(sub * fine_visits),
        "sub-pixel taps": channels * total(sub * fine_taps),
    }
    if hits is not None and partly.any():
        narrow, edges = size * psf.extent < WIDE_LENS, hits.edges + hits.rims
        round_lens = psf.cut_by_chords and psf.pupil.borders is None
        columns = partly & (size >= 0.5) & (hits.edges == 0) & round_lens & (psf.edge == "integrated")
        one, fine = (lit & partly & ~columns) * (1.0 - finer), (lit & partly) * finer * subs
        once = (lit & partly & narrow) * alike * (subs - 1) * plan.spec.shared
        met, across = one * visits + (fine - once) * fine_visits, ~narrow * (one * rows + fine * fine_rows)
        tested = 0.0 * size if has_spans(plan.spec, plan.device.has_fp64) else ~narrow * (one * taps + fine * fine_taps)
        found |= {
            "rim row": total(lit * columns * (1.0 - finer) * visits * rows),
            "rim taps": channels * total(lit * columns * (1.0 - finer) * taps),
            "hidden source": total(met * edges),
            "edge row": total(across * (edges - hits.cut_edges)),
            "cut edge row": total(across * hits.cut_edges),
            "edge taps": channels * total(tested),
            "narrow edge": total(met * narrow * (edges - hits.cut_edges)),
            "narrow cut edge": total(met * narrow * hits.cut_edges),
        }
    return found


def _taps(plan: Plan, size: Array, fine: bool) -> tuple[Array, Array, Array]:
    """Bands that sources of |radii| in px reach, their rows, and their taps in vectors."""
    half = plan.psf.reaches(size.ravel(), fine).reshape(size.shape)
    rows = 2.0 * half.astype(np.float64) + 1.0
    return 1.0 + 2.0 * half / BAND, rows, rows * row_lanes(half) / TAP_LANES
