"""The reference's own plan, which omits no feature and makes none of the device's optimizations.

Each object is blurred separately, and in visibility tests every other object is an occluder. All pixels that an outline
can touch have sub-pixel sources, the guard band is twice as wide as needed, and radii are not clamped. The formulas of
`clsco.optics` are shared with the device, and so are approximations by design: cells of the lens, edges of occluders,
taps, and depth layers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens_path import lens_at, reference_camera
from clsco.optics.motion import Eye
from clsco.optics.point_spread import PointSpread, spreads_of_colors
from clsco.optics.pupils.circle import Circle
from clsco.optics.quadrics import cutting_bounds
from clsco.optics.visibility import OcclusionGroup
from clsco.plan.methods import BlurSpec, Occlusion, lens_cells
from clsco.plan.plan import make_plan
from clsco.plan.request import Request
from clsco.reference.common.geometry import Array, blur_radius, pixel_ray
from clsco.reference.trace.trace import SILHOUETTE_RANGE, everything, mark_silhouettes, padded_grid
from clsco.reference.trace.view import View
from clsco.scene.model import Object, Plane, Rectangle, Scene

Maps = Sequence[Array | None]  # inverse depths in 1/mm of every object, None for analytic objects
ROUND, BEYOND = 0.01, 1.1  # least difference of an ellipse from a disc, as a share of R; margin factor for ellipses
CASTS = 4  # rays per pixel along each axis, which may hit objects that rays through pixel centers miss
WIDEST_BAND = 1024  # px, largest width of the guard band


@dataclass(frozen=True, eq=False)
class ReferencePlan:
    """The reference's plan for a view of a scene.

    scene: a scene with a resolution; psf: PSF of its lens; spreads: PSFs of red, green and blue if each is blurred
    separately, else empty; channels: number of channels of the frame; only: number of the color that the plan is for,
    None for all; claimed: the device's number of time samples, guard band in px, and largest |R| in px. A frame with
    motion depends on the number of samples, and depth layers and moved pixels depend on the other two, so the device's
    values are used if they are sufficient.
    """

    scene: Scene
    psf: PointSpread
    spreads: tuple[PointSpread, ...]
    eye: Eye
    channels: int
    maps: Maps
    claimed: tuple[int, int, float]
    only: int | None = None

    @classmethod
    def of(cls, scene: Scene, channels: int, eye: Eye, maps: Maps, psf: PointSpread) -> ReferencePlan:
        """Plan of a view. Raises SceneError as the device's plan does."""
        device = make_plan(scene, psf, channels, Request(), eye, maps)
        plan = cls(scene, psf, (), eye, channels, maps, (device.samples, device.guard_px, device.largest_blur))
        distortion = lens_at(scene, 0.0).distortion
        round_discs = type(psf.pupil) is Circle and psf.edge == "integrated" and not psf.rims
        if distortion is not None and round_discs and plan.by_rays:
            rays = pixel_ray(reference_camera(scene), *padded_grid(scene.camera, 0))
            off = float(distortion.ellipticity(rays[..., 0], rays[..., 1]).max())
            psf = replace(psf, stretched=BEYOND * off) if off > ROUND else psf
        separate = scene.separates_colors or (channels > 1 and scene.psf.is_colored)
        spreads = spreads_of_colors(psf, scene.psf, scene.camera) if separate else ()
        return replace(plan, psf=max(spreads, key=lambda spread: spread.pupil.margin, default=psf), spreads=spreads)

    @cached_property
    def color_plans(self) -> tuple[ReferencePlan, ...]:
        """Plans for separately blurred light: one per color, or one for all."""
        colors = (replace(self, channels=1, psf=psf, spreads=(), only=k) for k, psf in enumerate(self.spreads))
        return tuple(colors) or (self,)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        return self.scene.camera.frame_size[1], self.scene.camera.frame_size[0]

    @property
    def static_map(self) -> bool:
        """True if the scene is a single depth map whose pixels all stay at their positions."""
        scene = self.scene
        stays = not (scene.moves or scene.shifts_colors) and scene.stereo is None
        return not scene.is_analytic and len(scene.objects) == 1 and stays

    @property
    def forward(self) -> bool:
        """True if pixels of the reference pose are moved."""
        scene = self.scene
        moved = scene.is_displaced or self.is_displaced_view
        return not self.static_map if not scene.is_analytic else scene.motion.warp == "forward" and moved

    @property
    def is_displaced_view(self) -> bool:
        """True if a view of a stereo pair is not at the viewpoint of the textures."""
        return self.scene.stereo is not None and (self.eye == "right" or self.scene.stereo.toe_in > 0.0)

    @property
    def by_rays(self) -> bool:
        """True if sources are traced by rays, False if they are pixels of a warped image or of depth layers."""
        return not (self.static_map or self.forward or self.occlusion == "layered")

    @property
    def occlusion(self) -> Occlusion:
        """The method: "none" if set or nothing can be hidden, "layered" for depth maps and moved pixels, else the
        scene's.
        """
        scene = self.scene
        convex = len(scene.objects) == 1 and scene.is_analytic and not _hollow(scene.objects[0])
        if scene.psf.occlusion == "none" or convex:
            return "none"
        return scene.psf.occlusion if not (self.static_map or self.forward) else "layered"

    @cached_property
    def groups(self) -> tuple[OcclusionGroup, ...]:
        """Occlusion groups: each object, or each root of a hollow object, with all others as occluders."""
        if self.occlusion != "visibility":
            return (everything(self.scene),)
        groups, every = [], everything(self.scene).members
        for k, item in enumerate(self.scene.objects):
            if _hollow(item):
                groups += [OcclusionGroup(1 << k, every, k, root) for root in (1, 2)]
            else:
                groups.append(OcclusionGroup(1 << k, every & ~(1 << k)))
        return tuple(groups)

    @property
    def spec(self) -> BlurSpec:
        """The blur specification; fields that the reference does not use have placeholder values."""
        scene, psf = self.scene, self.psf
        border, largest = scene.psf.border, self.claimed[2]
        cells = lens_cells(psf, "scatter", border, largest)
        return BlurSpec(psf, "scatter", 0.0, largest, tilt=scene.psf.tilt, border=border, cells=cells)


