"""Mutants of a text, and all of them in one: what is on there is what one alone does."""

import mmap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

from clsco.opencl.session import Session
from clsco.reference.common import geometry
from tests.mutation import memo
from tests.mutation.memory import Killed, reason, reasons, unmatched
from tests.mutation.mutants import ROOT, Mutant, mutants, owners_of
from tests.mutation.switched import ADDRESS, Switches, reserve, turn_on
from tests.mutation.tests import files

FILE = "kernels/some.cl"
OPTIONS = ["-cl-std=CL1.2", "-cl-opt-disable"]
TEXT = """#define HALF(a) ((a) / 2)  // rounds down
#define TWICE(a) \\
    ((a) * 2)
#if defined(cl_khr_fp64) && 1 + 1 == 2
#define BOTH(a, b) ((a) + (b))
#endif
kernel void some(__global int *out, int n)
{
    const int i = get_global_id(0);
    if (i >= n) return;
    int sum = i * 3 + 1, left = n - i;  // two of them
    for (int k = 0; k < 4; ++k)
        sum += k % 2 ? HALF(k) : TWICE(k) - left;
    if (sum > 5 && left != 2 || i == 1)
        sum -= min(left << 1, sum & 12);
    const int2 pair = (int2)(sum, -left);
    int list[2] = {pair.x | 8, BOTH(pair.y, 1)};
    const int most = max(list[0], list[1]);
    out[i] = most * (i < n / 2 ? 1 : -1) ^ 6;
}
"""


def built(session: Session, texts: Sequence[str]) -> list[cl.Kernel]:
    """The kernel of each text, of one program."""
    undefined = "".join(f"#undef {name}\n" for name in ("HALF", "TWICE", "BOTH"))
    renamed = [undefined + text.replace("void some(", f"void some_{k}(") for k, text in enumerate(texts)]
    program = cl.Program(session.context, "\n".join(renamed)).build(OPTIONS)
    return [getattr(program, f"some_{k}") for k in range(len(texts))]


def run(session: Session, kernel: cl.Kernel) -> list[int]:
    out = cl.Buffer(session.context, cl.mem_flags.READ_WRITE, 64)
    found = np.full(16, -7, np.int32)
    cl.enqueue_copy(session.queue, out, found)
    kernel(session.queue, (12,), (1,), out, np.int32(9))
    cl.enqueue_copy(session.queue, found, out)
    return found.tolist()


@pytest.fixture(scope="module")
def switches(tmp_path_factory: pytest.TempPathFactory) -> Switches:
    root: Path = tmp_path_factory.mktemp("root")
    (root / "kernels").mkdir()
    (root / FILE).write_text(TEXT, "utf-8")
    reserve()
    return Switches(root, mutants(root, FILE))


def test_each_mutant_that_is_on_does_what_it_does_alone(session: Session, switches: Switches) -> None:
    """As long as it stays within the arrays."""
    text = switched(session, switches)
    assert text != TEXT
    assert switches.unswitched(text) == TEXT
    tried = [mutant for mutant in switches.mutants if switches.has(mutant) and "list" not in mutant.line]
    assert len(tried) > 35
    together, plain, *alone = built(session, [text, TEXT, *(mutant.of(TEXT) for mutant in tried)])
    turn_on(0)
    unchanged = run(session, together)
    assert unchanged == run(session, plain)
    killed = 0
    for mutant, kernel in zip(tried, alone, strict=True):
        turn_on(switches.numbers[mutant])
        found = run(session, together)
        assert found == run(session, kernel), mutant.name
        killed += found != unchanged
    turn_on(0)
    assert killed > 25


def switched(session: Session, switches: Switches) -> str:
    """The text with all mutants with which it builds."""
    text: str | None = switches.texts[FILE]
    while text is not None:
        try:
            cl.Program(session.context, f'#line 1 "some.cl"\n{text}').build(OPTIONS)
            return text
        except cl.Error as error:
            text = switches.without(text, str(error))
    raise AssertionError("must build")


