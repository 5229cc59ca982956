"""Sweeps: scene files with several values for some keys, and the scenes of all their combinations."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from clsco.errors import SceneError
from clsco.scene.changes import MAX_VARIANTS, VARIANT, variant_tables
from clsco.scene.faults import at_most
from clsco.scene.file import MAX_OUTPUTS, absolute, parse_file, parse_scene, read_mapping, swept_keys, table_of
from clsco.scene.model import Scene
from clsco.scene.quantities import Location, as_python
from clsco.scene.sensor import NOISE_SEEDS
from clsco.scene.text import key_name, shown

RANGE = ("from", "to", "steps")
DIOPTERS = "diopters"  # spacing of a range: equal steps of 1 / value
DEEPEST = 8  # deepest nesting of tables and lists, more than a range of an object's velocities needs


@dataclass(frozen=True)
class Sweep:
    """Scenes of one file, each with a label of the swept keys and their values.

    A label is a valid folder name; it is "" if the file has only one scene.
    """

    labels: tuple[str, ...]
    scenes: tuple[Scene, ...]


@dataclass(frozen=True)
class _Axis:
    """A swept key with its values, each in the form of a single value in a scene file."""

    location: Location
    values: tuple[Any, ...]

    @property
    def name(self) -> str:
        """The key as written in messages."""
        return key_name(self.location)

    def words(self) -> list[str]:
        """A word for each value, the shortest that distinguishes them."""
        short = [_word(value, exact=False) for value in self.values]
        return short if len(set(short)) == len(short) else [_word(value, exact=True) for value in self.values]

    def label(self) -> str:
        """The key as part of a label: short, and different for every key that can be swept."""
        section, *inner, key = (str(part) for part in self.location)
        return "_".join([section, *inner[:-1], key] if inner else [key])  # without "motion"


def load_sweep(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Sweep:
    """Read all scenes of a .toml or .json file in which keys may have several values.

    Parameters
    ----------
    path : str or os.PathLike
        The file, at most 1 MiB.
    overrides : sequence of str
        As for `clsco.load_scene`; a value may also be a list or a range.

    Returns
    -------
    Sweep
        At most 4096 scenes with labels like "focus_distance_200__f_number_4"; one scene with the label "" if no key has
        several values. Paths are absolute, as from `clsco.load_scene`.

    Raises
    ------
    SceneError
        One message per fault, `file: key: rule; got value`. A swept key is named with the position of the value,
        counted from 0: camera.f_number[2].

    Notes
    -----
    Keys of [camera], [motion], [sequence], [camera.motion], [object.motion] and [group.motion] may be a list of values,
    or a range { from = 200, to = 400, steps = 9 } that includes both ends; for a vector a list of vectors, or a range
    of vectors. With spacing = "diopters", a range has equal steps of 1 / value. Several such keys give all
    combinations, the first key of the file changing slowest. For values that change together, each table [[variant]]
    has the keys that differ from the rest of the file; labels then begin with "v00", "v01". Each variant is a separate
    exposure: the sensor's noise_seed is 1 higher than in the previous variant, unless it is given for each.

    Examples
    --------
    >>> import clsco
    >>> from clsco.resources import folder
    >>> sweep = clsco.load_sweep(folder("examples") / "sphere.toml", ["camera.f_number=[2, 4]"])
    >>> sweep.labels
    ('f_number_2', 'f_number_4')
    """
    where = os.fspath(path)
    sweep, folder = parse_file(read_mapping(where, overrides), where, parse_sweep), Path(where).absolute().parent
    return replace(sweep, scenes=tuple(absolute(scene, folder) for scene in sweep.scenes))


def load_sweeps(paths: Sequence[Path], overrides: Sequence[str] = ()) -> list[tuple[Path, Sweep | SceneError]]:
    """Read the sweeps of several files, as `load_sweep` does; an invalid file gives its error in place of a sweep."""
    loaded: list[tuple[Path, Sweep | SceneError]] = []
    for path in paths:
        try:
            loaded.append((path, load_sweep(path, overrides)))
        except SceneError as error:
            loaded.append((path, error))
    return loaded


def parse_sweep(mapping: Mapping[str, Any] | str, where: str = "scene") -> Sweep:
    """Validate all scenes in nested mappings and lists with the keys of a scene file, or in its text.

    Parameters
    ----------
    mapping : mapping or str
        Content of a scene file as for `clsco.parse_scene`, in which keys may have several values as for
        `clsco.load_sweep`; in a mapping also as NumPy arrays. Paths stay as they are.
    where : str
        Name for messages.

    Returns
    -------
    Sweep
        As from `clsco.load_sweep`.

    Raises
    ------
    SceneError
        As `clsco.load_sweep`.

    Examples
    --------
    >>> import clsco
    >>> sweep = clsco.parse_sweep({"camera": {"f_number": [2, 4]}, "object": [{"shape": "plane"}]})
    >>> [scene.camera.f_number for scene in sweep.scenes]
    [2.0, 4.0]
    """
    mapping = _listed(table_of(mapping, where))
    if isinstance(mapping, Mapping) and VARIANT in mapping:
        return _parse_variants(mapping, where)
    return _parse_lists(mapping, where)


def _parse_variants(mapping: Mapping[str, Any], where: str) -> Sweep:
    """Scenes of a file with [[variant]]: those of each variant, one variant after the other."""
    tables = mapping[VARIANT]
    if not (whole := variant_tables(mapping)):
        raise SceneError(f"{where}: variant: must be 1 to {MAX_VARIANTS} tables, [[variant]]; got {shown(tables)}")
    faults, labels, scenes = dict[str, list[int]](), list[str](), list[Scene]()
    objects: tuple[Any, ...] = ()
    for number, table in enumerate(whole):
        is_shared = table.get("object") is mapping.get("object")
        if is_shared and objects:  # valid objects are not validated again
            table["object"] = objects
        try:
            sweep = _parse_lists(table, "")
        except SceneError as error:
            for message in error.messages:
                faults.setdefault(message.removeprefix(": "), []).append(number)
            continue
        objects = sweep.scenes[0].objects if is_shared else objects
        if len(scenes) + len(sweep.scenes) > MAX_OUTPUTS:
            raise SceneError(f"{where}: variant: must give at most {MAX_OUTPUTS} scenes in all; got more")
        labels += [f"v{number:02d}__{label}" if label else f"v{number:02d}" for label in sweep.labels]
        has_seed = isinstance(sensor := tables[number].get("sensor"), Mapping) and "noise_seed" in sensor
        later = 0 if has_seed else len(scenes)
        scenes += [exposed_again(scene, later) for scene in sweep.scenes]
    if faults:  # one of each variant is a fault of the file
        every = {message for message, places in faults.items() if 1 < len(places) == len(whole)}
        own = (f"variant[{k}]: {message}" for message, places in faults.items() for k in places if message not in every)
        raise SceneError(at_most(where, [*sorted(every), *own]))
    return Sweep(tuple(labels), tuple(scenes))


def _parse_lists(mapping: Any, where: str) -> Sweep:
    """Scenes of a file in which keys have lists or ranges of values."""
    if not isinstance(mapping, Mapping) or not (swept := swept_keys(mapping)):
        return Sweep(("",), (parse_scene(mapping, where),))
    faults: list[str] = []
    axes = [_Axis(location, _values(key_name(location), value, faults)) for location, value in swept]
    count = math.prod(max(1, len(axis.values)) for axis in axes)
    if count > MAX_OUTPUTS:
        names = ", ".join(axis.name for axis in axes[:4]) + (f" and {len(axes) - 4} more" if len(axes) > 4 else "")
        faults.append(f"{names}: must give at most {MAX_OUTPUTS} scenes in all; got {count}")
    if faults:  # report also other faults of the file, found with the first value of every swept key
        faults += _faults(mapping, axes, [(0,) * len(axes)])[1]
        raise SceneError(at_most(where, dict.fromkeys(faults)))
    choices = list(product(*(range(len(axis.values)) for axis in axes)))
    scenes, faults = _faults(mapping, axes, choices)
    if faults:
        raise SceneError(at_most(where, faults))
    words = [[f"{axis.label()}_{word}" for word in axis.words()] for axis in axes]
    labels = ["__".join(column[i] for column, i in zip(words, choice, strict=True)) for choice in choices]
    if all(axis.location != ("sensor", "noise_seed") for axis in axes):
        scenes = [exposed_again(scene, number) for number, scene in enumerate(scenes)]
    return Sweep(tuple(labels), tuple(scenes))


def exposed_again(scene: Scene, number: int) -> Scene:
    """The scene with the sensor noise of another exposure, `number` exposures later."""
    if scene.sensor is None or number == 0:
        return scene
    seed = (scene.sensor.noise_seed + number) % NOISE_SEEDS
    return scene.model_copy(update={"sensor": scene.sensor.model_copy(update={"noise_seed": seed})})


def _listed(value: Any, depth: int = 0) -> Any:
    """A mapping with NumPy values converted to lists and numbers, except textures and depths."""
    if isinstance(value, Mapping | list) and depth == DEEPEST:  # deeper nesting is rejected later
        return value
    if isinstance(value, Mapping):
        named = value.items()
        return {key: entry if key in ("texture", "depth") else _listed(entry, depth + 1) for key, entry in named}
    return [_listed(entry, depth + 1) for entry in value] if isinstance(value, list) else as_python(value)


def _faults(
    mapping: Mapping[str, Any], axes: Sequence[_Axis], choices: Sequence[tuple[int, ...]]
) -> tuple[list[Scene], list[str]]:
    """The valid scenes, and the faults of the others, each reported once."""
    scenes: list[Scene] = []
    seen: dict[str, list[tuple[int, ...]]] = {}
    same_objects = all(axis.location[0] != "object" for axis in axes)
    for choice in choices:
        data: Any = mapping
        for axis, index in zip(axes, choice, strict=True):
            data = _with(data, axis.location, axis.values[index : index + 1])
        try:
            scenes.append(parse_scene(data, ""))
            if same_objects:  # valid objects are not validated again
                mapping = {**mapping, "object": scenes[0].objects}
        except SceneError as error:
            for message in error.messages:
                seen.setdefault(_at_value(message.removeprefix(": "), axes, choice), []).append(choice)
    faults = []
    for message, places in seen.items():
        # A fault of one value occurs with every value of the other keys; any other fault is reported with all values.
        alone = any(
            message.startswith(f"{axis.name}[{places[0][k]}]") and len(places) * len(axis.values) == len(choices)
            for k, axis in enumerate(axes)
        )
        if len(places) == len(choices) or alone:
            faults.append(message)
        else:
            those = ", ".join(f"{axis.name}[{index}]" for axis, index in zip(axes, places[0], strict=True))
            faults.append(f"{message} (with {those})")
    return scenes, faults


def _at_value(message: str, axes: Sequence[_Axis], choice: tuple[int, ...]) -> str:
    """The message; if it begins with a swept key, the index of the key's value is added: "camera.f_number[2]: ..."."""
    for axis, index in zip(axes, choice, strict=True):
        if message.startswith(axis.name) and message[len(axis.name)] in ":[":
            return f"{axis.name}[{index}]{message[len(axis.name) :]}"
    return message


