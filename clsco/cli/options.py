"""Options that commands share, with their parsers."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from decimal import Decimal
from functools import wraps
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click
from click.shell_completion import CompletionItem

from clsco.cli.progress import FORM
from clsco.errors import DeviceError, SceneError

if TYPE_CHECKING:
    from clsco.engine.batch import Span

Command = TypeVar("Command", bound=Callable[..., Any])


class Names(click.ParamType):  # type: ignore[type-arg] # before click 8.2 it takes none
    """Type of an option whose values are names, which the shell completes.

    source: function that returns the names; it imports modules, so it is called only if the names are needed. many:
    True for several names with commas between them. strict: True to reject other names.
    """

    name = "name"

    def __init__(self, source: Callable[[], Iterable[str]], many: bool = False, strict: bool = False) -> None:
        self.source, self.many, self.strict = source, many, strict

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if self.strict and value not in (known := list(self.source())):
            self.fail(f"must be one of {', '.join(known)}; got {value}", param, ctx)
        return value

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        del ctx, param
        head, comma, last = incomplete.rpartition(",") if self.many else ("", "", incomplete)
        return [CompletionItem(f"{head}{comma}{name}") for name in self.source() if name.startswith(last)]


class NumberRange(click.FloatRange):
    """Type of an option whose value is in a range; click's own also accepts NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if (number := super().convert(value, param, ctx)) != number:
            self.fail(f"must be a number; got {value}", param, ctx)
        return number


def option(
    names: str, metavar: str, text: str, kind: Any = str, shown: Any = None, **more: Any
) -> Callable[[Command], Command]:
    """An option with a value. names: separated by spaces; text: help; shown: default value, which the help shows."""
    default = {} if shown is None else {"default": shown, "show_default": True}
    return click.option(*names.split(), metavar=metavar, help=text, type=kind, **default, **more)


def flag(names: str, text: str) -> Callable[[Command], Command]:
    return click.option(*names.split(), is_flag=True, help=text)


def attribute(place: str) -> Callable[[], Iterable[str]]:
    """Make a function that returns the entries of a "module:OBJECT", or the allowed values of a "module:Model.key"."""
    module, _, path = place.partition(":")

    def names() -> Iterable[str]:
        name, _, field = path.partition(".")
        value = getattr(import_module(module), name)
        return get_args(value.model_fields[field].annotation) if field else value

    return names


def _arrays() -> tuple[str, ...]:
    return "all", *attribute("clsco.frame.outputs:ATTRIBUTES")()


def _keys() -> list[str]:
    from clsco.scene.schema import list_keys

    return [f"{key}=" for key in list_keys()]


def _types() -> list[str]:
    return [f"{name}={dtype}" for name in _arrays() for dtype in attribute("clsco.frame.truth_files:FLOATS")()]


def usage_error(error: SceneError) -> click.UsageError:
    """Usage error with the messages of `error`, which begin with names of options."""
    return click.UsageError("; ".join(f"--{message}" for message in error.messages))


PRESET = Names(attribute("clsco.files.video:PRESETS"), strict=True)


def parse_pair(text: str, pattern: str, rule: str, ordered: bool = False) -> tuple[Any, Any]:
    """The two numbers in a text that matches a pattern; None for an empty one. ordered: True if they must increase."""
    match = re.fullmatch(pattern, text, re.ASCII)
    numbers: list[Any] = [int(number) if number else None for number in match.groups()] if match else []
    if not numbers or (ordered and numbers[0] >= numbers[1]):
        raise click.BadParameter(f"must be {rule}; got {text}")
    return numbers[0], numbers[1]


def parse_span(text: str) -> Span:
    return parse_pair(text, r"(\d{0,9}):(\d{0,9})", "A:B, frames A to B - 1 counted from 0")


def quantity(rule: str, **units: str) -> Callable[[str], float]:
    """Make a parser of a number with or without a unit. units: what each is worth in that of a number without one."""

    def parse(text: str) -> float:
        number, unit = re.sub(r"[a-z\s]+$", "", text), text.strip().lstrip("+-.0123456789e").strip()
        try:
            return float(Decimal(number) * Decimal(units[unit])) if unit in units else float(text)
        except (ArithmeticError, ValueError, KeyError):
            raise click.BadParameter(f"{rule}; got {text}") from None

    return parse


parse_length = quantity(
    "must be a length, in mm or with a unit: 35.5, 85mm, 3m (um, mm, cm, m, in, ft)",
    um="0.001", mm="1", cm="10", m="1000", ft="304.8", **{"in": "25.4"},
)  # fmt: skip
parse_angle = quantity("must be an angle in degrees, like 40 or 40deg", deg="1")


