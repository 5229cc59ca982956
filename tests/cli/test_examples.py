"""`clsco examples`: all that is listed can be copied, and is valid where it lies then."""

from __future__ import annotations

from pathlib import Path

from click.testing import Result

from clsco.data.distribution import load_distribution
from clsco.scene.sweep import load_sweeps
from tests.command import clsco_, done

ROOT = Path(__file__).resolve().parents[2] / "examples"


def examples(*words: object) -> Result:
    return clsco_("examples", *words)


def test_all_are_listed_and_copied(tmp_path: Path) -> None:
    listed = examples().stdout
    scenes = sorted(path.stem for path in ROOT.glob("*.toml"))
    sets = sorted(path.stem for path in (ROOT / "sets").glob("*.toml"))
    assert all(f"{name} " in listed for name in [*scenes, *(f"sets/{name}" for name in sets)])
    assert "thesis/" not in listed
    done("examples", *scenes, "thesis/fig_4_10", "-o", tmp_path / "scenes")
    for _, sweep in load_sweeps(sorted((tmp_path / "scenes").glob("*.toml")), ()):
        assert not isinstance(sweep, Exception), sweep
    assert (tmp_path / "scenes" / "depth_map_depth.png").read_bytes() == (ROOT / "depth_map_depth.png").read_bytes()
    assert examples("damaged", "-o", tmp_path).exit_code == 0
    assert (tmp_path / "damaged_mask.png").read_bytes() == (ROOT / "damaged_mask.png").read_bytes()
    assert examples(*(f"sets/{name}" for name in sets), "-o", tmp_path / "sets").exit_code == 0
    for name in sets:
        load_distribution(tmp_path / "sets" / f"{name}.toml")


def test_what_cannot_be(tmp_path: Path) -> None:
    assert examples("sphere", "-o", tmp_path).stdout == f"{tmp_path}/sphere.toml: Sphere\n"
    assert examples("sphere", "-o", tmp_path).exit_code == 0
    (tmp_path / "sphere.toml").write_text("other")
    result = examples("sphere", "-o", tmp_path)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == f"error: {tmp_path}/sphere.toml: must not be there, or be the same file; got another one\n"
    assert (tmp_path / "sphere.toml").read_text() == "other"
    result = examples("spere", "-o", tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: examples: must be some of background, bowl")
    assert result.stderr.endswith('got "spere" (did you mean sphere?)\n')
    assert examples("-o", tmp_path).exit_code == 2
