"""Keys of an object's texture: its image, and its mapping to the surface."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, cast

from pydantic import BeforeValidator, Field

from clsco.scene.arrays import HasInputs, Input, LayerInput, TextureInput
from clsco.scene.quantities import Angle, Length, Name, Pair, Strict, Within, as_python, fault, raise_faults
from clsco.scene.text import meant

BUILT_IN_TEXTURES = ("bricks", "checkerboard", "slanted_edge", "siemens_star")
COLOR = re.compile("#[0-9a-fA-F]{6}")

Mapped = Literal["card", "plane", "cylinder", "longitude", "cone", "triplanar", "cube"]
Wrap = Literal["repeat", "mirror", "clamp", "none"]


def is_drawn(texture: object) -> bool:
    """True if a texture is a built-in pattern or a color, False for a file or an array."""
    return isinstance(texture, str) and (texture in BUILT_IN_TEXTURES or COLOR.fullmatch(texture) is not None)


def in_layer(source: Any, layer: str | None) -> Input:
    """An input together with the layer named in the scene, if the input is a file that can have layers."""
    is_file = isinstance(source, str) and not is_drawn(source)
    return LayerInput(source, layer) if layer is not None and is_file else cast("Input", source)


def missing_texture(name: str) -> str:
    """The rule of an error message about an image that is not found, or an unknown pattern."""
    base = PurePath(name).name
    if PurePath(base).suffix:
        return "must be an existing file, a built-in pattern or a color #rrggbb"
    hint = meant(base.lower(), BUILT_IN_TEXTURES)
    return f"must be one of {', '.join(BUILT_IN_TEXTURES)}, a color #rrggbb, or an image file{hint}"


def _one_or_two(value: Any) -> Any:
    """A tuple from a number, or from a list of one or two numbers."""
    numbers = as_python(value)
    if isinstance(numbers, int | float) and not isinstance(numbers, bool):
        return (numbers,)
    if isinstance(numbers, list | tuple) and len(numbers) in (1, 2):
        return tuple(numbers)
    raise fault("must be a number or a list of 2 numbers")


class _Rule(NamedTuple):
    """Keys that a texture mapping accepts."""

    size: Literal["", "may", "must"]  # texture_size: not accepted, optional or required
    repeats: int  # largest number of texture_repeats
    angle: bool = True
    offset: bool = True


RULES: dict[Mapped, _Rule] = {
    "card": _Rule("may", 2),
    "plane": _Rule("must", 0),
    "cylinder": _Rule("may", 1),
    "longitude": _Rule("", 2, angle=False),
    "cone": _Rule("must", 0),
    "triplanar": _Rule("must", 0),
    "cube": _Rule("", 0, angle=False, offset=False),
}
TRIPLANAR: dict[str, Mapped] = {"triplanar": "triplanar"}
ROUND: dict[str, Mapped] = {"surface": "longitude", "cube": "cube", "triplanar": "triplanar"}

_OneOrTwo = Field(json_schema_extra={"minItems": 1, "maxItems": 2})
_Sizes = Annotated[tuple[Length, ...], _OneOrTwo, BeforeValidator(_one_or_two)]
_Repeats = Annotated[tuple[Annotated[float, Within(1e-6, 1e6)], ...], _OneOrTwo, BeforeValidator(_one_or_two)]
_Shift = Annotated[float, Within(-1e6, 1e6)]
_Shifts = Annotated[tuple[_Shift, _Shift], Pair]


class Textured(HasInputs, Strict):
    """Keys of the texture of an object."""

    MAPPINGS: ClassVar[Mapping[str, Mapped]] = TRIPLANAR
    """Kinds of mappings of textures onto the shape, by the value of `texture_mapping`."""

    texture: TextureInput = "bricks"
    """bricks, checkerboard, slanted_edge, siemens_star, a color "#rrggbb", or an image: a path, relative to the scene
    file; in Python also a NumPy array."""
    texture_layer: Name | None = None
    """Layer of the images, EXR files with several, such as "ViewLayer.Combined" or "Combined". Default: the only one,
    or that which renderers call the image."""
    texture_mapping: Literal["projected", "surface", "triplanar", "cube"] = "projected"
    """projected: the image that the camera sees at t = 0. surface: an image that lies on the surface and moves with it.
    triplanar: the same from three sides, on any shape. cube: from six, on spheres and ellipsoids."""
    texture_size: _Sizes | None = None
    """Width, or width and height, of one copy of the image on the surface, mm."""
    texture_repeats: _Repeats | None = None
    """Copies of the image across the surface, or across and up, in place of a size."""
    texture_offset: _Shifts | None = None
    """Copies by which the image is moved to the right and up; by default not at all."""
    texture_angle: Angle | None = None
    """Turn of the image on the surface, counterclockwise as seen from outside, deg; by default none."""
    texture_wrap: Wrap | None = None
    """Beyond the image: repeat, mirror, clamp or none, which is black. Default: repeat, and clamp where a rectangle or
    disc has one copy."""

    @property
    def mapped(self) -> Mapped | None:
        """Mapping of the texture onto the surface, None for a projected one."""
        return None if self.texture_mapping == "projected" else self.MAPPINGS[self.texture_mapping]

    @property
    def wrap(self) -> Wrap:
        """Continuation of the image beyond its edges."""
        once = self.mapped == "card" and self.texture_size is None and self.texture_repeats is None
        return self.texture_wrap or ("clamp" if once else "repeat")

    def inputs(self) -> dict[str, Input]:
        return {"texture": in_layer(self.texture, self.texture_layer)}

    def files(self) -> dict[str, str]:
        return {key: path for key, path in super().files().items() if key == "depth" or not is_drawn(path)}

    def textures(self) -> tuple[Input, ...]:
        """The single texture of the object, or the six of a cube map: right, left, top, bottom, back, front."""
        return (self.inputs()["texture"],)

    def texture_keys(self) -> dict[str, Any]:
        """Values of the keys of `Textured` that were set explicitly, by key."""
        names = [name for name in Textured.model_fields if name in self.model_fields_set]
        return {name: getattr(self, name) for name in names}


class SixSided(Textured):
    """Keys of shapes that can have an image on each of six sides."""

    texture_back: TextureInput | None = None
    """Image on the side away from the camera; `texture` is on the front, and on all sides that none is given for."""
    texture_left: TextureInput | None = None
    """Image on the left side, as seen by who looks at it from there with the front on the right."""
    texture_right: TextureInput | None = None
    """Image on the right side, with the front on the left."""
    texture_top: TextureInput | None = None
    """Image on the top, with the front below."""
    texture_bottom: TextureInput | None = None
    """Image on the bottom, with the front above."""

    @property
    def has_sides(self) -> bool:
        """True if the sides may have different images."""
        return self.texture_mapping == "cube"

    def inputs(self) -> dict[str, Input]:
        sides = {key: getattr(self, key) for key in SixSided.__annotations__}
        sources = {key: in_layer(side, self.texture_layer) for key, side in sides.items() if side is not None}
        return super().inputs() | sources

    def side(self, name: str) -> Input:
        """The texture of a side: front, back, left, right, top or bottom."""
        inputs = self.inputs()
        return inputs.get(f"texture_{name}", inputs["texture"])

    def textures(self) -> tuple[Input, ...]:
        if self.mapped != "cube":
            return super().textures()
        return tuple(self.side(name) for name in ("right", "left", "top", "bottom", "back", "front"))


def check_texture_keys(item: Any) -> Any:
    """Reject keys that the texture's mapping or the shape does not use, and missing keys that are required."""
    faults = _misplaced(item)
    raise_faults(*(((key,), fault(rule, "nothing" if got is None else None), got) for key, rule, got in faults))
    return item


