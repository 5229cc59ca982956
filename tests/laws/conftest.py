"""Textures of the laws' own, and the profiles of `make laws`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

for name in ("laws", "some_laws"):
    settings.register_profile(name)  # scenes.py asks for it


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
