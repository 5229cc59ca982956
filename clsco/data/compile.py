"""Compiles a distribution file into a scene with the fixed values, parameters that vary, and populations of objects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from clsco.data.acceptance import DERIVED, parse_target
from clsco.data.draws import Splits
from clsco.data.folder import Folder, RefusedError
from clsco.data.forms import FORMS, ChoiceForm, Files, Form, Frustum, form_of, is_form
from clsco.data.tables import DistributionTables
from clsco.scene.changes import displace, put
from clsco.scene.file import FILE_KEYS, named_files, names_file
from clsco.scene.objects import MAX_OBJECTS
from clsco.scene.text import key_name, shown

Location = tuple[str | int, ...]
MAX_PARAMETERS = 1000
MAX_SWEPT = 4096  # entries of a list that are searched for distributions
# Keys of tables that are one value: a rotation, a range.
VALUE_TABLES = frozenset(("axis", "angle", "quaternion", "from", "to", "steps", "spacing"))
MOVING = ("camera", "object", "group")


@dataclass(frozen=True)
class Parameter:
    """A value that varies. name: selects the random stream; location: parts of the key; form: distribution."""

    name: str
    location: Location
    form: Form


@dataclass(frozen=True)
class Population:
    """Objects of one kind, whose number and values are drawn."""

    label: str  # its name in the names of parameters
    entry: int  # position of its table in [[vary.object]]
    named: bool  # True if the file gives it a name
    count: Parameter  # number of objects
    constants: dict[str, Any]  # values that all objects share
    parameters: tuple[Parameter, ...]  # values that are drawn for each object
    shapes: tuple[str, ...]  # shapes that an object may have


@dataclass(frozen=True)
class VariedKeys:
    """Content of a distribution, except the table [accept] and the splits."""

    scene: dict[str, Any]
    parameters: tuple[Parameter, ...]
    populations: tuple[Population, ...]
    derived: tuple[tuple[tuple[str, ...], Any], ...]  # derived keys, each with its target: a number, or a Parameter
    sized: bool  # True if a resolution is needed, because rays are cast, or points are placed in the frustum


class Reader:
    """Compiles the tables of a distribution, and lists all their faults."""

    def __init__(self, tables: DistributionTables, folder: Folder, splits: Splits | None) -> None:
        self.faults: list[str] = []
        self._tables, self._folder, self._splits = tables, folder, splits
        self._scene = copied(tables.scene)
        self._count = 0

    def parts(self) -> VariedKeys:
        """Compile the distribution. If `faults` is not empty after the call, the result is incomplete."""
        self._no_forms(self._tables.scene, ())
        parameters, populations = list[Parameter](), list[Population]()
        for section, value in self._tables.vary.items():
            if section in ("object", "group"):
                for entry, table in enumerate(self._entries(section, value)):
                    if section == "group" or "index" in table:
                        parameters += self._existing(section, entry, table)
                    else:
                        populations += self._population(entry, table, [one.label for one in populations])
            elif isinstance(value, dict):
                parameters += self._section((section,), value)
            else:
                self._faulty(("vary", section), "must be a table", value)
        derived = self._derived()
        parameters += [target for _, target in derived if isinstance(target, Parameter)]
        self._check_files(self._scene)
        for population in populations:
            self._check_files({"object": [population.constants]}, ("vary", "object", population.entry))
        if self._count > MAX_PARAMETERS:
            self.faults.append(f"vary: must have at most {MAX_PARAMETERS} distributions; got {self._count}")
        names = [one.name for one in parameters]
        for name in dict.fromkeys(name for name in names if names.count(name) > 1):
            self.faults.append(f"vary: {name}: must vary in one place; got two")
        members = [one for population in populations for one in population.parameters]
        frustum = any(isinstance(one.form, Frustum) for one in (*parameters, *members))
        sized = bool(frustum or derived or self._tables.accept)
        return VariedKeys(self._scene, tuple(parameters), tuple(populations), tuple(derived), sized)

    def _faulty(self, key: Location, rule: str, got: Any) -> None:
        self.faults.append(f"{key_name(key)}: {rule}; got {shown(got)}")

    def _no_forms(self, value: Any, location: Location) -> None:
        """Report distributions outside of [vary] as faults."""
        if isinstance(value, Mapping):
            # Entries of arrays, and motions, are tables of the scene; tables at other keys are values.
            is_value = len(location) > 1 and location[-1] != "motion" and not isinstance(location[-1], int)
            if is_value and is_form(value):
                self._faulty(location, "a distribution belongs in [vary]", value)
                return
            for key, entry in value.items():
                self._no_forms(entry, (*location, key))
        elif isinstance(value, list):
            for index, entry in enumerate(value[:MAX_SWEPT]):
                self._no_forms(entry, (*location, index))

    def _section(self, place: Location, table: Mapping[str, Any]) -> list[Parameter]:
        """Parameters in the table of [vary] for the scene's table at `place`; fixed values are set in the scene."""
        parameters = []
        for key, value in table.items():
            location, names = (*place, key), [*map(str, place), key]
            if key == "motion" and place[0] in MOVING and isinstance(value, Mapping):
                parameters += self._section(location, value)
                continue
            constant, varying = self._value(value, ("vary", *location), location, ".".join(names))
            displace(self._scene, ".".join(names), None if varying else constant)
            if (fault := put(self._scene, names, constant)) is not None:
                self.faults.append(f"{key_name(('vary', *location))}: {fault}")
            else:
                parameters += varying
        return parameters

    def _value(self, value: Any, key: Location, location: Location, name: str) -> tuple[Any, list[Parameter]]:
        """A value in which None replaces each varying part, and the parameters of these parts.

        key: location in the file, for messages; location: location in the scene; name: name of the parameter.
        """
        if isinstance(value, Mapping):
            is_keyframe = key[-2:-1] == ("keyframe",)  # its key `rotation` looks like a distribution
            if is_form(value) and not is_keyframe:
                return None, self._parameter(value, key, location, name)
            if value and (value.keys() <= VALUE_TABLES or is_keyframe):
                parts = {k: self._value(v, (*key, k), (*location, k), f"{name}.{k}") for k, v in value.items()}
                return {k: part[0] for k, part in parts.items()}, [p for part in parts.values() for p in part[1]]
            rule = f"must be a value, or a distribution by one of {', '.join(FORMS)}"
            self._faulty(key, rule, next(iter(value), value))
            return None, []
        if isinstance(value, list) and len(value) <= MAX_SWEPT:
            items = [self._value(v, (*key, k), (*location, k), f"{name}.{k}") for k, v in enumerate(value)]
            return [item[0] for item in items], [p for item in items for p in item[1]]
        return value, []

    def _parameter(self, value: Mapping[str, Any], key: Location, location: Location, name: str) -> list[Parameter]:
        self._count += 1
        if self._count > MAX_PARAMETERS:
            return []
        try:
            form = form_of(value, self._folder, self._splits)
        except RefusedError as error:
            self.faults.append(error.message(key_name(key), value))
            return []
        if location[-1] in FILE_KEYS and isinstance(form, ChoiceForm):
            for index, entry in enumerate(form.entries):
                self._check_file(entry, (*key, "choice", index))
        elif isinstance(form, Files) and location[-1] not in FILE_KEYS:
            self._faulty(key, f"files are for {', '.join(FILE_KEYS[:2])} and the like", value)
        return [Parameter(name, location, form)]

    def _entries(self, section: str, value: Any) -> list[dict[str, Any]]:
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            self._faulty(("vary", section), f"must be an array of tables, [[vary.{section}]]", value)
        elif len(value) > MAX_OBJECTS:
            self._faulty(("vary", section), f"must have at most {MAX_OBJECTS} tables", value)
        else:
            return value
        return []

    def _existing(self, section: str, entry: int, table: Mapping[str, Any]) -> list[Parameter]:
        """Parameters of an object or a group that the scene has already."""
        index, there = table.get("index"), self._scene.get(section)
        count = len(there) if isinstance(there, list) else 0
        if type(index) is not int or not 0 <= index < count:
            rule = f"must be the position of a [[{section}]] of the scene, which has {count}, counted from 0"
            self._faulty(("vary", section, entry, "index"), rule, index)
            return []
        before = len(self.faults)
        parameters = self._section((section, index), {key: value for key, value in table.items() if key != "index"})
        in_scene, in_file = f"vary.{section}[{index}]", f"vary.{section}[{entry}]"
        self.faults[before:] = [message.replace(in_scene, in_file, 1) for message in self.faults[before:]]
        return parameters

    def _population(self, entry: int, table: Mapping[str, Any], labels: list[str]) -> list[Population]:
        key: Location = ("vary", "object", entry)
        name, before = table.get("name"), len(self.faults)
        label = name if isinstance(name, str) else f"population_{len(labels)}"
        if "name" in table and not (isinstance(name, str) and 0 < len(name) <= 64 and name.isprintable()):
            self._faulty((*key, "name"), "must be a text of 1 to 64 characters", name)
        elif label in labels:
            self._faulty((*key, "name"), "names of populations must differ", label)
        count = self._how_many(table.get("count", 1), (*key, "count"), f"object.{label}.count")
        constants: dict[str, Any] = {}
        parameters: list[Parameter] = []
        for part, value in table.items():
            inner = value if part == "motion" and isinstance(value, Mapping) else {None: value}
            for last, one in inner.items() if part not in ("name", "count") else ():
                place: Location = (part,) if last is None else (part, last)
                dotted = ".".join(map(str, place))
                constant, varying = self._value(one, (*key, *place), place, f"object.{label}.{dotted}")
                put(constants, list(map(str, place)), constant)
                parameters += varying
        shapes = [p.form.extremes() for p in parameters if p.location == ("shape",)] or [(constants.get("shape"),)]
        if len(self.faults) > before or count is None:
            return []
        known = tuple(shape for shape in shapes[0] if isinstance(shape, str))
        return [Population(label, entry, "name" in table, count, constants, tuple(parameters), known)]

    def _how_many(self, value: Any, key: Location, name: str) -> Parameter | None:
        if is_form(value):
            parameters = self._parameter(value, key, ("count",), name)
        else:
            parameters = [Parameter(name, ("count",), ChoiceForm(None, (value,), (1.0,)))]
        for parameter in parameters:
            if all(type(count) is int and 0 <= count <= MAX_OBJECTS for count in parameter.form.extremes()):
                return parameter
            rule = f"must be a number of objects, 0 to {MAX_OBJECTS}, or integers or a choice of them"
            self._faulty(key, rule, value)
        return None

    def _derived(self) -> list[tuple[tuple[str, ...], Any]]:
        """Keys of [derive] with their targets; a distribution as target is replaced by its parameter."""
        targets: dict[tuple[str, ...], Any] = {}
        if not isinstance(sections := self._tables.derive, dict):
            self._faulty(("derive",), "must be a table", sections)
            sections = {}
        for section, table in sections.items():
            for key, value in table.items() if isinstance(table, dict) else [("", table)]:
                here: Location = ("derive", section, key) if key else ("derive", section)
                try:
                    if (section, key) not in DERIVED:
                        raise RefusedError(f"must be one of {', '.join('.'.join(one) for one in DERIVED)}")
                    target = parse_target((section, key), value)
                except RefusedError as error:
                    self.faults.append(error.message(key_name(here), value))
                    continue
                displace(self._scene, f"{section}.{key}", None)
                varies = isinstance(target, Mapping)
                targets[section, key] = self._drawn_target((section, key), target) if varies else target
        return [(key, targets[key]) for key in DERIVED if key in targets]

    def _drawn_target(self, key: tuple[str, str], value: Mapping[str, Any]) -> Parameter | None:
        """The parameter that draws the target of a derived key."""
        here: Location = ("derive", *key)
        for parameter in self._value(value, here, here, ".".join(("derive", *key)))[1]:
            for end in parameter.form.extremes():
                try:
                    parse_target(key, {DERIVED[key]: end})
                except RefusedError as error:
                    self.faults.append(error.message(key_name(here), end))
            return parameter
        return None

    def _check_files(self, table: Mapping[str, Any], start: Location = ()) -> None:
        """Register the files that the content of a scene file names.

        start: location of an object in the distribution file, for messages; () for the whole scene.
        """
        for place, name in named_files(table):
            self._check_file(name, (*start, place[-1]) if start else place)

    def _check_file(self, name: Any, key: Location) -> None:
        """Register the file that an object names at a key."""
        kind = next((kind for kind in ("depth", "image") if kind in key), "texture")
        if isinstance(name, str) and names_file(kind, name):
            try:
                self._folder.take(name)
            except RefusedError as error:
                self.faults.append(error.message(key_name(key), name))


def copied(value: Any) -> Any:
    """Copy tables and lists; other values are shared, but inf becomes "inf", because JSON has no infinity."""
    if isinstance(value, dict):
        return {key: copied(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [copied(entry) for entry in value]
    return "inf" if isinstance(value, float) and value == math.inf else value
