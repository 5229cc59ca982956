"""Reference renderer in NumPy float64, without OpenCL; it has the file and function names of the kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsco.reference.sequence import render as render

__all__ = ["render"]


def __getattr__(name: str) -> Any:
    """Import `render` lazily, because time predictions use only some modules of this package."""
    if name != "render":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from clsco.reference.sequence import render

    globals()["render"] = render
    return render
