"""Facts of a device that plans and sizes of buffers depend on."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Protocol

UNKNOWN = 2**62  # bytes, of a limit that is not known


class DeviceFacts(Protocol):
    """Device limits that a plan depends on; `clsco.opencl.device.Device` has them."""

    @property
    def kind(self) -> str:
        """ "gpu", "cpu" or "accelerator"."""

    @property
    def has_fp64(self) -> bool:
        """True if the device computes in double precision."""

    @property
    def has_int64_atomics(self) -> bool:
        """True if the device adds whole numbers of 64 bits by atomics."""

    @property
    def compute_units(self) -> int:
        """Cores, which work at a time."""

    @property
    def global_mem(self) -> int:
        """Its memory in bytes."""

    @property
    def max_alloc(self) -> int:
        """Bytes of its largest buffer."""

    @property
    def unified_memory(self) -> bool:
        """True if the device works in the machine's memory."""


@dataclass(frozen=True)
class ThisMachine:
    """The processor, for a plan that is made before a device is opened."""

    kind: str = "cpu"
    has_fp64: bool = True
    has_int64_atomics: bool = True
    compute_units: int = field(default_factory=lambda: os.cpu_count() or 1)  # as PoCL counts, whatever it is allowed
    global_mem: int = UNKNOWN
    max_alloc: int = UNKNOWN
    unified_memory: bool = True
