"""Processors that PoCL's LLVM has no name for."""

from __future__ import annotations

import ctypes

import pytest

from clsco.opencl import pocl_cpu as poclcpu
from clsco.opencl.session import Session

AVX512 = {"avx512f", "avx512cd", "avx512dq", "avx512bw", "avx512vl"}
AVX2 = {"avx2", "fma", "bmi2"}


class Structure:
    """Memory as a device of PoCL has it: words that are numbers, pointers to nowhere, and pointers to texts."""

    def __init__(self, *texts: bytes) -> None:
        self.texts = [ctypes.create_string_buffer(text) for text in texts]
        self.words = (ctypes.c_uint64 * 128)(*range(128))
        self.words[3] = 2**64 - 1
        self.words[5] = 0x7000_0000_0000
        for place, text in enumerate(self.texts, 80):
            self.words[place] = ctypes.addressof(text)

    @property
    def address(self) -> int:
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
    assert poclcpu.known_name(flags) == name


def test_the_unknown_name_behind_the_machine_is_found() -> None:
    structure = Structure(b"generic", b"x86_64-unknown-linux-gnu", b"generic", b"generic")
    assert poclcpu.name_in(structure.address) == structure.address + 8 * 82


@pytest.mark.parametrize("texts", [(), (b"x86_64-", b"znver3"), (b"x86_64-", b"generic-gpu"), (b"generic", b"generic")])
def test_what_is_not_as_expected_is_left(texts: tuple[bytes, ...]) -> None:
    assert poclcpu.name_in(Structure(*texts).address) is None


UNKNOWN, KNOWN = (f"OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-{name}" for name in ("generic", "znver3"))


def test_an_unknown_processor_gets_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poclcpu, "_flags", lambda: AVX2)
    structure = Structure(b"x86_64-unknown-linux-gnu", b"generic", b"generic")
    for _ in range(2):  # a second session finds it done, and leaves what is not the device's
        poclcpu.ensure_known(UNKNOWN, structure.address)
        assert [structure.text(place) for place in (81, 82)] == [b"haswell", b"generic"]


@pytest.mark.parametrize(("version", "flags"), [(KNOWN, AVX2), (UNKNOWN, set())])
def test_all_else_stays(monkeypatch: pytest.MonkeyPatch, version: str, flags: set[str]) -> None:
    monkeypatch.setattr(poclcpu, "_flags", lambda: flags)
    structure = Structure(b"x86_64-unknown-linux-gnu", b"generic")
    poclcpu.ensure_known(version, structure.address)
    assert structure.text(81) == b"generic"


def test_a_session_can_build_whatever_the_processor(session: Session) -> None:
    handle = session.device.handle
    assert poclcpu.name_in(handle.int_ptr) is None or poclcpu.known_name(poclcpu._flags()) is None