def test_lengths_of_arrays_have_texts_of_their_own(session: Session, switches: Switches) -> None:
    switched(session, switches)
    (length,) = (mutant for mutant in switches.mutants if mutant.line.startswith("int list[2]") and mutant.old == "2")
    assert not switches.has(length)
    assert switches.has(one(switches, "sum+=k%2", "+="))


def one(switches: Switches, line: str, old: str) -> Mutant:
    (found,) = (mutant for mutant in switches.mutants if mutant.line.startswith(line) and mutant.old == old)
    return found


def test_conditions_of_the_preprocessor_have_no_mutants(switches: Switches) -> None:
    assert not any(mutant.line.startswith("#if") for mutant in switches.mutants)


def test_the_number_is_held_once(switches: Switches) -> None:
    assert ADDRESS % mmap.PAGESIZE == 0
    with pytest.raises(OSError, match="must be free"):
        reserve()


def test_results_of_the_reference_are_kept_for_the_same_constants(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memo, "WORTH", 0.0)
    calls: list[int] = []

    def some_reference(value: int) -> float:
        calls.append(value)
        return value * geometry.BOUNDS_SLACK

    kept = memo._keeping(tmp_path, some_reference)
    assert kept(2) == kept(2) == 2 * geometry.BOUNDS_SLACK
    assert calls == [2]
    monkeypatch.setattr(geometry, "BOUNDS_SLACK", 0.5)
    assert kept(2) == kept(2) == 1.0
    assert calls == [2, 2]


def test_reasons_name_functions_that_exist() -> None:
    """The one check of survivors.toml that every change has to pass; `make mutation` reports reasons of no mutant."""
    there = {owner.name for file in files() for owner in owners_of(ROOT, file)}
    known = reasons()
    assert len(known) > 100
    assert known.keys() <= there, "rename or remove these tables of tests/mutation/survivors.toml"
    assert all(changes and all(changes.values()) for changes in known.values())


def test_a_reason_stays_with_a_function_that_moves(tmp_path: Path) -> None:
    (tmp_path / "kernels").mkdir()
    moved = TEXT.replace("TWICE(a)", "TWICE(b)").replace("list", "lists").replace("; //", ";\n    //")
    for file, text in ((FILE, TEXT), ("kernels/other.clh", f"int first(int a) {{ return a + 1; }}\n\n{moved}")):
        (tmp_path / file).write_text(text, "utf-8")
    before, after = (
        [m for m in mutants(tmp_path, file) if m.owner.name != "first"] for file in (FILE, "kernels/other.clh")
    )
    assert {m.owner.name for m in before} == {"HALF", "TWICE", "BOTH", "some"}
    known: dict[str, dict[str, str]] = {}
    for mutant in before:
        known.setdefault(mutant.owner.name, {})[mutant.change] = "why"
    lost = [mutant for mutant in after if reason(mutant, known) is None]
    assert lost
    assert all("lists" in mutant.line or mutant.owner.name == "TWICE" for mutant in lost)
    assert len(unmatched(after, known)) == len(lost)


def test_a_verdict_is_kept_until_its_function_changes(tmp_path: Path) -> None:
    (tmp_path / "kernels").mkdir()
    (tmp_path / FILE).write_text(TEXT, "utf-8")
    killed = Killed(tmp_path / ".mutation" / "killed.json")
    for mutant in mutants(tmp_path, FILE):
        killed.keep(mutant)
    killed.write()
    (tmp_path / FILE).write_text(TEXT.replace("rounds down", "a comment").replace("((a) / 2)", "((a) / 3)"), "utf-8")
    again = Killed(killed.path)
    assert {mutant.owner.name for mutant in mutants(tmp_path, FILE) if not again.has(mutant)} == {"HALF"}


def test_every_reason_has_its_mutant() -> None:
    """Wherever its function is: a reason without one is to be removed, or its line changed."""
    assert unmatched((mutant for name in files() for mutant in mutants(ROOT, name)), reasons()) == []
