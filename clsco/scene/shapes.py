"""Shapes with textures and motions, in millimeters, seconds and degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import Field, ValidationInfo, field_validator

from clsco.scene.arrays import ArrayInput, DepthInput, Input, LayerInput
from clsco.scene.motions import ObjectMotion
from clsco.scene.quantities import (
    Bounds,
    Coefficients,
    Coordinate,
    Direction,
    Length,
    Lengths,
    Name,
    Point,
    Sides,
    Slope,
    Vector,
    Within,
    fault,
    refuse_if,
)
from clsco.scene.rotations import Rotation, after, depth_row
from clsco.scene.texture_keys import ROUND, TRIPLANAR, Mapped, SixSided, Textured, in_layer

BACKGROUND_MM = 1e12
"""Distance that stands for infinity: the blur differs from the blur at infinity by a part in 10^10."""
ROUNDING = 1e-15  # rounding error of a direction's component that should be 0 after a rotation
STATIC = "a background stays where it is; turn the camera by camera.motion"
IN_FRONT = "must leave part of the object in front of the lens (z > 0)"


class _Object(Textured):
    """Keys that every shape has."""

    is_analytic: ClassVar[bool] = True
    """True if the surface has an equation, so that rays can be cast at it."""
    is_background: ClassVar[bool] = False
    """True if the object is behind all others; in the ground truth it does not count as a surface."""
    shape: str
    """Kind of surface."""
    name: Name = Field(default_factory=lambda data: data["shape"])
    """Name in messages and metadata. Default: shape."""
    rotation: Rotation | None = None
    """Pose at t = 0, about the object's origin: Euler angles [x, y, z] in deg, {axis, angle} or {quaternion}, in the
    order and sense of a motion; none if not given."""
    motion: ObjectMotion = ObjectMotion.model_construct()
    """Velocities; static if none are given."""
    group: Name | None = None
    """Name of the group that the object moves with; none if not given."""

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        """Distance in mm that a body with these keys extends from its center away from the camera; None if infinite."""
        del keys
        return None

    @field_validator("center", "apex", check_fields=False)
    @classmethod
    def _visible(cls, center: Vector, info: ValidationInfo) -> Vector:
        """Reject a body that ends at or behind the lens."""
        with suppress(KeyError):  # a rejected key is missing
            reach = cls._reach(info.data)
            if reach is not None and center[2] + reach <= 0.0:
                raise fault(IN_FRONT)
        return center


class _Bounded(_Object):
    """Keys of shapes that a box may cut."""

    bounds: Bounds | None = None
    """Box [[x0, x1], [y0, y1], [z0, z1]] about the object's origin before any rotation, mm; cuts the surface."""


class Plane(_Bounded):
    """Plane Z = distance + slope_x X + slope_y Y (3.7); origin (0, 0, distance)."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "plane"}
    shape: Literal["plane"] = "plane"
    distance: Length = 250.0
    """Distance a on the optical axis, mm."""
    slope_x: Slope = 0.0
    """Slope b along x, mm per mm."""
    slope_y: Slope = 0.0
    """Slope c along y, mm per mm."""


class Rectangle(_Object):
    """Flat card; unless it is rotated, it faces the camera."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "card"}
    shape: Literal["rectangle"] = "rectangle"
    size: Sides = (40.0, 30.0)
    """Width and height, mm."""
    offset: Coordinate = 0.0
    """Distance of the card from its origin, along its own z axis, before any rotation; mm."""
    center: Point = (0.0, 0.0, 250.0)
    """Origin, mm: the center of a card without offset."""

    @property
    def bounds(self) -> Bounds:
        """Box that cuts the card's plane to size; as deep as its longer side, so that front and back cut nothing."""
        width, height = (0.5 * side for side in self.size)
        deep = max(width, height)
        return (-width, width), (-height, height), (self.offset - deep, self.offset + deep)

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float:
        row = depth_row(keys["rotation"])
        sides = sum(0.5 * side * abs(r) for side, r in zip(keys["size"], row[:2], strict=True))
        return float(sides + keys["offset"] * row[2])


