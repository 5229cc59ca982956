"""Size of the project beside its budget: python -m benchmarks.size [--wheel] [--tests]

Lines are those that are not blank; `--tests` runs `make test`, for its seconds and the kernel programs that it uses.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path
from time import perf_counter, time

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
BUDGET = {
    "lines of clsco/*.py": 44_150,
    "lines of kernels": 9_375,
    "lines of tests": 43_205,
    "words of documentation": 25_000,
    "wheel, kB": 2_230,
    "kernel files that the tests compile": 430,
    "seconds of make test": 360,
}
"""Upper limits: lower one whenever its figure has fallen, and raise one only with a reason in the commit."""


def measure_text(root: Path = ROOT) -> dict[str, int]:
    """Lines and words of what the repository holds, by the names of BUDGET."""
    return {
        "lines of clsco/*.py": sum(map(_lines, (root / "clsco").rglob("*.py"))),
        "lines of kernels": sum(
            _lines(path) for kind in ("cl", "clh") for path in (root / "kernels").rglob(f"*.{kind}")
        ),
        "lines of tests": sum(map(_lines, (root / "tests").rglob("*.py"))),
        "words of documentation": sum(len(path.read_text("utf-8").split()) for path in _pages(root)),
    }


def measure_wheel(root: Path = ROOT) -> dict[str, int]:
    """Size of the wheel in kB."""
    with tempfile.TemporaryDirectory() as folder:
        build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, str(root)]
        subprocess.run(build, check=True)
        (wheel,) = Path(folder).glob("*.whl")
        return {"wheel, kB": round(wheel.stat().st_size / 1000)}


def measure_tests(root: Path = ROOT) -> dict[str, int]:
    """Seconds of the tests, and number of kernel files that they compile. Raises CalledProcessError if one fails."""
    start, begun = perf_counter(), time()
    subprocess.run(["make", "test"], cwd=root, check=True)
    seconds = round(perf_counter() - start)
    uses = (root / ".pytest_cache" / "kernels").glob("??/*/last_accessed")
    programs = sum(path.stat().st_mtime >= begun for path in uses)
    return {"kernel files that the tests compile": programs, "seconds of make test": seconds}


def _lines(path: Path) -> int:
    return sum(bool(line.strip()) for line in path.read_text("utf-8").splitlines())


def _pages(root: Path) -> list[Path]:
    return [root / "README.md", *(root / "docs").glob("*.md")]


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--wheel", action="store_true", help="build the wheel")
    parser.add_argument("--tests", action="store_true", help="run make test")
    options = parser.parse_args()
    sizes = measure_text()
    sizes |= measure_wheel() if options.wheel else {}
    sizes |= measure_tests() if options.tests else {}
    table = Table("", "is", "budget")
    for name, size in sizes.items():
        table.add_row(name, f"{size:,}", f"{BUDGET[name]:,}")
    Console().print(table)


if __name__ == "__main__":
    main()
