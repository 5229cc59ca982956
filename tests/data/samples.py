"""Small records with everything that a container has to hold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from clsco.data.record import Drawn, Record, make_record
from clsco.frame.frame import FILE_NAMES, Frame
from clsco.scene.file import parse_scene


def frame(number: int, size: tuple[int, int] = (9, 12), color: bool = True, index: int = 0, eye: str = "") -> Frame:
    """A frame of random values, infinite depths among them."""
    rng = np.random.default_rng([number, index, len(eye)])
    image = (*size, 3) if color else size
    depth = rng.uniform(200, 300, size).astype(np.float32)
    depth[:2] = np.inf
    return Frame(
        index=index,
        color=rng.random(image, np.float32),
        sharp=rng.random(image, np.float32),
        depth=depth,
        blur_radius=rng.normal(size=size).astype(np.float32),
        mask=np.isfinite(depth),
        filled=rng.integers(0, 3, size, np.uint8),
        object_id=rng.integers(-1, 5, size, np.int32),
        normal=rng.normal(size=(*size, 3)).astype(np.float32),
        flow=rng.normal(size=(*size, 2)).astype(np.float32),
        eye=eye,
        metadata={"frame": index, "bits": 16, "samples": 1, "seconds": {"blur": 0.1}, "device": "some"},
    )


def drawn(number: int, variants: int = 1, split: str = "train") -> Drawn:
    """A sample as a distribution gives it."""
    scene = parse_scene({"object": [{"shape": "sphere", "center": [0, 0, 280], "radius": 30}]})
    found: Any = SimpleNamespace(
        number=number,
        split=split,
        attempts=1,
        parameters={"camera.f_number": 1.5 + number, "object.0.shape": "sphere"},
        table={"object": [{"shape": "sphere", "center": [0, 0, 280], "radius": 30, "n": [number] * (number % 3)}]},
        labels=tuple(f"f_number_{n}" for n in range(variants)) if variants > 1 else ("",),
        scenes=(scene,) * variants,
    )
    return found


def record(number: int, size: tuple[int, int] = (9, 12), wanted: tuple[str, ...] = (), **options: Any) -> Record:
    """The record of a sample with one frame; all of its arrays by default."""
    names = wanted or tuple(FILE_NAMES.values())
    return make_record(drawn(number), 7, [[frame(number, size, **options)]], names)


def same(one: Record, other: Record) -> bool:
    """Whether two records are one: keys, types, shapes, bits, JSON."""
    arrays = one.arrays.keys() == other.arrays.keys() and one.sha256() == other.sha256()
    return arrays and one.key == other.key and one.meta == other.meta
