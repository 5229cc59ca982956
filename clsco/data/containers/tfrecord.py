"""TFRecord: an `Example` per sample, with features for TensorFlow's parsers.

Codes and masks are PNG in a list of bytes, for tf.io.decode_png; other arrays are flat lists of float or int64 with
their shape in NAME/shape. Besides there are `__key__` and `meta`, JSON. Read back with the package `tfrecord`.
"""

from __future__ import annotations

import functools
import importlib
import os
import re
import struct
from array import array as numbers
from collections.abc import Callable, Collection, Iterable
from math import prod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers.base import ShardReader, whole
from clsco.data.encoding import LARGEST, decoded, described, is_png, meta_bytes, parsed_meta, png_bytes
from clsco.data.record import Record, is_wanted
from clsco.files.atomic import refuse
from clsco.files.decoders import codec
from clsco.resources import open_regular

NEEDS = ("google_crc32c", "data")
# tensorflow/core/example/feature.proto and example.proto.
_SCHEMA = """
name: "clsco/example.proto" package: "clsco" syntax: "proto3"
message_type { name: "BytesList" field { name: "value" number: 1 label: LABEL_REPEATED type: TYPE_BYTES } }
message_type { name: "FloatList" field { name: "value" number: 1 label: LABEL_REPEATED type: TYPE_FLOAT } }
message_type { name: "Int64List" field { name: "value" number: 1 label: LABEL_REPEATED type: TYPE_INT64 } }
message_type {
  name: "Feature"
  field { name: "bytes_list" number: 1 label: LABEL_OPTIONAL type: TYPE_MESSAGE type_name: ".clsco.BytesList" }
  field { name: "float_list" number: 2 label: LABEL_OPTIONAL type: TYPE_MESSAGE type_name: ".clsco.FloatList" }
  field { name: "int64_list" number: 3 label: LABEL_OPTIONAL type: TYPE_MESSAGE type_name: ".clsco.Int64List" }
}
message_type {
  name: "Features"
  field {
    name: "feature" number: 1 label: LABEL_REPEATED type: TYPE_MESSAGE type_name: ".clsco.Features.FeatureEntry"
  }
  nested_type {
    name: "FeatureEntry"
    field { name: "key" number: 1 label: LABEL_OPTIONAL type: TYPE_STRING }
    field { name: "value" number: 2 label: LABEL_OPTIONAL type: TYPE_MESSAGE type_name: ".clsco.Feature" }
    options { map_entry: true }
  }
}
message_type {
  name: "Example"
  field { name: "features" number: 1 label: LABEL_OPTIONAL type: TYPE_MESSAGE type_name: ".clsco.Features" }
}
"""
_EXACT = ("float16", "float32")  # in a list of float
_KEY = re.compile(rb"\n\x07__key__\x12.\n.\n.(\d+)", re.DOTALL)  # the first feature, as names are in order


def write(path: Path, records: Iterable[Record]) -> None:
    """Write records to a new file, uncompressed.

    Notes
    -----
    The writer of the package `tfrecord` leaves the order of features to chance, and its messages cannot be imported
    beside TensorFlow's.
    """
    pb, checksum = _package(path)
    with open(path, "xb") as file:
        for record in records:
            features = {"__key__": _bytes(pb, record.key.encode()), "meta": _bytes(pb, meta_bytes(record))}
            for name, array in record.arrays.items():
                features |= _features(path, pb, name, array)
            content = pb.Example(features=pb.Features(feature=features)).SerializeToString(deterministic=True)
            size = struct.pack("<Q", len(content))
            file.writelines([size, checksum(size), content, checksum(content)])


@functools.cache
def _messages() -> Any:
    """Classes of `_SCHEMA`, in a pool of their own: beside TensorFlow's a second `Example` would be refused."""
    pool = importlib.import_module("google.protobuf.descriptor_pool").DescriptorPool()
    made = importlib.import_module("google.protobuf.descriptor_pb2").FileDescriptorProto()
    importlib.import_module("google.protobuf.text_format").Parse(_SCHEMA, made)
    pool.Add(made)
    message_class = importlib.import_module("google.protobuf.message_factory").GetMessageClass
    names = [message.name for message in made.message_type]
    return SimpleNamespace(**{name: message_class(pool.FindMessageTypeByName(f"clsco.{name}")) for name in names})


