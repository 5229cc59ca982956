"""Processors that PoCL's LLVM has no name for."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from clsco.opencl import pocl_cpu
from clsco.opencl.session import Session

AVX512 = {"avx512f", "avx512cd", "avx512dq", "avx512bw", "avx512vl"}
AVX2 = {"avx2", "fma", "bmi2"}
NOTHING = "builds nothing for this processor"
# Has PoCL call the processor "generic", as where its LLVM does not know it, and builds a program.
NAMELESS = """
import ctypes
from clsco.opencl import device, pocl_cpu
from clsco.opencl.session import Session
import pyopencl as cl

chosen = device.choose("pocl")
name = chosen.handle.version.rpartition("linux-gnu-")[2].encode() + b"\\0"
known, pocl_cpu._UNKNOWN = pocl_cpu._UNKNOWN, name
place = pocl_cpu.name_in(chosen.handle.int_ptr)
pocl_cpu._UNKNOWN = known
duplicate = ctypes.CDLL(None).strdup
duplicate.restype, duplicate.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
ctypes.c_void_p.from_address(place).value = duplicate(b"generic")
pocl_cpu._is_nameless = lambda _: True
for _ in range(2):
    with Session(chosen) as session:
        cl.Program(session.context, "__kernel void nothing(void) {}").build()
        print(pocl_cpu.name_in(chosen.handle.int_ptr))
"""


class Structure:
    """Memory as a device of PoCL has it: words that are numbers, pointers to nowhere, and pointers to texts."""

    def __init__(self, version: str, *texts: bytes) -> None:
        self.version = version
        self.texts = [ctypes.create_string_buffer(text) for text in texts]
        self.words = (ctypes.c_uint64 * 128)(*range(128))
        self.words[3] = 2**64 - 1
        self.words[5] = 0x7000_0000_0000
        for place, text in enumerate(self.texts, 80):
            self.words[place] = ctypes.addressof(text)

    @property
    def int_ptr(self) -> int:
        return ctypes.addressof(self.words)

    def text(self, place: int) -> bytes:
        return ctypes.string_at(self.words[place])


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        (AVX512 | AVX2 | {"sse2"}, b"skylake-avx512"),
        (AVX512 - {"avx512vl"} | AVX2, b"haswell"),
        (AVX2, b"haswell"),
        ({"avx", "sse2"}, None),
        (set(), None),
    ],
)
def test_the_name_has_what_the_processor_has(flags: set[str], name: bytes | None) -> None:
    assert pocl_cpu.known_name(flags) == name


def test_the_unknown_name_behind_the_machine_is_found() -> None:
    structure = Structure(UNKNOWN, b"generic", b"x86_64-unknown-linux-gnu", b"generic", b"generic")
    assert pocl_cpu.name_in(structure.int_ptr) == structure.int_ptr + 8 * 82


@pytest.mark.parametrize("texts", [(), (b"x86_64-", b"znver3"), (b"x86_64-", b"generic-gpu"), (b"generic", b"generic")])
def test_what_is_not_as_expected_is_left(texts: tuple[bytes, ...]) -> None:
    assert pocl_cpu.name_in(Structure(UNKNOWN, *texts).int_ptr) is None


UNKNOWN, KNOWN = (f"OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-{name}" for name in ("generic", "znver3"))


@pytest.mark.parametrize("asked", [True, False])
def test_an_unknown_processor_gets_a_name(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, asked: bool
) -> None:
    monkeypatch.setenv(pocl_cpu.VARIABLE, str(int(asked)))
    monkeypatch.setattr(pocl_cpu, "_flags", lambda: AVX2)
    monkeypatch.setattr(pocl_cpu, "_builds_nothing", lambda device: not asked)
    pocl_cpu._report.cache_clear()
    for _ in range(2):
        structure: Any = Structure(UNKNOWN, b"x86_64-unknown-linux-gnu", b"generic", b"generic")
        for _ in range(2):  # a second session finds it done, and leaves what is not the device's
            pocl_cpu.ensure_known(structure)
            assert [structure.text(place) for place in (81, 82)] == [b"haswell", b"generic"]
    lines = caplog.messages
    assert len(lines) == (0 if asked else 1)
    assert all(NOTHING in line and "haswell" in line and pocl_cpu.VARIABLE in line for line in lines)


@pytest.mark.parametrize(
    ("version", "flags", "builds"), [(KNOWN, AVX2, False), (UNKNOWN, set(), False), (UNKNOWN, AVX2, True)]
)
def test_all_else_stays(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, version: str, flags: set[str], builds: bool
) -> None:
    monkeypatch.delenv(pocl_cpu.VARIABLE, raising=False)
    monkeypatch.setattr(pocl_cpu, "_flags", lambda: flags)
    monkeypatch.setattr(pocl_cpu, "_builds_nothing", lambda device: not builds)
    structure: Any = Structure(version, b"x86_64-unknown-linux-gnu", b"generic")
    pocl_cpu.ensure_known(structure)
    assert structure.text(81) == b"generic"
    assert caplog.messages == []


def test_a_session_can_build_whatever_the_processor(session: Session) -> None:
    handle = session.device.handle
    assert pocl_cpu.name_in(handle.int_ptr) is None or pocl_cpu.known_name(pocl_cpu._flags()) is None
    assert not pocl_cpu._builds_nothing(handle)


@pytest.mark.skipif(pocl_cpu.known_name(pocl_cpu._flags()) is None, reason="no name of PoCL's fits this processor")
@pytest.mark.parametrize(
    ("asked", "lines"), [({}, 1), pytest.param({pocl_cpu.VARIABLE: "1"}, 0, marks=pytest.mark.slow)]
)
def test_pocl_builds_for_a_processor_that_it_does_not_know(
    session: Session, tmp_path: Path, asked: dict[str, str], lines: int
) -> None:
    if not session.device.handle.version.startswith("OpenCL 3.0 PoCL HSTR: pthread-x86_64"):
        pytest.skip("the structure is that of PoCL 3.0")
    environ = {name: value for name, value in os.environ.items() if name != pocl_cpu.VARIABLE}
    environ |= {"POCL_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(__file__).parents[2])} | asked
    done: Any = subprocess.run([sys.executable, "-c", NAMELESS], env=environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "None\nNone\n"
    assert [NOTHING in line for line in done.stderr.splitlines()] == [True] * lines
