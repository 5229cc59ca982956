"""Files of packaging/: they say what pyproject.toml says, and the image renders where images can be built."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

import clsco

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def test_the_recipe_says_what_the_package_says() -> None:
    recipe = (ROOT / "packaging/conda/meta.yaml").read_text("utf-8")
    assert f'version = "{clsco.__version__}"' in recipe
    assert PROJECT["description"] in recipe
    run = recipe.split("  run:\n")[1].split("\n\n")[0]
    wanted = {
        f"python {PROJECT['requires-python']}",
        # One package for all systems has what any of them needs.
        *(re.sub(r"(>=)", r" \1", one.split(";")[0]) for one in PROJECT["dependencies"]),
    }
    assert set(re.findall(r"- (.+)", run)) == wanted


def builder() -> str | None:
    """A program that builds images here; one without its service does not."""
    for name in ("podman", "docker"):
        if shutil.which(name) and subprocess.run([name, "info"], capture_output=True, timeout=60).returncode == 0:
            return name
    return None


@pytest.mark.slow
def test_the_image_renders(tmp_path: Path) -> None:
    name = builder()
    if name is None:
        pytest.skip("no builder of images here: packaging/Containerfile has not been built")
    build = [name, "build", "-q", "-t", "clsco-test", "-f", str(ROOT / "packaging/Containerfile"), str(ROOT)]
    subprocess.run(build, check=True)
    tmp_path.chmod(0o777)
    run = [name, "run", "--rm", "-v", f"{tmp_path}:/work", "clsco-test"]
    subprocess.run([*run, "examples", "sphere", "-o", "."], check=True)
    subprocess.run([*run, "render", "sphere.toml", "-o", "frames"], check=True)
    assert (tmp_path / "frames/frame_0000.png").stat().st_size > 10_000
