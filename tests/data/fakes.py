"""Distributions and sets for tests of the engine: small, and bad where a test wants it; other processes import it."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clsco import __version__
from clsco.data.distribution import Sample
from clsco.data.manifest import Identity
from clsco.data.shards import SetJob, ShardMaker, device_family
from clsco.data.storage import open_storage
from clsco.errors import SceneError
from clsco.opencl.device import choose
from clsco.scene.sweep import parse_sweep

ARRAYS = ("color", "depth", "flow")


class Deadly(Sample):
    """A sample that ends the process which renders it."""

    def __getattribute__(self, name: str) -> Any:
        if name == "scenes":
            os._exit(9)
        return super().__getattribute__(name)


@dataclass(frozen=True)
class Fake:
    """A ball whose place and speed follow from seed and number."""

    digest: str = "fake"
    splits: tuple[tuple[str, float], ...] = ()
    where: str = "fake.toml"
    folder: Path = Path("/fake")
    deadly: frozenset[int] = field(default_factory=frozenset)
    undrawable: frozenset[int] = field(default_factory=frozenset)
    unrenderable: frozenset[int] = field(default_factory=frozenset)

    def draw(self, seed: int, number: int) -> Sample:
        """A sample, or SceneError."""
        if number in self.undrawable:
            raise SceneError(f"{self.where}: must be accepted; got sample {number}")
        table = {
            "camera": {"resolution": [24, 16], "pixel_pitch": 0.2, "focus_distance": 200.0 + number},
            "object": [{
                "shape": "sphere", "center": [float(seed % 7), 0.5 * number, 280.0], "radius": 30.0,
                "texture": f"/no/{number}.png" if number in self.unrenderable else "#808080",
                "motion": {"velocity": [1.0 + number, 2.0, 5.0]},
            }],
            "sequence": {"samples": 1, "shutter": 0.1},
        }  # fmt: skip
        sweep = parse_sweep(table)
        split = ("train", "test")[number % 3 == 0] if self.splits else ""
        kind = Deadly if number in self.deadly else Sample
        parameters = {"camera.focus_distance": 200.0 + number}
        return kind(number, split, 1, parameters, table, sweep.labels, sweep.scenes)


def job_of(where: Path | str, count: int, *, size: int = 4, seed: int = 1, **options: Any) -> SetJob:
    """A job for a fake distribution on the default device."""
    fake, device = Fake(**options), choose()
    identity = Identity(
        fake.digest, seed, 0, size, "webdataset", ARRAYS, "double", fake.splits, __version__, device_family(device)
    )
    return SetJob(fake, identity, range(count), str(where))  # type: ignore[arg-type]


def make_here(job: SetJob) -> None:
    """Make all shards of a job in this process."""
    storage = open_storage(job.where)
    maker = ShardMaker(job, storage, choose(), False)
    for shard in range(-(-job.samples.stop // job.identity.shard_size)):
        maker.deliver(maker.make(shard), {})
    storage.close()
