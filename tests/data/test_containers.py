"""Containers: what goes in comes out, the same records give the same bytes, and damage is refused."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from clsco.data.containers import CONTAINERS, container_named
from clsco.data.record import Record, make_record
from clsco.errors import FileError, MissingDependencyError, SceneError
from tests.data.samples import contents, drawn, frame, record, same

EACH = pytest.mark.parametrize("form", CONTAINERS)
ONE_SHAPE = ("zarr", "zarr+raw")  # for all samples of a shard
ROOT = Path(__file__).resolve().parents[2]


def written(folder: Path, form: str, records: list[Record]) -> Path:
    path = folder / f"{form}{CONTAINERS[form].suffix}"
    CONTAINERS[form].write(path, iter(records))
    return path


def digest(path: Path) -> str:
    """Digest of all files and their names."""
    total = hashlib.sha256()
    for name, content in (contents(path) if path.is_dir() else {"": path.read_bytes()}).items():
        total.update(f"{name} {len(content)}\n".encode() + content)
    return total.hexdigest()


@EACH
def test_records_come_back_bit_by_bit(form: str, tmp_path: Path) -> None:
    # Of formats with columns more than a block of records.
    some_arrays = ("color", "depth", "object_id") if form in ONE_SHAPE else ()
    records = [record(number, wanted=some_arrays) for number in range(18 if form in ONE_SHAPE else 6)]
    reader = CONTAINERS[form].read(written(tmp_path, form, records))
    assert len(reader) == len(records)
    assert list(reader.keys) == [each.key for each in records]
    for found, wanted in zip(reader, records, strict=True):
        assert same(found, wanted)
        assert all(array.flags.writeable and array.flags.c_contiguous for array in found.arrays.values())
    assert same(reader[-2], records[-2])
    some = reader.record(5, ("depth", "color"))
    assert list(some.arrays) == ["color", "depth"]
    np.testing.assert_array_equal(some["depth"], records[5]["depth"])
    assert some.meta == records[5].meta
    assert same(reader[3], records[3])
    with pytest.raises(IndexError):
        reader[len(records)]


@EACH
def test_prefixes_grays_halves_and_missing_arrays(form: str, tmp_path: Path) -> None:
    views = [frame(1, (5, 3), color=False, index=n, eye=eye) for n in (0, 1) for eye in ("left", "right")]
    wanted = ("color", "sharp", "depth", "normal")
    types = {"depth": "float16", "sharp": "uint8", "normal": "float16"}
    made = make_record(drawn(1, 2), 0, [views] * 2, wanted, types)
    records = [made] if form in ONE_SHAPE else [made, record(2, (4, 6), ("depth",))]
    found = list(CONTAINERS[form].read(written(tmp_path, form, records)))
    assert list(map(same, found, records)) == [True] * len(records)
    assert found[0]["f0001.left.depth"].dtype == np.float16


def test_one_shape_for_all_where_columns_need_it(tmp_path: Path) -> None:
    for form in ONE_SHAPE:
        for number, other in enumerate((record(2, (4, 6)), record(2, wanted=("depth",)))):
            path = tmp_path / f"{number}{form}"
            with pytest.raises(FileError, match="must have the same arrays in all samples, of one type and size; got"):
                CONTAINERS[form].write(path, iter([record(1), other]))
        with pytest.raises(FileError, match="must have a sample; got none"):
            CONTAINERS[form].write(tmp_path / f"empty{form}", iter([]))


def test_large_records_are_not_kept_together(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("clsco.data.containers.zarr3.MOST_BYTES", 1)
    records = [record(number, wanted=("color", "depth")) for number in range(3)]
    for form in ONE_SHAPE:
        path = written(tmp_path, form, records)
        assert all(map(same, CONTAINERS[form].read(path), records))
    assert len(list((tmp_path / "zarr.zarr/depth/c").iterdir())) == 3


def test_the_same_bytes_at_another_time_and_in_another_process(tmp_path: Path) -> None:
    records = [record(number) for number in range(3)]
    here = {form: digest(written(tmp_path, form, records)) for form in CONTAINERS}
    there = tmp_path / "there"
    there.mkdir()
    lines = [
        "import sys, time; from pathlib import Path",
        "from tests.data.samples import record; from tests.data.test_containers import digest, written",
        "from clsco.data.containers import CONTAINERS",
        "real = time.time; time.time = lambda: real() + 1e7; time.localtime()",
        "frames = []; sys.setprofile(lambda frame, *about: frames.append(frame))  # as profilers may",
        "for form in CONTAINERS: print(form, digest(written(Path(sys.argv[1]), form, list(map(record, range(3))))))",
    ]
    command = [sys.executable, "-c", "\n".join(lines), str(there)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert dict(line.split() for line in run.stdout.splitlines()) == here


@pytest.mark.slow
@EACH
def test_memory_does_not_grow_with_the_shard(form: str, tmp_path: Path) -> None:
    size, counts, peaks = (64, 64), (16, 64), []
    total = sum(array.nbytes for array in record(0, size).arrays.values())

    def some(count: int) -> Iterator[Record]:
        return (record(number, size) for number in range(count))

    written(tmp_path, form, [record(0, size)])  # imports, and what is made once
    for count in counts:
        tracemalloc.start()
        path = tmp_path / f"{count}{CONTAINERS[form].suffix}"
        CONTAINERS[form].write(path, some(count))
        reader = CONTAINERS[form].read(path)
        for each in reader:
            assert each.key
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 8 * total


def test_unknown_and_missing_formats(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneError, match=r"format: must be one of webdataset, .*zarr\+raw; got tar"):
        container_named("tar")
    monkeypatch.setattr("clsco.data.containers.find_spec", lambda name: None)
    message = r"format: hdf5 needs h5py: pip install 'clsco\[data\]'; got no such module"
    with pytest.raises(MissingDependencyError, match=message):
        container_named("hdf5")
    assert container_named("webdataset+raw").name == "webdataset+raw"  # needs nothing