def _misplaced(item: Textured) -> Iterator[tuple[str, str, Any]]:
    """Key, rule and value of each misplaced texture key."""
    shape, mapping = type(item).model_fields["shape"].default, item.texture_mapping
    lying = ("texture_size", "texture_repeats", "texture_offset", "texture_angle", "texture_wrap")
    keys = {key: getattr(item, key) for key in lying if getattr(item, key) is not None}
    images = (value for key, value in item.inputs().items() if key != "depth")
    if item.texture_layer is not None and not any(isinstance(image, LayerInput) for image in images):
        yield "texture_layer", "belongs to images in EXR files", item.texture_layer
    if mapping not in ("projected", *item.MAPPINGS):
        known = " or ".join(f'"{name}"' for name in ("projected", *item.MAPPINGS))
        yield "texture_mapping", f"on a {shape} must be {known}", mapping
        return
    if isinstance(item, SixSided) and not item.has_sides:
        rule = 'belongs to boxes, and to texture_mapping = "cube"'
        yield from ((key, rule, getattr(item, key)) for key in item.inputs() if key != "texture")
    if mapping == "projected":
        rule = 'belongs to textures on surfaces: texture_mapping = "surface", "triplanar" or "cube"'
        yield from ((key, rule, value) for key, value in keys.items())
    else:
        yield from _unfit(item, RULES[item.MAPPINGS[mapping]], f'"{mapping}" on a {shape}')


def _unfit(item: Textured, takes: _Rule, where: str) -> Iterator[tuple[str, str, Any]]:
    """Key, rule and value of each key that a mapping does not accept, and of each required key that is missing."""
    if takes.size == "must" and item.texture_size is None:
        yield "texture_size", f"must be given with texture_mapping = {where}", None
    if not takes.size and item.texture_size is not None:
        yield "texture_size", f"does not belong to {where}", item.texture_size
    if len(item.texture_repeats or ()) > takes.repeats:
        what = "takes one number" if takes.repeats else "does not belong"
        yield "texture_repeats", f"{what} with {where}", item.texture_repeats
    elif item.texture_repeats is not None and item.texture_size is not None and takes.size:
        yield "texture_repeats", "stands in place of texture_size: give one of them", item.texture_repeats
    if not takes.angle and item.texture_angle is not None:
        yield "texture_angle", f"does not belong to {where}: give the object a rotation", item.texture_angle
    if not takes.offset and item.texture_offset is not None:
        yield "texture_offset", f"does not belong to {where}: give the object a rotation", item.texture_offset
