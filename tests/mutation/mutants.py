"""Small faults in the text of kernels, one at a time: another operator, another number, another function."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OPERATORS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "<<": ">>", ">>": "<<",
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "&": "|", "|": "&", "^": "|",
    "&&": "||", "||": "&&", "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=", "|=": "&=", "&=": "|=",
    "<<=": ">>=", ">>=": "<<=",
}  # fmt: skip
NAMES = {
    "min": "max", "max": "min", "MIN": "MAX", "MAX": "MIN", "fmin": "fmax", "fmax": "fmin", "floor": "ceil",
    "ceil": "floor", "sin": "cos", "cos": "sin", "atomic_min": "atomic_max", "atomic_max": "atomic_min",
    "any": "all", "all": "any",
}  # fmt: skip
C_TYPE = re.compile(r"(?:(?:u?char|u?short|u?int|u?long|float|double|real|bool|size_t|void)\d*|\w+_t|const|restrict)$")
C_TOKEN = re.compile(
    r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\n])*\"|'(?:\\.|[^'\n])*'"
    r"|(?P<number>0[xX][\da-fA-F.]+(?:[pP][+-]?\d+)?[uUlLfF]*|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[uUlLfF]*)"
    r"|(?P<name>[A-Za-z_]\w*)|(?P<operator><<=|>>=|->|\+\+|--|&&|\|\||<<|>>|[-+*/%&|^<>=!]=|[-+*/%&|^<>=!?:;,.~()\[\]{}#])"
    r"|(?P<space>\\\n|\s)",
    re.DOTALL,
)
LINE = re.compile(r"^(?:.*\\\n)*.*$", re.MULTILINE)  # with those that it goes on in
# Of the preprocessor: which text there is at all. A `#define` is what stands in its place. PREFETCH changes the time
# alone.
NOT_TEXT = re.compile(r"\s*(?:#\s*(?:if|ifdef|ifndef|elif|else|endif|include|pragma|undef)|PREFETCH)\b")
DEFINED = re.compile(r"\s*#\s*define\s+(\w+)(?:\([^)]*\))?")


@dataclass(frozen=True)
class Owner:
    """A definition of a file: a function, a macro or a constant."""

    name: str
    start: int
    stop: int


@dataclass(frozen=True)
class Mutant:
    """One change: from `old` to `new` at `start` of a file's text.

    line: the tokens of the line that it is in; number: of the places of its kind in such lines of its owner.
    """

    file: str
    start: int
    row: int
    owner: Owner
    line: str
    old: str
    new: str
    number: int

    @property
    def change(self) -> str:
        """The same wherever its function is, and whatever else changes there."""
        again = f" ({self.number})" if self.number else ""
        return f"{self.line} # {self.old} -> {self.new}{again}"

    @property
    def name(self) -> str:
        return f"{self.owner.name}: {self.change}"

    def apply(self, text: str) -> str:
        """The text with the change."""
        return text[: self.start] + self.new + text[self.start + len(self.old) :]


def mutants(text: str, file: str) -> list[Mutant]:
    """All changes of a kernel file's text, each operator, number and function once."""
    lines, owners, changes = text.split("\n"), list(owners_of(text)), list[Mutant]()
    seen: Counter[tuple[str, str, str]] = Counter()
    for start, old, new in _changes(text):
        row = text.count("\n", 0, start)
        owner = next((owner for owner in owners if owner.start <= start < owner.stop), Owner("", 0, 0))
        line = _joined(_tokens(lines[row]))
        changes.append(Mutant(file, start, row + 1, owner, line, old, new, seen[owner.name, line, old]))
        seen[owner.name, line, old] += 1
    return changes


