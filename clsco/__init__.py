"""Images of moving objects out of focus, with their ground truth, computed with OpenCL.

`load_scene` and `parse_scene` read a scene, `render` computes its frames, `defocus` blurs one image by its
radius map, `inpaint` fills missing pixels of one, and `reference` renders in NumPy float64 without OpenCL. Each is
imported when it is first used: without OpenCL everything but `render`, `defocus` and `inpaint` works.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsco import reference as reference
    from clsco.defocus import defocus as defocus
    from clsco.inpainting import inpaint as inpaint
    from clsco.render import render as render
    from clsco.scenefile import load_scene as load_scene
    from clsco.scenefile import parse_scene as parse_scene
    from clsco.sweep import load_sweep as load_sweep

__version__ = "0.1.0"
__all__ = ["__version__", "defocus", "inpaint", "load_scene", "load_sweep", "parse_scene", "reference", "render"]

_FUNCTIONS = {
    "defocus": "clsco.defocus",
    "inpaint": "clsco.inpainting",
    "load_scene": "clsco.scenefile",
    "load_sweep": "clsco.sweep",
    "parse_scene": "clsco.scenefile",
    "render": "clsco.render",
}


def __getattr__(name: str) -> Any:
    if name == "reference":
        return import_module("clsco.reference")
    if name in _FUNCTIONS:
        value = getattr(import_module(_FUNCTIONS[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module clsco has no attribute {name}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """`clsco.render` is the function, also after something has imported the module `clsco.render`."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _FUNCTIONS and isinstance(value, ModuleType)):  # what the import of a module does
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
