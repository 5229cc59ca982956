"""Panels and fields of the studio, generated from the schema of scene files, so that every key has a control.

The first five panels have the labels, the order and the symbols of the thesis (appendix A, sections 3.3.2 and 4.3.2).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, get_args

from clsco.scene.changes import VARIANT
from clsco.scene.file import FILE_KEYS, SECTIONS
from clsco.scene.groups import Group
from clsco.scene.model import Scene
from clsco.scene.quantities import Within
from clsco.scene.schema import scene_schema
from clsco.scene.shapes import SHAPES
from clsco.scene.texture_keys import BUILT_IN_TEXTURES
from clsco.studio import tables
from clsco.studio.session import Document
from clsco.studio.tables import as_lists, at, label_of, without, words

# For each scale, the function from a value to its position on a slider. The unit of "inverse" is the diopter, that of
# "stops" a third of a stop. static/scales.js has the inverse functions.
PLACES: Mapping[str, Callable[[float], float]] = {
    "": float, "inverse": lambda value: -1.0 / value, "log": math.log10, "stops": lambda value: 6.0 * math.log2(value),
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """Control of a scene key."""

    path: str  # path of the key, such as "object.0.radius"
    label: str
    symbol: str = ""  # symbol in the thesis, "" if it has none
    unit: str = ""
    kind: str = "number"  # or "vector", "choice", "text", "flag", "image"
    default: Any = None  # the key's value if none is given; None without a default
    # least, most: ends of the valid range of the value, or of each component of a vector
    least: float | None = None
    most: float | None = None
    step: float = 0.0  # step of a slider
    # values with labels: all that a choice may have, or those that a number or an image may have instead
    choices: tuple[tuple[Any, str], ...] = ()
    help: str = ""
    slider: tuple[float, float] | None = None  # ends of a slider; values beyond them must be typed
    components: tuple[str, ...] = ()  # labels of the components of a vector
    is_integer: bool = False
    # condition under which the key has an effect: "psf.model=gaussian|wave" for values of another key, "moves" if
    # something must move, "" for no condition
    only: str = ""

    @property
    def scale(self) -> str:
        """Scale of the slider: "inverse", "stops" or "log", "" for linear."""
        if self.slider is None or self.slider[0] <= 0.0 or self.is_integer:
            return ""
        return tables.SCALES.get(self.key, "log" if self.slider[1] >= tables.WIDE * self.slider[0] else "")

    def place(self, value: float) -> float:
        """Position of a value on the slider's scale."""
        return PLACES[self.scale](value)

    @property
    def key(self) -> str:
        """The last part of the path."""
        return self.path.rpartition(".")[2]

    @property
    def name(self) -> str:
        """Label with symbol and unit, as a screen reader announces it."""
        symbol = f" {self.symbol}" if self.symbol else ""
        return f"{self.label}{symbol}" + (f" ({self.unit})" if self.unit else "")

    def component(self, index: int) -> Field:
        """The number field of a component of a vector, by its index in the flat vector."""
        label = self.components[index]
        part = f"{index // 2}.{index % 2}" if self.key == "bounds" else str(index)  # bounds are pairs
        default = flat(self.default)[index] if isinstance(self.default, list) else None
        symbol = f"{self.symbol}{label}" if self.symbol and len(label) == 1 else ""
        is_point = self.key in ("center", "apex", "position", "origin") and ".keyframe." not in self.path
        slider = tables.POINT.get(label, self.slider) if is_point else self.slider
        return replace(
            self, path=f"{self.path}.{part}", label=f"{self.label} {label}", symbol=symbol, kind="number",
            default=default, components=(), slider=slider, step=_step(slider, self.is_integer),
        )  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """Fields under a title."""

    title: str
    fields: tuple[Field, ...]
    is_open: bool = False


def flat(value: Any) -> list[Any]:
    """List of the components of a vector, with pairs concatenated; any other value as a list of one."""
    if not isinstance(value, list | tuple):
        return [value]
    return [entry for part in value for entry in (part if isinstance(part, list | tuple) else [part])]


