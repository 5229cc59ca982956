"""Programs for a GPU are plain OpenCL C 1.2: no extension of clang, and nothing that knows a processor."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clsco.opencl import source_text
from clsco.opencl.program import build
from clsco.opencl.session import Session
from clsco.passes.blur import FILES_OF
from clsco.passes.trace import TRACE_FILES
from clsco.records import structs
from tests.kernels.test_programs_build import PROGRAMS, variants

ROOT = Path(__file__).resolve().parents[2]
# Programs of GPUs, with all features and with none.
ON_GPU: dict[tuple[str, ...], dict[str, tuple[int, ...]]] = {
    files: PROGRAMS[files] for files in PROGRAMS if not any("/cpu/" in name for name in files)
}
ON_GPU[TRACE_FILES] = PROGRAMS[TRACE_FILES] | {"GATHER": (0,)}
ON_GPU[FILES_OF["tiles"]] = PROGRAMS[FILES_OF["scatter"]] | {"OCCLUDED": (0,), "CUT_CHORDS": (0,), "BORDERS": (0,)}
EXTENSIONS = re.compile(r"__builtin_|ext_vector_type|vector_size|__atomic_|__AVX|__SSE|__FMA__|min_vector_width|\(\{")
# The last line of PoCL's own header has no end.
PEDANTIC = '#pragma clang diagnostic error "-Wpedantic"\n#pragma clang diagnostic ignored "-Wnewline-eof"\n'


def test_every_method_of_a_gpu_is_looked_at() -> None:
    asked = {name for files in ON_GPU for name in files}
    assert asked >= {*TRACE_FILES, *FILES_OF["scatter"], *FILES_OF["tiles"]}
    assert asked >= {f"{name}.cl" for name in ("blur/convolve", "blur/accumulate", "layered/layered")}


@pytest.mark.parametrize("files", ON_GPU, ids="+".join)
def test_programs_of_gpus_are_plain(
    session: Session, files: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    made, texts = source_text.program_text, list[str]()

    def pedantic(*given: Any) -> str:
        texts.append(made(*given))
        return PEDANTIC + texts[-1]

    monkeypatch.setattr(source_text, "program_text", pedantic)
    with Session(replace(session.device, kind="gpu")) as opened:
        none, everything = variants(ON_GPU[files])[:2]
        build(opened, files, none, structs("float"), "float")
        build(opened, files, everything, structs("double"), "double")
    assert len(texts) == 2
    for text in texts:
        assert {found[0] for found in EXTENSIONS.finditer(text)} == set()
        # Of warnings that its compiler does not know, a GPU's driver counts one for each program on the terminal.
        assert "#pragma clang" not in re.sub(r"#ifdef __x86_64__\n.*\n#endif", "", text)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("path", sorted((ROOT / "kernels").rglob("*.cl*")), ids=lambda path: path.name)
def test_extensions_stay_with_processors(path: Path) -> None:
    assert path.parent.name == "cpu" or not EXTENSIONS.search(path.read_text("utf-8"))
