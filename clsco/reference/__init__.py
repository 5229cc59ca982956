"""The whole renderer once more in NumPy float64, without OpenCL: same files and names as the kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsco.reference.sequence import render as render

__all__ = ["render"]


def __getattr__(name: str) -> Any:
    """Import `render` when it is first used: predictions of time take some modules from here, and not all."""
    if name != "render":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from clsco.reference.sequence import render

    globals()["render"] = render
    return render