def _hollow(item: Object) -> bool:
    """True if an object can hide its own inside: it is curved, and cut open."""
    return not isinstance(item, Plane | Rectangle) and cutting_bounds(item) is not None


def band_of(plan: ReferencePlan, view: View) -> int:
    """Width in px of the guard band of a view: twice the width that the |R| of all surfaces on its rays needs.

    Occluded surfaces count as well.
    """
    if plan.scene.psf.border == "renormalize":
        return 0
    guard, needed = 0, 0
    while guard <= WIDEST_BAND:
        row, column = padded_grid(view.camera, guard)
        rays, largest = pixel_ray(view.camera, row, column), np.zeros((row.size, column.size))
        for group in plan.groups:
            w, label, _ = view.nearest(group, rays)
            largest = np.maximum(largest, np.where(label > 0, np.abs(blur_radius(view.lens, rays, w)), 0.0))
        pairs = zip((row, column), plan.shape, strict=True)
        away = np.maximum(*(np.maximum(-position, position - size + 1) for position, size in pairs))
        reach = plan.psf.reaches(largest.ravel(), subpixel=True).reshape(largest.shape) + SILHOUETTE_RANGE
        needed = max(needed, int(np.where(reach >= away, np.maximum(away, reach if guard == 0 else 0), 0).max()))
        if guard >= 2 * needed:
            return guard
        guard = 2 * needed
    return guard


def silhouettes_of(view: View, group: OcclusionGroup, guard: int, label: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Mask (H, W) of pixels that get sub-pixel sources: near a change of the labels (H, W), or near a missed object.

    An object is missed if none of the rays through pixel centers within SILHOUETTE_RANGE px hits it.
    """
    (row, column), center, missed = padded_grid(view.camera, guard), label & 127, np.zeros(label.shape, dtype=bool)
    members = [item for k, item in enumerate(view.scene.objects) if group.members >> k & 1]
    if len(members) == 1 and isinstance(members[0], Plane) and members[0].bounds is None:  # half of the view or more
        return mark_silhouettes(label)
    places = (np.arange(CASTS) + 0.5) / CASTS - 0.5
    for below, right in ((y, x) for y in places for x in places):
        _, labels, _ = view.nearest(group, pixel_ray(view.camera, row + below, column + right))
        for neighbor in np.unique(labels[labels != center]).tolist():
            missed |= (labels == neighbor) & (center != neighbor) & ~mark_silhouettes(center == neighbor)
    return mark_silhouettes(label) | missed | mark_silhouettes(missed)
