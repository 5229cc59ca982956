"""Objects are whole or absent, in a folder and in a store."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from clsco.data.storage import Storage, open_storage
from clsco.errors import FileError


@pytest.fixture(params=["folder", "memory"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    if request.param == "memory":
        fsspec = pytest.importorskip("fsspec")
        fsspec.filesystem("memory").store.clear()
        return open_storage("memory://bucket/set")
    return open_storage(tmp_path / "set")


def test_files_and_folders_are_put_listed_read_and_removed(storage: Storage) -> None:
    assert storage.read("data/a") is None
    assert storage.digest("data/a") is None
    assert storage.sizes("data") == {}
    assert not storage.has_others()
    path = storage.scratch() / "made"
    path.write_bytes(b"abc")
    storage.put("data/a", path)
    assert not path.exists()
    folder = storage.scratch() / "folder"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "b").write_bytes(b"12345")
    storage.put("data/zarr", folder)
    storage.write("card.json", b"{}")
    assert storage.has_others()
    assert storage.sizes("data") == {"data/a": 3, "data/zarr/inner/b": 5}
    assert storage.read("data/a") == b"abc"
    assert storage.digest("data/a") == hashlib.sha256(b"abc").hexdigest()
    assert (storage.local("data/zarr") / "inner" / "b").read_bytes() == b"12345"
    storage.write("data/a", b"other")
    assert storage.read("data/a") == b"other"
    storage.remove("data/zarr")
    storage.remove("data/none")
    assert storage.sizes("data") == {"data/a": 5}
    storage.close()
    assert not storage.scratch().exists() or not any(storage.scratch().iterdir())
    storage.close()


@pytest.mark.parametrize("key", ["../a", "/etc/passwd", "data//a", "data/../../a", "data/.", "", "a\\b", "a\nb"])
def test_keys_of_strangers_stay_in_their_place(storage: Storage, key: str) -> None:
    with pytest.raises(FileError, match="a file of a data set must lie in its folder"):
        storage.read(key)
    with pytest.raises(FileError, match="a file of a data set must lie in its folder"):
        storage.local(key)


def test_a_folder_that_is_put_takes_the_place_of_an_older_one(tmp_path: Path) -> None:
    storage = open_storage(tmp_path)
    for name in ("one", "two"):
        made = storage.scratch() / "made"
        made.mkdir()
        (made / name).write_bytes(b"")
        storage.put("data/0", made)
    assert [path.name for path in (tmp_path / "data" / "0").iterdir()] == ["two"]


def test_what_dead_processes_left_is_removed_and_no_more(tmp_path: Path) -> None:
    storage = open_storage(tmp_path)
    own = storage.scratch()
    code = "import sys; from clsco.data.storage import open_storage; print(open_storage(sys.argv[1]).scratch())"
    words = [sys.executable, "-c", code, str(tmp_path)]
    left = Path(subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip())
    (left / "half.tar").write_bytes(b"1")
    alive = left.with_name(left.name.replace(f"-{left.name.split('-')[1]}-", f"-{os.getppid()}-"))
    other = tmp_path / ".work.00000000-1-00000000.part"  # of another machine, and new
    for path in (alive, other):
        path.mkdir()
    old = tmp_path / ".work.00000000-2-00000000.part"
    old.mkdir()
    os.utime(old, (1, 1))
    storage.tidy()
    assert {path.name for path in tmp_path.iterdir()} == {own.name, alive.name, other.name}


def test_a_process_that_nobody_has_waited_for_has_ended(tmp_path: Path) -> None:
    code = "import sys; from clsco.data.storage import open_storage; open_storage(sys.argv[1]).scratch()"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) as process:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert list(tmp_path.iterdir())
        open_storage(tmp_path).tidy()
        assert not list(tmp_path.iterdir())


def test_a_store_that_cannot_be_had_is_named(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    with pytest.raises(FileError, match="nosuch://a: must be an address that fsspec opens; got"):
        open_storage("nosuch://a")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(FileError, match="the data set must be writable and readable; got Not a directory"):
        open_storage(tmp_path / "file").write("a", b"")
