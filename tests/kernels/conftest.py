"""Kernels of the tests' own, built after the shared headers as every kernel file is; records of sources."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.opencl import program as program_module
from clsco.opencl import source_text
from clsco.opencl.buffers import download, upload
from clsco.opencl.program import build, launch
from clsco.opencl.session import Session
from clsco.records import Real, structs
from clsco.resources import folder
from tests.edges import edges as edges

Array = NDArray[Any]


def source_planes(records: Array, tilt: bool, marked: bool) -> Array:
    """Records (rows, columns, 4) as kernels/common/sources.clh has them."""
    return np.ascontiguousarray(np.moveaxis(records[..., [True, tilt, tilt, marked]], -1, 0))


def download_sources(session: Session, source: cl.Buffer, shape: tuple[int, ...], tilt: bool, marked: bool) -> Array:
    """The reverse: records (rows, columns, 4), slopes 0 and marks -1 where there are none."""
    wanted = [True, tilt, tilt, marked]
    records = np.zeros((*shape, 4), np.float32)
    records[..., 3].view(np.int32)[...] = -1
    records[..., wanted] = np.moveaxis(download(session, source, (sum(wanted), *shape), np.float32), 0, -1)
    return records


PLAIN = {"QUADRATIC": 1, "CHANNELS": 1}


@pytest.fixture
def run_source(session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """run_source(text, name, real, features, count, *args): runs kernel `name` of a text over `count` work-items.

    Arrays are uploaded, and stay until the device is done; buffers and scalars are passed on.
    """
    copytree(str(folder("kernels")), tmp_path, dirs_exist_ok=True)
    begin = '#include "common/visibility_test.clh"\n#include "common/sources.clh"\n#include "trace/texture.clh"\n'
    monkeypatch.setattr(program_module, "folder", lambda name: tmp_path)
    monkeypatch.setattr(source_text, "folder", lambda name: tmp_path)

    def run(text: str, name: str, real: Real, features: dict[str, int], count: int, *args: Any) -> None:
        (tmp_path / "tests.cl").write_text(begin + text, "utf-8")
        target = build(session, "tests.cl", PLAIN | features, structs(real), real)
        held = [upload(session, a) if isinstance(a, np.ndarray) and a.ndim else a for a in args]
        launch(session, target[name], (count,), (64,), *held)
        session.queue.finish()

    return run
