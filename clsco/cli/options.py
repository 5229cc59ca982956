"""Options that commands share, with their parsers, and a group that turns errors into exit statuses."""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from clsco.cli.output import echo, visible_usage
from clsco.errors import ClscoError, DeviceError, SceneError

if TYPE_CHECKING:
    from clsco.engine.batch import Span
    from clsco.frame.truth_files import TruthFile

Command = TypeVar("Command", bound=Callable[..., Any])
USER_ERROR, NO_DEVICE, INTERRUPTED, TERMINATED = 1, 3, 130, 143


class _TerminatedError(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Have SIGTERM end the block as Ctrl-C does, so that nothing is left half-written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> NoReturn:
        raise _TerminatedError

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class Commands(click.Group):
    """A group whose commands end with one line per error and the exit status that belongs to it."""

    def make_context(self, *args: Any, **options: Any) -> click.Context:
        """Parse a command line."""
        with visible_usage():
            return super().make_context(*args, **options)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; what the user can mend, Ctrl-C and SIGTERM end it without a traceback."""
        try:
            with visible_usage(), _terminable():
                return super().invoke(ctx)
        except _TerminatedError:
            echo("terminated", err=True)
            ctx.exit(TERMINATED)
        except KeyboardInterrupt:
            echo("interrupted", err=True)
            ctx.exit(INTERRUPTED)
        except MemoryError:
            echo("error: memory: must hold the arrays of the scene; got too little of it", err=True)
            ctx.exit(USER_ERROR)
        except BrokenPipeError:
            raise  # who reads the output has had enough, which click takes for an end
        except OSError as error:
            echo(f"error: {error.filename or 'output'}: must be writable; got {error.strerror}", err=True)
            ctx.exit(USER_ERROR)
        except ClscoError as error:
            for message in error.messages if isinstance(error, SceneError) else (str(error),):
                echo(f"error: {message}", err=True)
            ctx.exit(NO_DEVICE if isinstance(error, DeviceError) else USER_ERROR)


def parse_files(text: str) -> tuple[TruthFile, ...]:
    if not text:
        return ()
    from clsco.frame.files import truth_files

    try:
        return truth_files(text)
    except SceneError as error:
        raise click.BadParameter(str(error)) from None


def parse_preset(text: str) -> str:
    """The name of a video preset."""
    from clsco.files.video import PRESETS

    if text not in PRESETS:
        raise click.BadParameter(f"must be one of {', '.join(PRESETS)}; got {text}")
    return text


def parse_span(text: str) -> Span:
    match = re.fullmatch(r"(\d{0,9}):(\d{0,9})", text, re.ASCII)
    if match is None:
        raise click.BadParameter(f"must be A:B, frames A to B - 1 counted from 0; got {text}")
    first, end = (int(number) if number else None for number in match.groups())
    return first, end


def parse_memory(text: str) -> int:
    from clsco.plan.memory import parse_size

    try:
        return parse_size(text)
    except SceneError as error:
        raise click.BadParameter(str(error).removeprefix("memory: ")) from None


def one_value(name: str, kind: type[Any], *options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Give a command one argument for a group of options.

    Parameters
    ----------
    name : str
        Argument of the command.
    kind : type
        Dataclass with a field for each option, of the option's name.
    *options : decorators
        Options of click, in the order of the help text.
    """
    names = [field.name for field in fields(kind)]

    def decorate(command: Command) -> Command:
        @wraps(command)
        def call(**values: Any) -> Any:
            value = kind(**{field: values.pop(field) for field in names})
            return command(**values, **{name: value})

        found: Any = call
        for option in reversed(options):
            found = option(found)
        return found

    return decorate


@dataclass(frozen=True)
class Extent:
    """Extent of `clsco dev bench`: options of these names."""

    quick: bool = False
    compare: bool = False
    sizes: tuple[int, ...] = ()
    radii: tuple[float, ...] = ()
    minutes: float | None = None


@dataclass(frozen=True)
class Computation:
    """Place and method of computing frames: options of `render` and `defocus`."""

    device: str | None
    precision: str | None
    memory: int | None
    tolerance: float | None


def require_opencl() -> None:
    if find_spec("pyopencl") is None:
        raise DeviceError("device: needs pyopencl: pip install 'clsco[pocl]'; got no such module")


def require_device(name: str | None) -> None:
    """Fail before anything is written where there is no device, or none of this name."""
    require_opencl()
    from clsco.opencl.device import choose

    choose(name, "--device")


class _Path(click.Path):
    """A path that is not empty: Path("") would be the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; click fails for none."""
        if os.fspath(value) == "":
            self.fail('must be a path; got ""', param, ctx)
        return super().convert(value, param, ctx)


PATH = _Path(path_type=Path)
one_scene = click.argument("scene", type=PATH)
scenes_wanted = click.argument("scenes", metavar="SCENE...", nargs=-1, required=True, type=PATH)
set_option = click.option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True,
    help="Set a key of the scene, such as camera.f_number=4 or object.0.radius=30; may be given again.",
)  # fmt: skip
truth_option = click.option(
    "--truth", "files", metavar="FORMAT,...", type=parse_files, default="",
    help="Also compute the ground truth, and write it in these formats: npz or exr, which hold all of it; npy or pfm, "
    "a file per array; of the field flo, kitti_flow, kitti_disparity, kitti_depth, dpt; the camera as cam or colmap; "
    "codes of a sensor as png or tiff. npz:depth,coc: these arrays alone; npz+float16: floats in 16 bits; "
    "npz+compressed, npy+zstd: smaller files.",
)  # fmt: skip
no_color_option = click.option(
    "--no-color", is_flag=True, help="The ground truth alone: no image is made, which is most of the work."
)
device_option = click.option(
    "--device", metavar="NAME", help="Part of the name of an OpenCL device or platform, or gpu or cpu."
)
precision_option = click.option(
    "--precision", type=click.Choice(["single", "double"]),
    help="Of the geometry. Default: double where the device has it.",
)  # fmt: skip
memory_option = click.option(
    "--memory", metavar="SIZE", type=parse_memory,
    help="Most that buffers on the device may take, like 1.5GiB or 800MB; frames that need more are made in strips. "
    "Default: half of what is free.",
)  # fmt: skip
tolerance_option = click.option(
    "--tolerance", metavar="E", type=click.FloatRange(min=0.0, min_open=True),
    help="Take the fewest time samples and silhouette samples whose estimated RMS error is at most E of white.",
)  # fmt: skip
quiet_option = click.option("--quiet", is_flag=True, help="Show no progress.")
computation_options = one_value(
    "computation", Computation, device_option, precision_option, memory_option, tolerance_option
)
quick_option = click.option("--quick", is_flag=True, help="A small grid: a minute or two on a slow machine.")
bench_extent = one_value(
    "extent",
    Extent,
    quick_option,
    click.option(
        "--compare",
        is_flag=True,
        help="Also measure numba, OpenCV and Mitsuba, as far as they are installed; needs a checkout of clsco.",
    ),
    click.option("--size", "sizes", metavar="PX", type=int, multiple=True, help="Pixels a side; may be given again."),
    click.option(
        "--radius", "radii", metavar="PX", type=float, multiple=True, help="Largest radius; may be given again."
    ),
    click.option("--minutes", metavar="M", type=float, help="Begin no case later, and leave out what is left."),
)
