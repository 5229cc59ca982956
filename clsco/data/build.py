"""Builds the scene file and the scenes of a sample, and tests scenes of extreme values when a distribution is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from clsco.data.acceptance import UnfitError, derive_value
from clsco.data.compile import Location, Parameter, Population, VariedKeys, copied
from clsco.data.forms import Placed
from clsco.errors import FileError, SceneError
from clsco.inputs.textures import texture_size
from clsco.scene.changes import displace
from clsco.scene.file import absolute, names_file, relocated
from clsco.scene.shapes import SHAPES
from clsco.scene.sweep import Sweep, parse_sweep
from clsco.scene.text import key_name, shown

ValueOf = Callable[[Parameter, int], Any]
"""Returns the value of a parameter. The second argument is the number of the object in its population, else 0."""


class Builder:
    """Builds one sample; folder: base of relative paths."""

    def __init__(self, parts: VariedKeys, folder: Path) -> None:
        self._parts, self._folder = parts, folder
        self._table: dict[str, Any] = copied(parts.scene)
        self._parameters: dict[str, Any] = {}
        self._targets: dict[Location, Any] = {}  # drawn targets by derived key
        self._sources: dict[str, str] = {}  # for keys of an object in the scene, the key in the distribution file

    def build(
        self, value_of: ValueOf, derive: bool = True, noise_seed: int = 0
    ) -> tuple[dict[str, Any], dict[str, Any], Sweep]:
        """Build a sample; returns the content of its scene file, its parameters by name, and its scenes.

        derive: False to leave out derived keys. noise_seed: seed for a sensor that has none. Raises UnfitError, or
        SceneError whose messages do not name the file.
        """
        parts = self._parts
        try:
            for parameter in parts.parameters:
                value = value_of(parameter, 0)
                if parameter.location[0] == "derive":
                    self._parameters[parameter.name] = self._targets[parameter.location[1:]] = value
                else:
                    self._set(self._table, parameter.location, value, parameter.name)
            for population in parts.populations:
                count = self._parameters[population.count.name] = value_of(population.count, 0)
                for element in range(count):
                    self._add(population, element, value_of)
            if self._parts.sized:
                self._size()
            if any(isinstance(value, Placed) for value in self._parameters.values()):
                self._place()
            if isinstance(sensor := self._table.get("sensor"), dict):
                sensor.setdefault("noise_seed", noise_seed)
            sweep = parse_sweep(self._table, "")
            for key, target in parts.derived if derive else ():
                sweep = self._derive(key, self._targets[key] if isinstance(target, Parameter) else target, sweep)
        except UnfitError:
            raise
        except SceneError as error:
            raise SceneError([self._varied(message.removeprefix(": ")) for message in error.messages]) from error
        scenes = tuple(absolute(scene, self._folder) for scene in sweep.scenes)
        return self._table, self._parameters, replace(sweep, scenes=scenes)

    def _set(self, table: Any, location: Location, value: Any, name: str) -> None:
        for part in location[:-1]:
            table = table.setdefault(part, {}) if isinstance(table, dict) else table[part]
        table[location[-1]] = self._parameters[name] = copied(value)

    def _add(self, population: Population, element: int, value_of: ValueOf) -> None:
        item: dict[str, Any] = copied(population.constants)
        prefix = f"object.{population.label}."
        for parameter in population.parameters:
            name = f"{prefix}{element}.{parameter.name.removeprefix(prefix)}"
            self._set(item, parameter.location, value_of(parameter, element), name)
        if population.named:
            item["name"] = f"{population.label} {element + 1}"
        objects = self._table.setdefault("object", [])
        if not isinstance(objects, list):
            raise SceneError(f"object: must be an array of tables, [[object]]; got {shown(objects)}")
        self._sources[f"object[{len(objects)}]."] = f"vary.object[{population.entry}]."
        objects.append(item)
        if len(population.shapes) > 1:
            self._fit(item, population.shapes)

    def _fit(self, item: dict[str, Any], shapes: tuple[str, ...]) -> None:
        """Remove keys that the drawn shape of an object does not have; a cone gets its `center` as its `apex`."""
        shape = item.get("shape")
        own = SHAPES[shape].model_fields.keys() if isinstance(shape, str) and shape in SHAPES else set(item)
        others = {key for one in shapes if one in SHAPES for key in SHAPES[one].model_fields}
        for key in [key for key in item if key not in own and key in others]:
            value = item.pop(key)
            if key == "center" and shape == "cone" and "apex" not in item:
                item["apex"] = value

    def _size(self) -> None:
        """Set a missing resolution of the camera to the size of the first object's texture."""
        camera, objects = self._table.setdefault("camera", {}), self._table.get("object")
        first = objects[0] if isinstance(objects, list) and objects else None
        if isinstance(camera, dict) and "resolution" not in camera and isinstance(first, dict):
            texture = first.get("texture", "bricks")
            try:
                name = str(self._folder / texture) if names_file("texture", texture) else texture
                camera["resolution"] = list(texture_size(name) if isinstance(texture, str) else (1, 1))
            except FileError as error:
                raise SceneError(f"object[0].texture: {error}") from None

    def _place(self) -> None:
        """Replace each point in the frustum by its coordinates, for the camera of the first variant."""
        section = self._table["camera"]
        if not isinstance(section, dict):
            raise SceneError(f"camera: must be a table; got {shown(section)}")
        first = {key: _first(key, value) for key, value in section.items() if key != "motion"}
        camera = parse_sweep({"camera": first, "object": [{"shape": "background"}]}, "").scenes[0].camera
        columns, rows = camera.resolution or (0, 0)
        step = camera.pixel_pitch / camera.normalization_distance
        self._table, self._parameters = (
            _with_points(each, columns, rows, step) for each in (self._table, self._parameters)
        )

    def _derive(self, key: tuple[str, ...], target: float, sweep: Sweep) -> Sweep:
        section, name = key
        value = derive_value(key, float(target), sweep.scenes)
        displace(self._table, f"{section}.{name}", value)
        self._table.setdefault(section, {})[name] = self._parameters[f"{section}.{name}"] = value
        return parse_sweep(self._table, "")

    def _varied(self, message: str) -> str:
        """A message in which the scene's key is replaced by the key in the distribution file."""
        for key, source in self._sources.items():
            if message.startswith(key):
                return source + message.removeprefix(key)
        varied = (".".join(map(str, one.location)) for one in self._parts.parameters)
        key = message.partition(":")[0].replace("[", ".").replace("]", "")
        return f"vary.{message}" if any(key == one or key.startswith(f"{one}.") for one in varied) else message


