"""Shards and cards of strangers: sizes are checked before memory is taken, nothing leaves its folder, nothing runs."""

from __future__ import annotations

import io
import json
import pickle
import tarfile
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import imagecodecs
import numpy as np
import pytest

import clsco.data
from clsco.data.containers import CONTAINERS
from clsco.data.containers.base import decoded, encoded, parsed_meta
from clsco.errors import FileError
from clsco.files.png import png_parts
from tests.data.samples import make_set, record

HERE = Path("shard")


def npy_of(shape: tuple[int, ...], dtype: str = "<f4", content: bytes = b"") -> bytes:
    """An NPY whose header says what it likes."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue() + content


def bomb() -> bytes:
    return bytes(imagecodecs.zstd_encode(bytes(2**25), 3))


def large_png() -> bytes:
    """A PNG of 2^31 pixels under a header of four."""
    parts = png_parts(np.zeros((2, 2), np.uint8))
    pixels = zlib.compress(bytes(2**24))
    chunk = len(pixels).to_bytes(4, "big") + b"IDAT" + pixels + zlib.crc32(b"IDAT" + pixels).to_bytes(4, "big")
    joined = b"".join(parts)
    return joined[:33] + chunk + joined[-12:]


@pytest.mark.parametrize(
    ("extension", "content"),
    [
        ("npy", npy_of((2**20, 2**20))), ("npy", npy_of((2, 2), content=bytes(8))),
        ("npy", npy_of((2, 2), content=bytes(32))), ("npy", npy_of((2, 2), "<f8", bytes(32))),
        ("npy", npy_of((2, 2), "|O", pickle.dumps([print] * 4))), ("npy.zst", b""), ("npy.zst", bomb()),
        ("npy", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535),
        ("npy", b"\x93NUMPY\x03\x00\x10\x00\x00\x00" + b" " * 16),
        ("npy.zst", imagecodecs.zstd_encode(npy_of((2**20, 2**20)), 3)),
        ("npy.zst", bytes.fromhex("28b52ffda0") + (2**31 - 1).to_bytes(4, "little") + b"\0" * 8),
    ],
)  # fmt: skip
def test_lies_about_sizes_take_no_memory(extension: str, content: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(Exception):  # noqa: B017, PT011, any: readers turn all of them into a FileError
        decoded(HERE, extension, content, np.dtype("f4"), (2, 2))
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_a_png_is_sized_by_what_describes_it() -> None:
    whole = encoded(HERE, np.zeros((2, 2), np.uint8))[1]
    for dtype, shape in (("u1", (2, 3)), ("u2", (2, 2)), ("u1", (2, 2, 3)), ("f4", (2, 2))):
        with pytest.raises(ValueError, match="a PNG of 2 x 2, 8 bits, color type 0"):
            decoded(HERE, "png", whole, np.dtype(dtype), shape)
    assert decoded(HERE, "png", large_png(), np.dtype("u1"), (2, 2)).shape == (2, 2)  # libpng reads no more than four


@pytest.mark.parametrize(
    "meta",
    [
        b"[]", b"{", b'{"arrays": []}', b'{"arrays": {"a": 1}}',
        b'{"arrays": {"../a": {"dtype": "uint8", "shape": [2, 2]}}}',
        b'{"arrays": {"a": {"dtype": "object", "shape": [2, 2]}}}',
        b'{"arrays": {"a": {"dtype": ["uint8"], "shape": [2, 2]}}}',
        b'{"arrays": {"a": {"dtype": "uint8", "shape": [1099511627776]}}}',
        b'{"arrays": {"a": {"dtype": "uint8", "shape": [-1, 2]}}}',
        b'{"arrays": {"a": {"dtype": "uint8", "shape": [2.0, true]}}}',
        b'{"arrays": {"a": {"dtype": "uint8", "shape": []}}}',
        b'{"arrays": "' + b"[" * 100000 + b'"}',
    ],
)  # fmt: skip
def test_meta_that_no_record_has(meta: bytes) -> None:
    with pytest.raises((FileError, ValueError, RecursionError)):
        parsed_meta(HERE, meta)


def tar_of(path: Path, *entries: tuple[tarfile.TarInfo, bytes]) -> Path:
    with tarfile.open(path, "w") as tar:
        for entry, content in entries:
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))
    return path


def test_members_that_a_tar_must_not_have(tmp_path: Path) -> None:
    link = tarfile.TarInfo("000000001.color.png")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
    tar = tar_of(tmp_path / "link.tar", (link, b""))
    with pytest.raises(FileError, match=r"must hold whole, plain files alone; got '000000001\.color\.png'"):
        CONTAINERS["webdataset"].read(tar)
    outside = tar_of(tmp_path / "outside.tar", (tarfile.TarInfo("../../evil.meta.json"), b"{}"))
    reader = CONTAINERS["webdataset"].read(outside)
    with pytest.raises(FileError, match=r"outside\.tar"):
        list(reader)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["link.tar", "outside.tar"]
    again = [(tarfile.TarInfo(f"00000000{n}.meta.json"), b"{}") for n in (1, 2, 1)]
    with pytest.raises(FileError, match="files of a sample must follow each other"):
        CONTAINERS["webdataset"].read(tar_of(tmp_path / "again.tar", *again))


def test_a_tar_whose_headers_lie(tmp_path: Path) -> None:
    path = tmp_path / "a.tar"
    CONTAINERS["webdataset"].write(path, iter([record(1)]))
    content = bytearray(path.read_bytes())
    header = content[:512]
    header[124:136] = b"77777777777\0"  # 8 GiB
    header[148:156] = b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    path.write_bytes(header + content[512:])
    with pytest.raises(FileError, match=r"a\.tar: must "):
        CONTAINERS["webdataset"].read(path)


def replace_depth(group: Any, kind: str, folder: Path) -> None:
    """Have the dataset of depth lie elsewhere, or be far larger than what describes it."""
    del group["depth"]
    with h5py.File(folder / "other.h5", "w") as other:
        other["depth"] = np.zeros((9, 12), np.float32)
    if kind == "external link":
        group["depth"] = h5py.ExternalLink("other.h5", "depth")
    elif kind == "raw file":
        (folder / "secret").write_bytes(bytes(4 * 9 * 12))
        group.create_dataset("depth", (9, 12), "<f4", external=[(str(folder / "secret"), 0, 432)])
    elif kind == "virtual":
        layout = h5py.VirtualLayout((9, 12), "<f4")
        layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "depth", (9, 12))
        group.create_virtual_dataset("depth", layout)
    else:
        group.create_dataset("depth", (2**20, 2**20), "<f4", chunks=(64, 64))


@pytest.mark.parametrize("kind", ["external link", "raw file", "virtual", "large"])
def test_hdf5_that_leads_elsewhere(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    CONTAINERS["hdf5"].write(path, iter([record(1)]))
    with h5py.File(path, "r+") as file:
        replace_depth(file["000000001"], kind, tmp_path)
    reader = CONTAINERS["hdf5"].read(path)
    with pytest.raises(FileError, match=r"a\.h5: must be a whole HDF5"):
        reader.record(0)
    assert list(reader.record(0, ("color",)).arrays) == ["color"]


def test_what_json_cannot_hold_is_not_written(tmp_path: Path) -> None:
    wrong = record(1)
    wrong = replace(wrong, meta={**wrong.meta, "parameters": {"camera.focus_distance": np.inf}})
    for form, container in CONTAINERS.items():
        with pytest.raises(FileError, match="sample 000000001: must be values that JSON holds"):
            container.write(tmp_path / form, iter([wrong]))


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"files": {"train": [["../../etc/passwd", 1]]}}, "must lie in its folder"),
        ({"files": {"train": [["/etc/passwd", 1]]}}, "must lie in its folder"),
        ({"files": {"train": [["train/000000.tar", -1]]}}, r"must describe a data set; got files\.train\[0\]\[1\] -1"),
        (
            {"files": {"train": [["train/000000.tar", 10**30]]}},
            r"must describe a data set; got files\.train\[0\]\[1\] 1",
        ),
        ({"files": ["train"]}, "must describe a data set; got files"),
        ({"files": {"train": [["train/000000.tar", 2]]}}, r"\.tar: must hold 2 samples, as dataset.json says; got"),
        ({"identity": {"format": ["webdataset"]}}, "must describe a data set; got no identity.distribution"),
        (
            {"distribution": "/etc/passwd"},
            'must describe a data set; got distribution "/etc/passwd", which is no table',
        ),
    ],
)
def test_cards_of_strangers(values: dict[str, Any], rule: str, tmp_path: Path) -> None:
    card = json.loads((make_set(tmp_path / "set") / "dataset.json").read_text())
    (tmp_path / "set/dataset.json").write_text(json.dumps(card | values))
    with pytest.raises(FileError, match=rule):
        clsco.data.open(tmp_path / "set", "train")[0]


def test_a_card_that_is_no_text_is_not_shown(tmp_path: Path) -> None:
    card = make_set(tmp_path / "set") / "dataset.json"
    card.write_bytes(card.read_bytes()[:-2] + b"\xff" * 10**6)
    with pytest.raises(FileError, match="must describe a data set; got 'utf-8' codec") as caught:
        clsco.data.open(tmp_path / "set")
    assert len(str(caught.value)) < 200 + len(str(tmp_path))
