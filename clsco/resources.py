"""Folders that are shipped with the package: the kernels and the example scenes."""

from __future__ import annotations

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path


def folder(name: str) -> Traversable:
    """The shipped folder `name` ("kernels" or "examples"), installed or in a source tree.

    An installed package carries it as `clsco.<name>`. In a source tree it lies beside the package, which then
    shadows an installed one. Raises FileNotFoundError when it is in neither place.
    """
    beside = Path(__file__).resolve().parent.parent / name
    if (beside.parent / "pyproject.toml").is_file() and beside.is_dir():
        return beside
    inside = files("clsco") / name
    if inside.is_dir():
        return inside
    raise FileNotFoundError(f"{name}: must be installed as clsco/{name} or lie beside the package; got neither")
