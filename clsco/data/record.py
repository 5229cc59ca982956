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
from clsco.plan.predict import without_lens

if TYPE_CHECKING:
    from clsco.data.distribution import Sample
    from clsco.scene.model import Scene

CODES = {"uint8": 8, "uint16": 16}
PICTURES = ("color", "sharp")  # arrays that can be stored as codes
OF_THE_LENS = frozenset(FILE_NAMES[name] for name in (*OF_THE_IMAGE, "blur_radius", "throughput"))
_VARIANT = re.compile(r"v\d{2,}")
# Of a frame's metadata what depends on its scene alone, not on memory, devices or clocks.
_OF_FRAMES = (
    "frame", "samples", "intermediate", "bits", "precision", "blur_method", "approximation", "chromaticities",
    "check",
)  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Record(Mapping[str, NDArray[Any]]):
    """One sample: a mapping of its arrays by name, which the default collation of PyTorch takes.

    Attributes
    ----------
    key : str
        Number of the sample in nine digits.
    arrays : mapping of str to ndarray
        By name in files, such as "color" or "coc". With several frames "f0003.depth", with a stereo pair "left.color",
        with variants "v01.color", with all three "v01.f0003.left.color". Variants that differ only in lens and sensor
        share other arrays, such as "depth" and "mask". Images are codes, uint8 or uint16, or linear floats.
    meta : mapping
        Content of the sample's JSON: number, seed, split, attempts, version, parameters, scene, labels; `arrays`, with
        dtype, shape, unit and convention of each, for codes also transfer curve and `clipped` share; and `frames`.

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
        """An array by its name; raises KeyError, which lists the names that exist."""
        try:
            return self.arrays[name]
        except KeyError:
            known = ", ".join(self.arrays) or "none"
            raise KeyError(f"record {self.key}: must be one of {known}; got {name}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)

    __eq__, __hash__ = object.__eq__, object.__hash__  # by identity: arrays have no truth

    def __repr__(self) -> str:
        arrays = (f"{name} {'x'.join(map(str, array.shape))} {array.dtype}" for name, array in self.arrays.items())
        split = str(self.meta.get("split") or "")
        return f"<Record {self.key!r}{f' of {split!r}' if split else ''}: {', '.join(arrays) or 'no arrays'}>"

    def image(self, name: str = "color") -> NDArray[np.uint8]:
        """An image as 8-bit codes of sRGB, for `matplotlib.pyplot.imshow`, Pillow and OpenCV.

        Parameters
        ----------
        name : str
            Such as "color", or of a stereo pair "left.sharp".

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
            .png in sRGB codes of 16 bits, .tif, .tiff and .exr in linear float32; .npz holds all arrays as they are
            stored.
        name : str
            Name of the image.

        Raises
        ------
        KeyError
            The record has no such array.
        SceneError
            The array is no image, and the format stores codes.
        FileError
            The extension is another one, the extra that the format needs is missing, or the file cannot be written.
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
        """Linear radiance of each image of the record, by its name."""
        return {name: self.radiance(name) for name in self.arrays if name.rpartition(".")[2] in PICTURES}

    def _repr_html_(self) -> str:
        """The line of `print` with the images, for notebooks."""
        return html_to_show(repr(self), list(self.pictures().values())[:8])

    def radiance(self, name: str = "color") -> NDArray[np.float32]:
        """Linear radiance of an image, 1 = white, whether it is stored as codes or as floats.

        Parameters
        ----------
        name : str

        Returns
        -------
        ndarray of float32, (rows, columns[, 3])
        """
        return decode(self[name], self.meta["arrays"][name].get("transfer", "linear")).astype(np.float32)

    def stacked(self) -> Record:
        """The record with the arrays of its variants stacked: "color" (variants, rows, columns[, 3]) instead of
        "v00.color", "v01.color".

        Returns
        -------
        Record
            Arrays that variants share, such as "depth", stay as they are. Without variants, the record itself.

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
        """`radiance` of what codes can show: an image. Raises SceneError for other arrays."""
        radiance = self.radiance(name)
        if name.rpartition(".")[2] not in PICTURES:
            raise SceneError(f"name: must be an image, {' or '.join(PICTURES)}; got {name}, which is no light")
        return radiance

    def sha256(self) -> dict[str, str]:
        """SHA-256 of each array's dtype, shape and bytes, which do not depend on the format."""
        return {name: array_sha256(array) for name, array in self.arrays.items()}