def owners_of(text: str) -> Iterator[Owner]:
    """The functions, macros and constants of a text, in their order."""
    depth, begin, tokens, is_function = 0, 0, list[str](), False
    for line in LINE.finditer(text):
        if line[0].lstrip().startswith("#"):
            if head := DEFINED.match(line[0]):
                yield Owner(head[1], line.start(), line.end())
            continue
        for match in C_TOKEN.finditer(text, line.start(), line.end()):
            if match.lastgroup in (None, "space"):
                continue
            if not tokens:
                begin = match.start()
            if match[0] == "{" and depth == 0:
                is_function = tokens[-1:] == [")"]
            tokens.append(match[0])
            depth += {"(": 1, "{": 1, ")": -1, "}": -1}.get(match[0], 0)
            if depth == 0 and (match[0] == ";" or (match[0] == "}" and is_function)):
                yield Owner(_defined_name(tokens), begin, match.end())
                tokens = []


def _defined_name(tokens: list[str]) -> str:
    """Name that a definition defines: before its arguments, its lengths or its value, attributes apart."""
    words = " ".join(tokens)
    words = re.sub(r"__attribute__ \( \( (?:[^()]|\( [^()]* \))*\) \)", "", words)
    name = re.search(r"(\w+) (?:[(\[=]|;)", words)
    return name[1] if name else ""


def _tokens(text: str) -> list[str]:
    """Tokens without comments."""
    matches = C_TOKEN.finditer(text)
    return [m[0] for m in matches if m.lastgroup != "space" and not m[0].startswith(("//", "/*"))]


def _joined(tokens: list[str]) -> str:
    """Tokens as one text, with spaces between words alone."""
    words = [" " if re.match(r"\w{2}", before[-1] + after) else "" for before, after in pairwise([";", *tokens])]
    return "".join(space + token for space, token in zip(words, tokens, strict=True))


def _number(text: str) -> str:
    """One more of a whole number, twice any other."""
    digits = re.sub(r"(?<!0[xX])[uUlL]+$", "", text)
    if re.fullmatch(r"\d+", digits):
        return str(int(digits) + 1) + text[len(digits) :]
    if re.fullmatch(r"0[xX][\da-fA-F]+[uUlL]*", text):
        return f"({text} + 1)"
    mantissa = re.sub(r"0[xX]|[pP].*|[fF]$", "", text)
    return f"(2 * {text})" if re.search(r"[1-9a-fA-F]", mantissa) else f"({text} + 1)"


def _replacement(kind: str, old: str, closes: bool) -> str | None:
    """Replacement of a token; closes: the one before it ends an operand."""
    if kind == "number":
        return _number(old)
    if kind == "name":
        return NAMES.get(old)
    if old in OPERATORS and not closes:
        return "+" if old == "-" else None
    return OPERATORS.get(old)


def _changes(text: str) -> Iterator[tuple[int, str, str]]:
    skipped: list[range] = []
    for match in LINE.finditer(text):
        if NOT_TEXT.match(match[0]) or "__attribute__" in match[0] or "typedef" in match[0]:
            skipped.append(range(match.start(), match.end()))
        elif head := DEFINED.match(match[0]):
            skipped.append(range(match.start(), match.start() + head.end()))
    before = ""
    for match in C_TOKEN.finditer(text):
        kind, old = match.lastgroup or "", match[0]
        if kind in ("", "space"):
            continue
        inside = any(match.start() in one for one in skipped)
        closes = before in (")", "]") or (bool(re.match(r"[\w.]", before)) and not C_TYPE.match(before))
        closes = closes and before not in ("return", "case", "else")
        if before == ")" and old in ("*", "&", "-", "+") and _casts(text, match.start()):
            closes = False
        pointed = old == "*" and (C_TYPE.match(before) or before == ",")
        field = kind == "name" and before in (".", "->")
        new = None if inside or pointed or field else _replacement(kind, old, closes)
        if new is not None:
            yield match.start(), old, new
        before = "" if inside and match.end() in {one.stop for one in skipped} else old


def _casts(text: str, end: int) -> bool:
    """True if the parenthesis that ends before `end` names a type."""
    named = re.search(r"\((?:__global |__constant |const )*(\w+)\s*\**\)\s*$", text[max(0, end - 80) : end])
    return named is not None and C_TYPE.match(named[1]) is not None
