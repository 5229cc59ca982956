"""Records of mutants: which were killed, and why others survive."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path

from tests.mutation.mutants import ROOT, Mutant

REASONS = Path(__file__).with_name("survivors.toml")
KILLED = ROOT / ".mutation" / "killed.json"
"""A cache outside of git, which `make clean` removes."""


def reasons() -> dict[str, dict[str, str]]:
    """Function -> mutant of it -> why it is no gap of the tests that it survives."""
    return tomllib.loads(REASONS.read_text("utf-8"))


def reason(mutant: Mutant, known: dict[str, dict[str, str]]) -> str | None:
    return known.get(mutant.owner.name, {}).get(mutant.change)


def unmatched(found: Iterable[Mutant], known: dict[str, dict[str, str]]) -> list[str]:
    """Reasons of which there is no mutant any more, by their names."""
    names = {mutant.name for mutant in found}
    every = [f"{owner}: {change}" for owner, changes in known.items() for change in changes]
    return [name for name in every if name not in names]


class Killed:
    """Killed mutants: hashes of the code of their function and of what they change there.

    So one that has changed is tried again, alone. What it calls, and tests, may have changed nevertheless: without the
    file all are tried again.
    """

    def __init__(self, path: Path = KILLED) -> None:
        self.path = path
        self.hashes: set[str] = set(json.loads(path.read_text("utf-8"))) if path.exists() else set()

    def has(self, mutant: Mutant) -> bool:
        return _hash(mutant) in self.hashes

    def keep(self, mutant: Mutant) -> None:
        self.hashes.add(_hash(mutant))

    def write(self) -> None:
        self.path.parent.mkdir(exist_ok=True)
        partial = self.path.with_suffix(".part")
        partial.write_text(json.dumps(sorted(self.hashes), indent=0) + "\n", "utf-8")
        partial.replace(self.path)


def _hash(mutant: Mutant) -> str:
    return sha256(f"{mutant.owner.code} {mutant.name}".encode()).hexdigest()[:16]
