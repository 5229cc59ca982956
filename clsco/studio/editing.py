"""Editor that changes a scene key by key, with messages on invalid values, undo and redo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from clsco.errors import SceneError
from clsco.resources import folder
from clsco.scene.file import FILE_KEYS, absolute, missing_input, named_files, parse_scene, swept_keys
from clsco.scene.model import Scene
from clsco.scene.shapes import SHAPES
from clsco.scene.sweep import parse_sweep
from clsco.scene.text import key_name, shown
from clsco.studio.background import Observable
from clsco.studio.tables import Table, as_lists, at, path_parts, placed, pose_for, reshaped, seed, with_value, without

STEPS = 200  # largest number of undo steps
THESIS: Table = {"object": [{"shape": "plane"}]}  # a scene whose other keys have their defaults, which the thesis uses
_CHOICES = ("texture_mapping", "unit")  # keys of an object whose values decide which other keys it may have


@dataclass(frozen=True)
class State:
    """State of an editor, to which undo can return."""

    table: Table
    apart: tuple[Mapping[str, Table], ...]  # for each object, the keys that it had with other shapes, by shape
    path: Path | None = None  # of the scene file
    label: str = ""  # of the displayed scene of a sweep
    opened: int = 0  # number of the opened scene, counted from 1; 0 for the initial scene

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Labels of all scenes of a valid table, as `clsco render` names their folders; ("",) for a single scene."""
        return parse_sweep(self.table).labels if swept_keys(self.table) else ("",)

    @property
    def shown(self) -> int:
        """Index of the displayed scene in `labels`; 0 if its label no longer exists."""
        return self.labels.index(self.label) if self.label in self.labels else 0


@dataclass(frozen=True)
class _Step:
    state: State
    scene: Scene
    drag: int | None = None  # number of the drag that changed this state


@dataclass
class _History:
    past: list[_Step] = field(default_factory=list)
    future: list[_Step] = field(default_factory=list)

    def push(self, before: _Step) -> None:
        """Add the state before a change, and clear the future; all changes of one drag are one step."""
        self.future.clear()
        if before.drag is None or not self.past or self.past[-1].drag != before.drag:
            self.past.append(before)
            del self.past[:-STEPS]

    def came_back(self, state: State, drag: int | None) -> None:
        """Remove the step of a drag that ends where it began."""
        if drag is not None and self.past[-1].drag == drag and self.past[-1].state == state:
            self.past.pop()


