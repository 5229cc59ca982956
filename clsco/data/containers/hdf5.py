"""HDF5: one group per sample, with a dataset for each array, and `meta`, a string of JSON. h5py reads such files."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from clsco.data.containers import base
from clsco.data.record import Record
from clsco.errors import import_extra
from clsco.files.decoder_process import run_decoder
from clsco.resources import open_regular

NEEDS = ("h5py", "data")
_FILE = "clsco.data.containers.hdf5_file"


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new file. The file is made in memory, because HDF5 does not survive a disk that fails.

    raw: True to compress nothing; else arrays are shuffled and deflated (gzip 4), which every build of HDF5 reads.
    Each dataset is flushed at once: HDF5 gives it a place in the file when it is closed, and thus when the last
    reference to it goes, which another thread may hold, such as a profiler.
    """
    h5py = import_extra(path, *NEEDS)
    options = {} if raw else {"shuffle": True, "compression": "gzip", "compression_opts": 4}
    with h5py.File(path.name, "w", track_order=False, driver="core", backing_store=False) as file:
        for record in records:
            group = file.create_group(record.key)
            text = base.meta_bytes(record)
            group.create_dataset("meta", data=text, dtype=h5py.string_dtype("utf-8", len(text)), track_times=False)
            file.flush()
            for name, array in record.items():
                chunks = None if raw else array.shape
                made = group.create_dataset(name, data=array, chunks=chunks, track_times=False, **options)
                if unit := record.meta["arrays"][name]["unit"]:
                    made.attrs["unit"] = unit
                file.flush()
        content = file.id.get_file_image()
    with path.open("xb") as stored:
        stored.write(content)


class Hdf5Reader(base.ShardReader):
    """Records of an HDF5 file."""

    def __init__(self, path: Path) -> None:
        with base.translate_errors(path, "HDF5 file"), open_regular(path) as file:
            about, _ = run_decoder(f"{_FILE}:keys", file, 0)
        super().__init__(path, about["keys"])

    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        key = self.keys[index]
        with base.translate_errors(self.path, "HDF5 file"), open_regular(self.path) as file:
            _, (text,) = run_decoder(f"{_FILE}:meta", file, base.LARGEST_META, key=key)
            meta, layout = base.parsed_meta(self.path, text.tobytes())
            arrays = base.confined_arrays(f"{_FILE}:arrays", file, base.chosen(layout, names), key=key)
        return Record(key, arrays, meta)
