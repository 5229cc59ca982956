"""All mutants of the kernels in one text of each file: a number in memory says which of them is on when it runs.

So a program is compiled once for all of its mutants. It runs on the CPU only, in processes that have called `reserve`.
"""

from __future__ import annotations

import ctypes
import mmap
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.mutation.mutants import C_TOKEN, DEFINED, OPERATORS, Mutant

ADDRESS = 0x2000_0000_0000  # of the number, in all processes
ON = f"*(__constant int *){ADDRESS:#x}UL == "
LINE = re.compile(r"^.*(?:\\\n.*)*$", re.MULTILINE)
SPACE = re.compile(r"//[^\n]*|/\*.*?\*/|\\?\n", re.DOTALL)
# Where a macro has what is wrong, in its own line, but for what is pasted in it. What has not been declared was to be
# by another line that is reported of.
ERROR = re.compile(
    r"^error: (?P<file>\S+?):(?P<row>\d+):\d+(?: <Spelling=(?P<spelled>[^:]+):(?P<at>\d+):\d+>)?: "
    r"(?!use of undeclared)(?P<pasting>pasting)?",
    re.MULTILINE,
)
DEFINES, WORD = re.compile(r"\s*#\s*define\s+(\w+)"), re.compile(r"[A-Za-z_]\w*")
ASSIGNING = {operator for operator in OPERATORS if operator.endswith("=") and operator not in ("<=", ">=", "==", "!=")}
OPENS, CLOSES = {"(", "[", "{"}, {")", "]", "}"}
ENDS = {",", ";", "?", ":", "{", "}"}  # of an operator's operands, beside the brackets around them
HEADS = {"if", "while", "for", "switch"}


def reserve() -> None:
    """Have this process, and its forks, hold a number at ADDRESS: 0, no mutant. Raises OSError where it cannot."""
    map_ = ctypes.CDLL(None, use_errno=True).mmap
    map_.restype, map_.argtypes = (
        ctypes.c_void_p,
        [ctypes.c_void_p, ctypes.c_size_t, *3 * [ctypes.c_int], ctypes.c_long],
    )
    fixed = 0x100000  # MAP_FIXED_NOREPLACE
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | fixed
    if map_(ADDRESS, mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_WRITE, flags, -1, 0) != ADDRESS:
        raise OSError(ctypes.get_errno(), f"{ADDRESS:#x} must be free")


def turn_on(number: int) -> None:
    """Have kernels of this process run with that mutant from now on."""
    ctypes.c_int.from_address(ADDRESS).value = number


@dataclass
class Token:
    start: int
    text: str
    part: int  # of the text: a macro's body, or what is between two lines of the preprocessor
    ends: bool  # whether the part is whole: what is after its last token is not of the same expression

    @property
    def stop(self) -> int:
        return self.start + len(self.text)


@dataclass
class Place:
    """A piece of the text in which some mutants are."""

    start: int
    stop: int
    numbers: list[int] = field(default_factory=list)
    inside: list[Place] = field(default_factory=list)


