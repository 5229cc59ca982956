"""A decision of a plan, with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Choice(Generic[T]):
    """A value that a plan decided on, and the reason.

    Attributes
    ----------
    value : object
        False, 0, empty or "none" if a part of the pipeline is left out.
    reason : str
        Text for reports.
    unused : tuple of str
        Keys of the scene file that have no effect with this value.
    """

    value: T
    reason: str = ""
    unused: tuple[str, ...] = ()

    @property
    def left_out(self) -> bool:
        """True if the scene does not need this part of the pipeline."""
        return not self.value or self.value == "none"
