"""Images of moving objects out of focus, with their ground truth, computed with OpenCL.

A scene is built from its types, or read from a file, and rendered frame by frame::

    import clsco

    ball = clsco.Sphere(center=(0, 0, 280), radius=30, texture="bricks")
    frame = clsco.render_frame(clsco.Scene(objects=(ball,)))
    frame.color, frame.depth, frame.blur_radius         # NumPy arrays (rows, columns[, channels])

    scene = clsco.load_scene("ball.toml").replace("camera.f_number", 4)
    for frame in clsco.render(scene, truth=("depth", "flow")):
        ...

The two engines work on any arrays, of NumPy or pyopencl::

    blurred = clsco.defocus(image, blur_radius, "gaussian")   # signed radius per pixel, px
    filled = clsco.inpaint(image, mask)                       # True = missing

`device=` takes a part of a device's name, "cpu", "gpu", or a Device, Context or CommandQueue of pyopencl. Lengths are
in mm, angles in degrees, times in s. Each name is imported when it is first used: without OpenCL everything but
`render`, `render_frame`, `render_sweep`, `response`, `Live`, `defocus`, `inpaint` and `list_devices` works.
`reference.render` renders in NumPy float64 without OpenCL. Errors raised on purpose are subclasses of `ClscoError`.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.1.0"

# pyopencl caches generated code as pickles in the user's cache folder. It would execute pickles that anybody put there,
# and fails if it cannot write there. Generating the code takes less time than looking it up.
os.environ.setdefault("PYOPENCL_NO_CACHE", "1")

# The stub, which type checkers read as well, has a line for each public name, `from MODULE import NAME as NAME`.
_LINES = map(str.split, Path(__file__).with_suffix(".pyi").read_text("utf-8").splitlines())
_MODULES = {words[-1]: words[1] for words in _LINES if words[:1] == ["from"]}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module clsco has no attribute {name}")
    module = _MODULES[name]
    value = import_module(f"clsco.{name}") if module == "clsco" else getattr(import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