class Disc(_Object):
    """Flat round card; unless it is rotated, it faces the camera."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "card"}
    bounds: ClassVar[None] = None
    shape: Literal["disc"] = "disc"
    radius: Length = 20.0
    """Radius, mm."""
    offset: Coordinate = 0.0
    """Distance of the disc from its origin, along its own z axis, before any rotation; mm."""
    center: Point = (0.0, 0.0, 250.0)
    """Origin, mm: the center of a disc without offset."""

    @property
    def size(self) -> tuple[float, float]:
        """Sides of the square around the disc, mm."""
        return 2.0 * self.radius, 2.0 * self.radius

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        row = depth_row(keys["rotation"])
        return float(keys["radius"] * math.hypot(*row[:2]) + keys["offset"] * row[2])


class Box(SixSided, _Object):
    """Closed box; a scene replaces it by its six faces, as rectangles."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "card"}
    shape: Literal["box"] = "box"
    size: Lengths = (40.0, 30.0, 30.0)
    """Sides along x, y and z before any rotation, mm."""
    center: Point = (0.0, 0.0, 280.0)
    """Center, mm; the origin."""

    @property
    def bounds(self) -> Bounds:
        """The box itself."""
        x, y, z = (0.5 * side for side in self.size)
        return (-x, x), (-y, y), (-z, z)

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        pairs = zip(keys["size"], depth_row(keys["rotation"]), strict=True)
        return float(sum(0.5 * side * abs(row) for side, row in pairs))

    @property
    def has_sides(self) -> bool:
        return True

    def faces(self) -> tuple[Rectangle, ...]:
        """Rectangles named "box front" and so on, which rotate about the center of the box and move with it.

        Faces that are completely behind the lens are omitted, because a scene rejects objects there.
        """
        x, y, z = self.size
        # Each face is a front face, rotated to its place, so that no image is mirrored as seen from outside.
        placed: tuple[tuple[str, tuple[float, float], float, Vector | None], ...] = (
            ("front", (x, y), z, None), ("back", (x, y), z, (0.0, 180.0, 0.0)),
            ("left", (z, y), x, (0.0, 90.0, 0.0)), ("right", (z, y), x, (0.0, -90.0, 0.0)),
            ("top", (x, z), y, (90.0, 0.0, 0.0)), ("bottom", (x, z), y, (-90.0, 0.0, 0.0)),
        )  # fmt: skip
        shared = self.texture_keys() | {"motion": self.motion, "group": self.group, "center": self.center}
        shared.pop("texture_layer", None)
        rectangles = []
        for side, size, deep, turn in placed:
            keys: dict[str, Any] = {"size": size, "offset": -0.5 * deep, "rotation": after(turn, self.rotation)}
            if self.center[2] + Rectangle._reach(keys) > 0.0:
                image = self.side(side)
                layer = {"texture_layer": image.layer} if isinstance(image, LayerInput) else {}
                keys |= {"name": f"{self.name} {side}", "texture": image}
                rectangles.append(Rectangle.model_validate(shared | keys | layer))
        return tuple(rectangles)


class Cylinder(_Bounded):
    """Circular cylinder without ends (3.11), its axis in any direction."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "cylinder"}
    shape: Literal["cylinder"] = "cylinder"
    radius: Length = 30.0
    """Radius, mm."""
    axis: Direction = (0.0, 1.0, 0.0)
    """Direction of the axis, of any length."""
    center: Point = (0.0, 0.0, 280.0)
    """Point on the axis, mm; the origin."""

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        axis, row = keys["axis"], depth_row(keys["rotation"])
        # One end of an axis that is not parallel to the plane of the lens is always in front of the lens.
        along = abs(sum(a * r for a, r in zip(axis, row, strict=True)))
        return float(keys["radius"]) if along <= ROUNDING * math.hypot(*axis) else None


class Sphere(SixSided, _Bounded):
    """Sphere (3.18), its center anywhere."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = ROUND
    shape: Literal["sphere"] = "sphere"
    radius: Length = 30.0
    """Radius, mm."""
    center: Point = (0.0, 0.0, 280.0)
    """Center, mm; the origin."""

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        return float(keys["radius"])