class Switches:
    """The mutants of kernel files, each with its number, from 1; `texts`: file -> text with those that can be in it."""

    def __init__(self, root: Path, mutants: Iterable[Mutant]) -> None:
        self.mutants = list(mutants)
        self.numbers = {mutant: number for number, mutant in enumerate(self.mutants, 1)}
        self.left_out = set[int]()
        self.plain = {mutant.file: (root / mutant.file).read_text("utf-8") for mutant in self.mutants}
        self.texts = dict[str, str]()
        for file in self.plain:
            self._write(file)

    def has(self, mutant: Mutant) -> bool:
        """True if a mutant is in the text of its file."""
        return mutant in self.numbers and self.numbers[mutant] not in self.left_out

    def switched(self, program: str) -> str:
        """A program's text with its mutants."""
        for file, text in self.plain.items():
            program = program.replace(text, self.texts[file])
        return program

    def unswitched(self, program: str) -> str:
        """A program's text as it is without mutants."""
        for file, text in self.texts.items():
            program = program.replace(text, self.plain[file])
        return program

    def without(self, program: str, log: str) -> str | None:
        """A program's text without the mutants that a compiler's log tells of; None where it tells of none."""
        lines, uses = set[tuple[str, int]](), set[tuple[str, int]]()
        for error in ERROR.finditer(log):
            use = error["file"], int(error["row"])
            uses.add(use)
            lines.add((error["spelled"], int(error["at"])) if error["spelled"] and not error["pasting"] else use)
        # Where they have none it is in one of the macros that stand there, or stand in these.
        fresh = self._at(lines) or self._at(uses)
        rows = {Path(file).name: text.split("\n") for file, text in self.plain.items()}
        used = [rows[file][row - 1] for file, row in uses if file in rows]  # not in a file without a mutant
        names, known = {name for row in used for name in WORD.findall(row)}, set[str]()
        while not fresh and names > known:
            known = names
            defining = [row for text in rows.values() for row in text if (m := DEFINES.match(row)) and m[1] in names]
            fresh = {k for k in self._all() if (m := DEFINES.match(self.mutants[k - 1].line)) and m[1] in names}
            names = names.union(*map(WORD.findall, defining))
        before = dict(self.texts)
        self.leave_out(fresh)
        for file, text in before.items():
            program = program.replace(text, self.texts[file])
        return program if fresh else None

    def _all(self) -> set[int]:
        return set(self.numbers.values()) - self.left_out

    def _at(self, lines: set[tuple[str, int]]) -> set[int]:
        return {k for k in self._all() if (Path(self.mutants[k - 1].file).name, self.mutants[k - 1].row) in lines}

    def write(self, tree: Path) -> None:
        """Have the kernels of a tree be these."""
        for file, text in self.texts.items():
            (tree / file).write_text(text, "utf-8")

    def leave_out(self, numbers: Iterable[int]) -> None:
        fresh = set(numbers) - self.left_out
        self.left_out |= fresh
        for file in {self.mutants[number - 1].file for number in fresh}:
            self._write(file)

    def _write(self, file: str) -> None:
        text, top, places = self.plain[file], Place(0, len(self.plain[file])), dict[tuple[int, int], Place]()
        tokens = list(_tokens(text))
        index = {token.start: k for k, token in enumerate(tokens)}
        for number, mutant in enumerate(self.mutants, 1):
            if mutant.file != file or number in self.left_out:
                continue
            piece = _piece(tokens, index[mutant.start]) if mutant.start in index else None
            if piece is None:
                self.left_out.add(number)
            else:
                places.setdefault(piece, Place(*piece)).numbers.append(number)
        stack = [top]
        for place in sorted(places.values(), key=lambda place: (place.start, -place.stop)):
            while place.start >= stack[-1].stop:
                stack.pop()
            stack[-1].inside.append(place)
            stack.append(place)
        self.texts[file] = self._made(text, top)

    def _made(self, text: str, place: Place) -> str:
        made, at = "", place.start
        for inner in place.inside:
            made += text[at : inner.start] + self._made(text, inner)
            at = inner.stop
        made += text[at : place.stop]
        if not place.numbers:
            return made
        chosen = ""
        for number in place.numbers:
            mutant = self.mutants[number - 1]
            changed = mutant.of(text)[place.start : place.stop + len(mutant.new) - len(mutant.old)]
            chosen += f"{ON}{number} ? ({SPACE.sub(' ', changed)}) : "
        return f"({chosen}({made}))"


def _tokens(text: str) -> Iterator[Token]:
    part = 0
    for line in LINE.finditer(text):
        directive, body = line[0].lstrip().startswith("#"), DEFINED.match(line[0])
        part += directive
        if not directive or body:
            begin = line.start() + (body.end() if body else 0)
            for match in C_TOKEN.finditer(text, begin, line.end()):
                if match.lastgroup not in (None, "space"):
                    yield Token(match.start(), match[0], part, body is not None)
        part += directive


def _piece(tokens: list[Token], k: int) -> tuple[int, int] | None:
    """Piece that has to stand twice where token k changes: a number, a call, or an operator with all beside its
    operands."""
    token = tokens[k]
    if token.text[0].isalpha():
        last = _matching(tokens, k + 1, 1) if k + 1 < len(tokens) and tokens[k + 1].text == "(" else None
        return None if last is None else (token.start, tokens[last].stop)
    if token.text not in OPERATORS:
        lone = tokens[k - 1].text in ("(", ",") and k + 1 < len(tokens) and tokens[k + 1].text in (")", ",")
        return None if token.ends and lone else (token.start, token.stop)  # a macro may paste it
    assigns = token.text in ASSIGNING
    before = ENDS if assigns else ENDS | ASSIGNING | {"="}
    first, last = _end(tokens, k, -1, before), _end(tokens, k, 1, ENDS - {"?", ":"} if assigns else before)
    return None if first is None or last is None else (tokens[first].start, tokens[last].stop)


def _end(tokens: list[Token], k: int, step: int, ends: set[str]) -> int | None:
    """The outermost token on one side of an operator that is of its operands or theirs; None: not distinguishable."""
    part, whole = tokens[k].part, tokens[k].ends
    inwards, outwards = (OPENS, CLOSES) if step > 0 else (CLOSES, OPENS)
    while True:
        following = k + step
        if not 0 <= following < len(tokens) or tokens[following].part != part:
            return k if whole else None
        text = tokens[following].text
        if text in outwards or text in ends or text in ("return", "else", "do"):
            return k
        if text in inwards:
            match = _matching(tokens, following, step)
            if match is None:
                return None
            if step < 0 and match > 0 and tokens[match - 1].text in HEADS:
                return k
            following = match
        elif text == "case":
            return None
        k = following


def _matching(tokens: list[Token], k: int, step: int) -> int | None:
    """The bracket that belongs to bracket k, forwards or backwards."""
    part, depth = tokens[k].part, 0
    while 0 <= k < len(tokens) and tokens[k].part == part:
        depth += {**dict.fromkeys(OPENS, step), **dict.fromkeys(CLOSES, -step)}.get(tokens[k].text, 0)
        if depth == 0:
            return k
        k += step
    return None
