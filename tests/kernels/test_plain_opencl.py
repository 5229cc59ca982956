"""Programs for a GPU are plain OpenCL C 1.2: no extension of clang, and nothing that knows a processor."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clsco.opencl import source_text
from clsco.opencl.session import Session
from clsco.passes.trace import TRACE_FILES
from clsco.passes.warp import KERNELS as FORWARD
from clsco.records import Real
from tests.kernels.test_programs_build import ELSEWHERE, GATHER, PROGRAMS, SCATTER, TILES, built, defined_in, variants

ROOT = Path(__file__).resolve().parents[2]
ON_GPU = {files: features for files, features in PROGRAMS.items() if files != GATHER}
ON_GPU |= {TRACE_FILES: PROGRAMS[TRACE_FILES] | {"GATHER": (0,)}, FORWARD: PROGRAMS[FORWARD] | {"OWNED": (0,)}}
FIELD = dict.fromkeys(("GENERAL", "WAVES", "FIELD"), (0, 1)) | dict.fromkeys(("SAMPLED", "DISC", "SEPARABLE"), (0,))
ON_GPU |= {TILES: PROGRAMS[TILES] | FIELD}  # weights that no other test of `make test` builds them with
LESS: dict[str, Any] = {"has_fp64": False, "has_int64_atomics": False, "correctly_rounded": False}
EXTENSIONS = re.compile(r"__builtin_|ext_vector_type|vector_size|__atomic_|__AVX|__SSE|__FMA__|min_vector_width|\(\{")
# The last line of PoCL's own header has no end.
PEDANTIC = '#pragma clang diagnostic error "-Wpedantic"\n#pragma clang diagnostic ignored "-Wnewline-eof"\n'


@pytest.mark.parametrize(
    ("files", "real"), [*((files, "float") for files in ON_GPU), (SCATTER, "double"), (FORWARD, "double")]
)
def test_programs_of_gpus_are_plain(
    session: Session, files: tuple[str, ...], real: Real, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Floats are built for cards with less; what asks for doubles or atomics of 64 bits, also for cards with these."""
    made, texts = source_text.program_text, list[str]()

    def pedantic(*given: Any) -> str:
        texts.append(made(*given))
        return PEDANTIC + texts[-1]

    monkeypatch.setattr(source_text, "program_text", pedantic)
    with Session(replace(session.device, kind="gpu", **LESS if real == "float" else {})) as opened:
        program = built(opened, files, variants(ON_GPU[files])[1], real)
    assert program.keys() >= defined_in(files) - ELSEWHERE.get(files, set())
    text = "\n".join(texts)
    assert {found[0] for found in EXTENSIONS.finditer(text)} == set()
    # Of warnings that its compiler does not know, a GPU's driver counts one for each program on the terminal.
    assert "#pragma clang" not in re.sub(r"#ifdef __x86_64__\n.*\n#endif", "", text)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("path", sorted((ROOT / "kernels").rglob("*.cl*")), ids=lambda path: path.name)
def test_extensions_stay_with_processors(path: Path) -> None:
    assert path.parent.name == "cpu" or not EXTENSIONS.search(path.read_text("utf-8"))
