"""Small faults in source text, one at a time: another operator, another number, another function."""

from __future__ import annotations

import io
import keyword
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OPERATORS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "**": "*", "<<": ">>", ">>": "<<",
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "&": "|", "|": "&", "^": "|",
    "&&": "||", "||": "&&", "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=", "|=": "&=", "&=": "|=",
    "<<=": ">>=", ">>=": "<<=",
}  # fmt: skip
NAMES = {
    "min": "max", "max": "min", "MIN": "MAX", "MAX": "MIN", "fmin": "fmax", "fmax": "fmin", "floor": "ceil",
    "ceil": "floor", "sin": "cos", "cos": "sin", "atomic_min": "atomic_max", "atomic_max": "atomic_min",
    "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin", "sqrt": "abs", "any": "all",
    "all": "any", "and": "or", "or": "and",
}  # fmt: skip
C_TYPE = re.compile(r"(?:(?:u?char|u?short|u?int|u?long|float|double|real|bool|size_t|void)\d*|\w+_t|const|restrict)$")
C_TOKEN = re.compile(
    r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\n])*\"|'(?:\\.|[^'\n])*'"
    r"|(?P<number>0[xX][\da-fA-F.]+(?:[pP][+-]?\d+)?[uUlLfF]*|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[uUlLfF]*)"
    r"|(?P<name>[A-Za-z_]\w*)|(?P<operator><<=|>>=|->|\+\+|--|&&|\|\||<<|>>|[-+*/%&|^<>=!]=|[-+*/%&|^<>=!?:;,.~()\[\]{}#])"
    r"|(?P<space>\\\n|\s)",
    re.DOTALL,
)
# Of the preprocessor: which text there is at all. A `#define` is what stands in its place. What is asked for ahead
# (SOON) changes the time alone.
NOT_TEXT = re.compile(r"\s*(?:#\s*(?:if|ifdef|ifndef|elif|else|endif|include|pragma|undef)|SOON)\b")
DEFINED = re.compile(r"\s*#\s*define\s+\w+(?:\([^)]*\))?")


@dataclass(frozen=True)
class Mutant:
    """One change: from `old` to `new` at `start` of a file's text; the `number`-th place of its kind in its line."""

    file: str
    start: int
    row: int
    line: str
    old: str
    new: str
    number: int

    @property
    def name(self) -> str:
        """The same after the file has changed elsewhere."""
        again = f" ({self.number})" if self.number else ""
        return f"{self.file}: {self.line} # {self.old} -> {self.new}{again}"

    def of(self, text: str) -> str:
        """The text with the change."""
        return text[: self.start] + self.new + text[self.start + len(self.old) :]


def mutants(root: Path, file: str) -> list[Mutant]:
    """All changes of a file, each operator, number and function once."""
    text = (root / file).read_text("utf-8")
    lines, found = text.split("\n"), []
    seen: Counter[tuple[str, str]] = Counter()
    for start, old, new in _python(text) if file.endswith(".py") else _opencl(text):
        row = text.count("\n", 0, start)
        line = lines[row].strip()
        found.append(Mutant(file, start, row + 1, line, old, new, seen[line, old]))
        seen[line, old] += 1
    return found


def code_of(root: Path, file: str) -> str:
    """The tokens of a file, without comments and where lines end."""
    text = (root / file).read_text("utf-8")
    if file.endswith(".py"):
        left_out = (tokenize.COMMENT, tokenize.NL)
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        return " ".join(token.string for token in tokens if token.type not in left_out)
    matches = C_TOKEN.finditer(text)
    return " ".join(m[0] for m in matches if m.lastgroup != "space" and not m[0].startswith(("//", "/*")))


def _number(text: str) -> str:
    """One more of a whole number, twice any other."""
    digits = re.sub(r"(?<!0[xX])[uUlL]+$", "", text)
    if re.fullmatch(r"\d+", digits):
        return str(int(digits) + 1) + text[len(digits) :]
    if re.fullmatch(r"0[xX][\da-fA-F]+[uUlL]*", text):
        return f"({text} + 1)"
    mantissa = re.sub(r"0[xX]|[pP].*|[fF]$", "", text)
    return f"(2 * {text})" if re.search(r"[1-9a-fA-F]", mantissa) else f"({text} + 1)"


def _changed(kind: str, old: str, closes: bool) -> str | None:
    """What takes the place of a token; closes: the one before it ends an operand."""
    if kind == "number":
        return _number(old)
    if kind == "name":
        return NAMES.get(old)
    if old in OPERATORS and not closes:
        return "+" if old == "-" else None
    return OPERATORS.get(old)


def _opencl(text: str) -> Iterator[tuple[int, str, str]]:
    skipped: list[range] = []
    for match in re.finditer(r"^.*(?:\\\n.*)*$", text, re.MULTILINE):
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
        new = None if inside or pointed or field else _changed(kind, old, closes)
        if new is not None:
            yield match.start(), old, new
        before = "" if inside and match.end() in {one.stop for one in skipped} else old


def _casts(text: str, end: int) -> bool:
    """Whether the parenthesis that ends before `end` names a type."""
    named = re.search(r"\((?:__global |__constant |const )*(\w+)\s*\**\)\s*$", text[max(0, end - 80) : end])
    return named is not None and C_TYPE.match(named[1]) is not None


def _python(text: str) -> Iterator[tuple[int, str, str]]:
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        at, old = starts[token.start[0] - 1] + token.start[1], token.string
        if token.type not in (tokenize.NUMBER, tokenize.NAME, tokenize.OP):
            continue
        closes = before in (")", "]", "}") or (bool(re.match(r"[\w.]", before)) and not keyword.iskeyword(before))
        kind = {tokenize.NUMBER: "number", tokenize.NAME: "name"}.get(token.type, "operator")
        annotation = old == "|" and re.search(r"\bNone\b|:\s*\w+ \||->", token.line) is not None
        new = None if annotation else _changed(kind, old, closes)
        if new is not None:
            yield at, old, new
        before = old
