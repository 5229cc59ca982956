"""Kernels of the tests' own, built after the shared headers as every kernel file is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco import program as program_module
from clsco.device import Session
from clsco.layout import Real, structs
from clsco.program import HEADERS, build, kernel, launch, upload
from clsco.resources import folder

PLAIN = {"SEVERAL": 0, "QUADRATIC": 1, "LINEAR": 0, "NAPPE": 0, "BOUNDED": 0, "FILTER": 0, "CHANNELS": 1, "SAMPLED": 0}


@pytest.fixture
def run_source(session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """run_source(text, name, real, features, count, *args): runs kernel `name` of a text over `count` work-items.

    Arrays are uploaded, and stay until the device is done; buffers and scalars are passed on.
    """
    for header in HEADERS:
        (tmp_path / header).write_text((folder("kernels") / header).read_text("utf-8"), "utf-8")
    monkeypatch.setattr(program_module, "folder", lambda name: tmp_path)

    def run(text: str, name: str, real: Real, features: dict[str, int], count: int, *args: Any) -> None:
        (tmp_path / "tests.cl").write_text(text, "utf-8")
        program = build(session, ["tests.cl"], PLAIN | features, structs(real), real)
        held = [upload(session, a) if isinstance(a, np.ndarray) and a.ndim else a for a in args]
        launch(session, kernel(program, name), (count,), (64,), *held)
        session.queue.finish()

    return run
