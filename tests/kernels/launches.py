"""Kernels launched by the names of their parameters, as their files have them, on arrays that stand amid others.

A parameter that kernels gain has its value for all tests in DEFAULTS.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.opencl.buffers import download, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.records import REAL, Real
from clsco.resources import folder

Array = NDArray[Any]
AROUND = 4096  # numbers before and after those of a plane
DEFAULTS: dict[str, Any] = {
    "part_rows": 0, "start": 0, "budget": cl.cltypes.make_int2(0, 0), "position": None,  # type: ignore[attr-defined]
    "scratch": None, "scratch_size": 0, "ends": None, "spare": 0,
    **dict.fromkeys(("maps", "share", "object", "seen", "bounds")),
    "extents": np.tile([-np.inf, np.inf], 3 * 64),  # of objects that may be anywhere
}  # fmt: skip


class Amid:
    """A plane on the device with the number `around` on both sides of it."""

    def __init__(self, session: Session, array: Array, around: float) -> None:
        side = np.full(AROUND, around, array.dtype)
        self.session, self.shape, self.held = session, array.shape, np.concatenate([side, array.ravel(), side])
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        self.all = cl.Buffer(session.context, flags, hostbuf=self.held)
        begin = AROUND * array.itemsize
        self.buffer = self.all.get_sub_region(begin, self.all.size - begin)

    def now(self) -> Array:
        found = download(self.session, self.all, self.held.shape, self.held.dtype)
        for side in (slice(None, AROUND), slice(-AROUND, None)):
            assert (found[side] == self.held[side]).all()
        return found[AROUND:-AROUND].reshape(self.shape)


def run(
    session: Session, target: Target, name: str, size: tuple[int, ...], local: tuple[int, ...], /, **given: Any
) -> None:
    """Run a kernel to its end; given: as for `arguments`."""
    found = target[name]
    launch(session, found, size, local, *arguments(session, found, **given))
    session.queue.finish()


def arguments(session: Session, wanted: cl.Kernel, **given: Any) -> list[Any]:
    """Arguments of a kernel in its order.

    given: by name, also those of other kernels, but none of features that the program does not have; arrays are
    uploaded, int and float are those of 32 bits.
    """
    names = parameters(wanted.function_name)
    if len(given.keys() & set(names)) < wanted.num_args:
        given = DEFAULTS | given
    found = [name for name in names if name in given]
    assert len(found) == wanted.num_args, f"{wanted.function_name} takes {wanted.num_args} of {names}; got {found}"
    return [_argument(session, given[name]) for name in found]


def _argument(session: Session, value: Any) -> Any:
    if isinstance(value, Amid):
        return value.buffer
    if isinstance(value, np.ndarray) and value.ndim:
        return upload(session, value)
    return {int: np.int32, float: np.float32}.get(type(value), lambda same: same)(value)


@cache
def _text() -> str:
    files = sorted(Path(str(folder("kernels"))).rglob("*.cl*"))
    return "\n".join(re.sub(r"//[^\n]*", "", path.read_text("utf-8")) for path in files)


@cache
def parameters(name: str) -> tuple[str, ...]:
    """Names of the parameters of a kernel in their order, those of all features."""
    found = re.search(rf"\b__kernel\s+(?:__attribute__\S+\s+)?void\s+{name}\s*\(([^{{]*)\)\s*\{{", _text())
    assert found, name
    lines = re.sub(r"^\s*#.*", "", found[1], flags=re.MULTILINE)
    while macros := re.findall(r"\b[A-Z][A-Z_]+\b", lines):
        macro = macros[0]
        forms = re.findall(rf"#define {macro}\b((?:\\\n|[^\n])*)", _text())
        lines = lines.replace(macro, max(forms, key=len).replace("\\\n", " "))
    return tuple(re.findall(r"\w+", each)[-1] for each in lines.split(","))


def whole(session: Session, buffer: cl.Buffer, shape: tuple[int, ...], real: Real) -> Array:
    """Download real numbers as float64 (...)."""
    return download(session, buffer, shape, REAL[real]).astype(np.float64)


def held(values: Array) -> Array:
    """Numbers near `values`, float64, that both precisions hold exactly."""
    return np.asarray(values, dtype=np.float32).astype(np.float64)


def filled(session: Session, fill: Any, image: Array, missing: Array) -> Array:
    """The image with the values that a method finds."""
    result = image.copy()
    result[missing] = fill(session, image, missing)
    return result
