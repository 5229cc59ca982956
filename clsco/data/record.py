"""One sample of a data set: its arrays by name, and their description."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsco import __version__
from clsco.errors import FileError, SceneError
from clsco.files.color import exr_color
from clsco.files.images import WRITERS, save_image, write_npz
from clsco.files.ranges import check_values
from clsco.files.transfer import decode, encode
from clsco.frame.frame import Frame
from clsco.frame.notebook import codes_to_show, html_to_show
from clsco.frame.outputs import ATTRIBUTES, FILE_NAMES, OF_THE_IMAGE, OUTPUTS
from clsco.frame.truth_files import FLOATS, parse_types, to_float16
from clsco.optics.resolved_view import without_lens

if TYPE_CHECKING:
    from clsco.data.distribution import Sample
    from clsco.scene.model import Scene

CODES = {"uint8": 8, "uint16": 16}
PICTURES = ("color", "sharp")  # arrays that can be stored as codes
OF_THE_LENS = frozenset(FILE_NAMES[name] for name in (*OF_THE_IMAGE, "blur_radius", "throughput"))
_VARIANT = re.compile(r"v\d{2,}")
# Keys of a frame's metadata that depend only on the scene, not on memory, devices or clocks.
_OF_FRAMES = (
    "frame", "samples", "intermediate", "bits", "precision", "blur_method", "approximation", "chromaticities",
    "check",
)  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Record(Mapping[str, NDArray[Any]]):
    """One sample: a mapping of names to arrays, which the default collation of PyTorch accepts.

    Attributes
    ----------
    key : str
        Number of the sample in nine digits.
    arrays : mapping of str to ndarray
        Arrays by their names in files, such as "color" or "coc". Names of a sample with several frames are like
        "f0003.depth", with a stereo pair "left.color", with variants "v01.color", with all three
        "v01.f0003.left.color". If variants differ only in lens and sensor, arrays that do not depend on these, such as
        "depth" and "mask", are stored once. Images are codes (uint8 or uint16) or linear floats.
    meta : mapping
        Content of the sample's JSON: number, seed, split, attempts, version, parameters, scene, labels and `frames`;
        and `arrays`, with dtype, shape, unit and convention of each array. For codes, it also has the transfer curve
        and `clipped`, the share of clipped values.

    Examples
    --------
    >>> import clsco.data
    >>> record = clsco.data.open("DATA")[0]
    >>> record["depth"].dtype, record.radiance("color").shape, record.image("color").dtype
    (dtype('float32'), (9, 12, 3), dtype('uint8'))
    >>> "color" in record, len(record) == len(record.arrays)
    (True, True)
    """

    key: str
    arrays: Mapping[str, NDArray[Any]]
    meta: Mapping[str, Any]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """An array by its name. Raises KeyError, whose message lists the names that exist."""
        try:
            return self.arrays[name]
        except KeyError:
            known = ", ".join(self.arrays) or "none"
            raise KeyError(f"record {self.key}: must be one of {known}; got {name}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)

    __eq__, __hash__ = object.__eq__, object.__hash__  # by identity, because `array == array` is no single bool

    def __repr__(self) -> str:
        arrays = (f"{name} {'x'.join(map(str, array.shape))} {array.dtype}" for name, array in self.arrays.items())
        split = str(self.meta.get("split") or "")
        return f"<Record {self.key!r}{f' of {split!r}' if split else ''}: {', '.join(arrays) or 'no arrays'}>"

    def image(self, name: str = "color") -> NDArray[np.uint8]:
        """An image as 8-bit codes of sRGB, for `matplotlib.pyplot.imshow`, Pillow and OpenCV.

        Parameters
        ----------
        name : str
            Name of the image, such as "color", or "left.sharp" in a stereo pair.

        Returns
        -------
        ndarray of uint8, (rows, columns, 3)

        Raises
        ------
        KeyError
            The record has no such array.
        SceneError
            The array is no image, such as "depth".
        """
        return codes_to_show(self._light(name))

    def save(self, path: str | os.PathLike[str], name: str = "color") -> None:
        """Write one image, or all arrays, to a file.

        Parameters
        ----------
        path : path
            A .png stores 16-bit sRGB codes; .tif, .tiff and .exr store linear float32; .npz stores all arrays as they
            are in the record.
        name : str
            Name of the image; not used for .npz.

        Raises
        ------
        KeyError
            The record has no such array.
        SceneError
            The array is no image, but the format stores only codes.
        FileError
            The extension is unknown, the extra that the format needs is missing, or the file cannot be written.
        """
        if Path(path).suffix.lower() == ".npz":
            write_npz(path, self.arrays)
        else:
            prefix = name.removesuffix(name.rpartition(".")[2])
            frames = [each for each in self.meta["frames"] if each["prefix"].endswith(prefix)]
            known = [each.get("chromaticities", ()) for each in frames]
            writer = WRITERS.get(Path(path).suffix.lower())
            values = self.radiance(name) if writer is None or writer.floats else self._light(name)
            save_image(path, values, color=exr_color(next(iter(known), ())))

    def pictures(self) -> dict[str, NDArray[np.float32]]:
        """Linear radiance of each image of the record, by the image's name."""
        return {name: self.radiance(name) for name in self.arrays if name.rpartition(".")[2] in PICTURES}

    def _repr_html_(self) -> str:
        """The text of `repr` and the images, for notebooks."""
        return html_to_show(repr(self), list(self.pictures().values())[:8])

    def radiance(self, name: str = "color") -> NDArray[np.float32]:
        """Linear radiance (1 = white) of an image, which may be stored as codes or as floats.

        Parameters
        ----------
        name : str

        Returns
        -------
        ndarray of float32, (rows, columns[, 3])
        """
        return decode(self[name], self.meta["arrays"][name].get("transfer", "linear")).astype(np.float32)

    def stacked(self) -> Record:
        """A record in which arrays of variants are stacked: "color" (variants, rows, columns[, 3]) replaces
        "v00.color", "v01.color" and so on.

        Returns
        -------
        Record
            Arrays that variants share, such as "depth", stay as they are. Without variants, it is the record itself.

        Raises
        ------
        FileError
            Arrays of the variants differ in size or type.
        """
        arrays, about = dict[str, NDArray[Any]](), dict[str, Any]()
        for name in self.arrays:
            variant, _, rest = name.partition(".")
            if not _VARIANT.fullmatch(variant):
                arrays[name], about[name] = self.arrays[name], self.meta["arrays"][name]
            elif rest not in arrays:
                layers = [array for each, array in self.arrays.items() if _without_variant(each) == rest != each]
                if len({(layer.shape, layer.dtype) for layer in layers}) > 1:
                    raise FileError(f"record {self.key}: {rest} must be alike in all variants; got several sizes")
                arrays[rest] = np.stack(layers)
                about[rest] = {**self.meta["arrays"][name], "shape": list(arrays[rest].shape), "stacked": True}
        return Record(self.key, arrays, {**self.meta, "arrays": about}) if arrays.keys() != self.arrays.keys() else self

    def _light(self, name: str) -> NDArray[np.float32]:
        """Linear radiance of an image. Raises SceneError for other arrays."""
        radiance = self.radiance(name)
        if name.rpartition(".")[2] not in PICTURES:
            raise SceneError(f"name: must be an image, {' or '.join(PICTURES)}; got {name}, which is no light")
        return radiance

    def sha256(self) -> dict[str, str]:
        """SHA-256 of dtype, shape and bytes of each array, by the array's name; it does not depend on the container."""
        return {name: array_sha256(array) for name, array in self.arrays.items()}