def located(table: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The content of a scene file with `folder` put before its paths. Raises SceneError for paths outside of it."""

    def inside(place: Location, name: str) -> str:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise SceneError(f"{key_name(place)}: must lie in {folder}; got {shown(name)}")
        return str(folder / name)

    return relocated(table, inside)


def _with_points(value: Any, columns: int, rows: int, step: float) -> Any:
    """A copy of tables and lists in which points in the frustum are replaced by their coordinates."""
    if isinstance(value, Placed):
        return value.point(columns, rows, step)
    if isinstance(value, dict):
        return {key: _with_points(entry, columns, rows, step) for key, entry in value.items()}
    return [_with_points(entry, columns, rows, step) for entry in value] if isinstance(value, list) else value


def _first(key: str, value: Any) -> Any:
    """The first value of a camera key that has several; any other value as it is."""
    if isinstance(value, dict):
        return value.get("from")
    several = isinstance(value, list) and value and (key != "resolution" or isinstance(value[0], list))
    return value[0] if several else value


MAX_CORNERS = 400
MAX_EXTREMES = 48  # extreme values of one distribution that are tested


def corner_faults(parts: VariedKeys, folder: Path) -> list[str]:
    """Messages on faults of scenes with extreme values.

    In these scenes all parameters have their lowest value, or all their highest one; or one parameter has one of its
    extreme values, and all others are lowest, or all highest.
    """
    faults: dict[str, str] = {}  # messages by their part before the value
    for corner in _corners(parts):
        try:
            Builder(parts, folder).build(partial(_corner_value, corner), derive=False)
        except SceneError as error:
            for message in error.messages:
                faults.setdefault(message.partition("; got ")[0], message)
    return list(faults.values())


def _corner_value(corner: Mapping[str, Any], parameter: Parameter, _: int) -> Any:
    return corner[parameter.name]


def _corners(parts: VariedKeys) -> Iterator[dict[str, Any]]:
    """For each scene of `corner_faults`, the values of parameters by name."""
    every = [*parts.parameters, *(one for population in parts.populations for one in population.parameters)]
    extremes = {one.name: _some(one.form.extremes()) for one in every}
    counts = {population.count.name: sorted(population.count.form.extremes()) for population in parts.populations}
    lowest, highest = ({name: values[end] for name, values in (extremes | counts).items()} for end in (0, -1))
    yield lowest
    yield highest
    one_each = {name: min(1, values[-1]) for name, values in counts.items()}
    varied = (
        others | one_each | {name: value}
        for name in extremes
        for value in extremes[name]
        for others in (lowest, highest)
    )
    yield from islice(varied, MAX_CORNERS)


def _some(values: tuple[Any, ...]) -> list[Any]:
    """At most MAX_EXTREMES of the values, evenly selected, among them the first and the last one."""
    count = min(len(values), MAX_EXTREMES)
    return [values[(len(values) - 1) * k // max(1, count - 1)] for k in range(count)]