def _with(node: Any, location: Location, value: tuple[Any, ...]) -> Any:
    """A copy of `node` with another value at `location`, or without that key for (); other parts are not copied."""
    copy = list(node) if isinstance(node, list) else dict(node)
    first: Any = location[0]
    if len(location) > 1:
        copy[first] = _with(copy[first], location[1:], value)
    elif value:
        copy[first] = value[0]
    else:
        del copy[first]
    return copy


def _values(name: str, values: Any, faults: list[str]) -> tuple[Any, ...]:
    """Values of a list or a range; if it is invalid, () and messages appended to `faults`."""
    if isinstance(values, Mapping):
        return _range(name, values, faults)
    if not 1 <= len(values) <= MAX_OUTPUTS:
        faults.append(f"{name}: must hold 1 to {MAX_OUTPUTS} values; got {len(values)}")
        return ()
    first: dict[str, int] = {}
    for index, value in enumerate(values):
        try:
            other = first.setdefault(_word(value, exact=True), index)
        except RecursionError:
            faults.append(f"{name}[{index}]: nested too deeply; got {shown(value)}")
            return ()
        if other != index:
            faults.append(f"{name}[{index}]: values must differ; {name}[{other}] is the same; got {shown(value)}")
    return tuple(values)


def _range(name: str, table: Mapping[str, Any], faults: list[str]) -> tuple[Any, ...]:
    """Values of a range; if it is invalid, () and messages appended to `faults`."""
    inverse = table.get("spacing") == DIOPTERS
    own = [
        f"{name}.{key_name((key,))}: a range has from, to and steps; got {shown(table[key])}"
        for key in table
        if key not in (*RANGE, "spacing")
    ]
    own += [f"{name}.{key}: must be given; got nothing" for key in RANGE if key not in table]
    for key, value in table.items():
        if rule := _range_rule(key, value, inverse):
            own.append(f"{name}.{key}: {rule}; got {shown(value)}")
    if own:
        faults += own
        return ()
    start, end, steps = (table[key] for key in RANGE)
    if isinstance(start, list) != isinstance(end, list) or len(_components(start)) != len(_components(end)):
        faults.append(f"{name}.to: must have as many numbers as from = {shown(start)}; got {shown(end)}")
        return ()
    if start == end:
        faults.append(f"{name}.to: must differ from from; got {shown(end)}")
        return ()
    if inverse:
        shares = [i / (steps - 1) for i in range(1, steps - 1)]
        return (start, *(1.0 / ((1.0 - share) / start + share / end) for share in shares), end)
    values = []
    for i in range(steps):
        pairs = zip(_components(start), _components(end), strict=True)
        value = [_between(low, high, i, steps - 1) for low, high in pairs]
        values.append(value if isinstance(start, list) else value[0])
    return tuple(values)