def array_sha256(array: NDArray[Any]) -> str:
    """SHA-256 in hexadecimal of dtype, shape and bytes, in C order and little endian."""
    plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    digest = hashlib.sha256(f"{array.dtype.name} {','.join(map(str, array.shape))}\n".encode())
    digest.update(plain.data.cast("B"))
    return digest.hexdigest()


def is_named(name: str, names: Collection[str] | None) -> bool:
    """True if `names`, or None for all, include an array by its full name or its kind: "left.color" is a "color"."""
    return names is None or name in names or name.rpartition(".")[2] in names


def parse_stored(text: str) -> dict[str, str]:
    """Types in which arrays are stored, by name, from a text such as "color=float32,depth=float16", or "all=float16".

    Images can be codes, uint8 or uint16 (default), or linear floats; other float arrays can be float32 (default) or
    float16. Raises SceneError with one message per invalid entry.
    """
    known = {name: (*FLOATS, *(CODES if name in PICTURES else ())) for name in ATTRIBUTES}
    return parse_types(text, known)


def make_record(
    sample: Sample,
    seed: int,
    frames: Sequence[Sequence[Frame]],
    names: Collection[str],
    stored: Mapping[str, str] | None = None,
) -> Record:
    """Make the record of a sample from the frames of each variant; of a stereo pair, the left view is first.

    names: arrays as in files; an array that a frame does not have is left out, such as `uv` without a texture. stored:
    types as `parse_stored` gives them. Raises FileError: radiance that is not finite, or floats beyond float16.

    Codes are clipped at white, as in a sensor, and at black, which interpolated textures may undershoot at an edge.
    Clipping is not an error: `meta["arrays"][name]["clipped"]` is the share of clipped values. float32 is not clipped.
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
        "number": sample.number,
        "seed": seed,
        "split": sample.split,
        "attempts": sample.attempts,
        "version": __version__,
        "parameters": sample.parameters,
        "labels": list(sample.labels),
        "scene": sample.table,
        "arrays": about,
        "frames": described,
    }
    return Record(f"{sample.number:09d}", arrays, meta)


def _without_blur(scene: Scene) -> Scene:
    """The scene without its lens, PSF and sensor: equal for scenes whose rays meet the same surfaces."""
    return without_lens(scene).model_copy(update={"psf": None, "aperture": None})


def _without_variant(name: str) -> str:
    """The name of an array without "v01."."""
    variant, _, rest = name.partition(".")
    return rest if _VARIANT.fullmatch(variant) else name


def _share(arrays: dict[str, NDArray[Any]], about: dict[str, dict[str, Any]]) -> None:
    """Store arrays that do not depend on the lens, and are equal in all variants, once: "depth" for "v00.depth"."""
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
    """An array in its stored type, and its description."""
    output = OUTPUTS[ATTRIBUTES[name]]
    more: dict[str, Any] = {}
    if dtype in CODES:
        bits = CODES[dtype]
        half = 0.5 / (2**bits - 1)  # what rounds to white or black is not clipped
        check_values(where, "radiance must be a finite number", array, ~np.isfinite(array))
        # Below black: where the cubic between texels, and what sharpens it, goes below them at an edge.
        beyond = np.count_nonzero((array > 1 + half) | (array < -half))
        more = {"transfer": transfer, "clipped": float(beyond / array.size)}
        array = encode(array, bits, transfer)
    elif dtype == "float16":
        array = to_float16(where, array)
    about = {"dtype": array.dtype.name, "shape": list(array.shape), "unit": output.unit, "convention": output.about}
    return np.ascontiguousarray(array), about | more
