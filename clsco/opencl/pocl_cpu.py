"""Replaces the name of a processor that is newer than PoCL's LLVM, for which no kernel would build.

PoCL takes the processor's name from the LLVM that it was built with. For a processor that this LLVM does not know, such
as a Zen 5 in PoCL 3.0, the name is "generic", and Clang ends every build with "unknown target CPU 'generic'" (issues
512 and 1049 of pocl/pocl). No option or variable can set the name, because options precede it on Clang's command line.
So before the first build, the name is replaced in the device's structure in memory: if a trial build of an empty kernel
fails, with a warning, or if CLSCO_POCL_CPU=1 is set, without trial and warning.

The new name must stand for the CPU features of PoCL's library of built-in functions, which PoCL chooses by the real
processor: otherwise caller and callee would pass vectors of 64 bytes differently, and the process would crash.

To be deleted when PoCL's wheel has a newer LLVM.
"""

from __future__ import annotations

import ctypes
import logging
import os
import struct
import warnings
from functools import lru_cache
from pathlib import Path

import pyopencl as cl

from clsco.opencl import pocl_cache

VARIABLE = "CLSCO_POCL_CPU"
_UNKNOWN, _BEFORE = b"generic\0", b"x86_64-"  # the name, and the start of the text to which the word before points
_WORDS = 128  # number of words searched in a device's structure; in PoCL 3.0 the name is word 80
_BY_FLAGS = (
    ({"avx512f", "avx512cd", "avx512dq", "avx512bw", "avx512vl"}, b"skylake-avx512"),
    ({"avx2", "fma", "bmi2"}, b"haswell"),
)
"""Flags of /proc/cpuinfo, and LLVM's name of the processor that PoCL's library for these flags was compiled for."""


def ensure_known(device: cl.Device) -> None:
    """If a PoCL device gives its processor the name "generic", replace the name by one that LLVM knows.

    Nothing changes if PoCL builds anyway and CLSCO_POCL_CPU is not 1. If no name fits, or PoCL's structure is not as
    expected, nothing changes either, and the first build raises an error. Tested on a Zen 5 with the wheel of PoCL 3.0.
    """
    if not _is_nameless(device):
        return
    name, place = known_name(_flags()), name_in(device.int_ptr)
    requested = os.environ.get(VARIABLE) == "1"
    if name is None or place is None or not (requested or _builds_nothing(device)):
        return
    # Allocated by malloc, like PoCL's own name, because PoCL frees it at its end.
    duplicate = ctypes.CDLL(None).strdup
    duplicate.restype, duplicate.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    ctypes.c_void_p.from_address(place).value = duplicate(name)
    if not requested:
        _report(name.decode())


def _is_nameless(device: cl.Device) -> bool:
    return bool(device.version.endswith(_UNKNOWN.rstrip(b"\0").decode()))


@lru_cache
def _builds_nothing(device: cl.Device) -> bool:
    """True if a trial build of an empty kernel fails; takes 3 ms if it fails, 30 ms if it succeeds."""
    if pocl_cache.shortage():  # PoCL writes a successful build to the cache, and aborts on a full disk
        return False
    with pocl_cache.exclusive(), warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        try:
            cl.Program(cl.Context([device]), "__kernel void nothing(void) {}").build()
        except cl.Error:
            return True
    return False


@lru_cache
def _report(name: str) -> None:
    """Log a warning of the replaced name, once per process."""
    rule = f"builds nothing for this processor, which is newer; its name was set to {name} in PoCL's memory"
    logging.getLogger("clsco").warning("PoCL %s (%s=1 agrees to it without this line)", rule, VARIABLE)


def known_name(flags: set[str]) -> bytes | None:
    """LLVM's name of the best processor for which PoCL has a library; None if the flags of /proc/cpuinfo fit none."""
    return next((name for needed, name in _BY_FLAGS if needed <= flags), None)


def name_in(address: int) -> int | None:
    """Address of the pointer to the name "generic" in the device's structure at `address`; None if there is none.

    Only a pointer that follows the one to the kind of machine counts, so that memory behind the structure is never
    changed.
    """
    size = struct.calcsize("P")
    words = struct.unpack(f"{_WORDS}P", _read(address, _WORDS * size).ljust(_WORDS * size, b"\0"))
    for place in range(1, _WORDS):
        texts = (_BEFORE, words[place - 1]), (_UNKNOWN, words[place])
        if all(word and _read(word, len(text)) == text for text, word in texts):
            return address + size * place
    return None


def _read(address: int, count: int) -> bytes:
    """Up to `count` bytes of this process's memory at `address`; fewer or none where no memory is mapped."""
    try:
        # Through a file, since reading at an invalid address must not crash the process.
        with open("/proc/self/mem", "rb", buffering=0) as memory:
            memory.seek(address)
            return memory.read(count)
    except (OSError, OverflowError, ValueError):
        return b""


def _flags() -> set[str]:
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return set()
    return next((set(line.split()[2:]) for line in text.splitlines() if line.startswith("flags")), set())
