"""The line of what a picture takes has the figures of `clsco plan`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

import clsco
from clsco.cli.main import main
from clsco.engine.probe import measure_frame
from clsco.plan.prepare import prepare
from clsco.studio.ladder import plan_line

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(("name", "views"), [("sphere", 1), ("stereo", 2)])
def test_the_line_is_that_of_the_command(name: str, views: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsco.engine.probe.measure_frame", partial(measure_frame, seconds=0.0))  # the first steps
    path = EXAMPLES / f"{name}.toml"
    prepared = prepare(clsco.load_scene(path))
    passes, time, memory = plan_line(prepared, 0.0414).split(", ")
    assert passes == "3 passes"
    assert time == "41 ms"
    printed = CliRunner().invoke(main, ["plan", str(path)], env={"COLUMNS": "200"}).output
    (line,) = (line for line in printed.splitlines() if "memory on the device" in line)
    assert float(memory.removesuffix(" MiB")) == pytest.approx(views * float(line.split("MiB")[0].split()[-1]), abs=0.6)
