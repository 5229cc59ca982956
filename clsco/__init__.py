"""Images of moving objects out of focus, with their ground truth, computed with OpenCL.

`load_scene` and `parse_scene` read a scene, `render` computes its frames, `defocus` blurs one image by its
radius map, `inpaint` fills missing pixels of one, and `reference` renders in NumPy float64 without OpenCL. Each is
imported when it is first used: without OpenCL everything but `render`, `defocus` and `inpaint` works.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsco import reference as reference
    from clsco.engine.defocus import defocus as defocus
    from clsco.engine.inpaint import inpaint as inpaint
    from clsco.engine.sequence import render as render
    from clsco.scene.file import load_scene as load_scene
    from clsco.scene.file import parse_scene as parse_scene
    from clsco.scene.sweep import load_sweep as load_sweep

__version__ = "0.1.0"
__all__ = ["__version__", "defocus", "inpaint", "load_scene", "load_sweep", "parse_scene", "reference", "render"]

_HOME = {
    "defocus": "clsco.engine.defocus",
    "inpaint": "clsco.engine.inpaint",
    "load_scene": "clsco.scene.file",
    "load_sweep": "clsco.scene.sweep",
    "parse_scene": "clsco.scene.file",
    "render": "clsco.engine.sequence",
}


def __getattr__(name: str) -> Any:
    if name == "reference":
        return import_module("clsco.reference")
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module clsco has no attribute {name}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
