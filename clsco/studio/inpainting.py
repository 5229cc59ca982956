"""Inpainting in the studio: a mask that the user paints, and results of methods with their figures."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from clsco.engine.child import Child
from clsco.errors import ClscoError, FileError, SceneError
from clsco.files.atomic import atomic_folder, make_writable_folder
from clsco.files.color import SRGB
from clsco.files.images import Picture, read_image, write_png
from clsco.files.png import png_parts
from clsco.files.transfer import encode
from clsco.studio.folder import below
from clsco.studio.presets import REMOVALS
from clsco.studio.session import Document

FILLERS = ("mean-median", "biharmonic", "texture", "auto")  # "auto": the better one of the two before it
MOST_RUNS = 2**20
LARGEST = 2**24  # pixels of an image that can be filled interactively
ROWS = {  # rows of the table in figure 5.21, with their keys in `Report.figures`
    "missing_pixels": "Missing pixels",
    "border_pixels": "Border pixels",
    "gradient_range": "Range of gradients",
    "threshold": "Threshold of the gradient",
    "sweeps": "Sweeps",
    "blended_pixels": "Blended pixels",
    "seconds": "Seconds",
}


@dataclass(frozen=True, eq=False)
class FilledImage:
    """Result of a method: the filled image (rows, columns[, 3]), of the original's type, and its `Report.figures`."""

    method: str
    image: NDArray[Any]
    figures: dict[str, Any]


