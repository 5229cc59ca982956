"""Each format read by the field's own reader, without clsco."""

from __future__ import annotations

import errno
import io
import json
import multiprocessing
import os
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco.data
from clsco.data.containers import CONTAINERS
from clsco.data.record import Record
from tests.data.samples import make_set, record

RECORDS = [record(number) for number in range(3)]


def written(folder: Path, form: str) -> Path:
    path = folder / f"000000{CONTAINERS[form].suffix}"
    CONTAINERS[form].write(path, iter(RECORDS))
    return path


def png(content: bytes) -> np.ndarray[Any, Any]:
    found: np.ndarray[Any, Any] = pytest.importorskip("imagecodecs").png_decode(content)
    return found


def npy(content: bytes) -> np.ndarray[Any, Any]:
    """The two lines of docs/loading.md."""
    zstandard = pytest.importorskip("zstandard")
    found: np.ndarray[Any, Any] = np.load(io.BytesIO(zstandard.decompress(content)))
    return found


def check(wanted: Record, arrays: dict[str, np.ndarray[Any, Any]], exact: bool = True) -> None:
    """Arrays are those of a record; where not `exact`, masks are 0 and 255."""
    assert arrays
    for name, array in arrays.items():
        given = wanted[name]
        np.testing.assert_array_equal(array, given if exact or given.dtype != bool else given * np.uint8(255))
        assert array.dtype == given.dtype or (not exact and given.dtype == bool)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")  # its files
@pytest.mark.parametrize("form", ["webdataset", "webdataset+raw"])
def test_webdataset(form: str, tmp_path: Path) -> None:
    webdataset = pytest.importorskip("webdataset")
    samples = list(webdataset.WebDataset(str(written(tmp_path, form)), shardshuffle=False).decode())
    assert [sample["__key__"] for sample in samples] == [each.key for each in RECORDS]
    decoders: dict[str, Any] = {".npy.zst": npy, ".png": png, ".npy": np.asarray}  # the last kind is decoded already
    for sample, wanted in zip(samples, RECORDS, strict=True):
        assert json.loads(sample["meta.json"]["parameters"]) == wanted.meta["parameters"]
        kinds = {name: next((kind for kind in decoders if name.endswith(kind)), "") for name in sample}
        arrays = {name.removesuffix(kind): decoders[kind](sample[name]) for name, kind in kinds.items() if kind}
        assert arrays.keys() == wanted.arrays.keys()
        check(wanted, arrays, exact=form.endswith("+raw"))


def test_npz(tmp_path: Path) -> None:
    with np.load(written(tmp_path, "npz") / f"{RECORDS[1].key}.npz") as found:
        assert json.loads(found["meta.json"]) == RECORDS[1].meta
        check(RECORDS[1], {name: found[name] for name in found.files if name != "meta.json"})


@pytest.mark.parametrize("form", ["hdf5", "hdf5+raw"])
def test_h5py(form: str, tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(written(tmp_path, form)) as file:
        group = file[RECORDS[1].key]
        assert json.loads(group["meta"][()]) == RECORDS[1].meta
        assert group["depth"].attrs["unit"] == "mm"
        check(RECORDS[1], {name: group[name][()] for name in group if name != "meta"})


def test_a_disk_that_is_full_ends_hdf5_with_one_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """HDF5 makes the file in memory: it crashes where it cannot write."""
    pytest.importorskip("h5py")
    opened = Path.open

    def full(path: Path, mode: str = "r", *options: Any) -> Any:
        if "x" in mode:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return opened(path, mode, *options)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OSError, match="No space left on device"):
        written(tmp_path, "hdf5")
    assert list(tmp_path.iterdir()) == []


def test_zarr(tmp_path: Path) -> None:
    path = written(tmp_path, "zarr")
    group = pytest.importorskip("zarr").open_group(path, mode="r")
    check(RECORDS[1], {name: group[name][1] for name in RECORDS[1].arrays})
    first, end = group["meta_ends"][1:3]
    assert json.loads(group["meta"][first:end].tobytes()) == RECORDS[1].meta
    assert group["keys"][:].tolist() == [0, 1, 2]
    few = 1 + 2 * (len(RECORDS[0].arrays) + 3)
    assert len([each for each in path.rglob("*") if each.is_file()]) == few


def test_opencv(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    with tarfile.open(written(tmp_path, "webdataset")) as tar:
        for member in tar:
            content = tar.extractfile(member)
            assert content is not None
            (tmp_path / member.name).write_bytes(content.read())
    names = {name: str(tmp_path / f"{RECORDS[0].key}.{name}.png") for name in ("color", "mask")}
    color = cv2.imread(names["color"], cv2.IMREAD_UNCHANGED)
    check(RECORDS[0], {"color": color[..., ::-1]})  # which it gives as blue, green, red
    check(RECORDS[0], {"mask": cv2.imread(names["mask"], cv2.IMREAD_UNCHANGED)}, exact=False)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the package and what it imports
def test_hugging_face(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets", reason="datasets is not installed: pip install datasets")
    files = str(written(tmp_path, "webdataset"))
    rows = list(datasets.load_dataset("webdataset", data_files=files, split="train", streaming=True))
    for row, wanted in zip(rows, RECORDS, strict=True):
        for name in ("depth", "flow", "object_id"):
            check(wanted, {name: np.array(row[f"{name}.npy.zst"], wanted[name].dtype)})
        check(wanted, {"mask": np.asarray(row["mask.png"])}, exact=False)


def test_spawned_workers_read_a_set(tmp_path: Path) -> None:
    """A data set is sent to a process without anything of its parent, as a DataLoader does."""
    opened = clsco.data.open(make_set(tmp_path / "set"), arrays=("depth",))
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.map(opened.__getitem__, range(len(opened)))
    assert [each.meta["number"] for each in found] == [0, 1, 3, 2, 4, 6, 7, 9, 8]
    assert list(found[0].arrays) == ["depth"]


RECIPES = Path(__file__).resolve().parents[2] / "docs/loading.md"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("package", ["torch", "jax", "tensorflow"])
def test_recipes_of_the_documentation(package: str, tmp_path: Path) -> None:
    """Each recipe gives `color` and `depth`, a batch of two, as a script of its own."""
    pytest.importorskip(package, reason=f"{package} is not installed: pip install {package}")
    folder = make_set(tmp_path / "set")
    blocks = [block for block in RECIPES.read_text().split("```python\n")[1:] if f"import {package}" in block]
    assert blocks
    for block in blocks:
        code = block.partition("```")[0].replace('"DATA', f'"{folder}')
        script = tmp_path / "recipe.py"
        shown = "import numpy\nprint(tuple(color.shape), tuple(depth.shape), numpy.max(numpy.asarray(color)) > 0)"
        script.write_text(f"{code}\n{shown}")
        run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
        shapes = ("(2, 3, 9, 12) (2, 9, 12) True", "(2, 9, 12, 3) (2, 9, 12) True")
        assert run.stdout.split("\n")[-2] in shapes, run.stderr