def array_sha256(array: NDArray[Any]) -> str:
    """SHA-256, hexadecimal, of an array's dtype, shape and bytes, which are taken in C order and little endian."""
    plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    digest = hashlib.sha256(f"{array.dtype.name} {','.join(map(str, array.shape))}\n".encode())
    digest.update(plain.data.cast("B"))
    return digest.hexdigest()


def is_named(name: str, names: Collection[str] | None) -> bool:
    """True if `names` is None, or contains an array's full name, like "left.color", or its kind, like "color"."""
    return names is None or name in names or name.rpartition(".")[2] in names


def parse_stored(text: str) -> dict[str, str]:
    """Parse a text such as "color=float32,depth=float16" or "all=float16"; returns the stored type of each array.

    Images can be codes (uint8, or by default uint16) or linear floats (float32 or float16). Other float arrays can be
    float32 (default) or float16. Raises SceneError with one message per invalid entry.
    """
    known = {name: (*FLOATS, *(CODES if name in PICTURES else ())) for name in ATTRIBUTES}
    return parse_types(text, known)


def make_record(
    sample: Sample, seed: int, frames: Sequence[Sequence[Frame]], names: Collection[str],
    stored: Mapping[str, str] | None = None,
) -> Record:  # fmt: skip
    """Make the record of a sample from the frames of each variant. In a stereo pair, the left view is first.

    names: names of the arrays in files; arrays that a frame does not have, such as `uv` without a texture, are left
    out. stored: types from `parse_stored`. Raises FileError if an image to be stored as codes is not finite, or a value
    is too large for float16.

    Codes are clipped at white, as in a sensor, and at black, because interpolated textures may be negative at an edge.
    `meta["arrays"][name]["clipped"]` is the share of clipped values. Floats are not clipped.
    """
    types = dict.fromkeys(PICTURES, "uint16") | dict(stored or {})
    arrays: dict[str, NDArray[Any]] = {}
    about: dict[str, dict[str, Any]] = {}
    described = []
    several = len({frame.index for views in frames for frame in views}) > 1
    chosen = [name for name in FILE_NAMES.values() if name in names]
    for variant, (views, scene) in enumerate(zip(frames, sample.scenes, strict=True)):
        stereo = len({frame.eye for frame in views}) > 1
        for frame in views:
            parts = [f"v{variant:02d}"] if len(frames) > 1 else []
            parts += [f"f{frame.index:04d}"] if several else []
            parts += [frame.eye] if stereo else []
            held = frame.arrays()
            for name in chosen:
                if (array := held.get(name)) is None:
                    continue
                whole = ".".join([*parts, name])
                where = f"sample {sample.number}: {whole}"
                arrays[whole], about[whole] = _stored(where, name, array, types.get(name), scene.image.transfer)
            known = {name: frame.metadata[name] for name in _OF_FRAMES if name in frame.metadata}
            described.append({"prefix": "".join(f"{part}." for part in parts), "eye": frame.eye, **known})
    first, *others = map(_without_blur, sample.scenes)
    if others and all(other == first for other in others):
        _share(arrays, about)
    meta = {
        "number": sample.number, "seed": seed, "split": sample.split, "attempts": sample.attempts,
        "version": __version__, "parameters": sample.parameters, "labels": list(sample.labels), "scene": sample.table,
        "arrays": about, "frames": described,
    }  # fmt: skip
    return Record(f"{sample.number:09d}", arrays, meta)


