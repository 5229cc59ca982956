"""What is known of mutants: which were noticed, and why others survive."""

from __future__ import annotations

import json
import tomllib
from hashlib import sha256
from pathlib import Path

from tests.mutation.mutants import ROOT, Mutant, code_of
from tests.mutation.tests import files

REASONS = Path(__file__).with_name("survivors.toml")
NOTICED = Path(__file__).with_name("noticed.json")


def reasons() -> dict[str, str]:
    """Mutant -> why it is no gap of the tests that it survives."""
    entries = tomllib.loads(REASONS.read_text("utf-8"))["survivor"]
    return {name: entry["reason"] for entry in entries for name in entry["mutants"]}


def short(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:12]


class Memory:
    """Which mutants were noticed: of each file a hash of its code, and hashes of their names."""

    def __init__(self, path: Path) -> None:
        self.path = path
        found = json.loads(path.read_text("utf-8")) if path.exists() else {}
        self.code = {name: short(code_of(ROOT, name)) for name in files()}
        self.noticed = {
            name: set(found[name]["noticed"]) if found.get(name, {}).get("code") == code else set[str]()
            for name, code in self.code.items()
        }

    def has(self, mutant: Mutant) -> bool:
        return short(mutant.name) in self.noticed[mutant.file]

    def keep(self, mutant: Mutant) -> None:
        self.noticed[mutant.file].add(short(mutant.name))

    def write(self) -> None:
        kept = {
            name: {"code": self.code[name], "noticed": sorted(hashes)}
            for name, hashes in self.noticed.items()
            if hashes
        }
        partial = self.path.with_suffix(".part")
        partial.write_text(json.dumps(kept, indent=0) + "\n", "utf-8")
        partial.replace(self.path)
