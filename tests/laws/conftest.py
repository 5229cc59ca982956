"""One session for all laws, textures of their own, and the profile of `make laws`."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from clsco.device import Session, choose

settings.register_profile("laws")  # scenes.py asks for it


@pytest.fixture(scope="module", autouse=True)
def one_session() -> Iterator[None]:
    """`clsco.render` opens a session for each call, in which programs are built anew: a hundred frames' time."""
    with pytest.MonkeyPatch.context() as patched, Session(choose("pocl"), profiling=True) as opened:
        patched.setattr(importlib.import_module("clsco.render"), "Session", lambda *given, **how: nullcontext(opened))
        yield


@pytest.fixture(scope="session")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with random light as textures: as it is, mirrored, and in other units."""
    from tests.laws.scenes import COLUMNS, LIGHT, ROWS  # not before the profile is chosen

    folder = tmp_path_factory.mktemp("light")
    drawn = np.random.default_rng(8).random((ROWS, COLUMNS)).astype(np.float32)
    np.save(folder / "plain.npy", drawn)
    np.save(folder / "mirrored.npy", drawn[:, ::-1])
    for exponent in LIGHT:
        np.save(folder / f"times_{exponent}.npy", drawn * np.float32(2.0**exponent))
    return folder
