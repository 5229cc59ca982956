"""Mutants of a text, their outcomes, and reasons of those that survive."""

from pathlib import Path
from unittest.mock import patch

import pytest

from tests.mutation import __main__ as tool
from tests.mutation.mutants import Mutant, Owner, mutants

FILE = "kernels/some.cl"
TEXT = """#define HALF(a) ((a) / 2)  // rounds down
#define TWICE(a) \\
    ((a) * 2)
#if defined(cl_khr_fp64) && 1 + 1 == 2
#define BOTH(a, b) ((a) + (b))
#endif
kernel void some(__global int *out, int n)
{
    const int i = get_global_id(0);
    int sum = -i * 3 + 1;
    int list[2] = {sum, BOTH(sum, 1)};
    out[i] = max(list[0], (int)-list[1]) < 2.5f ? 6 : 0x10;
}
"""


def test_mutants_are_other_operators_numbers_and_functions() -> None:
    changes = {(mutant.owner.name, mutant.old, mutant.new) for mutant in mutants(TEXT, FILE)}
    some = {("-", "+"), ("*", "/"), ("3", "4"), ("+", "-"), ("1", "2"), ("2", "3"), ("0", "1"), ("max", "min"),
            ("<", "<="), ("2.5f", "(2 * 2.5f)"), ("6", "7"), ("0x10", "(0x10 + 1)")}  # fmt: skip
    macros = {("HALF", "/", "*"), ("HALF", "2", "3"), ("TWICE", "*", "/"), ("TWICE", "2", "3"), ("BOTH", "+", "-")}
    assert changes == macros | {("some", *change) for change in some}


def test_a_reason_stays_with_a_function_that_moves() -> None:
    moved = TEXT.replace("TWICE(a)", "TWICE(b)").replace("list", "lists").replace("; //", ";\n    //")
    before = mutants(TEXT, FILE)
    after = [m for m in mutants(f"int first(int a) {{ return a + 1; }}\n\n{moved}", FILE) if m.owner.name != "first"]
    known: dict[str, dict[str, str]] = {}
    for mutant in before:
        known.setdefault(mutant.owner.name, {})[mutant.change] = "why"
    lost = [mutant for mutant in after if tool.reason(mutant, known) is None]
    assert lost
    assert all("lists" in mutant.line or mutant.owner.name == "TWICE" for mutant in lost)
    assert len(tool.unmatched(after, known)) == len(lost)


@pytest.mark.slow
def test_every_reason_has_its_mutant() -> None:
    """Wherever its function is: a reason without one is to be removed, or its line changed."""
    known = tool.reasons()
    assert len(known) > 100
    assert all(changes and all(changes.values()) for changes in known.values())
    assert tool.unmatched(tool.kernel_mutants(tool.kernel_files()), known) == []


@pytest.mark.parametrize(
    ("test", "outcome"),
    [
        ("assert text == 'kernel text'", "survived"),
        ("assert 'text' not in text", "killed"),
        ("raise SystemError('must build on')", "not built"),
        ("import time; time.sleep(60)", "timeout"),
    ],
)
def test_outcomes(test: str, outcome: str, tmp_path: Path) -> None:
    (tmp_path / "kernels").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / FILE).write_text("kernel line", "utf-8")
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = -p no:zarr -p no:anyio\n", "utf-8")
    content = f"def test_some() -> None:\n    text = open('{FILE}').read()\n    {test}\n"
    (tmp_path / "tests/test_some.py").write_text(content, "utf-8")
    mutant = Mutant(FILE, 7, 1, Owner("kernel", 0, 11), "kernel line", "line", "text", 0)
    with patch.dict(tool.TESTS, {"some.cl": "test_some"}):
        result = tool.try_mutant(tmp_path, mutant, "not slow", 1.0 if outcome == "timeout" else 60.0)
    assert result["outcome"] == outcome
    assert bool(result["by"]) == (outcome in ("killed", "not built"))
    assert (tmp_path / FILE).read_text("utf-8") == "kernel line"
