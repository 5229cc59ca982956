"""A decision of a plan, with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Choice(Generic[T]):
    """Value that a plan decided on, and why.

    Attributes
    ----------
    value : object
        False, 0, empty or "none" where a part of the pipeline is left out.
    reason : str
        Words for reports.
    unused : tuple of str
        Keys of the scene file that nothing depends on with this value.
    """

    value: T
    reason: str = ""
    unused: tuple[str, ...] = ()

    @property
    def left_out(self) -> bool:
        """True if the scene has no use for the part."""
        return not self.value or self.value == "none"
