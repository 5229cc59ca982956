"""The loader: a data set as a sequence, in processes and threads."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import re
import time
import tracemalloc
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco.data
from clsco.data.record import Record
from clsco.data.storage import open_storage
from clsco.errors import FileError, MissingDependencyError, SceneError
from tests.data.samples import make_set, record, same
from tests.slow import mostly_slow

ORDER = [0, 1, 3, 2, 4, 6, 7, 9, 8]  # by shards of four, then by splits; 5 failed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_set(tmp_path_factory.mktemp("set") / "data")


def numbers(records: Iterable[Record]) -> list[int]:
    return [each.meta["number"] for each in records]


def test_a_set_is_a_sequence(folder: Path) -> None:
    opened = clsco.data.open(folder)
    assert len(opened) == 9
    assert numbers(opened) == ORDER
    assert opened.keys == tuple(f"{number:09d}" for number in ORDER)
    assert opened[-1].meta["number"] == 8
    assert same(opened[3], record(2))
    assert numbers(opened[2:7:2]) == ORDER[2:7:2]
    assert numbers(opened[::-1]) == ORDER[::-1]
    assert numbers(opened[1:][1:][-2:]) == ORDER[-2:]
    assert len(opened[20:]) == 0
    for index in (9, -10):
        with pytest.raises(IndexError, match="must be below"):
            opened[index]
    opened.close()
    assert opened[0].meta["number"] == 0


def test_splits_and_arrays(folder: Path) -> None:
    assert numbers(clsco.data.open(folder, "train")) == [0, 1, 3, 4, 6, 7, 9]
    some = clsco.data.open(str(folder), split="val", arrays=("depth", "color"))
    assert [list(each.arrays) for each in some] == [["color", "depth"]] * 2
    for name in ("coc", "blur_radius"):
        assert list(clsco.data.open(folder, arrays=name)[0].arrays) == ["coc"]
    with pytest.raises(SceneError, match="split: must be one of train, val; got test"):
        clsco.data.open(folder, "test")
    with pytest.raises(SceneError, match=r"arrays: must be some of color, .*; got colour \(did you mean color\?\)"):
        clsco.data.open(folder, arrays=("colour",))
    with pytest.raises(AttributeError):
        clsco.data.load  # noqa: B018


def test_a_set_that_is_being_made(tmp_path: Path) -> None:
    folder = make_set(tmp_path / "data")
    card = json.loads((folder / "dataset.json").read_text())
    (folder / "dataset.json").write_text(json.dumps({name: card[name] for name in ("identity", "samples")}))
    (folder / "manifest/000001.jsonl").unlink()
    assert numbers(clsco.data.open(folder)) == [0, 1, 3, 2, 9, 8]


def test_a_set_without_splits(tmp_path: Path) -> None:
    folder = make_set(tmp_path / "data", splits=False)
    assert numbers(clsco.data.open(folder)) == [0, 1, 2, 3, 4, 6, 7, 8, 9]
    assert clsco.data.open(folder).card["counts"] == {"samples": 9, "failed": 1, "splits": {"": 9}}


def in_worker(opened: clsco.data.Dataset) -> list[int]:
    return [opened[index].meta["number"] for index in range(len(opened))]


@pytest.mark.parametrize("form", ["webdataset", "hdf5"])
def test_forked_workers_have_shards_of_their_own(form: str, tmp_path: Path) -> None:
    opened = clsco.data.open(make_set(tmp_path / "data", form), arrays=("depth",))
    assert in_worker(opened) == ORDER  # open in the parent, too
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map(in_worker, [opened] * 2) == [ORDER] * 2
        assert [each.meta["number"] for each in pool.imap(opened.__getitem__, range(9))] == ORDER
    assert in_worker(opened) == ORDER


def test_it_is_small_when_it_is_pickled(folder: Path) -> None:
    opened = clsco.data.open(folder)[1:]
    assert in_worker(opened) == ORDER[1:]
    content = pickle.dumps(opened)
    assert len(content) < 8000
    assert in_worker(pickle.loads(content)) == ORDER[1:]


def test_threads(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsco.data.dataset.MOST_COPIES", 2)
    opened = clsco.data.open(folder, arrays=("depth",))
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda index: opened[index].meta["number"], list(range(9)) * 5))
    assert found == ORDER * 5


def test_a_million_samples_open_at_once(folder: Path, tmp_path: Path) -> None:
    card = json.loads((folder / "dataset.json").read_text())
    card["files"] = {"train": [[f"train/{shard:06d}.tar", 256] for shard in range(4000)]}
    (tmp_path / "dataset.json").write_text(json.dumps(card))
    start = time.process_time()
    opened = clsco.data.open(tmp_path)
    spent = time.process_time() - start
    assert len(opened[100:]) == 1_024_000 - 100
    assert spent < 0.5  # 0.02 s on a free core
    tracemalloc.start()
    opened = clsco.data.open(tmp_path)
    assert tracemalloc.get_traced_memory()[1] < 4 * 2**20
    tracemalloc.stop()


@pytest.mark.parametrize("form", mostly_slow(["webdataset", "npz", "hdf5", "zarr"], ["webdataset", "npz", "hdf5"]))
@pytest.mark.parametrize(("splits", "variants"), [(True, 1), (False, 2)])
def test_the_examples_of_a_sets_own_readme_run(
    form: str, splits: bool, variants: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (make_set(tmp_path / "DATA", form, splits=splits, variants=variants) / "README.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    names = {"clsco": "clsco", "webdataset": "webdataset", "hdf5": "h5py", "zarr": "zarr", "npz": "numpy"}
    examples = dict(re.findall(r"^(\w+):\n\n```python\n(.*?)\n```", text, re.DOTALL | re.MULTILINE))
    for name in ("clsco", names[form]):
        exec(examples[name], {name: import_module(name), "glob": import_module("glob")})


def test_a_set_prints_as_one_line_and_shows_its_images(folder: Path) -> None:
    opened = clsco.data.open(folder, "train", ("color", "depth"))
    assert repr(opened) == "<Dataset of 7 samples, webdataset: color, depth>"
    assert opened._repr_html_().count("<img") == 4


def test_a_record_is_a_mapping_of_its_arrays(folder: Path) -> None:
    one = clsco.data.open(folder)[0]
    assert one["depth"] is one.arrays["depth"]
    assert dict(one) == one.arrays
    assert list(one.keys()) == list(one.arrays)
    assert ("color" in one, "nothing" in one, one.get("nothing"), len(one)) == (True, False, None, len(one.arrays))
    assert one != clsco.data.open(folder)[0]
    assert len({one, one}) == 1


def test_functions_are_called_when_records_are_read(folder: Path) -> None:
    called: list[str] = []

    def depth_of(record: Record) -> Any:
        called.append(record.key)
        return record["depth"]

    opened = clsco.data.open(folder)
    mapped = opened.map(depth_of).map(np.nanmax)
    assert called == []
    assert mapped[1:][0] == np.nanmax(opened[1]["depth"])
    assert called == [opened[1].key]
    assert (len(mapped), repr(mapped).endswith(", functions: 2>")) == (len(opened), True)
    assert "<img" in mapped._repr_html_()


def test_an_order_follows_from_seed_and_epoch(folder: Path) -> None:
    """Samples of a shard lie together, so that it is opened once."""
    opened = clsco.data.open(folder)
    orders = [numbers(opened.shuffle(seed, epoch)) for seed, epoch in ((1, 0), (1, 1), (2, 0), (1, 0))]
    assert all(sorted(order) == sorted(ORDER) for order in orders)
    assert orders[0] == orders[3]
    assert len(set(map(tuple, orders))) == 3
    for order in orders:
        files = [(number // 4, number % 3 == 2) for number in order]
        assert sum(one != two for one, two in pairwise(files)) + 1 == len(set(files))
    assert sorted(numbers(opened[2:5].shuffle(3))) == sorted(ORDER[2:5])
    assert numbers(opened.shuffle(1)[:3]) == orders[0][:3]
    assert numbers(pickle.loads(pickle.dumps(opened.shuffle(1)))) == orders[0]


@pytest.mark.parametrize("form", mostly_slow(["webdataset", "npz", "zarr"], ["webdataset", "npz"]))
def test_a_set_in_a_store_is_read_by_copies_of_its_shards(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.setattr("clsco.data.dataset.MOST_COPIES", 1)
    memory, folders = fsspec.filesystem("memory"), [make_set(tmp_path / name, form) for name in ("one", "two")]
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    for folder in folders:
        memory.put(str(folder), f"/bucket/{folder.name}", recursive=True)
    one, two = (clsco.data.open(f"memory://bucket/{name}", arrays="depth") for name in ("one", "two"))
    local = clsco.data.open(folders[0])
    for index in (8, 0, 4, 8):
        assert numbers([one[index], two[index]]) == [ORDER[index]] * 2
        np.testing.assert_array_equal(one[index]["depth"], local[index]["depth"])
        copies = list((open_storage("memory://bucket/one").scratch() / "read").glob("*/*/*"))
        assert len(copies) == 2
    assert numbers(pickle.loads(pickle.dumps(one))) == ORDER
    one.close()
    two.close()
    assert not list((open_storage("memory://bucket/one").scratch() / "read").glob("*/*/*"))
    with pytest.raises(FileError, match=r"must hold a data set that clsco dataset make made; got no dataset\.json"):
        clsco.data.open("memory://bucket/three")


def test_tensors(folder: Path) -> None:
    opened = clsco.data.open(folder)
    if find_spec("torch") is None:
        with pytest.raises(
            MissingDependencyError, match="to_torch: needs PyTorch: pip install torch; got no such module"
        ):
            opened.to_torch()
        return
    torch = import_module("torch")
    first: Any = opened.to_torch()[0]
    for name, shape, dtype in (
        ("color", (3, 9, 12), torch.float32), ("depth", (9, 12), torch.float32), ("flow", (2, 9, 12), torch.float32),
        ("mask", (9, 12), torch.bool), ("object_id", (9, 12), torch.int64),
    ):  # fmt: skip
        assert (tuple(first[name].shape), first[name].dtype) == (shape, dtype)
    np.testing.assert_array_equal(np.moveaxis(first["color"].numpy(), 0, -1), opened[0].radiance("color"))
    loader = torch.utils.data.DataLoader(opened.to_torch().shuffle(1), batch_size=3, num_workers=2)
    assert [tuple(batch["color"].shape) for batch in loader] == [(3, 3, 9, 12)] * 3


def test_the_default_collation_of_torch_takes_records(folder: Path) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")
    records = clsco.data.open(folder, arrays=("depth", "mask"))
    batch = next(iter(torch.utils.data.DataLoader(records, batch_size=2)))
    assert {name: tuple(array.shape) for name, array in batch.items()} == {"depth": (2, 9, 12), "mask": (2, 9, 12)}
    np.testing.assert_array_equal(batch["depth"][1].numpy(), records[1]["depth"])
