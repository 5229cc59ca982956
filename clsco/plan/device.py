"""Properties of a device that plans and buffer sizes depend on."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Protocol

UNKNOWN = 2**62  # bytes, in place of a limit that is not known


class DeviceFacts(Protocol):
    """Limits of a device that a plan depends on; `clsco.opencl.device.Device` implements it.

    kind: "gpu", "cpu" or "accelerator"; compute_units: number of cores; global_mem: bytes; max_alloc: bytes of the
    largest buffer; unified_memory: True if the device uses host memory.
    """

    @property
    def kind(self) -> str: ...

    @property
    def has_fp64(self) -> bool: ...

    @property
    def has_int64_atomics(self) -> bool: ...

    @property
    def compute_units(self) -> int: ...

    @property
    def global_mem(self) -> int: ...

    @property
    def max_alloc(self) -> int: ...

    @property
    def unified_memory(self) -> bool: ...


@dataclass(frozen=True)
class ThisMachine:
    """Assumed properties of this machine's processor, for a plan that is made before a device is opened."""

    kind: str = "cpu"
    has_fp64: bool = True
    has_int64_atomics: bool = True
    compute_units: int = field(default_factory=lambda: os.cpu_count() or 1)  # as PoCL counts, ignoring limits
    global_mem: int = UNKNOWN
    max_alloc: int = UNKNOWN
    unified_memory: bool = True