def _without_blur(scene: Scene) -> Scene:
    """The scene without lens, PSF and sensor. It is equal for two scenes if their rays meet the same surfaces."""
    return without_lens(scene).model_copy(update={"psf": None, "aperture": None})


def _without_variant(name: str) -> str:
    """The name of an array without "v01."."""
    variant, _, rest = name.partition(".")
    return rest if _VARIANT.fullmatch(variant) else name


def _share(arrays: dict[str, NDArray[Any]], about: dict[str, dict[str, Any]]) -> None:
    """Store an array once, as "depth" for "v00.depth", if it is equal in all variants and independent of the lens."""
    groups: dict[str, list[str]] = {}
    for name in arrays:
        groups.setdefault(_without_variant(name), []).append(name)
    for rest, (first, *others) in groups.items():
        if rest.rpartition(".")[2] in OF_THE_LENS:
            continue
        if all(array_sha256(arrays[name]) == array_sha256(arrays[first]) for name in others):
            arrays[rest], about[rest] = arrays[first], about[first]
            for name in (first, *others):
                del arrays[name], about[name]


def _stored(
    where: str, name: str, array: NDArray[Any], dtype: str | None, transfer: str
) -> tuple[NDArray[Any], dict[str, Any]]:
    """An array converted to its stored type, and its description; where: name of the array in messages."""
    output = OUTPUTS[ATTRIBUTES[name]]
    more: dict[str, Any] = {}
    if dtype in CODES:
        bits = CODES[dtype]
        half = 0.5 / (2**bits - 1)  # values that round to white or black do not count as clipped
        check_values(where, "radiance must be a finite number", array, ~np.isfinite(array))
        # Values below black: at edges, the sharpened cubic interpolation of textures undershoots the texels.
        beyond = np.count_nonzero((array > 1 + half) | (array < -half))
        more = {"transfer": transfer, "clipped": float(beyond / array.size)}
        array = encode(array, bits, transfer)
    elif dtype == "float16":
        array = to_float16(where, array)
    about = {"dtype": array.dtype.name, "shape": list(array.shape), "unit": output.unit, "convention": output.about}
    return np.ascontiguousarray(array), about | more
