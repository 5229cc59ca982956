"""PoCL's cache under attack: a hundred corruptions, and sixteen processes that begin at once, twenty times."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from tests.opencl.test_pocl_cache import Start, ended, start, warm

__all__ = ["start", "warm"]
GOOD = (0, "256\n512\n")
pytestmark = pytest.mark.soak


def corrupt(cache: Path, rng: random.Random) -> str:
    """Damage a file of the cache, one that PoCL loads or one of the list and the lock; tells what."""
    files = sorted(path for path in (cache / "clsco").rglob("*") if path.is_file())
    path = rng.choice(files)
    content = path.read_bytes()
    kind = rng.choice(("flip", "cut", "zeros", "noise", "empty", "remove", "swap", "folder", "longer"))
    if kind in ("remove", "folder"):
        path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "swap":
        path.write_bytes(rng.choice(files).read_bytes())
    elif kind != "remove":
        start_at = rng.randrange(len(content) + 1)
        flipped = bytes([content[start_at] ^ 1 << rng.randrange(8)]) if start_at < len(content) else b""
        path.write_bytes({
            "flip": content[:start_at] + flipped + content[start_at + 1 :], "cut": content[:start_at], "empty": b"",
            "zeros": bytes(len(content)), "noise": rng.randbytes(len(content)), "longer": content + rng.randbytes(100),
        }[kind])  # fmt: skip
    return f"{kind} {path.relative_to(cache)}"


@pytest.mark.parametrize("seed", range(10))
def test_corruptions(start: Start, warm: Path, tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    for number in range(10):
        cache = tmp_path / str(number)
        shutil.copytree(warm, cache)
        what = [corrupt(cache, rng) for _ in range(rng.choice((1, 1, 3)))]
        assert ended(start(cache)) == GOOD, what
        assert ended(start(cache)) == GOOD, what


@pytest.mark.parametrize("round_", range(20))
def test_cold_starts_at_once(start: Start, tmp_path: Path, round_: int) -> None:
    processes = [start(tmp_path) for _ in range(16)]
    assert [ended(process) for process in processes] == [GOOD] * 16
