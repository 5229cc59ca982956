"""The formats in which a shard stores its samples, by name."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec

from clsco.data.containers import hdf5, npz, webdataset, zarr3
from clsco.data.containers.base import NEEDS
from clsco.data.containers.base import Container as Container
from clsco.data.containers.base import ShardReader as ShardReader
from clsco.errors import MissingDependencyError, SceneError

DEFAULT = "webdataset"
# One row for each format; the commands take the names of formats from here. Formats with "+raw" compress nothing.
CONTAINERS = {
    container.name: container
    for container in (
        Container("webdataset", ".tar", webdataset.write, webdataset.TarReader, NEEDS),
        Container("webdataset+raw", ".tar", partial(webdataset.write, raw=True), webdataset.TarReader),
        Container("npz", "", npz.write, npz.NpzReader),
        Container("npz+raw", "", partial(npz.write, raw=True), npz.NpzReader),
        Container("hdf5", ".h5", hdf5.write, hdf5.Hdf5Reader, hdf5.NEEDS),
        Container("hdf5+raw", ".h5", partial(hdf5.write, raw=True), hdf5.Hdf5Reader, hdf5.NEEDS),
        Container("zarr", ".zarr", zarr3.write, zarr3.ZarrReader, zarr3.NEEDS),
        Container("zarr+raw", ".zarr", partial(zarr3.write, raw=True), zarr3.ZarrReader, zarr3.NEEDS),
    )
}


def container_named(name: str) -> Container:
    """The container with a name. Raises SceneError for an unknown name, MissingDependencyError for a missing extra."""
    if name not in CONTAINERS:
        raise SceneError(f"format: must be one of {', '.join(CONTAINERS)}; got {name}")
    container = CONTAINERS[name]
    if container.needs is not None and find_spec(container.needs[0]) is None:
        module, extra = container.needs
        raise MissingDependencyError(f"format: {name} needs {module}: pip install 'clsco[{extra}]'; got no such module")
    return container