class Cone(_Bounded):
    """One nappe of a circular cone (3.23); unless it is rotated, its axis is parallel to the optical axis."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "cone"}
    shape: Literal["cone"] = "cone"
    half_angle: Annotated[float, Within(0.0, 90.0, "deg", "()")] = 45.0
    """Angle from axis to surface, deg."""
    nappe: Literal["away", "towards"] = "away"
    """The cone opens away from the camera, or towards it, before any rotation."""
    apex: Point = (0.0, 0.0, 250.0)
    """Apex, mm; the origin."""

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        opening = depth_row(keys["rotation"])[2] * (1.0 if keys["nappe"] == "away" else -1.0)
        half = math.radians(keys["half_angle"])
        # z of the unit vector along the line of the cone that points most directly away from the camera.
        away = opening * math.cos(half) + math.sqrt(max(0.0, 1.0 - opening * opening)) * math.sin(half)
        return 0.0 if away <= 0.0 else None


class Ellipsoid(SixSided, _Bounded):
    """Ellipsoid (3.33); unless it is rotated, its axes are along x, y and z."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = ROUND
    shape: Literal["ellipsoid"] = "ellipsoid"
    semi_axes: Lengths = (30.0, 30.0, 50.0)
    """Semi-axes along x, y and z before any rotation, mm."""
    center: Point = (0.0, 0.0, 300.0)
    """Center, mm; the origin."""

    @staticmethod
    def _reach(keys: Mapping[str, Any]) -> float | None:
        pairs = zip(keys["semi_axes"], depth_row(keys["rotation"]), strict=True)
        return math.hypot(*(a * r for a, r in pairs))


