"""Rays through the real lens: expected values of a frame's pixels, by formulas independent of `clsco.optics`.

The package shares the scene model and loaded textures with the engine. numba and scipy are in the extra `check`.
"""

from __future__ import annotations

from clsco.errors import require_extra


def require_rays() -> None:
    """Raise MissingDependencyError if the packages for tracing rays are not installed."""
    for name in ("numba", "scipy"):
        require_extra("check", name, "check")
