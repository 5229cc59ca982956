"""Rays through the real lens: what pixels of a frame should be, by formulas that are not those of `clsco.optics`.

It shares with the engine the model of a scene and its loaded textures. numba and scipy are the extra `check`.
"""

from __future__ import annotations

from clsco.errors import require_extra


def require_rays() -> None:
    """Raise MissingDependencyError where what traces rays is not installed."""
    for name in ("numba", "scipy"):
        require_extra("check", name, "check")