def panels(session: Document, index: int = 0) -> tuple[Panel, ...]:
    """Panels with a field for every key that a scene may have; index: the only object whose keys are shown."""
    shape = session.shown(f"object.{index}.shape")
    shape = shape if isinstance(shape, str) and shape in SHAPES else session.known(f"object.{index}.shape")
    of_object = {field.path.split(".", 2)[2]: field for field in _fields(session, SHAPES[shape], f"object.{index}")}
    scene = {field.path: field for field in _of_scene(session)}
    count = len(session.table.get("group", ()))
    groups = tuple(field for number in range(count) for field in _fields(session, Group, f"group.{number}"))

    def taken(keys: Sequence[str], start: str = "") -> tuple[Field, ...]:
        source = scene if start else of_object
        return tuple(source.pop(start + key) for key in keys if start + key in source)

    motion = taken(("motion.velocity", "motion.angular_velocity"))
    image, kind = taken(("texture",)), taken(("shape",))
    shared = ("texture_", "rotation", "motion", "name", "group", "bounds")
    own = sorted((key for key in of_object if not key.startswith(shared)), key=lambda key: key in tables.OWN_ORDER)
    camera = (
        "focal_length", "aperture_diameter", "pixel_pitch", "sensor_distance", "normalization_distance",
        "focus_distance", "f_number", "resolution",
    )  # fmt: skip
    motion += taken(("frames", "interval"), "sequence.")
    of_thesis = image, kind, taken(own), motion, taken(camera, "camera.")
    panels = [Panel(title, fields, True) for title, fields in zip(tables.THESIS_TITLES, of_thesis, strict=True)]
    rest: tuple[tuple[str, dict[str, Field], tuple[str, ...]], ...] = (
        ("Texture", of_object, ("texture_",)),
        ("Keyframes", of_object, ("motion.",)),
        ("Pose", of_object, ("",)),
        ("PSF and method", scene, ("psf.", "aperture.")),
        ("Sequence", scene, ("sequence.", "motion.", "camera.")),
        ("Focus pull", scene, ("lens.keyframe", "lens.interpolation", "lens.outside")),
        ("Lens errors", scene, ("lens.",)),
        ("Filling", scene, ("fill.",)),
        ("Light", scene, ("light.",)),
        ("Sensor", scene, ("sensor.",)),
        ("Stereo", scene, ("stereo.",)),
        ("Image", scene, ("title", "image.")),
    )
    for title, source, starts in rest:
        keys = [key for key in source if key.startswith(starts)]
        panels.append(Panel(title, tuple(source.pop(key) for key in keys)))
    panels += [Panel("Groups", groups), Panel("More", tuple(scene.values()))]  # "More": keys that no row above names
    return tuple(replace(panel, is_open=panel.is_open or _is_used(session, panel)) for panel in panels if panel.fields)


def _is_used(session: Document, panel: Panel) -> bool:
    paths = [field.path for field in panel.fields if field.path != "title" and not field.path.endswith(".name")]
    return any(at(session.table, path.split(".")) is not None for path in paths)


def field_at(session: Document, path: str) -> Field | None:
    """The field of the key at a path, or of the vector whose component is at the path; None if there is no field."""
    index = int(path.split(".")[1]) if path.startswith("object.") else 0
    listed = [field for panel in panels(session, index) for field in panel.fields]
    return next((field for field in listed if path == field.path or path.startswith(f"{field.path}.")), None)


_QUOTED = r'"(\w+)"'
_ONLY = re.compile(rf"only with (?P<key>[\w.]+) = (?P<values>{_QUOTED}(?: or {_QUOTED})?)".replace(r"(\w+)", r"\w+"))


@cache
def _schema() -> dict[str, Any]:
    return scene_schema()


def _of_scene(session: Document) -> Iterator[Field]:
    """Fields of all keys outside of objects and groups."""
    for key, entry in _schema()["properties"].items():
        if key in ("object", "group", VARIANT):
            continue
        if key in SECTIONS:
            yield from _fields(session, SECTIONS[key], key)
        else:
            yield _field(session, Scene, key, key, entry, _kinds(entry), None)


def _fields(session: Document, model: Any, start: str) -> Iterator[Field]:
    """Fields of the keys of a model at the path `start` of the scene."""
    definition = _schema()["$defs"][model.__name__]
    for key, entry in definition["properties"].items():
        path = f"{start}.{key}" if start else key
        annotation = model.model_fields[key]
        kinds = _kinds(entry)
        if kinds and (listed := kinds[0].get("items", {}).get("$ref")):  # an array: the tables that exist
            part = _inner_model(annotation.annotation, listed.rpartition("/")[2])
            for number in range(len(at(session.table, path.split(".")) or ())):
                yield from _fields(session, part, f"{path}.{number}")
            continue
        inner = [kind["$ref"].rpartition("/")[2] for kind in kinds if "$ref" in kind]
        if kinds and not all("$ref" in kind for kind in kinds):
            yield _field(session, model, path, key, entry, kinds, _limits(annotation))
        for name in inner:
            yield from _fields(session, _inner_model(annotation.annotation, name), path)


def _inner_model(annotation: Any, name: str) -> Any:
    waiting = [annotation]
    while getattr(waiting[0], "__name__", "") != name:
        waiting += get_args(waiting.pop(0))
    return waiting[0]


