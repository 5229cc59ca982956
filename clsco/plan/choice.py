"""A decision of a plan, with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Choice(Generic[T]):
    """A value that a plan decided on, the reason in reports, and the keys of the scene that have no effect because of
    it.

    value: False, 0, empty or "none" if a part of the pipeline is left out.
    """

    value: T
    reason: str = ""
    unused: tuple[str, ...] = ()

    @property
    def left_out(self) -> bool:
        """True if the scene does not need this part of the pipeline."""
        return not self.value or self.value == "none"