def parse_memory(text: str) -> int:
    from clsco.plan.memory import parse_size

    try:
        return parse_size(text)
    except SceneError as error:
        raise click.BadParameter(str(error).removeprefix("memory: ")) from None


@dataclass(frozen=True)
class Computation:
    """Options of `render` and `defocus` that select where and how they compute."""

    device: str | None
    precision: str | None
    memory: int | None
    tolerance: float | None


def require_opencl() -> None:
    if find_spec("pyopencl") is None:
        raise DeviceError("device: needs pyopencl: pip install 'clsco[pocl]'; got no such module")


def require_device(name: str | None) -> None:
    """Raise an error, before any file is written, if no device exists or none has this name."""
    require_opencl()
    from clsco.opencl.device import choose

    choose(name, "--device")


class _Path(click.Path):
    """Type of a path that must not be empty, because Path("") would mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if os.fspath(value) == "":
            self.fail('must be a path; got ""', param, ctx)
        return super().convert(value, param, ctx)


PATH = _Path(path_type=Path)
scene_argument = click.argument("scene", type=PATH)
scenes_argument = click.argument("scenes", metavar="SCENE...", nargs=-1, required=True, type=PATH)
set_option = option(
    "--set overrides", "KEY=VALUE",
    "Set a key of the scene, such as camera.f_number=4 or object.0.radius=30; may be given again.",
    Names(_keys), multiple=True,
)  # fmt: skip
ARRAYS = Names(_arrays, many=True)
SET_FORMAT = Names(attribute("clsco.data.containers:CONTAINERS"))
_TRUTH = option(
    "--truth", "NAME,...",
    "Also compute the ground truth, and write these arrays, such as depth,coc; all: all that the formats hold.",
    ARRAYS, default="",
)  # fmt: skip
_FORMAT = option(
    "--format formats", "FORMAT,...",
    "Files of the ground truth: npz (default) or exr, which hold all of it; npy or pfm, a file per array; of the field "
    "flo, kitti_flow, kitti_disparity, kitti_depth; the cameras as colmap; codes of a sensor as png or tiff. "
    "npz+compressed: smaller files. Without --truth all that they hold.",
    Names(attribute("clsco.frame.files:TRUTH_FORMATS"), many=True), default="",
)  # fmt: skip
types_option = option(
    "--types", "NAME=TYPE,...",
    "Such as depth=float16, or all=float16: floats in 16 bits; in a data set also color=float32, linear instead of "
    "codes of 16 bits, or uint8.",
    Names(_types, many=True), default="",
)  # fmt: skip


def truth_options(command: Command) -> Command:
    """Decorate a command with options of ground truth, passed as its argument `files`."""

    @wraps(command)
    def call(truth: str, formats: str, types: str, **values: Any) -> Any:
        if not (truth or formats or types):
            return command(files=(), **values)
        from clsco.frame.files import files_of

        try:
            files = files_of(truth, formats, types)
        except SceneError as error:
            raise usage_error(error) from None
        return command(files=files, **values)

    decorated: Any = call
    return _TRUTH(_FORMAT(types_option(decorated)))


no_color_option = flag("--no-color", "The ground truth alone: no image is made, which is most of the work.")
device_option = option("--device", "NAME", "Part of the name of an OpenCL device or platform, or gpu or cpu.")
precision_option = click.option(
    "--precision", type=click.Choice(["single", "double"]),
    help="Of the geometry. Default: double where the device has it.",
)  # fmt: skip
_MEMORY = option(
    "--memory", "SIZE",
    "Most that buffers on the device may take, like 1.5GiB or 800MB; frames that need more are made in strips. "
    "Default: half of what is free.",
    parse_memory,
)  # fmt: skip
_TOLERANCE = option(
    "--tolerance", "E",
    "Take the fewest time samples and silhouette samples whose estimated RMS error is at most E of white.",
    click.FloatRange(min=0.0, min_open=True),
)  # fmt: skip


def quiet_option(command: Command) -> Command:
    """Decorate a command with the options --quiet, passed as its argument `quiet`, and --progress."""
    form = click.option(
        "--progress", type=click.Choice(["bar", "json"]), default="bar", expose_value=False,
        callback=lambda ctx, _, value: ctx.meta.update({FORM: value}),
        help="Show a bar on a terminal (default), or print lines of JSON on stderr, for programs.",
    )  # fmt: skip
    return flag("--quiet", "Show no progress.")(form(command))


def computation_options(command: Command) -> Command:
    """Decorate a command with the options of a Computation, passed as its argument `computation`."""
    names = [field.name for field in fields(Computation)]

    @wraps(command)
    def call(**values: Any) -> Any:
        return command(computation=Computation(**{name: values.pop(name) for name in names}), **values)

    decorated: Any = call
    return device_option(precision_option(_MEMORY(_TOLERANCE(decorated))))
