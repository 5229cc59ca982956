"""Groups of objects that share a motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

from pydantic import AfterValidator

from clsco.scene.motions import ObjectMotion
from clsco.scene.objects import MAX_OBJECTS, repeated_names
from clsco.scene.quantities import Location, Name, Point, Strict, Vector, array_of_tables, raise_faults
from clsco.scene.shapes import AnyShape, origin
from clsco.scene.text import shown


class Group(Strict):
    """Objects that move together, as one rigid body; each may also have its own motion."""

    name: Name
    """Name, which objects give as their group."""
    origin: Point | None = None
    """Point about which the group rotates, mm. Default: the origin of its first object."""
    motion: ObjectMotion = ObjectMotion.model_construct()
    """Velocities of the group; its objects move within it."""


def group_origin(group: Group, objects: Sequence[AnyShape]) -> Vector:
    """Point about which a group rotates, mm; objects: all objects of the scene, at least one of them in the group."""
    if group.origin is not None:
        return group.origin
    return next(origin(item) for item in objects if item.group == group.name)


def unknown_groups(members: Iterable[str | None], names: Iterable[str | None]) -> list[tuple[Location, str, str]]:
    """A fault for each object whose group does not exist; members: group of each object, names: names of all groups."""
    known = list(dict.fromkeys(name for name in names if name is not None))
    some = ", ".join(map(shown, known[:8])) + (", ..." if len(known) > 8 else "")
    rule = f"must be the name of a group, {some}" if known else "must be the name of a group; there is none"
    return [((k, "group"), rule, name) for k, name in enumerate(members) if name is not None and name not in known]


def _distinct(groups: tuple[Group, ...]) -> tuple[Group, ...]:
    """Reject groups with equal names."""
    raise_faults(*repeated_names((group.name for group in groups), "group"))
    return groups


Groups = Annotated[tuple[Group, ...], AfterValidator(_distinct), array_of_tables("group", "groups", MAX_OBJECTS)]
