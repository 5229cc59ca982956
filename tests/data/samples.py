"""Small records with everything that a container has to hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.containers import CONTAINERS
from clsco.data.distribution import Sample
from clsco.data.manifest import Identity, part_bytes, part_key
from clsco.data.record import Record, make_record
from clsco.data.sets import DataSet, finish
from clsco.data.storage import open_storage
from clsco.files.atomic import file_digests
from clsco.frame.frame import Frame
from clsco.frame.outputs import FILE_NAMES
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


def drawn(number: int, variants: int = 1, split: str = "train") -> Sample:
    """A sample as a distribution gives it."""
    ball = {"shape": "sphere", "center": [0, 0, 280], "radius": 30}
    parameters = {"camera.f_number": 1.5 + number, "object.0.shape": "sphere"}
    table = {"object": [{**ball, "n": [number] * (number % 3)}]}
    labels = tuple(f"f_number_{n}" for n in range(variants)) if variants > 1 else ("",)
    return Sample(number, split, 1, parameters, table, labels, (parse_scene({"object": [ball]}),) * variants)


def record(number: int, size: tuple[int, int] = (9, 12), wanted: tuple[str, ...] = (), **options: Any) -> Record:
    """The record of a sample with one frame; all of its arrays by default."""
    names = wanted or tuple(FILE_NAMES.values())
    return make_record(drawn(number), 7, [[frame(number, size, **options)]], names)


def same(one: Record, other: Record) -> bool:
    """True if two records are equal: keys, types, shapes, bits, JSON."""
    arrays = one.arrays.keys() == other.arrays.keys() and one.sha256() == other.sha256()
    return arrays and one.key == other.key and one.meta == other.meta


def make_set(
    folder: Path, form: str = "webdataset", count: int = 10, size: int = 4, splits: bool = True, variants: int = 1
) -> Path:
    """A whole set of small records, as `clsco dataset make` makes it but for the rendering. Sample 5 failed."""
    storage, container = open_storage(folder), CONTAINERS[form]
    shares = (("train", 0.7), ("val", 0.3)) if splits else ()
    identity = Identity(
        distribution="d" * 64, seed=7, first=0, shard_size=size, format=form, arrays=tuple(FILE_NAMES.values()),
        precision="double", splits=shares, version="0.1.0", device_family="cpu, some", types=(("color", "uint16"),),
    )  # fmt: skip
    made = DataSet(storage, identity, range(count))
    made.write({"license": "CC-BY-4.0", "recipe": 'base = "sphere.toml"\n'})
    for shard in made.shards:
        files: dict[str, list[Record]] = {}
        rows = []
        for number in made.numbers(shard):
            split = ("val" if number % 3 == 2 else "train") if splits else ""
            key = f"{split or 'data'}/{shard:06d}{container.suffix}"
            if number != 5:
                frames = [[frame(number)]] * variants
                files.setdefault(key, []).append(make_record(drawn(number, variants), 7, frames, identity.arrays))
                row = {"number": number, "split": split, "file": key, "offset": len(files[key]) - 1}
                rows.append({**row, "parameters": {}, "arrays": files[key][-1].sha256()})
        described: dict[str, tuple[int, str]] = {}
        for key, records in sorted(files.items()):
            path = storage.scratch() / key.replace("/", "_")
            container.write(path, records)
            described |= file_digests(key, path)
            storage.put(key, path)
        failures = [{"number": 5, "split": "val", "error": "e", "scene": {}}] if 5 in made.numbers(shard) else []
        storage.write(
            part_key(shard), part_bytes(shard, identity.digest, made.numbers(shard), described, rows, failures)
        )
    finish(made)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of all files in a folder, by their paths."""
    found = {each.relative_to(folder).as_posix(): each for each in folder.rglob("*") if each.is_file()}
    return {name: found[name].read_bytes() for name in sorted(found)}
