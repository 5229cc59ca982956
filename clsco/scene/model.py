"""Models of a scene: frozen and validated, in millimeters, seconds and degrees.

Attribute names are the keys of the scene file, except that the array of tables `object` is `Scene.objects`. Every
rule for scenes is stated here, in `clsco.scene.objects`, `shapes`, `texture_keys` and `quantities`; `clsco.scene.file`
turns violated rules into messages.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from clsco.scene.arrays import HasInputs
from clsco.scene.camera import Camera as Camera
from clsco.scene.camera import FollowedDistance, image_distance
from clsco.scene.changes import replaced
from clsco.scene.faults import refusal
from clsco.scene.groups import Group as Group
from clsco.scene.groups import Groups, unknown_groups
from clsco.scene.lens import Lens as Lens
from clsco.scene.lens import check_opening, with_distortion_of_wavefront
from clsco.scene.motions import CameraMotion as CameraMotion
from clsco.scene.motions import CameraShake as CameraShake
from clsco.scene.motions import Keyframe as Keyframe
from clsco.scene.motions import LensKeyframe as LensKeyframe
from clsco.scene.motions import ObjectMotion as ObjectMotion
from clsco.scene.objects import MAX_OBJECTS, Objects
from clsco.scene.objects import Object as Object
from clsco.scene.quantities import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    Deferred,
    Direction,
    Fault,
    Length,
    Point,
    Strict,
    Text,
    Within,
    fault,
    instead_of,
    only_with,
    raise_faults,
)
from clsco.scene.sensor import Sensor as Sensor
from clsco.scene.sequence import Sequence as Sequence
from clsco.scene.shapes import AnyShape as AnyShape
from clsco.scene.shapes import Background as Background
from clsco.scene.shapes import Box as Box
from clsco.scene.shapes import Cone as Cone
from clsco.scene.shapes import Cylinder as Cylinder
from clsco.scene.shapes import DepthMap as DepthMap
from clsco.scene.shapes import Disc as Disc
from clsco.scene.shapes import Ellipsoid as Ellipsoid
from clsco.scene.shapes import Plane as Plane
from clsco.scene.shapes import Quadric as Quadric
from clsco.scene.shapes import Rectangle as Rectangle
from clsco.scene.shapes import Sphere as Sphere
from clsco.scene.spread import NEEDS_RAYS, misfit
from clsco.scene.spread import Aperture as Aperture
from clsco.scene.spread import Psf as Psf

Place = tuple[str] | tuple[str, int]
"""Table of a scene file: ("aperture",) or ("object", 0)."""


class Motion(Strict):
    """Method by which moved surfaces are rendered, and the meaning of an angular velocity."""

    warp: Literal["inverse", "forward"] = "inverse"
    """Cast rays at the moved surface, or move the pixels of the reference pose."""
    rotation: Literal["euler", "axis"] = "euler"
    """Euler angles, or a constant angular velocity vector."""
    texture_filter: Literal["bicubic", "bilinear", "nearest"] = "bicubic"
    """Interpolation of the texture between pixels; only with warp = "inverse"."""

    _of_its_warp = only_with("motion.warp", {"texture_filter": ("inverse",)})


class Fill(Strict):
    """Filling of the pixels that a forward warp leaves missing; only with motion.warp = "forward"."""

    method: Literal["ait", "mean_median", "none"] = "ait"
    """Adaptive interpolation (section 4.3.5), mean and median (chapter 5), or no filling."""
    domain: Literal["surface", "span"] = "surface"
    """Fill where the ray meets a surface, or everything between known pixels; with a depth map both are the latter."""


class Stereo(Strict):
    """Right camera of a stereo pair, moved along x; the scene's camera is the left one."""

    baseline: Length
    """Distance of the right camera from the left one, mm."""
    toe_in: Annotated[float, Within(0.0, 45.0, "deg", "[)")] = 0.0
    """Angle by which each camera is turned inwards, deg."""


