"""Objects of a scene: rules for each object, and for all objects together."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from itertools import count
from typing import Annotated, Any, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import CoreSchema, core_schema

from clsco.scene.quantities import Location, array_of_tables, fault, raise_faults
from clsco.scene.rotations import depth_row
from clsco.scene.shapes import IN_FRONT, SHAPES, AnyShape, Box, origin
from clsco.scene.text import any_of
from clsco.scene.texture_keys import check_texture_keys

MAX_OBJECTS = 64


def _bounds_in_front(shape: AnyShape) -> AnyShape:
    """Reject bounds that end at or behind the lens."""
    if shape.bounds is None:
        return shape
    corners = zip(depth_row(shape.rotation), shape.bounds, strict=True)
    if origin(shape)[2] + sum(max(row * low, row * high) for row, (low, high) in corners) <= 0.0:
        place: Location = ("bounds", 2) if shape.rotation is None else ("bounds",)
        raise_faults((place, IN_FRONT, shape.bounds[2] if shape.rotation is None else shape.bounds))
    return shape


def _known_shape(value: Any) -> Any:
    """Reject a table with an unknown `shape` before its other keys are checked."""
    if isinstance(value, dict):
        shape = value.get("shape")
        if not isinstance(shape, str) or shape not in SHAPES:
            rule = fault(f"must be {any_of(SHAPES)}", None if "shape" in value else "nothing")
            raise_faults((("shape",), rule, shape))
    return value


def repeated_names(names: Iterable[str | None], table: str = "object") -> list[tuple[Location, str, str]]:
    """A fault for each object that has the name of an earlier one; table: name of the objects' array in a file."""
    first: dict[str, int] = {}
    return [
        ((index, "name"), f"names must differ; {table}[{first[name]}] has the same", name)
        for index, name in enumerate(names)
        if name is not None and first.setdefault(name, index) != index
    ]


def _one_background(objects: tuple[AnyShape, ...]) -> tuple[AnyShape, ...]:
    """Reject a second background, which the first would hide."""
    backgrounds = [index for index, item in enumerate(objects) if item.is_background]
    rule = "one background is enough; object[{}] is one already"
    raise_faults(*(((index, "shape"), rule.format(backgrounds[0]), "background") for index in backgrounds[1:]))
    return objects


def _named(objects: tuple[AnyShape, ...]) -> tuple[AnyShape, ...]:
    """Objects with distinct names: an unnamed object is named after its shape, with a number if needed, "sphere 2"."""
    names = [item.name if "name" in item.model_fields_set else None for item in objects]
    raise_faults(*repeated_names(names))
    used = set(names)
    placed = []
    for item, name in zip(objects, names, strict=True):
        if name is None:
            free = (item.shape if n == 1 else f"{item.shape} {n}" for n in count(1))
            chosen = next(word for word in free if word not in used)
            used.add(chosen)
            if chosen != item.name:
                item = item.model_copy(update={"name": chosen})
                item.model_fields_set.discard("name")  # so that another scene names it again
        placed.append(item)
    return tuple(placed)


def _without_boxes(objects: tuple[AnyShape, ...]) -> tuple[AnyShape, ...]:
    """Objects with each box replaced by its faces."""
    shapes = [shape for item in objects for shape in (item.faces() if isinstance(item, Box) else (item,))]
    if len(shapes) > MAX_OBJECTS:
        raise fault(f"must hold 1 to {MAX_OBJECTS} objects, and a box is six", got=str(len(shapes)))
    used = {item.name for item in objects if not isinstance(item, Box)}
    rule = "names of its faces must differ from those of other objects"
    boxes = ((index, item) for index, item in enumerate(objects) if isinstance(item, Box))
    same = ((index, item.name) for index, item in boxes if used & {face.name for face in item.faces()})
    raise_faults(*(((index, "name"), rule, name) for index, name in same))
    return tuple(shapes)


@cache
def _any_shape() -> TypeAdapter[Any]:
    return TypeAdapter(Annotated[AnyShape, Field(discriminator="shape")])


class _OfItsShape:
    """Constraint on an object: the rules of its shape. Models of shapes are built at their first use."""

    @staticmethod
    def check(value: Any) -> AnyShape:
        """The validated object; raises the same faults as validation by the union of all shapes."""
        model = SHAPES[value["shape"]] if isinstance(value, dict) else type(value)
        if model in SHAPES.values():
            model.model_rebuild()  # otherwise another thread could validate with a half-built model
            with suppress(ValidationError):
                return model.model_validate(value)
        return cast(AnyShape, _any_shape().validate_python(value, strict=True))

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return handler(_any_shape().core_schema)


Object = Annotated[
    AnyShape,
    _OfItsShape(),
    AfterValidator(_bounds_in_front),
    AfterValidator(check_texture_keys),
    BeforeValidator(_known_shape),
]
Objects = Annotated[
    tuple[Object, ...],
    AfterValidator(_one_background),
    AfterValidator(_named),
    AfterValidator(_without_boxes),
    array_of_tables("object", "objects", MAX_OBJECTS, least=1),
]