def _package(path: Path) -> tuple[Any, Callable[[bytes], bytes]]:
    """Messages, and the checksum of a part."""
    crc32c = codec(path, *NEEDS).value
    codec(path, "google.protobuf", "data")

    def masked(part: bytes) -> bytes:
        crc = crc32c(part)
        return struct.pack("<I", ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF)

    return _messages(), masked


def _bytes(pb: Any, content: bytes) -> Any:
    return pb.Feature(bytes_list=pb.BytesList(value=[content]))


def _features(path: Path, pb: Any, name: str, array: NDArray[Any]) -> dict[str, Any]:
    if is_png(array.dtype.name, array.shape):
        return {name: _bytes(pb, png_bytes(array))}
    if array.dtype.name in _EXACT:
        plain = array.astype("<f4").tobytes()  # taken as it is in the file: value by value it is 50 ms for 1 MB
        values = pb.Feature(float_list=pb.FloatList.FromString(b"\n" + _varint(len(plain)) + plain))
    elif array.dtype.kind in "iub":
        values = pb.Feature(int64_list=pb.Int64List(value=array.astype(np.int64).ravel()))
    else:
        refuse(path, f"{name} must be of whole numbers, float16 or float32 in a TFRecord", array.dtype)
    return {name: values, f"{name}/shape": pb.Feature(int64_list=pb.Int64List(value=array.shape))}


def _varint(number: int) -> bytes:
    parts = []
    while number > 127:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes([*parts, number])


class TfRecordReader(ShardReader):
    """Records of a TFRecord file: sizes are read once, and no file stays open."""

    def __init__(self, path: Path) -> None:
        self._pb, self._checksum = _package(path)
        self._places, self._sizes = numbers("q"), numbers("q")
        keys: list[str] = []
        with whole(path, "TFRecord file"), open_regular(path) as file:
            end, place = os.fstat(file.fileno()).st_size, 0
            while place < end:
                head = os.pread(file.fileno(), 12, place)
                size = int.from_bytes(head[:8], "little")
                if self._checksum(head[:8]) != head[8:] or size > min(LARGEST, end - place - 16):
                    raise ValueError(f"a record of {size} bytes, or a wrong checksum, at byte {place}")
                self._places.append(place + 12)
                self._sizes.append(size)
                found = _KEY.search(os.pread(file.fileno(), min(size, 64), place + 12))
                if found is None:
                    refuse(path, "each Example must begin with its __key__, a number", f"none at byte {place}")
                keys.append(found[1].decode())
                place += size + 16
        super().__init__(path, keys)

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read a record whole, and convert what is wanted of it."""
        with whole(self.path, "TFRecord file"):
            with open_regular(self.path) as file:
                size = self._sizes[index]
                content = os.pread(file.fileno(), size + 4, self._places[index])
            if len(content) != size + 4 or self._checksum(content[:size]) != content[size:]:
                raise ValueError(f"a wrong checksum of sample {self.keys[index]}")
            feature = self._pb.Example.FromString(content[:size]).features.feature
            meta = parsed_meta(self.path, feature["meta"].bytes_list.value[0])
            arrays = {}
            for name in meta["arrays"]:
                if is_wanted(name, wanted) and name in feature:
                    arrays[name] = self._array(feature[name], described(self.path, meta, name))
        return Record(self.keys[index], arrays, meta)

    def _array(self, feature: Any, about: dict[str, Any]) -> NDArray[Any]:
        dtype, shape = about["dtype"], about["shape"]
        if is_png(dtype.name, shape):
            return decoded(self.path, "png", feature.bytes_list.value[0], about)
        listed = feature.float_list.value if dtype.kind == "f" else feature.int64_list.value
        if len(listed) != prod(shape):
            raise ValueError(f"{len(listed)} values of {shape}")
        return np.array(listed, np.float32 if dtype.kind == "f" else np.int64).astype(dtype).reshape(shape)