def _range_rule(key: str, value: Any, inverse: bool) -> str:
    """The rule that the value of a range's key violates, "" if none; inverse: True for equal steps of 1 / value."""
    if key == "steps" and not (type(value) is int and 2 <= value <= MAX_OUTPUTS):
        return f"must be an integer between 2 and {MAX_OUTPUTS}"
    if key == "spacing" and not inverse:
        return f'must be "{DIOPTERS}"'
    if key in ("from", "to") and inverse and not (_is_number(value) and value > 0):
        return "must be a positive number in a range of diopters"
    ends = _components(value) if key in ("from", "to") and not inverse else ()
    if not all(_is_number(end) and abs(end) < 1e300 for end in ends):  # so that differences are finite as well
        return "must be a finite number, or a list of them"
    return ""


def _components(value: Any) -> list[Any]:
    """Components of a vector, or the number itself."""
    return value if isinstance(value, list) else [value]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _between(low: float, high: float, step: int, last: int) -> float:
    """The number after `step` of `last` equal steps from low to high; ends are exact, and integers stay integers."""
    if step == last:
        return high
    if isinstance(low, int) and isinstance(high, int) and (high - low) * step % last == 0:
        return low + (high - low) * step // last
    return low + (high - low) * (step / last)


def _word(value: Any, *, exact: bool) -> str:
    """A value as part of a label: floats with six digits, or with all digits if `exact`."""
    if isinstance(value, list):
        return "_".join(_word(entry, exact=exact) for entry in value)
    if isinstance(value, float):
        return repr(value).removesuffix(".0") if exact else f"{value:.6g}"
    return value if isinstance(value, str) else repr(value)