def _kinds(entry: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Schemas of the values that a key may have, except null and a range."""
    several = entry.get("anyOf")
    if several is None:
        return [entry]
    if several and several[-1].get("$ref") == "#/$defs/Range":  # allowed only in a sweep
        several = several[:1]
    return [kind for part in several for kind in _kinds(part) if kind.get("type") != "null"]


def _limits(field: Any) -> Within | None:
    """Limits and unit of a number, or of the components of a vector; None if it has no limits."""
    waiting: list[Any] = [*field.metadata, field.annotation]
    while waiting:
        if isinstance(part := waiting.pop(0), Within):
            return part
        waiting += get_args(part)
    return None


def _field(
    session: Document, model: Any, path: str, key: str, entry: Mapping[str, Any], kinds: Any, limits: Within | None
) -> Field:
    shape = kinds[0]
    kind, choices, components = _kind(path, key, shape)
    instead = [(form["const"], words(form["const"])) for form in kinds[1:] if "const" in form]
    is_integer = any(part.get("type") == "integer" for part in (shape, *shape.get("prefixItems", ())))
    slider = _slider(session, key, limits) if kind in ("number", "vector") else None
    help_text = " ".join(str(entry.get("description", "")).split())
    return Field(
        path=path,
        label=label_of(path),
        symbol=_symbol(session, path, key),
        unit=limits.unit if limits is not None else "",
        kind=kind,
        default=_default(session, model, path, key),
        least=limits.low if limits is not None else None,
        most=limits.high if limits is not None else None,
        step=_step(slider, is_integer),
        choices=choices or tuple(instead),
        help=help_text,
        slider=slider,
        components=components,
        is_integer=is_integer,
        only=_only(path, help_text),
    )


def _only(path: str, help_text: str) -> str:
    """Condition under which a key has an effect, in the form of `Field.only`, from the schema's description."""
    section = path.rpartition(".")[0]
    if section == "sequence" and path not in ("sequence.frames", "sequence.interval"):
        return "moves"
    if (found := _ONLY.search(help_text)) is None or section.startswith(("object.", "group.")):
        return ""
    key = found["key"] if "." in found["key"] else f"{section}.{found['key']}"
    return f"{key}={'|'.join(re.findall(_QUOTED, found['values']))}"


def _kind(path: str, key: str, shape: Mapping[str, Any]) -> tuple[str, tuple[tuple[Any, str], ...], tuple[str, ...]]:
    """Kind of a field, its options, and names of its components, from the schema of its key."""
    if key == "shape" and path.startswith("object."):
        order = [*tables.SHAPE_LABELS, *(name for name in SHAPES if name not in tables.SHAPE_LABELS)]
        return "choice", tuple((name, tables.SHAPE_LABELS.get(name, words(name))) for name in order), ()
    if "enum" in shape:
        return "choice", tuple((value, words(value)) for value in shape["enum"]), ()
    if shape["type"] == "boolean":
        return "flag", (), ()
    if shape["type"] == "string" and key in FILE_KEYS:
        return "image", () if key == "depth" else tuple((name, words(name)) for name in BUILT_IN_TEXTURES), ()
    if shape["type"] == "string":
        return "text", (), ()
    if shape["type"] == "array":
        components = tables.COMPONENTS.get(key, ("x", "y", "z"))
        count = len(shape.get("prefixItems", ())) or shape["maxItems"]
        return "vector", (), components if key == "bounds" else components[:count]
    return "number", (), ()


def _symbol(session: Document, path: str, key: str) -> str:
    """Symbol of a key in formulas; for an object it depends on the shape."""
    where = path.split(".")
    if where[0] != "object" or len(where) < 3:
        return tables.SYMBOLS.get(path, "")
    motion = tables.SYMBOLS.get(".".join(where[2:]), "") if where[2] == "motion" else ""
    return tables.SYMBOLS.get(f"{session.known('.'.join(where[:2]) + '.shape')}.{key}", "") or motion


def _slider(session: Document, key: str, limits: Within | None) -> tuple[float, float] | None:
    if key in tables.BY_FOCAL_LENGTH and isinstance(f := session.known("camera.focal_length"), int | float):
        return tables.BY_FOCAL_LENGTH[key][0] * f, tables.BY_FOCAL_LENGTH[key][1] * f
    if limits is None or key in ("coefficients", "bounds", "quaternion"):
        return None
    low, high = tables.SLIDERS.get(key) or tables.BY_UNIT.get(limits.unit) or (limits.low, limits.high)
    return (max(low, limits.low), min(high, limits.high)) if high - low <= 1e4 else None


def _step(slider: tuple[float, float] | None, is_integer: bool) -> float:
    """About a thousandth of a slider's range, as 1, 2 or 5 times a power of ten; 1 for integers."""
    if is_integer or slider is None:
        return 1.0 if is_integer else 0.0
    rough = (slider[1] - slider[0]) / 1000.0
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough * 0.999)


def _default(session: Document, model: Any, path: str, key: str) -> Any:
    """Default of a key, which may depend on the keys beside it; None if the key is required or has none."""
    field = model.model_fields[key]
    if field.default_factory is None:
        return None if field.is_required() else as_lists(field.default)
    table = at(session.table, path.split(".")[:-1])
    try:
        return as_lists(getattr(model.model_validate(without(dict(table or {}), [key])), key))
    except ValueError:  # several values, or another key is at fault
        return None
