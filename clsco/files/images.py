"""Reading and writing of image and ground-truth files; writes are atomic."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.errors import import_extra
from clsco.files.atomic import AnyPath, atomic_write, raise_file_error
from clsco.files.color import SRGB, Color
from clsco.files.decoders import IMAGE_FORMATS, decode_file, open_format, path_of, read_size, read_tags
from clsco.files.png import Codes, png_parts
from clsco.files.ranges import first_of
from clsco.files.transfer import decode, encode, has_alpha

LARGEST = 1e36  # size of radiance: sums over an image are finite float32


@dataclass(frozen=True, eq=False)
class Picture:
    """An image (rows, columns[, 3]) as its file stores it: codes (uint8, uint16), or finite linear radiance (float32).

    below: number of negative values. Floats may have some, for example after a filter that rings.
    """

    data: NDArray[Any]
    color: Color = SRGB
    below: int = 0

    def notes(self) -> tuple[str, ...]:
        """Notes for the user, a line each."""
        below = f"{self.below} of {self.data.size} values are below 0: floats keep them, codes end at 0"
        return tuple(filter(None, (self.color.note, below if self.below else "")))

    @property
    def bits(self) -> int:
        """Bits per value: 8, 16 or 32."""
        return 8 * self.data.dtype.itemsize

    @property
    def is_float(self) -> bool:
        """True if the values are linear radiance, not codes."""
        return self.data.dtype.kind == "f"


def read_image(path: AnyPath, hidden: NDArray[np.bool_] | None = None, layer: str | None = None) -> Picture:
    """Read a gray or RGB image: PNG, JPEG, TIFF, EXR, PFM or NPY.

    hidden: mask (rows, columns), True for pixels whose floats need not be finite. layer: layer of an EXR with several,
    as for `clsco.files.layers.image_channels`. Raises FileError; MissingDependencyError if an extra is missing: TIFF
    and 16-bit color PNG need `formats`, EXR needs `exr`.

    Palettes, bools and 1-, 2- and 4-bit grays become 8 bits, float16 and float64 float32. Axes of length 1 around the
    image in an NPY, and opaque alpha, are dropped. PNG, JPEG and TIFF are turned upright by their orientation. An EXR
    is read in its display window: pixels outside of the data window are 0. The color space is returned, not applied;
    the scale of a PFM is ignored.
    """
    with open_format(path) as (file, kind):
        return _picture(file, kind, decode_file(file, kind, layer), hidden)


def read_rgba(path: AnyPath, layer: str | None = None) -> tuple[Picture, NDArray[np.float32]]:
    """Read an image as `read_image`, and the alpha (rows, columns) from 0 to 1 of a PNG or EXR; 1 if it has none.

    An EXR has its overscan, see `clsco.files.decoders.exr_planes`. Floats are premultiplied by alpha, codes are not;
    values under alpha 0 are 0.
    """
    with open_format(path) as (file, kind):
        data = decode_file(file, kind, layer, whole=True)
        alpha = np.ones(data.shape[:2], np.float32)
        if has_alpha(data):
            alpha = np.clip(decode(data[..., -1], "linear"), 0, 1).astype(np.float32)
            if (wrong := np.isnan(alpha)).any():
                raise_file_error(path_of(file), "alpha must be a number", first_of(alpha, wrong))
            data = np.where(alpha[..., None] > 0, data[..., :-1], data.dtype.type(0))
            data = data[..., 0] if data.shape[2] == 1 else data
        return _picture(file, kind, data, None), alpha


def image_size(path: AnyPath) -> tuple[int, int]:
    """Columns and rows that `read_image` would return, from the header of a file alone. Raises FileError."""
    with open_format(path) as (file, kind):
        return read_size(file, kind)


def check_sizes(
    image: str, right: tuple[int, int], other: str, size: tuple[int, int], hint: str = "one of them lies on its side"
) -> None:  # fmt: skip
    """Raise FileError if the `size` of the mask or depth map `other` differs from `right`, the size of its image.

    Sizes are (columns, rows). hint: text that the message adds if columns and rows are exchanged.
    """
    if size != right:
        sizes = [f"{columns} x {rows}" for columns, rows in (right, size)]
        got = f"{sizes[1]} ({hint})" if size == right[::-1] else sizes[1]
        raise_file_error(Path(other), f"the size must be that of {image}, {sizes[0]} pixels", got)


def check_same_size(image: str, other: str, size: tuple[int, int], formats: Mapping[str, str] = IMAGE_FORMATS) -> None:
    """Raise FileError if a mask or depth map, whose upright size is `size`, has another size than its image."""
    _, turned, untagged = _turned_alone(image, other, formats)
    hint = f"{turned} is turned upright by its orientation tag, and {untagged} has none: turn it likewise"
    check_sizes(image, image_size(image), other, size, *([hint] if turned else []))


def upright_note(image: str, other: str, formats: Mapping[str, str] = IMAGE_FORMATS) -> str:
    """Note on an image and its mask or depth map, if only one has an orientation tag, and the sizes do not show whether
    the other one is upright. The note says that it is taken to be upright. Otherwise "".
    """
    orientation, turned, untagged = _turned_alone(image, other, formats)
    columns, rows = image_size(image)
    if not turned or (orientation >= 5 and columns != rows):
        return ""
    return f"{untagged}: is taken to be upright, as {turned} is turned by its orientation tag"


def _turned_alone(image: str, other: str, formats: Mapping[str, str]) -> tuple[int, str, str]:
    """If a tag turns only one of two files: its orientation, its path, and the path of the other; else 1, "", ""."""
    if image == other:
        return 1, "", ""
    orientations = []
    for path, known in ((image, IMAGE_FORMATS), (other, formats)):
        with open_format(path, known) as (file, kind):
            orientations.append((read_tags(file, kind).orientation, path))
    (least, untagged), (orientation, turned) = sorted(orientations)
    return (orientation, turned, untagged) if least == 1 < orientation else (1, "", "")


def _picture(file: BinaryIO, kind: str, decoded: NDArray[Any], hidden: NDArray[np.bool_] | None) -> Picture:
    data = np.ascontiguousarray(_as_stored(file, decoded, hidden))
    below = np.count_nonzero((data if hidden is None else data[~hidden]) < 0) if data.dtype.kind == "f" else 0
    return Picture(data, read_tags(file, kind).color(1 if data.ndim == 2 else 3), int(below))


def _as_stored(file: BinaryIO, data: NDArray[Any], hidden: NDArray[np.bool_] | None) -> NDArray[Any]:
    """Convert decoded values to those of `Picture.data`. Raises FileError unless they are finite, gray or RGB."""
    if data.ndim not in (2, 3) or (data.ndim == 3 and data.shape[2] != 3):
        raise_file_error(path_of(file), "shape must be (rows, columns) or (rows, columns, 3)", data.shape)
    if data.dtype == np.bool_:  # a mask of NumPy
        return data.astype(np.uint8) * np.uint8(255)
    if data.dtype.str[1:] in ("u1", "u2"):
        return data.astype(data.dtype.newbyteorder("="), copy=False)
    if data.dtype.str[1:] not in ("f2", "f4", "f8"):
        raise_file_error(path_of(file), "values must be uint8, uint16, float16, float32 or float64", data.dtype)
    with np.errstate(over="ignore"):  # overflow becomes infinite, which is refused next
        data = data.astype(np.float32, copy=False)
    wrong = ~(np.abs(data) <= LARGEST)
    if hidden is not None:
        wrong[hidden] = False
    if wrong.any():
        raise_file_error(
            path_of(file), f"values must be finite, and at most {LARGEST:g} in size", first_of(data, wrong)
        )
    return data


def write_png(path: AnyPath, data: Codes, color: Color = SRGB) -> None:
    """Write codes (rows, columns[, 3]) as a PNG of 8 or 16 bits in a color space. Raises FileError."""
    with atomic_write(Path(path)) as file:
        file.writelines(png_parts(data, color.png_chunks(data.ndim == 3)))


def write_tiff(path: AnyPath, data: NDArray[Any], color: Color = SRGB) -> None:
    """Write uint8, uint16 or float32 (rows, columns[, 3]) as a lossless TIFF, with a profile of `color`."""
    tifffile = import_extra(path, "tifffile", "formats")
    options: dict[str, Any] = {"photometric": "rgb" if data.ndim == 3 else "minisblack", "compression": "zlib"}
    if profile := color.profile(data.dtype.kind == "f") if data.ndim == 3 else color.icc:
        options["iccprofile"] = profile
    with atomic_write(Path(path)) as file:
        tifffile.imwrite(file, data, metadata=None, **options)


def write_npz(path: AnyPath, arrays: Mapping[str, NDArray[Any]], compressed: bool = False) -> None:
    """Write named arrays as an NPZ, for np.load. Equal arrays give equal bytes. Raises FileError.

    By default, floats are not compressed: 15 MB of ground truth (512 x 512, color) become 13.6 MB in 16 ms. If
    everything is compressed, they become 7.1 MB in 210 to 450 ms.
    """
    with atomic_write(Path(path)) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")  # its fixed date keeps the time of writing out of the file
            stored = array.dtype.kind == "f" and not compressed
            entry.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)


def write_exr(
    path: AnyPath, *views: Mapping[str, NDArray[Any]], names: Sequence[str] = (),
    attributes: Sequence[Mapping[str, Any]] = (),
) -> None:  # fmt: skip
    """Write named channels (rows, columns) of each view in an OpenEXR file with lossless compression.

    float16 is stored as it is, uint16 as uint32, and all other types as float32. names: names of the views; () for a
    single view. Each view is a part with the attribute `view`, as in OpenEXR since version 2.0. attributes: standard
    attributes of each view, such as {"aperture": 2.8}.
    """
    exr = import_extra(path, "OpenEXR", "exr")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    types = {"float16": "float16", "uint16": "uint32"}
    pixels = [
        {name: np.ascontiguousarray(plane, types.get(plane.dtype.name, "float32")) for name, plane in view.items()}
        for view in views
    ]
    headers = [{**header, **about} for about in attributes or [{}] * len(views)]
    if names:
        parts = zip(names, headers, pixels, strict=True)
        content = exr.File([exr.Part({**about, "view": name}, planes, name=name) for name, about, planes in parts])
    else:
        (planes,), (about,) = pixels, headers
        content = exr.File(about, planes)
    errors: list[OSError] = []  # as OpenEXR ignores errors in its last write, the table of lines
    with atomic_write(Path(path)) as file:

        def write(part: bytes) -> int:
            try:
                return file.write(part)
            except OSError as error:
                errors.append(error)
                raise

        content.write(SimpleNamespace(write=write, seek=file.seek, tell=file.tell))
        if errors:
            raise errors[0]


def write_json(path: AnyPath, content: Mapping[str, Any]) -> None:
    """Write a JSON file. Raises FileError if a number is not finite, or the file cannot be written."""
    with atomic_write(Path(path)) as file:
        file.write(json.dumps(content, indent=2, allow_nan=False).encode() + b"\n")


def write_exr_image(path: AnyPath, image: NDArray[np.floating], color: Color = SRGB) -> None:
    """Write an image (rows, columns[, 3 or 4]) as channels R G B, and A if it has four; gray fills R, G and B, because
    some readers need them.
    """
    names = "RGB" if image.ndim == 2 else "RGBA"[: image.shape[2]]
    planes = {name: image if image.ndim == 2 else image[..., n] for n, name in enumerate(names)}
    write_exr(path, planes, attributes=[color.exr_attributes()])


@dataclass(frozen=True)
class ImageWriter:
    """Writer of images with one file extension.

    label: name with its article, for messages. write: function of a path, an image of codes or of linear float32, and,
    unless `color_kinds` is empty, a color space. code_bits: most bits of a code, 0 if the format has no codes. needs: a
    module, and the extra of clsco that installs it. color_kinds: attributes of `Color` that the format can store.
    """

    label: str
    write: Callable[..., None]
    code_bits: int
    floats: bool
    needs: tuple[str, str] | None = None
    color_kinds: tuple[str, ...] = ()

    def save(self, path: Path, image: NDArray[Any], color: Color) -> None:
        """Write an image, with its color space as far as the format can store it."""
        self.write(path, image, *([color] if self.color_kinds else []))

    def loss(self, color: Color) -> str:
        """Note that a file of this format cannot store a color space; "" if it can."""
        if color.is_plain or any(getattr(color, kind) for kind in self.color_kinds):
            return ""
        return f"{self.label} has no place for the color profile {color.name}, which is left out"


_TIFF = ImageWriter("a TIFF", write_tiff, 16, True, ("tifffile", "formats"), ("icc", "chromaticities"))
# One row for each extension; commands that write one image take their formats from here.
WRITERS = {
    ".png": ImageWriter("a PNG", write_png, 16, False, color_kinds=("icc", "chunks", "chromaticities")),
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".exr": ImageWriter("an EXR", write_exr_image, 0, True, ("OpenEXR", "exr"), ("chromaticities",)),
}


def writer_for(path: Path) -> ImageWriter:
    """Writer for a path's extension. Raises MissingDependencyError if the extra that it needs is missing."""
    writer = WRITERS[path.suffix.lower()]
    if writer.needs is not None:
        import_extra(path, *writer.needs)
    return writer


def save_image(path: AnyPath, image: NDArray[np.float32], bits: int = 16, color: Color = SRGB) -> None:
    """Write an image (rows, columns[, 3]) of linear radiance as PNG, TIFF or EXR, according to the path's extension.
    bits: bits of the codes of a PNG, 8 or 16; 32 gives 16. Raises MissingDependencyError, FileError.
    """
    to, ending = Path(path), Path(path).suffix.lower()
    if ending not in WRITERS:
        known = ", ".join((*WRITERS, ".npz"))
        raise_file_error(to, f"the extension must be one of {known}", ending or "none")
    writer = writer_for(to)
    writer.save(to, image if writer.floats else encode(image, min(bits, 16), "srgb"), color)