class Light(Strict):
    """Static light that shades surfaces by Lambert's law, without shadows or fall-off."""

    direction: Direction | None = None
    """Direction towards a far light: right, up, towards the camera; of any length."""
    position: Point | None = None
    """Position of a near light in the camera's frame at t = 0, mm; instead of direction."""
    ambient: Annotated[float, Within(0.0, 1.0)] = 0.0
    """Share of the texture that is visible without the light."""

    _one_of_a_pair = instead_of(position="direction")

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if self.direction is None and self.position is None:
            raise fault("must have a direction or a position", got="neither")
        return self


class ImageOptions(Strict):
    """Transfer curve of image files."""

    transfer: Literal["srgb", "linear"] = "srgb"
    """Transfer of 8- and 16-bit files: linear, or sRGB or what a file's color profile says; float files are linear."""


class Scene(Strict):
    """A camera, the objects in front of it, and how the images are made."""

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    title: Text = ""
    """Title; recorded in the metadata, used nowhere else."""
    camera: Camera = Camera.model_construct()
    aperture: Aperture = Aperture.model_construct()
    psf: Psf = Psf.model_construct()
    lens: Annotated[Lens | None, Deferred()] = Field(default=None, validate_default=True)
    """Changes of the camera's lens over time, and where it differs from a thin lens; a thin one if not given."""
    sequence: Sequence = Sequence.model_construct()
    motion: Motion = Motion.model_construct()
    fill: Fill = Fill.model_construct()
    image: ImageOptions = ImageOptions.model_construct()
    light: Annotated[Light | None, Deferred()] = None
    """Shades all surfaces; without one they emit the radiance of their texture in all directions."""
    stereo: Annotated[Stereo | None, Deferred()] = None
    """A second view; none if not given."""
    sensor: Annotated[Sensor | None, Deferred()] = None
    """Counts electrons; none if not given, and frames are light."""
    groups: Groups = Field(
        default=(), validation_alias="group", serialization_alias="group", json_schema_extra={"maxItems": MAX_OBJECTS}
    )
    """Groups of objects that move together; none if not given."""
    objects: Objects = Field(
        default=(),
        validation_alias="object",
        serialization_alias="object",
        validate_default=True,
        json_schema_extra={"minItems": 1, "maxItems": MAX_OBJECTS},
    )
    """1 to 64 objects of different names. Where two are equally near, the first one is visible."""

    @field_validator("lens")
    @classmethod
    def _lens_of_the_camera(cls, value: Lens | None, info: ValidationInfo) -> Lens | None:
        camera, psf, faults = info.data.get("camera"), info.data.get("psf"), list[Fault]()
        if camera is None:
            return value
        for k, key in enumerate(value.keyframe or () if value else ()):
            f, u, number = key.focal_length, key.focus_distance, key.f_number
            name = "camera.focal_length" if f is None else "its focal_length"
            if f is None and value and value.zooms:
                continue  # the focal length is interpolated from other keyframes
            f = camera.focal_length if f is None else f
            if u is not None and not (u > f and image_distance(f, u) <= MAX_LENGTH_MM):
                faults.append((("keyframe", k, "focus_distance"), f"must be greater than {name} = {f:g} mm", u))
            if number is not None and not MIN_LENGTH_MM <= f / number <= MAX_LENGTH_MM:
                rule = f"must leave an aperture between {MIN_LENGTH_MM:g} and {MAX_LENGTH_MM:g} mm"
                faults.append((("keyframe", k, "f_number"), rule, number))
        for k, longer in enumerate(value.axial if value else ()):
            if not MIN_LENGTH_MM <= camera.focal_length + longer <= MAX_LENGTH_MM:
                rule = f"must leave a focal length, of camera.focal_length = {camera.focal_length:g} mm"
                faults.append((("axial", k), rule, longer))
        raise_faults(*faults)
        if psf is None or camera.resolution is None:
            return value
        return with_distortion_of_wavefront(value, psf, camera)

    @field_validator("sensor")
    @classmethod
    def _with_an_opening_that_stays(cls, value: Sensor | None, info: ValidationInfo) -> Sensor | None:
        keys, camera = getattr(info.data.get("lens"), "keyframe", None) or (), info.data.get("camera")
        if value is None or value.exposure == "normalized":
            return value
        if any(key.f_number is not None for key in keys):
            raise_faults((("exposure",), "must be normalized where keyframes have f-numbers", "physical"))
        if keys and isinstance(getattr(camera, "normalization_distance", None), FollowedDistance):
            rule = 'must be normalized where keyframes change the lens and normalization_distance = "sensor"'
            raise_faults((("exposure",), rule, "physical"))
        return value

    @field_validator("fill")
    @classmethod
    def _of_the_forward_warp(cls, value: Fill, info: ValidationInfo) -> Fill:
        motion = info.data.get("motion")
        if motion is not None and motion.warp == "inverse" and value.model_fields_set:
            rule = 'belongs to motion.warp = "forward", not "inverse"'
            raise_faults(*(((key,), rule, getattr(value, key)) for key in sorted(value.model_fields_set)))
        return value

    @field_validator("objects")
    @classmethod
    def _in_known_groups(cls, value: tuple[AnyShape, ...], info: ValidationInfo) -> tuple[AnyShape, ...]:
        if "groups" in info.data:  # missing if they were rejected
            names = (group.name for group in info.data["groups"])
            raise_faults(*unknown_groups((item.group for item in value), names))
        return value

    @model_validator(mode="after")
    def _parts_of_the_lens_fit(self) -> Self:
        if self.psf.seidel.W311 and self.camera.resolution is None:
            rule = "needs camera.resolution, as it is of the corner of the frame"
            raise_faults((("psf", "seidel", "W311"), rule, self.psf.seidel.W311))
        check_opening(self.lens, self.psf)
        if faults := misfit(self.psf, self.aperture):
            key, rule, value = faults
            raise_faults((("aperture", key), rule, value))
        detector = self.camera.sensor_distance
        rule = f"must be before the detector, {detector:.6g} mm behind the lens"
        for index, rim in enumerate(self.aperture.rim):
            if rim.distance <= -detector:
                raise_faults((("aperture", "rim", index, "distance"), rule, rim.distance))
        return self

    @model_validator(mode="after")
    def _methods_fit_the_surfaces(self) -> Self:
        rule = "coc belongs to lenses without field_curvature and distortion whose focus_surface is a plane"
        maps = (k for k, item in enumerate(self.objects) if isinstance(item, DepthMap) and item.unit == "coc")
        if self.blurs_unevenly:
            raise_faults(*((("object", k, "unit"), rule, "coc") for k in maps))
        if self.psf.asks_for_rays and not self.is_ray_castable:
            raise_faults((("psf", "occlusion"), NEEDS_RAYS, self.psf.occlusion))
        of_two_views = self.motion.warp == "forward" and self.stereo is not None
        if of_two_views or not self.is_ray_castable:
            rule = 'belongs to scenes of analytic surfaces with motion.warp = "inverse"'
            faults: list[Fault] = []
            if self.sequence.rolls:
                faults.append((("sequence", "readout"), rule, self.sequence.readout))
            for index, item in enumerate(self.objects):
                if item.mapped is not None:
                    faults.append((("object", index, "texture_mapping"), rule, item.texture_mapping))
            if self.light is not None:
                faults.append((("light",), fault(rule, got="a light"), self.light))
            raise_faults(*faults)
        return self

    def replace(self, path: str, value: Any) -> Self:
        """Copy with another value of one key, without keys that contradict it.

        A new "camera.f_number", for example, removes "camera.aperture_diameter".

        Parameters
        ----------
        path : str
            Key of the scene file, such as "camera.f_number" or "object.0.radius".
        value
            Value of the key; a table as a mapping, or as an object of this package.

        Returns
        -------
        Scene

        Raises
        ------
        SceneError
            The key does not exist, or the value is invalid.

        Notes
        -----
        `model_copy(update=...)` of pydantic checks nothing, and keeps defaults that depend on the old value.

        Examples
        --------
        >>> import clsco
        >>> scene = clsco.Scene(objects=(clsco.Sphere(center=(0, 0, 280)),))
        >>> scene.replace("object[0].radius", 20).objects[0].radius
        20.0
        """
        return replaced(self, path, value)

    @property
    def inputs(self) -> tuple[tuple[Place, HasInputs], ...]:
        """Tables that may name files or arrays, each with its place in a scene file: the aperture and all objects."""
        objects = ((("object", index), item) for index, item in enumerate(self.objects))
        return (("aperture",), self.aperture), *objects

    @property
    def moves(self) -> bool:
        """True if an object, its group or the camera moves, or the lens changes over time."""
        return self.lens_moves or self.is_displaced

    @property
    def lens_moves(self) -> bool:
        """True if the lens changes over time."""
        return self.lens is not None and self.lens.moves

    @property
    def blurs_unevenly(self) -> bool:
        """True if points at the same depth are blurred differently in different parts of the frame."""
        return self.lens is not None and self.lens.blurs_unevenly

    @property
    def darkens(self) -> bool:
        """True if the lens darkens parts of the frame, as by vignetting."""
        return self.lens is not None and self.lens.darkens

    @property
    def shifts_colors(self) -> bool:
        """True if the magnification differs between colors."""
        return self.lens is not None and self.lens.shifts_colors

    @property
    def separates_colors(self) -> bool:
        """True if blur or magnification differs between colors."""
        return self.lens is not None and self.lens.separates_colors

    @property
    def is_displaced(self) -> bool:
        """True if points move in the image: an object, its group or the camera moves, or the lens zooms."""
        motions = (motion for item in self.objects for motion in self.motions(item))
        return self.zooms or self.camera.moves or any(motion.moves for motion in motions)

    @property
    def zooms(self) -> bool:
        """True if keyframes change the magnification: focal lengths, or the focus if it sets normalization_distance."""
        keys = () if self.lens is None else self.lens.keyframe or ()
        follows = isinstance(self.camera.normalization_distance, FollowedDistance)
        return any(key.focal_length is not None or (follows and key.focus_distance is not None) for key in keys)

    @property
    def moves_evenly(self) -> bool:
        """True if all velocities are constant: nothing has accelerations, keyframes (of poses or lens) or shake."""
        motions = (self.camera.motion, *(motion for item in self.objects for motion in self.motions(item)))
        return self.camera.shake is None and not self.lens_moves and all(motion.is_uniform for motion in motions)

    @property
    def rolls(self) -> bool:
        """True if the scene moves under a rolling shutter."""
        return self.sequence.rolls and self.moves

    def motions(self, item: AnyShape) -> tuple[ObjectMotion, ...]:
        """The motion of an object, and that of its group if it is in one."""
        return (item.motion, *(group.motion for group in self.groups if group.name == item.group))

    @property
    def is_ray_castable(self) -> bool:
        """True if rays can be cast at all surfaces at any time: no depth map, and no pixel moved by a forward warp."""
        return self.is_analytic and not (self.motion.warp == "forward" and self.is_displaced)

    @property
    def has_mapped_textures(self) -> bool:
        """True if any texture is mapped on its surface, not projected."""
        return any(item.mapped is not None for item in self.objects)

    @property
    def is_analytic(self) -> bool:
        """True if every object is analytic: there is no depth map."""
        return all(item.is_analytic for item in self.objects)


Strict.refusal = partial(refusal, Scene)
