"""Distribution files that tests write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from clsco.data.distribution import Distribution
from clsco.errors import SceneError

SCENE = '[camera]\nresolution = [64, 48]\n[[object]]\nshape = "plane"\nname = "wall"\ndistance = 400.0\n'
Load = Callable[..., Distribution]
"""Writes a distribution of SCENE and some more text, and loads it."""


def messages(load: Load, text: str, scene: str = SCENE, **options: Any) -> list[str]:
    """Messages without the name of the file."""
    with pytest.raises(SceneError) as caught:
        load(text, scene, **options)
    assert all("set.toml: " in message for message in caught.value.messages), caught.value.messages
    return [message.partition("set.toml: ")[2] for message in caught.value.messages]
