"""Rays through the real lens: what pixels of a frame should be, by formulas that are not those of `clsco.optics`.

It shares with the engine the model of a scene and its loaded textures. numba and scipy are the extra `check`.
"""

from __future__ import annotations

from importlib.util import find_spec

from clsco.errors import ClscoError


def require_rays() -> None:
    """Raise ClscoError where what traces rays is not installed."""
    for name in ("numba", "scipy"):
        if find_spec(name) is None:
            raise ClscoError(f"check: the lens needs {name}: pip install 'clsco[check]'; got no such module")
