"""Fixtures of the tests of data sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from clsco.data.distribution import Distribution, load_distribution
from tests.data.distributions import SCENE, Load


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Writes a distribution of SCENE and some more text, and loads it."""

    def loaded(text: str, scene: str = SCENE, name: str = "set.toml", **options: Any) -> Distribution:
        (tmp_path / name).write_text(f"{scene}\n{text}", "utf-8")
        return load_distribution(tmp_path / name, **options)

    return loaded
