"""Reach of tests: a test can kill a mutant of a kernel if it launches a kernel that has it after the preprocessor."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tests.mutation.mutants import Mutant, mutants

MARK = re.compile(r"\bMUTANT_(\d+)_")
ATTRIBUTE = re.compile(r"__attribute__\s*\(\((?:[^()]|\([^()]*\))*\)\)")
IN_CONDITIONS = re.compile(r"^\s*#\s*(?:el)?if\b(.*)$", re.MULTILINE)
CONSTANT = re.compile(r"\s*#\s*define\s+(\w+)\s")


class Reach:
    """All mutants of kernel files, each with a mark that stands before it in the files' texts."""

    def __init__(self, root: Path, files: Iterable[str]) -> None:
        self.mutants: list[Mutant] = []
        self.marked: dict[str, str] = {}  # text -> with marks
        self.always: dict[str, set[int]] = {}  # text -> mutants that cannot have a mark
        texts = {file: (root / file).read_text("utf-8") for file in files}
        asked = {
            name for text in texts.values() for line in IN_CONDITIONS.findall(text) for name in re.findall(r"\w+", line)
        }
        for file, text in texts.items():
            changed, self.always[text] = text, set()
            numbered = list(enumerate(mutants(root, file), len(self.mutants)))
            for number, mutant in reversed(numbered):
                constant = CONSTANT.match(text, mutant.owner.start)
                if constant and constant[1] in asked:
                    self.always[text].add(number)
                else:
                    changed = f"{changed[: mutant.start]} MUTANT_{number}_ {changed[mutant.start :]}"
            self.marked[text] = changed
            self.mutants += [mutant for _, mutant in numbered]

    def tests(self, recorded: Mapping[str, Any]) -> dict[Mutant, list[str]]:
        """Tests that reach a mutant, in their order, of what `Recorder` has written; without mutants of no test."""
        in_kernels = [self.in_kernels(options, text) for options, text in recorded["programs"]]
        found: dict[Mutant, list[str]] = {}
        for test, what in recorded["tests"].items():
            found_in = set(range(len(self.mutants))) if what["elsewhere"] else set[int]()
            for place, kernel in what["launched"]:
                found_in |= in_kernels[place][kernel]
            for number in sorted(found_in):
                found.setdefault(self.mutants[number], []).append(test)
        return found

    def in_kernels(self, options: list[str], text: str) -> dict[str, set[int]]:
        """Mutants in each kernel of a program and the functions that it calls, and outside of functions."""
        everywhere: set[int] = set()
        for plain, marked in self.marked.items():
            if plain in text:
                text = text.replace(plain, marked)
                everywhere |= self.always[plain]
        defined = [option for option in options if option.startswith("-D")]
        command = ["cpp", "-P", "-w", *defined, "-"]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
        bodies, kernels = dict[str, str](), set[str]()
        for item in _items(ATTRIBUTE.sub(" ", done.stdout)):
            head = item.partition("{")[0]
            called = re.search(r"(\w+)\s*\(", MARK.sub(" ", head))
            if item.endswith("}") and called:
                bodies[called[1]] = bodies.get(called[1], "") + item
                kernels |= {called[1]} if re.search(r"\b(?:__)?kernel\b", head) else set()
            else:
                everywhere |= _marks(item)
        calls = {name: set(re.findall(r"\w+", body)) & bodies.keys() for name, body in bodies.items()}
        marks = {name: _marks(body) for name, body in bodies.items()}
        return {kernel: everywhere.union(*(marks[name] for name in _reached(kernel, calls))) for kernel in kernels}


def _items(text: str) -> Iterable[str]:
    """Functions and declarations."""
    depth = begin = 0
    is_function = False
    for match in re.finditer(r"[(){};]", text):
        bracket = match[0]
        if bracket == "{" and depth == 0:
            is_function = text[begin : match.start()].rstrip().endswith(")")
        depth += {"(": 1, "{": 1, ")": -1, "}": -1}.get(bracket, 0)
        if depth == 0 and (bracket == ";" or (bracket == "}" and is_function)):
            yield text[begin : match.end()]
            begin, is_function = match.end(), False


def _marks(text: str) -> set[int]:
    return {int(number) for number in MARK.findall(text)}


def _reached(kernel: str, calls: Mapping[str, set[str]]) -> set[str]:
    reached, fresh = {kernel}, {kernel}
    while fresh:
        fresh = set[str]().union(*(calls[name] for name in fresh)) - reached
        reached |= fresh
    return reached
