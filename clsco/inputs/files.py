"""Cache of textures and depth maps: each file is decoded once per content."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from stat import S_ISREG
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clsco.cache import Cache
from clsco.files import transfer as transfer_curves
from clsco.files.array_cache import ArrayCache, user_cache
from clsco.files.atomic import sha256
from clsco.files.color import Color
from clsco.inputs import textures
from clsco.inputs.depth_maps import DepthValues, depth_numbers, load_scene_depths, map_values
from clsco.inputs.pupils import scale_radiance, scene_point_spread
from clsco.inputs.textures import PATTERNS, Texture, aligned, load_scene_textures, load_texture, picture_of
from clsco.optics.distortion import Distortion
from clsco.optics.point_spread import PointSpread, exposure_factor
from clsco.resources import code_digest
from clsco.scene.arrays import ArrayInput, Input, LayerInput
from clsco.scene.model import DepthMap, Scene
from clsco.scene.texture_keys import is_drawn

if TYPE_CHECKING:
    from clsco.files.images import Picture

CACHE_BYTES = 2**29  # size of a depth map of 8192 x 8192
MOST_BYTES = 2**31  # largest size of a file that is identified by its content; larger files are not cached
SETTLED_NS = 10**8  # ns after a change of a file during which another change may leave its time stamps the same
V = TypeVar("V")
Maps = tuple[NDArray[np.float64] | None, ...]


class About(NamedTuple):
    """Properties of an image without its pixels: True if it is gray, its color space, and `Picture.notes`."""

    is_gray: bool
    color: Color
    notes: tuple[str, ...]


class InputFiles:
    """Decoded files of scenes. Threads may share it.

    limit: memory limit in bytes, beyond which the least recently used files are evicted. Files and arrays in memory are
    identified by their content: a copy is not decoded again, but a changed file or array is.
    """

    def __init__(self, limit: int = CACHE_BYTES) -> None:
        self.cache = Cache(limit)
        self._digests: dict[str, tuple[tuple[int, ...], str]] = {}

    def textures(self, scene: Scene) -> tuple[Texture, ...]:
        """The texture of each object, in linear radiance; projected textures have the size of the frame.

        With `aperture.exposure = "area"`, radiance is multiplied by the light that the aperture transmits, relative to
        an open circle. Raises FileError as `clsco.inputs.textures.load_texture`.
        """
        loaded = load_scene_textures(scene, self.texture, lambda image: self.about(image).color)[1]
        if scene.aperture.exposure == "normalized":
            return loaded
        return scale_radiance(loaded, exposure_factor(scene.aperture, self.point_spread(scene)))

    def maps(self, scene: Scene) -> Maps:
        """The result of `clsco.inputs.depth_maps.load_scene_depths`, each map computed once per content and camera."""
        return load_scene_depths(scene, self.map)

    def point_spread(self, scene: Scene) -> PointSpread:
        """The result of `clsco.inputs.pupils.scene_point_spread`, with the same FileError."""
        return scene_point_spread(scene, self.picture)

    def texture(
        self, source: Input, transfer: str, size: tuple[int, int] | None = None, to_srgb: bool = False
    ) -> Texture:  # fmt: skip
        """The result of `clsco.inputs.textures.load_texture`, loaded once per content, transfer, size and primaries."""
        drawn = is_drawn(source)
        content: Hashable | None = source if drawn else self._content(source)
        if content is None:
            return load_texture(source, transfer, size, to_srgb)
        key = ("texture", content, transfer, size, to_srgb and not drawn)
        cached = self.cache.get(
            key, lambda: self._texture(source, transfer, size, to_srgb, key), lambda texture: texture.radiance.nbytes
        )
        return cached if cached.source == str(source) else replace(cached, source=str(source))

    def _texture(
        self, source: Input, transfer: str, size: tuple[int, int] | None, to_srgb: bool, key: Hashable
    ) -> Texture:  # fmt: skip
        if source in PATTERNS:
            return Texture(self._pattern(str(source), transfer, size), 8, str(source), key)
        return replace(load_texture(source, transfer, size, to_srgb, self.picture), content=key)

    @cached_property
    def _drawn(self) -> ArrayCache:
        """Cache of patterns on disk; its folder is made only when a pattern is drawn."""
        return user_cache("textures")

    def _pattern(self, name: str, transfer: str, size: tuple[int, int] | None) -> NDArray[np.float32]:
        """A built-in pattern, read from the disk cache if possible."""
        key = f"{_code()} {name} {transfer} {size}"
        arrays = self._drawn.get(key)
        if arrays is not None and arrays.keys() == {"radiance"}:
            return aligned(arrays["radiance"])
        radiance = load_texture(name, transfer, size).radiance
        self._drawn.put(key, {"radiance": radiance})
        return radiance

    def picture(self, source: Input) -> Picture:
        """The result of `clsco.inputs.textures.picture_of`, computed once per content."""
        return self._once("picture", source, lambda: picture_of(source), lambda picture: picture.data.nbytes)

    def about(self, source: Input) -> About:
        """Properties of `picture` without its pixels, read once per content."""

        def read() -> About:
            picture = self.picture(source)
            return About(picture.data.ndim == 2, picture.color, picture.notes())

        return self._once("about", source, read, lambda about: about.color.size)

    def depth(self, source: Input) -> NDArray[Any]:
        """The result of `clsco.inputs.depth_maps.depth_numbers`, computed once per content."""
        return self._once("depth", source, lambda: depth_numbers(source), lambda array: array.nbytes)

    def map(self, scene: Scene, item: DepthMap) -> NDArray[np.float64]:
        """Inverse depth (rows, columns) in 1/mm of an object, see `depth_values`."""
        return self.depth_values(scene, item).inverse_depth

    def depth_values(self, scene: Scene, item: DepthMap) -> DepthValues:
        """The result of `clsco.inputs.depth_maps.map_values` for an object, computed once per content and camera."""
        source, texture = item.inputs()["depth"], item.inputs()["texture"]
        content, picture = self._content(source), texture if is_drawn(texture) else self._content(texture)

        def image() -> NDArray[np.float32]:
            return self.texture(texture, scene.image.transfer, scene.camera.resolution).radiance

        known = None if picture is None else image  # a pipe is read once only
        if content is None:
            return map_values(scene, item, depth_numbers(source), known)
        kinds = item.depth_kind, item.no_depth, scene.fill.method == "none"
        numbers = item.unit, item.scale, item.baseline, item.offset, item.near, item.far
        seen = (picture, scene.image.transfer) if item.soft_edges == "assign" else None
        return self.cache.get(
            ("inverse depth", content, numbers, Distortion.of(scene.lens), kinds, seen, scene.camera.model_dump_json()),
            lambda: map_values(scene, item, self.depth(source), known),
            lambda values: values.inverse_depth.nbytes,
        )

    def digest(self, path: str) -> str:
        """SHA-256 of a file, computed again only if the file changes. Raises OSError if it cannot be read."""
        stamp, known = _stamp(path), self._digests.get(path)
        if known is not None and known[0] == stamp:
            return known[1]
        computed = sha256(Path(path))
        if stamp == _stamp(path) and time.time_ns() - max(stamp[-2:]) > SETTLED_NS:
            self._digests[path] = stamp, computed
        return computed

    def _once(self, what: str, source: Input, read: Callable[[], V], size: Callable[[V], int]) -> V:
        content = self._content(source)
        if content is None or isinstance(source, ArrayInput):  # arrays stay in memory with their scene anyway
            return read()
        beyond = self.cache.limit + 1  # a size above the limit: content of a file that changed meanwhile is not cached
        return self.cache.get((what, content), read, lambda v: size(v) if self._content(source) == content else beyond)

    def _content(self, source: Input) -> Hashable | None:
        """Key of an array, or of a file with its extension and layer; None for what must not be cached, as a pipe."""
        if isinstance(source, ArrayInput):
            return "array", source.sha256
        path, layer = str(source), source.layer if isinstance(source, LayerInput) else None
        try:
            state = Path(path).stat()
            if not S_ISREG(state.st_mode) or state.st_size > MOST_BYTES:
                return None
            return self.digest(path), Path(path).suffix.lower(), layer
        except (OSError, ValueError):
            return None  # the error is raised when the file is read


@cache
def _code() -> str:
    """Digest of the code that patterns depend on."""
    return code_digest(textures, transfer_curves)


@cache
def shared_files() -> InputFiles:
    """The files that renderings in this process share by default."""
    return InputFiles()


def _stamp(path: str) -> tuple[int, ...]:
    """Numbers that change when a file does: device, inode, size in bytes, times of content and status in ns."""
    state = Path(path).stat()
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns
