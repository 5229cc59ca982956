"""What a scene says: frozen, validated models in millimeters, seconds and degrees.

Attribute names are the keys of the scene file, except that the array of tables `object` is `Scene.objects`.
Every rule that a scene can break is stated here; `clsco.scenefile` turns broken rules into messages.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

SHAPES = ("plane", "cylinder", "sphere", "cone", "ellipsoid", "quadric")
BUILT_IN_TEXTURES = ("bricks", "checkerboard", "slanted_edge", "siemens_star")
MAX_PIXELS = 2**28
MIN_LENGTH_MM, MAX_LENGTH_MM = 1e-6, 1e9
IN_FRONT = "must leave part of the object in front of the lens (z > 0)"

Vector = tuple[float, float, float]


def _fault(rule: str, got: str | None = None) -> PydanticCustomError:
    """Error that states a rule; `got` replaces the input where that would show too much."""
    context = {"rule": rule} if got is None else {"rule": rule, "got": got}
    return PydanticCustomError("rule", "{rule}", context)


def _at_keys(found: list[tuple[tuple[str | int, ...], PydanticCustomError, Any]]) -> ValidationError:
    """One error for several (location, fault, value), each reported at its own key."""
    details = [InitErrorDetails(type=fault, loc=loc, input=value) for loc, fault, value in found]
    return ValidationError.from_exception_data("scene", details)


@dataclass(frozen=True)
class Within:
    """Constraint on a number: finite and between `low` and `high` in `unit`, ends included unless `open`."""

    low: float
    high: float
    unit: str = ""
    open: bool = False

    def check(self, value: float) -> float:
        unit = f" {self.unit}" if self.unit else ""
        if isinstance(value, float) and not math.isfinite(value):
            raise _fault("must be a finite number")
        if self.low < value < self.high or (not self.open and value in (self.low, self.high)):
            return value
        if 0.0 < self.low < 1.0 and value <= 0.0:
            raise _fault(f"must be greater than 0{unit}")
        ends = ", ends excluded" if self.open else ""
        raise _fault(f"must be between {self.low:.7g} and {self.high:.7g}{unit}{ends}")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        low, high = ("exclusiveMinimum", "exclusiveMaximum") if self.open else ("minimum", "maximum")
        return {**handler(schema), low: self.low, high: self.high}


def _list_of(count: int, what: str) -> Callable[[Any], Any]:
    """Turn a list of `count` entries into a tuple; the file formats know only lists."""

    def convert(value: Any) -> Any:
        if isinstance(value, list | tuple) and len(value) == count:
            return tuple(value)
        raise _fault(f"must be a list of {count} {what}")

    return convert


def _single_line(value: str) -> str:
    if any(unicodedata.category(character) in ("Cc", "Cs") for character in value):
        raise _fault("must be one line of text without control characters")
    return value


def _increasing(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise _fault("lower bound must be less than the upper bound")
    return value


def _not_zero(value: Vector) -> Vector:
    if max(abs(component) for component in value) < MIN_LENGTH_MM:
        raise _fault(f"must not be the zero vector (one component of {MIN_LENGTH_MM:g} at least)")
    return value


def _surface(value: tuple[float, ...]) -> tuple[float, ...]:
    if not any(value[:9]):
        raise _fault("must not all be 0, or all but a000")
    return value


def _count_or_auto(value: Any) -> Any:
    if (type(value) is int and 1 <= value <= 4096) or (type(value) is str and value == "auto"):
        return value
    raise _fault('must be an integer between 1 and 4096, or "auto"')


def _few_enough(value: tuple[int, int]) -> tuple[int, int]:
    if value[0] * value[1] > MAX_PIXELS:
        raise _fault(f"must have at most {MAX_PIXELS} pixels in all")
    return value


def _reaching(center: Vector, reach: float | None) -> Vector:
    """Refuse a body that reaches at most to the lens; `reach` in mm along z, None if it is not known."""
    if reach is not None and center[2] + reach <= 0.0:
        raise _fault(IN_FRONT)
    return center


_Pair, _Triple = BeforeValidator(_list_of(2, "numbers")), BeforeValidator(_list_of(3, "numbers"))
Text = Annotated[str, Field(max_length=4096), AfterValidator(_single_line)]
Name = Annotated[str, Field(min_length=1, max_length=4096), AfterValidator(_single_line)]
Length = Annotated[float, Within(MIN_LENGTH_MM, MAX_LENGTH_MM, "mm")]
SemiAxes = Annotated[tuple[Length, Length, Length], _Triple]
Coordinate = Annotated[float, Within(-MAX_LENGTH_MM, MAX_LENGTH_MM, "mm")]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], _Triple]
Interval = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_increasing), _Pair]
Box = Annotated[tuple[Interval, Interval, Interval], BeforeValidator(_list_of(3, "pairs [low, high]"))]
Component = Annotated[float, Within(-1e9, 1e9)]
Direction = Annotated[tuple[Component, Component, Component], AfterValidator(_not_zero), _Triple]
Slope = Annotated[float, Within(-1e6, 1e6, "mm per mm")]
Coefficient = Annotated[float, Within(-1e30, 1e30)]
Coefficients = Annotated[
    tuple[Coefficient, ...],
    Field(json_schema_extra={"minItems": 10, "maxItems": 10}),
    AfterValidator(_surface),
    BeforeValidator(_list_of(10, "numbers")),
]
Speed = Annotated[float, Within(-1e9, 1e9, "mm/s")]
Velocity = Annotated[tuple[Speed, Speed, Speed], _Triple]
Turn = Annotated[float, Within(-1e9, 1e9, "deg/s")]
AngularVelocity = Annotated[tuple[Turn, Turn, Turn], _Triple]
Duration = Annotated[float, Within(1e-9, 1e9, "s")]
FNumber = Annotated[float, Within(1e-3, 1e6)]
Pixels = Annotated[int, Within(1, 65536, "px")]
Resolution = Annotated[tuple[Pixels, Pixels], AfterValidator(_few_enough), BeforeValidator(_list_of(2, "integers"))]
Samples = Annotated[Annotated[int, Within(1, 4096)] | Literal["auto"], BeforeValidator(_count_or_auto)]


class _Strict(BaseModel):
    """No conversions, no unknown keys, no changes after validation."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)


def _aperture_mm(data: dict[str, Any]) -> float:
    return 10.0 if data["f_number"] is None else float(data["focal_length"] / data["f_number"])


def _sensor_distance_mm(data: dict[str, Any]) -> float:
    f, u = data["focal_length"], data["focus_distance"]
    return 21.739 if u is None else float(f * u / (u - f))


class Camera(_Strict):
    """Thin lens and detector. After validation every distance is a number, whichever of a pair was given."""

    focal_length: Length = 20.0
    """Focal length f, mm."""
    f_number: FNumber | None = None
    """f / D; instead of aperture_diameter."""
    focus_distance: Length | None = None
    """Distance u in focus, mm, greater than f; instead of sensor_distance: 1/s = 1/f - 1/u."""
    aperture_diameter: Length = Field(default_factory=_aperture_mm)
    """Aperture diameter D, mm. Default 10, or from f_number."""
    sensor_distance: Length = Field(default_factory=_sensor_distance_mm)
    """Distance s from lens to detector, mm. Default 21.739, or from focus_distance."""
    normalization_distance: Length = Field(default_factory=lambda data: data["focal_length"])
    """Magnification normalization distance s0, mm: x = s0 X / Z. Default: focal_length."""
    pixel_pitch: Length = 0.01
    """Pixel pitch p, mm."""
    resolution: Resolution | None = None
    """Columns and rows, px. Default: size of the first object's texture."""

    @field_validator("f_number")
    @classmethod
    def _opening(cls, value: float | None, info: ValidationInfo) -> float | None:
        f = info.data.get("focal_length")
        if value is not None and f is not None and not MIN_LENGTH_MM <= f / value <= MAX_LENGTH_MM:
            raise _fault(f"must leave an aperture between {MIN_LENGTH_MM:g} and {MAX_LENGTH_MM:g} mm")
        return value

    @field_validator("focus_distance")
    @classmethod
    def _beyond_focal_length(cls, value: float | None, info: ValidationInfo) -> float | None:
        f = info.data.get("focal_length")
        if value is None or f is None:
            return value
        if value <= f:
            raise _fault(f"must be greater than focal_length = {f:g} mm")
        if f * value / (value - f) > MAX_LENGTH_MM:
            raise _fault(f"too close to focal_length = {f:g} mm: detector beyond {MAX_LENGTH_MM:g} mm")
        return value

    @field_validator("aperture_diameter", "sensor_distance")
    @classmethod
    def _one_of_a_pair(cls, value: float, info: ValidationInfo) -> float:
        other = "f_number" if info.field_name == "aperture_diameter" else "focus_distance"
        if info.data.get(other, "refused") is not None:  # a refused value is missing from `data`
            raise _fault(f"give {other} or {info.field_name}, not both")
        return value


class Psf(_Strict):
    """Point spread function and how exactly it is evaluated."""

    model: Literal["pillbox", "gaussian"] = "pillbox"
    """A disc of radius |R|, or a Gaussian of standard deviation sigma_ratio |R|."""
    edge: Literal["integrated", "area", "sampled"] = "integrated"
    """Integrated over source and detector pixel, over the detector pixel only, or taken at pixel centers."""
    tilt: bool = True
    """Weight by the gradient of the blur radius."""
    silhouette_samples: Annotated[int, Within(1, 16)] = 4
    """Sources per pixel and axis near silhouettes; 1: off."""
    occlusion: Literal["visibility", "layered", "none"] = "visibility"
    """How nearer surface hides farther surface."""
    sigma_ratio: Annotated[float, Within(1e-6, 10.0)] = math.sqrt(0.5)
    """sigma / |R|; only with model = "gaussian"."""
    truncation: Annotated[float, Within(1.0, 6.0)] = Field(
        default_factory=lambda data: 2.0 if data["edge"] == "sampled" else 3.0
    )
    """Cut of the Gaussian, in sigma; only with model = "gaussian". Default 3, with edge = "sampled" 2."""
    border: Literal["lose", "renormalize"] = "lose"
    """Light that would fall outside the image is lost, or given back to the pixels inside."""

    @field_validator("sigma_ratio", "truncation")
    @classmethod
    def _of_the_gaussian(cls, value: float, info: ValidationInfo) -> float:
        if info.data.get("model") == "pillbox":
            raise _fault('belongs to psf.model = "gaussian", not "pillbox"')
        return value


class Sequence(_Strict):
    """Video frames and the intermediate frames that sample each exposure."""

    frames: Annotated[int, Within(1, 1_000_000)] = 1
    """Number of frames."""
    interval: Duration = 1.0
    """Time from frame to frame, s."""
    shutter: Duration = Field(default_factory=lambda data: data["interval"])
    """Time that the shutter is open, s, at most interval. Default: interval."""
    samples: Samples = 5
    """Intermediate frames per frame, or "auto": about one per 1 to 2 px of the largest motion."""
    sampling: Literal["midpoint", "endpoint"] = "midpoint"
    """Where in its share of the exposure a sample lies."""

    @field_validator("shutter")
    @classmethod
    def _within_interval(cls, value: float, info: ValidationInfo) -> float:
        interval = info.data.get("interval", math.inf)
        if value > interval:
            raise _fault(f"must be at most interval = {interval:g} s")
        return value


class Motion(_Strict):
    """How moved surface gets its radiance, and what an angular velocity means."""

    warp: Literal["inverse", "forward"] = "inverse"
    """Cast rays at the moved surface, or move the pixels at rest."""
    rotation: Literal["euler", "axis"] = "euler"
    """Euler angles, or a constant angular velocity vector."""
    texture_filter: Literal["bicubic", "bilinear", "nearest"] = "bicubic"
    """Sampling of the texture between pixels; only with warp = "inverse"."""

    @field_validator("texture_filter")
    @classmethod
    def _of_the_inverse_warp(cls, value: str, info: ValidationInfo) -> str:
        if info.data.get("warp") == "forward":
            raise _fault('belongs to motion.warp = "inverse", not "forward"')
        return value


class Fill(_Strict):
    """Filling of the pixels that a forward warp leaves missing; only with motion.warp = "forward"."""

    method: Literal["ait", "mean_median", "none"] = "ait"
    """Adaptive interpolation (section 4.3.5), mean and median (chapter 5), or no filling."""
    domain: Literal["surface", "span"] = "surface"
    """Fill where the ray meets a surface, or everything between known pixels."""


class ImageOptions(_Strict):
    """Reading and writing of images."""

    transfer: Literal["srgb", "linear"] = "srgb"
    """Transfer of 8- and 16-bit files; float files are linear."""


class ObjectMotion(_Strict):
    """Constant velocities of an object; it turns about its origin."""

    velocity: Velocity = (0.0, 0.0, 0.0)
    """Right, up, away from the camera; mm/s."""
    angular_velocity: AngularVelocity = (0.0, 0.0, 0.0)
    """About the object's axes right, up, towards the camera; deg/s."""

    @property
    def moves(self) -> bool:
        """Whether any component of either velocity differs from 0."""
        return any(self.velocity) or any(self.angular_velocity)


class _Object(_Strict):
    """What every shape has."""

    shape: str
    """Which surface it is."""
    name: Name = Field(default_factory=lambda data: data["shape"])
    """Name in messages and metadata. Default: shape."""
    texture: Name = "bricks"
    """bricks, checkerboard, slanted_edge, siemens_star, or an image: a path, relative to the scene file."""
    bounds: Box | None = None
    """Box [[x0, x1], [y0, y1], [z0, z1]] about the object's origin before rotation, mm; cuts the surface."""
    motion: ObjectMotion = ObjectMotion()
    """Velocities; at rest if none are given."""


class Plane(_Object):
    """Plane Z = distance + slope_x X + slope_y Y (3.7); origin (0, 0, distance)."""

    shape: Literal["plane"] = "plane"
    distance: Length = 250.0
    """Distance a on the optical axis, mm."""
    slope_x: Slope = 0.0
    """Slope b along x, mm per mm."""
    slope_y: Slope = 0.0
    """Slope c along y, mm per mm."""


class Cylinder(_Object):
    """Circular cylinder without ends (3.11), its axis in any direction."""

    shape: Literal["cylinder"] = "cylinder"
    radius: Length = 30.0
    """Radius, mm."""
    axis: Direction = (0.0, 1.0, 0.0)
    """Direction of the axis, of any length."""
    center: Point = (0.0, 0.0, 280.0)
    """Point on the axis, mm; the origin."""

    @field_validator("center")
    @classmethod
    def _visible(cls, center: Vector, info: ValidationInfo) -> Vector:
        # An axis that leaves the plane of the lens always runs to its front on one side.
        across = "axis" in info.data and info.data["axis"][2] == 0.0
        return _reaching(center, info.data.get("radius") if across else None)


class Sphere(_Object):
    """Sphere (3.18), its center anywhere."""

    shape: Literal["sphere"] = "sphere"
    radius: Length = 30.0
    """Radius, mm."""
    center: Point = (0.0, 0.0, 280.0)
    """Center, mm; the origin."""

    @field_validator("center")
    @classmethod
    def _visible(cls, center: Vector, info: ValidationInfo) -> Vector:
        return _reaching(center, info.data.get("radius"))


class Cone(_Object):
    """One nappe of a circular cone whose axis is parallel to the optical axis (3.23)."""

    shape: Literal["cone"] = "cone"
    half_angle: Annotated[float, Within(0.0, 90.0, "deg", open=True)] = 45.0
    """Angle from axis to surface, deg."""
    nappe: Literal["away", "towards"] = "away"
    """The cone opens away from the camera, or towards it."""
    apex: Point = (0.0, 0.0, 250.0)
    """Apex, mm; the origin."""

    @field_validator("apex")
    @classmethod
    def _visible(cls, apex: Vector, info: ValidationInfo) -> Vector:
        return _reaching(apex, 0.0 if info.data.get("nappe") == "towards" else None)


class Ellipsoid(_Object):
    """Ellipsoid with its axes along x, y and z (3.33)."""

    shape: Literal["ellipsoid"] = "ellipsoid"
    semi_axes: SemiAxes = (30.0, 30.0, 50.0)
    """Semi-axes along x, y and z, mm."""
    center: Point = (0.0, 0.0, 300.0)
    """Center, mm; the origin."""

    @field_validator("center")
    @classmethod
    def _visible(cls, center: Vector, info: ValidationInfo) -> Vector:
        return _reaching(center, info.data["semi_axes"][2] if "semi_axes" in info.data else None)


class Quadric(_Object):
    """Surface of second degree (3.39) about its center: x right, y up, z away from the camera."""

    shape: Literal["quadric"] = "quadric"
    coefficients: Coefficients
    """a200 a020 a002 a110 a011 a101 a100 a010 a001 a000; x, y and z in mm."""
    center: Point = (0.0, 0.0, 250.0)
    """Where x = y = z = 0, mm; the origin."""


AnyShape = Plane | Cylinder | Sphere | Cone | Ellipsoid | Quadric


def origin(shape: AnyShape) -> Vector:
    """Origin of an object's own frame in the camera frame, mm: about it the object turns and is bounded."""
    if isinstance(shape, Plane):
        return (0.0, 0.0, shape.distance)
    return shape.apex if isinstance(shape, Cone) else shape.center


def _bounds_in_front(shape: AnyShape) -> AnyShape:
    if shape.bounds is not None and origin(shape)[2] + shape.bounds[2][1] <= 0.0:
        raise _at_keys([(("bounds", 2), _fault(IN_FRONT), shape.bounds[2])])
    return shape


def _known_shape(value: Any) -> Any:
    if isinstance(value, dict):
        shape = value.get("shape")
        if not isinstance(shape, str) or shape not in SHAPES:
            rule = f"must be {', '.join(SHAPES[:-1])} or {SHAPES[-1]}"
            raise _at_keys([(("shape",), _fault(rule, None if "shape" in value else "nothing"), shape)])
    return value


def _one_object(value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise _fault("must be an array of tables, [[object]]")
    if len(value) != 1:
        raise _fault("one object per scene in this version", got=str(len(value)))
    return tuple(value)


_Union = Annotated[AnyShape, Field(discriminator="shape")]
Object = Annotated[_Union, AfterValidator(_bounds_in_front), BeforeValidator(_known_shape)]


class Scene(_Strict):
    """A camera, what it looks at, and how the images are made."""

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    title: Text = ""
    """Title; only told back."""
    camera: Camera = Camera()
    psf: Psf = Psf()
    sequence: Sequence = Sequence()
    motion: Motion = Motion()
    fill: Fill = Fill()
    image: ImageOptions = ImageOptions()
    objects: Annotated[tuple[Object, ...], BeforeValidator(_one_object)] = Field(
        default=(),
        validation_alias="object",
        serialization_alias="object",
        validate_default=True,
        json_schema_extra={"minItems": 1, "maxItems": 1},
    )
    """What the camera sees; one object in this version."""

    @field_validator("fill")
    @classmethod
    def _of_the_forward_warp(cls, value: Fill, info: ValidationInfo) -> Fill:
        motion = info.data.get("motion")
        if motion is not None and motion.warp == "inverse" and value.model_fields_set:
            fault = _fault('belongs to motion.warp = "forward", not "inverse"')
            raise _at_keys([((key,), fault, getattr(value, key)) for key in sorted(value.model_fields_set)])
        return value
