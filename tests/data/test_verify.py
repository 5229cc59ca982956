"""Findings of `clsco dataset verify`."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clsco
from clsco.data.distribution import Sample
from clsco.data.manifest import part_key
from clsco.data.sets import DataSet, finish
from clsco.data.shards import SampleRenderer
from clsco.data.storage import open_storage
from clsco.data.verify import chosen_samples, scene_table, verify_files, verify_samples
from clsco.errors import SceneError
from clsco.frame.frame import Frame
from tests.data.fakes import job_of, make_here


@pytest.fixture
def there(tmp_path: Path) -> DataSet:
    job = job_of(tmp_path / "set", 8, undrawable=frozenset({3}), unrenderable=frozenset({6}))
    make_here(job)
    found = DataSet(open_storage(job.where), job.identity, job.samples)
    found.write({})
    finish(found)
    return found


def findings(there: DataSet) -> list[str]:
    return verify_files(there, lambda: None)


def test_a_set_is_as_it_was_made(there: DataSet) -> None:
    assert findings(there) == []
    assert verify_samples(there, range(8), None, lambda: None, Path()) == []
    assert chosen_samples(there, 3) == [0, 2, 5]
    assert chosen_samples(there, 100) == list(range(8))


def test_a_flipped_bit_a_missing_shard_and_one_of_another_seed_are_found(there: DataSet, tmp_path: Path) -> None:
    folder = Path(there.storage.where)
    other = job_of(tmp_path / "other", 8, seed=2, undrawable=frozenset({3}), unrenderable=frozenset({6}))
    make_here(other)
    whole = tmp_path / "whole"
    shutil.copytree(folder, whole)

    def restored() -> None:
        shutil.rmtree(folder)
        shutil.copytree(whole, folder)

    for name in ("data/000000.tar", "manifest/000001.jsonl", "manifest.jsonl", "failed.jsonl"):
        for place in (0.1, 0.6, 0.95):
            data = bytearray((folder / name).read_bytes())
            data[int(place * len(data))] ^= 4
            (folder / name).write_bytes(data)
            found = findings(there)
            assert len(found) == 1
            assert name in found[0]
            restored()
    (folder / "data/000001.tar").unlink()
    assert findings(there) == ["data/000001.tar: must be there, as manifest/000001.jsonl names it; got no such file"]
    (folder / "manifest/000001.jsonl").unlink()
    assert findings(there) == ["manifest/000001.jsonl: shard 1 must be there; got none"]
    restored()
    for name in ("data/000001.tar", "manifest/000001.jsonl"):
        shutil.copy(tmp_path / "other" / name, folder / name)
    assert findings(there) == ["manifest/000001.jsonl: must be of shard 1 of this set; got another one's"]
    restored()
    shutil.copy(tmp_path / "other" / "data/000001.tar", folder / "data/000009.tar")
    assert findings(there) == ["data/000009.tar: must be a file of a shard of the set; got one that no part names"]


def test_arrays_and_seeds_that_a_forged_manifest_agrees_with_are_found(there: DataSet, tmp_path: Path) -> None:
    other = job_of(there.storage.where, 8, seed=2, undrawable=frozenset({3}), unrenderable=frozenset({6}))
    make_here(other)  # of another seed, under the same keys
    for key, data in list(there.parts()):  # as if it were of this set
        there.storage.write(key, data.replace(other.identity.digest.encode(), there.identity.digest.encode()))
    assert any("must be of seed 1; got sample 0 of seed 2" in finding for finding in findings(there))


def test_a_sample_that_is_rendered_otherwise_is_found(there: DataSet, monkeypatch: pytest.MonkeyPatch) -> None:
    render = SampleRenderer.render

    def other(self: SampleRenderer, sample: Sample) -> list[list[Frame]]:
        ((frame,),) = render(self, sample)
        assert frame.depth is not None
        changed = frame.depth.copy()
        changed[8, 12] = np.nextafter(changed[8, 12], np.float32(0))
        return [[replace(frame, depth=changed)]]

    monkeypatch.setattr(SampleRenderer, "render", other)
    assert verify_samples(there, [4], None, lambda: None, Path()) == [
        "data/000001.tar: sample 4: depth must be what is rendered again, bit by bit; got other values"
    ]
    old = replace(there, identity=replace(there.identity, version="0.1"))
    assert verify_samples(old, [4], None, lambda: None, Path()) == [
        f"samples must be rendered again by clsco 0.1; got {clsco.__version__}"
    ]
    gpu = replace(there, identity=replace(there.identity, device_family="gpu"))
    (finding,) = verify_samples(gpu, [4], None, lambda: None, Path())
    assert finding.startswith("samples must be rendered again on a device of the family gpu; got cpu")


def test_scenes_of_samples_are_shown(there: DataSet) -> None:
    assert clsco.parse_scene(scene_table(there, 5)).camera.focus_distance == 205.0
    assert clsco.parse_scene(scene_table(there, 6)).objects[0].texture == "/no/6.png"  # it failed
    with pytest.raises(SceneError, match="sample 3: has no scene, as none could be drawn; got fake"):
        scene_table(there, 3)
    with pytest.raises(SceneError, match="sample: must be from 0 to 7; got 8"):
        scene_table(there, 8)
    there.storage.remove(part_key(1))
    with pytest.raises(SceneError, match="sample 5: its shard must be made"):
        scene_table(there, 5)