class Inpainting:
    """An image, the mask of its missing pixels, and the results of methods."""

    def __init__(self, root: Path, device: str | None = None) -> None:
        self.root = root.resolve()
        self.filler = FillingProcess(device)
        self.name = self.title = ""  # of its file; for people
        self.image: NDArray[Any] = np.zeros((1, 1), np.uint8)
        self.color = SRGB
        self.mask = np.zeros((1, 1), np.bool_)
        self.results: dict[str, FilledImage] = {}

    def open(self, name: str) -> None:
        """Open another image, without a mask. Raises FileError if it is not below the root, unreadable or too large."""
        picture = self._read(name)
        image = picture.data
        if image.shape[0] * image.shape[1] > LARGEST:
            raise FileError(f"{name}: must have at most {LARGEST} pixels to be filled here; use clsco inpaint")
        self.name = self.title = name
        self.image, self.color = image, picture.color
        self.mask = np.zeros(image.shape[:2], np.bool_)
        self.results = {}

    def open_removal(self, name: str) -> None:
        """Open one of `REMOVALS`, with its mask. Raises SceneError."""
        if name not in REMOVALS:
            raise SceneError(f"preset: must be one of {', '.join(REMOVALS)}; got {name!r}")
        self.name, self.title = f"{name}.png", REMOVALS[name].title
        self.image, self.mask = REMOVALS[name].make()
        self.color = SRGB
        self.results = {}

    def paint(self, columns: int, rows: int, runs: Sequence[int]) -> None:
        """Set the mask from runs: numbers of known, missing, known, missing ... pixels in turn, row after row.

        Raises FileError if the runs do not add up to the pixels of the image.
        """
        if (rows, columns) != self.mask.shape:
            got = f"{columns} x {rows}"
            raise FileError(f"mask: must have {self.mask.shape[1]} x {self.mask.shape[0]} pixels; got {got}")
        lengths = list(runs)
        if len(lengths) > MOST_RUNS or not all(type(run) is int and 0 <= run <= rows * columns for run in lengths):
            raise FileError(f"mask: must be at most {MOST_RUNS} lengths of runs")
        if sum(lengths) != rows * columns:
            raise FileError(f"mask: runs must make up {rows * columns} pixels; got {sum(lengths)}")
        values = np.arange(len(lengths)) % 2 == 1
        self.mask = np.repeat(values, lengths).reshape(rows, columns)
        self.results = {}

    def runs(self) -> list[int]:
        """The mask as runs, in the form of `paint`."""
        changes = np.flatnonzero(np.diff(self.mask.ravel(), prepend=False))
        return [end - start for start, end in pairwise([0, *changes.tolist(), self.mask.size])]

    def add_color(self, column: int, row: int, tolerance: float, erase: bool = False) -> None:
        """Add all pixels that look like the given pixel to the mask, or, with `erase`, remove them from it.

        tolerance: largest difference in any channel, as a fraction of white. Raises FileError if the given pixel is
        outside the image.
        """
        if not (0 <= row < self.mask.shape[0] and 0 <= column < self.mask.shape[1]):
            raise FileError(f"color: must be that of a pixel of the image; got column {column}, row {row}")
        codes = self.shown(self.image).astype(np.int16)
        difference = np.abs(codes - codes[row, column])
        if difference.ndim == 3:
            difference = difference.max(axis=2)
        chosen = difference <= 255.0 * tolerance
        self.mask = self.mask & ~chosen if erase else self.mask | chosen
        self.results = {}

    def load_mask(self, name: str) -> None:
        """Read the mask from a file; pixels brighter than half of white are missing. Raises FileError."""
        values = self._read(name).data
        values = values if values.ndim == 2 else values[..., 0]
        if values.shape != self.mask.shape:
            got = f"{values.shape[1]} x {values.shape[0]}"
            raise FileError(f"{name}: must have the size of the image; got {got} pixels")
        half = 0.5 if values.dtype.kind == "f" else np.iinfo(values.dtype).max / 2
        self.mask = values > half
        self.results = {}

    def save_mask(self, name: str) -> None:
        """Write the mask as PNG, white where pixels are missing. Raises FileError."""
        target = self._target(name)
        if target.suffix.lower() != ".png":
            raise FileError(f"mask: must be written to a file that ends in .png; got {name!r}")
        if target == (self.root / self.name).resolve():
            raise FileError(f"mask: must not take the place of the image; got {name!r}")
        write_png(make_writable_folder(target.parent) / target.name, self._mask_codes())

    def fill(self, method: str) -> FilledImage | None:
        """Fill the missing pixels, and store the result for the method; returns it, or None if canceled.

        Raises ClscoError.
        """
        if method not in FILLERS:
            raise SceneError(f"method: must be one of {', '.join(FILLERS)}; got {method!r}")
        mask = self.mask
        if not mask.any():
            raise FileError("mask: some pixel must be missing; paint over what is to go")
        made = self.filler.fill(self.image, mask, method)
        if made is None:
            return None
        found = FilledImage(method, *made)
        if mask is self.mask:  # the mask was not painted meanwhile
            self.results[method] = found
        return found

    def table(self) -> list[tuple[str, list[str]]]:
        """Table of the methods that were run, as in figure 5.21: for each row its label, and a text for each method."""
        return [
            (label, [_figure(filled.figures.get(key)) for filled in self.results.values()])
            for key, label in ROWS.items()
        ]

    def command(self, method: str, folder: str) -> str:
        """The command line that gives the same result from the image and mask that `save` writes to `folder`."""
        name = self._target(folder).relative_to(self.root).as_posix()
        start = f"./{name}" if name.startswith("-") else name
        image, mask, out = (f"{start}/{end}" for end in ("image.png", "mask.png", f"{method}/filled.png"))
        return shlex.join(["clsco", "inpaint", image, mask, "-o", out, "--method", method])

    def save(self, folder: str) -> list[str]:
        """Write image, mask and results to a folder as PNG, atomically; returns their names. Raises FileError."""
        target = self._target(folder)
        if self.image.dtype.kind == "f":
            raise FileError("image: must be of 8 or 16 bits to be written as PNG; use clsco inpaint for floats")
        with atomic_folder(make_writable_folder(target), "inpainting") as made:
            write_png(made / "image.png", self.image, self.color)
            write_png(made / "mask.png", self._mask_codes())
            for filled in self.results.values():
                write_png(made / f"{filled.method}.png", filled.image, self.color)
            return sorted(path.name for path in made.iterdir())

    def picture(self, which: str) -> bytes:
        """8-bit PNG of "image", or of the result of a method; b"" if there is none."""
        images = {name: filled.image for name, filled in self.results.items()} | {"image": self.image}
        return b"".join(png_parts(self.shown(images[which]))) if which in images else b""

    @staticmethod
    def shown(image: NDArray[Any]) -> NDArray[np.uint8]:
        """8-bit codes of an image for display."""
        if image.dtype.kind == "f":
            return encode(np.clip(image.astype(np.float32), 0.0, 1.0), 8, "srgb").astype(np.uint8)
        return np.ascontiguousarray(image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8))

    def _mask_codes(self) -> NDArray[np.uint8]:
        return np.where(self.mask, 255, 0).astype(np.uint8)

    def _target(self, name: str) -> Path:
        """A path below the root for a file to write. Raises FileError."""
        try:
            return below(self.root, name)
        except SceneError:
            raise FileError(f"output: must be below the folder of the studio; got {name!r}") from None

    def _read(self, name: str) -> Picture:
        try:
            path = below(self.root, name)
            is_file = path.is_file()
        except (SceneError, OSError):  # OSError: the name is too long
            is_file = False
        if not is_file:
            raise FileError(f"image: must be a file below the folder of the studio; got {name!r}")
        try:
            return read_image(path)
        except FileError as error:
            raise FileError(str(error).replace(str(path), name)) from None


