"""Options that commands share, and messages of the library."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
from click.shell_completion import BashComplete

from clsco.cli.main import main
from clsco.scene import sweep
from tests.command import clsco_
from tests.scenes import PLANE, scene_file


def test_messages_of_the_library_are_shown_on_demand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_file(tmp_path / "scene.toml", PLANE)
    logger, load = logging.getLogger("clsco"), sweep.load_sweeps
    for name, value in (("handlers", []), ("propagate", True), ("level", logging.WARNING)):
        monkeypatch.setattr(logger, name, value)

    def logged(*arguments: Any) -> Any:
        logger.info("read")
        logger.debug("all of it\x1b")
        return load(*arguments)

    monkeypatch.setattr(sweep, "load_sweeps", logged)
    for words, log in ((), ""), (("-v",), "clsco: read\n"), (("-vv",), "clsco: read\nclsco: all of it\\x1b\n"):
        result = clsco_(*words, "validate", scene)
        assert (result.exit_code, result.stderr) == (0, log)


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("render --truth depth,no", ["depth,normal", "depth,noise_sigma"]), ("inpaint --method t", ["texture"]),
        ("render --types depth=", ["depth=float32", "depth=float16"]), ("video --preset ff", ["ffv1", "ffv1-16"]),
        ("render --format npz,kitti_f", ["npz,kitti_flow"]), ("dataset make --format za", ["zarr", "zarr+raw"]),
        ("defocus --unit inv", ["inverse_mm", "inverse_m"]), ("render --set camera.f_", ["camera.f_number="]),
        ("plan --set object.0.rad", ["object.0.radius="]),
        ("examples sphere_", ["sphere_moving", "sphere_turning"]),
    ],
)  # fmt: skip
def test_a_shell_completes_names(words: str, names: list[str]) -> None:
    *before, last = words.split()
    shell = BashComplete(main, {}, "clsco", "_CLSCO_COMPLETE")
    completed = [item.value for item in shell.get_completions(before, last)]
    assert [value for value in completed if not value.startswith("-")] == names
