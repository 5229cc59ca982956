"""Small files that say they are large, or take long: refused with little memory, and soon."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.data.containers.base import LARGEST_RECORD, parsed_meta
from clsco.errors import FileError
from clsco.files import decoder_process as confining
from clsco.files.decoder_process import run_decoder
from clsco.files.images import read_image
from clsco.inputs.depth_files import read_depth
from tests.hostile import bombs
from tests.hostile.decoders import echo, ended, generous, hungry, slow
from tests.hostile.pictures import exr, tiff
from tests.slow import mostly_slow

ALLOWED, ALLOWED_S = bombs.ZEROS // 2, 5.0


def peak(reset: bool = False) -> int:
    """Most bytes that this process has had since a reset."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024


@pytest.mark.skipif(not os.access("/proc/self/clear_refs", os.W_OK), reason="the peak of memory cannot be measured")
@pytest.mark.parametrize("name", mostly_slow(bombs.BOMBS, bombs.BOMBS.keys() - bombs.LIKE_OTHERS))
def test_bombs_take_little(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confining, "MEMORY", ALLOWED)
    file, read = bombs.BOMBS[name](tmp_path)
    with pytest.raises(FileError):
        read_image(tmp_path / "none.png")
    before, start = peak(reset=True), time.process_time()
    said = bombs.read_all(tmp_path / file, read)
    assert said.startswith("refused"), said
    assert peak() - before < ALLOWED
    assert time.process_time() - start < ALLOWED_S


def test_an_exr_whose_header_says_far_more_than_its_bytes(tmp_path: Path) -> None:
    path, small = tmp_path / "image.exr", exr(Y=np.zeros((4, 4), np.float32))
    path.write_bytes(small.replace(struct.pack("<4i", 0, 0, 3, 3), struct.pack("<4i", 0, 0, 11_000, 11_000)))
    with pytest.raises(FileError, match=rf"must be a whole EXR; got {len(small)} bytes of 1 channels of 11001 x 11001"):
        read_image(path)


def test_an_exr_whose_display_window_is_huge(tmp_path: Path) -> None:
    path, small = tmp_path / "image.exr", exr(Y=np.zeros((4, 4), np.float32))
    window = struct.pack("<4i", 0, 0, 3, 3)
    at = small.index(window, small.index(b"displayWindow"))
    path.write_bytes(small[:at] + struct.pack("<4i", 0, -(2**24), 3, 3) + small[at + 16 :])
    for read in (read_image, read_depth):
        with pytest.raises(FileError, match="columns and rows must be from 1 to 65536"):
            read(path)


def test_all_arrays_of_a_sample_have_a_limit() -> None:
    about = '{"dtype": "float32", "shape": [8192, 8192]}'
    several = ",".join(f'"v{k}.depth": {about}' for k in range(LARGEST_RECORD // 2**28 + 1))
    with pytest.raises(FileError, match="arrays of a sample must have at most 4294967296 bytes in all; got 456"):
        parsed_meta(Path("shard"), f'{{"arrays": {{{several}}}}}')


class TestConfined:
    """Decoders in a process with limits: what they give comes back, and none of what they do reaches this process."""

    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        path = tmp_path / "file"
        path.write_text("hello")
        return path

    def call(self, path: Path, function: Callable[..., Any], most: int = 100, **options: Any) -> Any:
        with open(path, "rb") as file:
            return run_decoder(f"tests.hostile.decoders:{function.__name__}", file, most, **options)

    def test_gives_what_the_function_does(self, file: Path) -> None:
        for _ in range(2):
            found, (numbers, none) = self.call(file, echo, more=[1, "é\n"])
            assert found == {"content": "hello", "more": [1, "é\n"]}
            assert numbers.tolist() == [[0, 1, 2], [3, 4, 5]]
            assert none.shape == (0, 2)

    @pytest.mark.parametrize(
        ("function", "message"),
        [
            (ended, "ended with status -6, allowed 256 MiB and 20 s"),
            (hungry, "more memory than its size allows"),
            (generous, "arrays of more than 100 bytes"),
        ],
    )
    def test_limits(self, function: Callable[..., Any], message: str, file: Path) -> None:
        with pytest.raises(ValueError, match=message):
            self.call(file, function)
        assert self.call(file, echo)[0]["content"] == "hello"

    @pytest.mark.parametrize(("seconds", "patience", "status"), [(0.1, 1000, -24), (20, 0.02, -9)])
    def test_deadlines(
        self, seconds: float, patience: float, status: int, file: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        self.call(file, echo)  # it has started
        monkeypatch.setattr(confining, "SECONDS", seconds)
        monkeypatch.setattr(confining, "PATIENCE", patience)
        with pytest.raises(ValueError, match=f"ended with status {status}"):
            self.call(file, slow)

    def test_a_file_that_was_replaced(self, file: Path, tmp_path: Path) -> None:
        with open(file, "rb") as opened:
            (tmp_path / "other").write_text("other")
            (tmp_path / "other").replace(file)
            with pytest.raises(ValueError, match="another file than was opened first"):
                run_decoder("tests.hostile.decoders:echo", opened, 0)

    def test_modules_of_the_current_folder_are_not_imported(
        self, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "clsco").mkdir()
        (tmp_path / "clsco/__init__.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')")
        (tmp_path / "tifffile.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')")
        path = tmp_path / "image.tif"
        path.write_bytes(tiff(np.zeros((4, 4), np.uint8)))
        confining._serving.end()
        monkeypatch.chdir(tmp_path)
        assert read_image(path).data.shape == (4, 4)
        assert not (tmp_path / "run").exists()

    def test_a_copy_of_the_process_has_its_own(self, file: Path) -> None:
        self.call(file, echo)
        process = confining._serving.process
        assert process is not None
        if (child := os.fork()) == 0:
            try:
                own = self.call(file, echo)[0]["content"] == "hello" and confining._serving.process is not process
                confining._serving.end()
            finally:
                os._exit(0 if own else 1)
        assert os.waitpid(child, 0)[1] == 0
        assert confining._serving.process is process
        assert self.call(file, echo)[0]["content"] == "hello"