class Quadric(_Bounded):
    """Surface of second degree (3.39) about its center: x right, y up, z away from the camera."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR | {"surface": "triplanar"}
    shape: Literal["quadric"] = "quadric"
    coefficients: Coefficients
    """a200 a020 a002 a110 a011 a101 a100 a010 a001 a000; x, y and z in mm."""
    center: Point = (0.0, 0.0, 250.0)
    """Origin, where x = y = z = 0, mm."""


class DepthMap(_Bounded):
    """Surface given by the depth of every pixel at t = 0, from a file of the texture's size."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = {}
    is_analytic: ClassVar[bool] = False
    shape: Literal["depth_map"] = "depth_map"
    depth: DepthInput
    """File of depths: PNG, JPEG, TIFF, EXR, PFM, DPT, .npy or .npz; a path, relative to the scene file; in Python also
    a NumPy array."""
    depth_layer: Name | None = None
    """Layer of the depth in an EXR with several layers, such as "ViewLayer.Depth" or "Depth". Default: the only depth
    in the file."""
    unit: Literal["mm", "m", "inverse_mm", "inverse_m", "disparity", "coc"] = "mm"
    """Quantity in the file: Z in mm or m, 1/Z in 1/mm or 1/m, disparity in px, or signed blur radius R in px."""
    scale: Annotated[float, Within(-1e12, 1e12)] = 1.0
    """Factor from numbers in the file to `unit`, such as 0.001, or -1 for disparities with the other sign; not 0."""
    baseline: Length | None = Field(default=None, validate_default=True)
    """Distance B between the views, mm: Z = B s0 / (p disparity); only with unit = "disparity"."""
    offset: Annotated[float, Within(-1e9, 1e9)] | None = None
    """Added to a number times `scale`, in `unit`: of a disparity `doffs` of Middlebury's calibrations, of an inverse
    depth the a of 1/Z = a + b v."""
    near: Length | None = None
    """Depth of the nearest number of the file, mm: the range of all numbers becomes `near` to `far`, linear in Z or,
    with an inverse unit, in 1/Z, as of networks' relative inverse depth; not with disparity and coc."""
    far: Length | None = Field(default=None, validate_default=True)
    """Depth of the farthest number of the file, mm; only with `near`. Default of inverse units: infinite."""
    depth_kind: Literal["z", "ray"] = "z"
    """Depth along the optical axis, or distance from the lens along the ray of a pixel; the latter only of lengths."""
    no_depth: Literal["around", "far"] = "around"
    """Depth of pixels without a depth in the file, such as 0: that of the surfaces around, or infinite, as for the
    sky."""
    soft_edges: Literal["assign", "keep"] = "assign"
    """Depths between two surfaces at their edge, as in averaged or blurred files: assign each to one of the two
    surfaces, or keep them."""
    center: Point = (0.0, 0.0, 0.0)
    """Center of rotation, mm; the origin. Default: in the lens."""

    def inputs(self) -> dict[str, Input]:
        return super().inputs() | {"depth": in_layer(self.depth, self.depth_layer)}

    @field_validator("depth_layer")
    @classmethod
    def _of_a_file(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is not None and isinstance(info.data.get("depth"), ArrayInput):
            raise fault("belongs to depths in EXR files")
        return value

    _not_analytic = field_validator("bounds", "rotation")(
        refuse_if(lambda value: value is not None, "belongs to analytic shapes, not to depth_map")
    )
    _not_zero = field_validator("scale")(refuse_if(lambda value: abs(value) < 1e-12, "must be at least 1e-12 in size"))

    @field_validator("depth_kind", "near")
    @classmethod
    def _of_lengths(cls, value: str | float | None, info: ValidationInfo) -> str | float | None:
        unit = info.data.get("unit")
        if value not in (None, "z") and unit in ("disparity", "coc"):
            what = '"ray" ' if value == "ray" else ""
            raise fault(f'{what}belongs to units of length and their inverse, not to "{unit}"')
        if value is not None and info.field_name == "near" and info.data.get("offset") is not None:
            raise fault("must be without offset, as it maps the range of all numbers")
        return value

    @field_validator("far")
    @classmethod
    def _beyond_near(cls, value: float | None, info: ValidationInfo) -> float | None:
        near = info.data.get("near", value)  # missing if it was rejected
        if value is None:
            if near is not None and info.data.get("unit") in ("mm", "m"):
                raise fault("must be given with near, in units of length", got="nothing")
        elif near is None:
            raise fault("must be with near")
        elif value <= near and "near" in info.data:
            raise fault(f"must be greater than near, {near:g} mm")
        return value

    @field_validator("baseline")
    @classmethod
    def _of_the_disparity(cls, value: float | None, info: ValidationInfo) -> float | None:
        unit = info.data.get("unit")  # missing if it was rejected
        if unit == "disparity" and value is None:
            raise fault('must be given with unit = "disparity"', got="nothing")
        if unit not in (None, "disparity") and value is not None:
            raise fault(f'belongs to unit = "disparity", not "{unit}"')
        return value


class Background(_Bounded):
    """Background behind all other objects, infinitely far away: an image, or a color."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = {}
    is_background: ClassVar[bool] = True
    shape: Literal["background"] = "background"

    _unbounded = field_validator("bounds", "rotation", "group")(
        refuse_if(lambda value: value is not None, "belongs to shapes with a surface, not to background")
    )
    _static = field_validator("motion")(refuse_if(lambda motion: motion.moves, STATIC, "a motion"))


AnyShape = Plane | Rectangle | Disc | Box | Cylinder | Sphere | Cone | Ellipsoid | Quadric | DepthMap | Background


SHAPES: dict[str, type[AnyShape]] = {kind.model_fields["shape"].default: kind for kind in get_args(AnyShape)}
"""All shapes by their names."""


def origin(shape: AnyShape) -> Vector:
    """Origin of an object, mm, about which it rotates and its bounds are given.

    It is the apex of a cone, (0, 0, distance) of a plane, and the center of other shapes.
    """
    if isinstance(shape, Plane):
        return (0.0, 0.0, shape.distance)
    if isinstance(shape, Background):
        return (0.0, 0.0, BACKGROUND_MM)
    return shape.apex if isinstance(shape, Cone) else shape.center