class Editor(Observable):
    """A scene that is edited key by key.

    An invalid value stays in its box with a message, and the last valid scene stays in use. The value is tried again
    with each later change, so that keys that depend on each other can be changed one after the other.

    All files are below `root`, but the shipped examples can be read, too. `scene` is the last valid scene, with
    absolute paths; in a sweep, it is the displayed scene. `revision` counts the changes of `scene`. `refused` has the
    invalid values, and `faults` their messages, by path of the key. With `is_linked`, the semi-axes b and c of
    ellipsoids change together.
    """

    def __init__(self, root: Path) -> None:
        super().__init__()
        self.root = root.resolve()
        self.readable = (self.root, Path(str(folder("examples"))).resolve())
        self.revision = 0
        self.faults: dict[str, str] = {}
        self.refused: dict[str, Any] = {}
        self.is_linked = False
        self._history = _History()
        self._models: dict[int, Any] = {}
        self.state = State(THESIS, ({},))
        self.scene = self._valid(self.state)

    @property
    def table(self) -> Table:
        """Content of the scene file: the explicitly given keys. It is never modified in place."""
        return self.state.table

    @property
    def path(self) -> Path | None:
        """The scene file, None before it is saved."""
        return self.state.path

    @property
    def folder(self) -> Path:
        """Base folder of the scene's relative paths."""
        return self.state.path.parent if self.state.path is not None else self.root

    @property
    def object_entries(self) -> list[int]:
        """Index in the file of each object of the scene, where each face of a box is an object."""
        models = [self._object(index) for index in range(len(self.table["object"]))]
        return [index for index, item in enumerate(models) for _ in (item.faces() if item.shape == "box" else (item,))]

    @property
    def can_undo(self) -> bool:
        return bool(self._history.past or self.refused)

    @property
    def can_redo(self) -> bool:
        return bool(self._history.future)

    def patch(self, path: str, value: Any, drag: int | None = None) -> bool:
        """Change one key; returns True if the scene changed. If the value is invalid, `faults` has a message.

        A component of a vector is "object.0.center.2". None or "" removes the key, so that it has its default. All
        changes of one drag are one undo step.
        """
        waiting = {other: old for other, old in self.refused.items() if not _overlaps(other, path)}
        if path.endswith(".shape"):  # discard invalid values of the former shape
            waiting = {other: old for other, old in waiting.items() if not other.startswith(path[: -len("shape")])}
        together = {**waiting, path: value}
        faults: dict[str, str] | None = None
        for chosen in (together, {path: value}) if waiting else (together,):
            try:
                state, scene = self._changed(chosen)
            except SceneError as error:
                faults = faults or placed(error)
                continue
            self.refused = {other: old for other, old in together.items() if other not in chosen}
            self.faults = (faults or {}) if self.refused else {}
            return self._accept(state, scene, drag)
        assert faults is not None
        if path not in faults and not any(other.startswith(f"{path}.") for other in faults):
            faults = {path: "; ".join(f"{key}: {rule}" if key else rule for key, rule in faults.items())} | faults
        self.refused, self.faults = together, faults
        self._tell()
        return False

    def undo(self) -> bool:
        """Go one step back, or only discard invalid values if there are any; returns False for nothing to undo."""
        if not self.refused:
            return self._go(self._history.past, self._history.future)
        self.refused, self.faults = {}, {}
        self._tell()
        return True

    def redo(self) -> bool:
        """Redo the last undone step; returns False if there is none."""
        return self._go(self._history.future, self._history.past)

    def reset(self, index: int = 0) -> None:
        """Reset an object (not its name, texture and group), the camera (not its resolution), and the sequence."""
        item = self.table["object"][index]
        objects = self.table["object"].copy()
        objects[index] = {"shape": "plane"} | {k: v for k, v in item.items() if k in ("name", "texture", "group")}
        table = {key: value for key, value in self.table.items() if key not in ("camera", "sequence")}
        if (resolution := at(self.table, ["camera", "resolution"])) is not None:
            table["camera"] = {"resolution": resolution}
        apart = tuple({} if k == index else kept for k, kept in enumerate(self.state.apart))
        self.take(replace(self.state, table=table | {"object": objects}, apart=apart))

    def add_object(self, shape: str = "sphere") -> int:
        """Add an object at the end of the list; returns its index. Raises SceneError."""
        item, _ = reshaped({}, shape, {})
        return self._insert(len(self.table["object"]), item, {})

    def copy_object(self, index: int) -> int:
        """Add a copy of an object after it; returns its index. Raises SceneError."""
        item = {key: value for key, value in self.table["object"][index].items() if key != "name"}
        return self._insert(index + 1, item, self.state.apart[index])

    def delete_object(self, index: int) -> None:
        """Delete an object, and groups that become empty. Raises SceneError for the last object."""
        pairs = self._pairs()
        del pairs[index]
        self._arrange(pairs)

    def move_object(self, index: int, to: int) -> None:
        """Move an object to another position in the list. Raises SceneError for an invalid position."""
        pairs = self._pairs()
        pairs.insert(to, pairs.pop(index))
        self._arrange(pairs)

    def known(self, path: str) -> Any:
        """The value of a key, or else its default; None if it has neither.

        If only one of `f_number` and `aperture_diameter`, or only one of `focus_distance` and `sensor_distance`, is
        given, the other is computed from it.
        """
        parts = path_parts(path)
        value = at(self.table, parts)
        if value is None:
            value = self._derived(parts)
        return as_lists(value) if isinstance(value, tuple) else value

    def shown(self, path: str) -> Any:
        """Value that the box of a key shows: the invalid value if there is one, else the value in use."""
        if path in self.refused:
            return self.refused[path]
        value = self.known(path)
        for other, component in self.refused.items():
            head, _, last = other.rpartition(".")
            if head == path and isinstance(value, list) and last.isdecimal() and int(last) < len(value):
                value = [component if k == int(last) else old for k, old in enumerate(value)]
        return value

    def show_scene(self, label: str) -> None:
        """Show the scene of a sweep with this label, as an undo step. Raises SceneError."""
        if label not in self.state.labels:
            raise SceneError(f"scene: must be one of the {len(self.state.labels)} of the file; got {shown(label)}")
        self.take(replace(self.state, label=label))

    def forget_past(self) -> None:
        """Clear the undo history."""
        self._history = _History()
        self._tell()

    def take(self, state: State, refused: Mapping[str, tuple[Any, str]] | None = None) -> None:
        """Go to another state, as one undo step; refused: invalid values and their messages, by path of the key.

        Raises SceneError, and changes nothing, if the state is invalid.
        """
        scene = self._valid(state)
        self.refused = {path: value for path, (value, _) in (refused or {}).items()}
        self.faults = {path: message for path, (_, message) in (refused or {}).items()}
        self._accept(state, scene, None)

    def _accept(self, state: State, scene: Scene, drag: int | None) -> bool:
        """Make a valid state the current one; returns True if it differs."""
        before = self.state
        changed = (state.table, state.path, state.label) != (before.table, before.path, before.label)
        if changed:
            self._history.push(_Step(before, self.scene, drag))
            self._history.came_back(state, drag)
            self._set(state, scene)
        self._tell()
        return changed

    def _set(self, state: State, scene: Scene) -> None:
        self.state, self.scene = state, scene
        self._models.clear()
        self.revision += 1

    def _go(self, steps: list[_Step], others: list[_Step]) -> bool:
        """Undo or redo: discard invalid values, move the last of `steps` to the current state, and the current state to
        `others`. Returns False if there are no steps.
        """
        self.refused, self.faults = {}, {}
        if moved := bool(steps):
            others.append(_Step(self.state, self.scene))
            step = steps.pop()
            self._set(step.state, step.scene)
        self._tell()
        return moved

    def _changed(self, chosen: Mapping[str, Any]) -> tuple[State, Scene]:
        """State with the values `chosen`, by path, without keys that these forbid; and its scene. Raises SceneError."""
        state = self.state
        for path, value in chosen.items():
            state = self._with(state, path, value)
        for _ in range(len(_CHOICES) + 1):
            try:
                return state, self._valid(state)
            except SceneError as error:
                beside = [path.rpartition(".")[0] for path in chosen if path.rpartition(".")[2] in _CHOICES]
                useless = [
                    parts
                    for key in placed(error)
                    if key not in chosen and key.rpartition(".")[0] in beside
                    if (parts := key.split(".")) and parts[-1] not in FILE_KEYS[:2]
                    if at(state.table, parts) is not None
                ]
                if not useless:
                    raise
            for parts in useless:
                state = replace(state, table=without(state.table, parts))
        return state, self._valid(state)

    def _with(self, state: State, path: str, value: Any) -> State:
        parts = path_parts(path)
        if parts[-1] in FILE_KEYS and isinstance(value, str) and Path(value).is_absolute():
            rule = "must be relative to the folder of the scene"
            place = key_name([int(part) if part.isdecimal() else part for part in parts])
            raise SceneError(f"scene: {place}: {rule}; got {shown(value)}")
        if len(parts) == 3 and parts[0] == "object" and parts[2] == "shape":
            item = at(state.table, parts[:2])
            if item is not None and value != item["shape"]:
                index = int(parts[1])
                item, kept = reshaped(item, value, state.apart[index])
                apart = (*state.apart[:index], kept, *state.apart[index + 1 :])
                return replace(state, table=with_value(state.table, parts[:2], item), apart=apart)
        if value is None or value == "":  # an empty box
            return replace(state, table=without(state.table, parts))
        table = state.table
        if len(parts) > 3 and parts[0] == "object" and parts[2] == "rotation":
            table = with_value(table, parts[:3], pose_for(at(table, parts[:3]), parts[3]))
        vector = next((k for k, part in enumerate(parts) if k > 1 and part.isdecimal()), len(parts))
        if parts[0] not in ("object", "group"):
            vector = next((k for k, part in enumerate(parts) if part.isdecimal()), len(parts))
        if vector < len(parts) and at(table, parts[:vector]) is None:  # the other components keep their values
            default = self.known(".".join(parts[:vector]))
            if not isinstance(default, list) and (default := seed(parts[vector - 1], value)) is None:
                raise SceneError(f"scene: {'.'.join(parts[:vector])}: must be given as a whole; got {shown(value)}")
            table = with_value(table, parts[:vector], default)
        table = with_value(table, parts, value)
        if self.is_linked and parts[0] == "object" and parts[2:] in (["semi_axes", "1"], ["semi_axes", "2"]):
            table = with_value(table, [*parts[:3], "2" if parts[3] == "1" else "1"], value)
        if parts == ["object"] and isinstance(value, list):
            state = replace(state, apart=({},) * len(value))
        return replace(state, table=table)

    def _valid(self, state: State) -> Scene:
        """The scene of a state, with absolute paths. Raises SceneError."""
        table = state.table
        scene = parse_sweep(table).scenes[state.shown] if swept_keys(table) else parse_scene(table)
        start = state.path.parent if state.path is not None else self.root
        faults = []
        for place, name in named_files(table):
            if rule := self._file_rule(start, str(place[-1]), name):
                faults.append(f"scene: {key_name(place)}: {rule}; got {shown(name)}")
        if faults:
            raise SceneError(faults)
        return absolute(scene, start)

    def _file_rule(self, start: Path, key: str, name: str) -> str:
        """The rule that a file name breaks as value of a key, or ""; start: base folder of relative names."""
        try:
            path = (start / name).resolve()
            if not any(path.is_relative_to(place) for place in self.readable):
                return "must be a file below the folder of the studio"
            return "" if path.is_file() else missing_input(key, name)
        except (OSError, ValueError, RuntimeError):  # not a file name: too long, a null character, a link to itself
            return missing_input(key, name)

    def _derived(self, parts: list[str]) -> Any:
        """The default of a key that is not given; some keys of the camera are computed from other keys."""
        camera = self.scene.camera
        if parts == ["camera", "f_number"]:
            return camera.focal_length / camera.aperture_diameter
        if parts == ["camera", "focus_distance"]:
            f, s = camera.focal_length, camera.sensor_distance
            return f * s / (s - f) if s > f else None
        node: Any = self.scene
        if parts[0] == "object" and len(parts) > 2 and parts[1].isdecimal():
            node, parts = self._object(int(parts[1])), parts[2:]
        elif parts[0] == "group" and len(parts) > 2 and parts[1].isdecimal():
            node, parts = at(self.scene.groups, parts[1:2]), parts[2:]
        for part in parts:
            if isinstance(node, tuple):
                node = at(node, [part])
            else:  # only keys, no other attributes of a model
                node = getattr(node, part) if part in getattr(type(node), "model_fields", ()) else None
        return node

    def _object(self, index: int) -> Any:
        """The model of a single object; a box is not split into its faces."""
        if index not in self._models:
            item = at(self.table, ["object", str(index)])
            if item is None:
                return None
            still = {key: value for key, value in item.items() if key != "motion"}  # its keys may have several values
            self._models[index] = SHAPES[item["shape"]].model_validate(still)
        return self._models[index]

    def _pairs(self) -> list[tuple[Table, Mapping[str, Table]]]:
        """Each object, and the keys that it had with other shapes."""
        return list(zip(self.table["object"], self.state.apart, strict=True))

    def _insert(self, index: int, item: Table, kept: Mapping[str, Table]) -> int:
        pairs = self._pairs()
        pairs.insert(index, (item, kept))
        self._arrange(pairs)
        return index

    def _arrange(self, pairs: list[tuple[Table, Mapping[str, Table]]]) -> None:
        """Replace the list of objects, as one undo step; groups without objects are removed."""
        table = self.table | {"object": [item for item, _ in pairs]}
        used = {item.get("group") for item, _ in pairs}
        if "group" in table:
            table["group"] = [group for group in table["group"] if group["name"] in used]
            if not table["group"]:
                del table["group"]
        self.take(replace(self.state, table=table, apart=tuple(kept for _, kept in pairs)))


def _overlaps(path: str, other: str) -> bool:
    """True if two paths are equal, or one contains the other."""
    return path == other or path.startswith(f"{other}.") or other.startswith(f"{path}.")