def _figure(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return " to ".join(map(_figure, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


_OPENED: WeakKeyDictionary[Document, Inpainting] = WeakKeyDictionary()


def inpainting_of(session: Document, device: str | None = None) -> Inpainting:
    """The inpainting of the tab with this session; the first call creates it, for `device`."""
    if session not in _OPENED:
        _OPENED[session] = Inpainting(session.root, device)
    return _OPENED[session]


class FillingProcess:
    """Fills one image at a time in a child process, which starts with the first image."""

    def __init__(self, device: str | None = None) -> None:
        self.device = device
        self.share = 0.0  # finished fraction of the current work
        self._child: Child | None = None
        self._working, self._is_canceled = Lock(), False

    def fill(
        self, image: NDArray[Any], mask: NDArray[np.bool_], method: str
    ) -> tuple[NDArray[Any], dict[str, Any]] | None:
        """Fill an image; returns it with the figures of its report, or None if canceled. Raises ClscoError."""
        if not self._working.acquire(blocking=False):
            raise FileError(f"{method}: must wait for what is being filled")
        try:
            self.share, self._is_canceled = 0.0, False
            if self._child is None:
                self._child = Child(_work)
            self._child.send((image, mask, method, self.device))
            while True:
                what, *content = self._child.pipe.recv()
                if what == "share":
                    (self.share,) = content
                elif what == "refused":
                    raise content[0]
                else:
                    image, figures = content
                    return image, figures
        except (EOFError, OSError):
            if self._child is not None:
                self._child.end()
            self._child = None
            if self._is_canceled:
                return None
            raise FileError(f"{method}: its process ended; it is begun again with the next try") from None
        finally:
            self._working.release()

    def cancel(self) -> None:
        """Cancel the running filling, if any."""
        if self._working.locked():
            self._is_canceled = True
            self.close()

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.kill()


def _work(pipe: Connection) -> None:
    """Fill images that the studio sends through the pipe, until the studio ends."""
    from clsco.engine.inpaint import inpaint

    while True:
        image, mask, method, device = pipe.recv()
        try:
            filled, report = inpaint(
                image, mask, method=method, device=device, return_report=True,
                progress=lambda share: pipe.send(("share", share)),
            )  # fmt: skip
        except ClscoError as error:
            pipe.send(("refused", error))
        else:
            pipe.send(("filled", filled, report.figures()))
