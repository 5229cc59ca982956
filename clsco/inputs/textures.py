"""Textures in linear radiance: built-in patterns, and image files resampled to the frame (pure).

Computed in float64, some rows at a time, and stored in float32, so that even a frame of 8192 x 8192 needs little extra
memory.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import FileError
from clsco.files.color import Color
from clsco.files.transfer import decode, encode
from clsco.inputs.mipmaps import mipmap
from clsco.inputs.resampling import resample, rows_for
from clsco.scene.arrays import ArrayInput, LayerInput
from clsco.scene.model import Scene
from clsco.scene.texture_keys import is_drawn, missing_texture

if TYPE_CHECKING:  # decoders are imported where an image is read
    from clsco.files.images import Picture

DEFAULT_SIDE = 512
ROWS_AT_A_TIME = 128
DECODED, RESAMPLED = 2**16, 2**21  # numbers of values of an image that are decoded, or resampled, at a time
ALIGNMENT = 4096  # bytes; devices in host memory can use an array aligned to this without a copy

Codes = NDArray[np.uint8]
Floats = NDArray[np.float64]
TextureSource = str | os.PathLike[str] | ArrayInput  # a LayerInput is a path


@dataclass(frozen=True, eq=False)
class Texture:
    """Image of a surface, in linear radiance.

    radiance: float32 (rows, columns) or (rows, columns, 3), 1 = white, finite; row 0 on top. bits: number of bits per
    stored value, 8, 16 or 32. source: name of the pattern, path of the file, or the array's name in messages. content:
    key that is equal only for equal radiance; None if unknown. others: for a cube map, the radiance of the sides after
    the first, in the order of `clsco.inputs.mipmaps`.
    """

    radiance: NDArray[np.float32]
    bits: int
    source: str
    content: Hashable = None
    others: tuple[NDArray[np.float32], ...] = ()

    @cached_property
    def brightest(self) -> float:
        """Upper bound of |radiance|: the range of all values and 0, which is the maximum if no value is negative."""
        return max(radiance_span(image) for image in self.images)

    @property
    def images(self) -> tuple[NDArray[np.float32], ...]:
        """The radiance, or the six images of a cube map."""
        return (self.radiance, *self.others)

    def with_images(self, images: Iterable[NDArray[np.float32]], content: Hashable) -> Texture:
        """The texture with other images; content: identifies them, if the content of this texture is known."""
        first, *others = images
        return replace(self, radiance=first, others=tuple(others), content=None if self.content is None else content)

    def mipmap(self, out: NDArray[np.float32], channels: int) -> None:
        """Write all levels of `clsco.inputs.mipmaps.mipmap` to `out`; channels: number of channels in `out`."""
        wide = [image[..., None] if image.ndim == 2 else image for image in self.images]
        mipmap([np.broadcast_to(image, (*image.shape[:2], channels)) for image in wide], out)


def radiance_span(image: NDArray[np.floating]) -> float:
    """Range of an image's radiance, 0 included."""
    return float(image.max(initial=0.0)) - float(image.min(initial=0.0))


def picture_of(source: TextureSource) -> Picture:
    """The picture in a file or in an array. Raises FileError as `load_texture`."""
    from clsco.files.images import Picture, read_image

    if isinstance(source, ArrayInput):
        return Picture(source.array)
    require_suffix(os.fspath(source))
    return read_image(source, layer=source.layer if isinstance(source, LayerInput) else None)


def load_texture(
    source: TextureSource, transfer: str, size: tuple[int, int] | None = None, to_srgb: bool = False,
    read: Callable[[Any], Picture] = picture_of,
) -> Texture:  # fmt: skip
    """Load a built-in pattern, an image file or an array as linear radiance.

    source: bricks, checkerboard, slanted_edge, siemens_star, a color "#rrggbb", a path, or an array. transfer: "srgb"
    or "linear", the curve of 8- and 16-bit images, and of patterns and colors, which have 8 bits. If an image has a
    color profile, its curve replaces "srgb"; floats are linear. size: (rows, columns) of the result. An image of
    another size is resampled (`resample`); a pattern is drawn in this size, by default in 512 x 512. to_srgb: True to
    convert an image to the primaries of sRGB (`Color.to_srgb`). read: `picture_of`, or a replacement. Raises FileError
    if the pattern or file does not exist or cannot be read.
    """
    if is_drawn(source):
        return Texture(radiance_of(str(source), transfer, size), 8, str(source))
    picture = read(source)
    return Texture(radiance_of(picture, transfer, size, to_srgb), picture.bits, str(source))


def radiance_of(
    picture: Picture | str, transfer: str, size: tuple[int, int] | None = None, to_srgb: bool = False
) -> NDArray[np.float32]:  # fmt: skip
    """Linear radiance (rows, columns[, 3]) of a picture or of a named built-in pattern; see `load_texture`.

    Read-only: several scenes may share it.
    """
    if isinstance(picture, str):
        rows, columns = size or (DEFAULT_SIDE, DEFAULT_SIDE)
        if picture not in PATTERNS:
            color = decode(color_codes(picture), transfer).astype(np.float32)
            return aligned(np.broadcast_to(color, (rows, columns, *color.shape)))
        draw = PATTERNS[picture]
        return _by_rows((rows, columns), lambda a, b: decode(draw(rows, columns, a, b), transfer))
    stored, curve = picture.data, picture.color.transfer(transfer)
    matrix = picture.color.to_srgb if to_srgb and stored.ndim == 3 and picture.color.converts(transfer) else None

    def converted(linear: Floats) -> Floats:
        return linear if matrix is None else linear @ matrix.T

    if size is None or stored.shape[:2] == size:
        return _by_rows(stored.shape, lambda a, b: converted(decode(stored[a:b], curve)), _rows_of(stored, DECODED))

    def resampled(first: int, end: int) -> Floats:
        above, below = rows_for(len(stored), size[0], first, end)
        linear = decode(stored[above:below], curve)
        return converted(resample(linear, size, first, end, (above, len(stored))))

    return _by_rows((*size, *stored.shape[2:]), resampled, max(1, _rows_of(stored, RESAMPLED) * size[0] // len(stored)))


def _rows_of(image: NDArray[np.generic], values: int) -> int:
    """Number of rows of an image that hold `values` values in total, at least 1."""
    return max(1, values * len(image) // image.size)


def color_codes(color: str) -> Codes:
    """The codes of a color "#rrggbb", (3,), or () if red, green and blue are equal."""
    codes = np.frombuffer(bytes.fromhex(color[1:]), np.uint8)
    return codes[0, ...] if (codes == codes[0]).all() else codes


def is_gray(name: str) -> bool:
    """Test whether a built-in pattern or a color has one channel."""
    return name in PATTERNS or color_codes(name).ndim == 0


def to_color(texture: Texture) -> Texture:
    """A texture converted to three channels."""
    if texture.radiance.ndim == 3:
        return texture
    images = (np.broadcast_to(image[..., None], (*image.shape, 3)) for image in texture.images)
    return texture.with_images(images, ("color", texture.content))


def select_channels(texture: Texture, channels: tuple[int, ...]) -> Texture:
    """A texture of selected channels; a gray one is returned unchanged."""
    if texture.radiance.ndim == 2:
        return texture
    chosen = channels[0] if len(channels) == 1 else channels
    images = [np.ascontiguousarray(image[..., chosen]) for image in texture.images]
    for image in images:
        image.flags.writeable = False
    return texture.with_images(images, ("channels", texture.content, channels))


def add_coverage(texture: Texture, channels: int, covers: bool) -> Texture:
    """A texture with `channels` channels and a coverage channel: 1 if it `covers` what is behind it, else 0."""
    images = []
    for image in texture.images:
        wider = empty_image((*image.shape[:2], channels + 1))
        wider[..., :channels] = image[..., None] if image.ndim == 2 else image
        wider[..., channels] = covers
        wider.flags.writeable = False
        images.append(wider)
    return texture.with_images(images, ("covering", texture.content, channels, covers))


def _by_rows(
    shape: tuple[int, ...], rows_of: Callable[[int, int], Floats], step: int = ROWS_AT_A_TIME
) -> NDArray[np.float32]:
    """An aligned float32 image of the given shape, computed `step` rows at a time.

    rows_of(first, end): returns the rows from `first` to before `end`.
    """
    image = empty_image(shape)
    for first in range(0, shape[0], step):
        end = min(first + step, shape[0])
        image[first:end] = rows_of(first, end)
    image.flags.writeable = False
    return image


def aligned(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """A copy of an image, aligned so that devices in host memory can use it; read-only."""
    copy = empty_image(image.shape)
    copy[...] = image
    copy.flags.writeable = False
    return copy


def empty_image(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An uninitialized image, aligned so that devices in host memory can use it."""
    image = np.empty(4 * math.prod(shape) + ALIGNMENT, np.uint8)
    start = -image.ctypes.data % ALIGNMENT
    return image[start : start + 4 * math.prod(shape)].view(np.float32).reshape(shape)


def texture_size(source: TextureSource) -> tuple[int, int]:
    """Size (columns, rows) of a texture in px, from its file's header. Raises FileError as `load_texture`."""
    if is_drawn(source):
        return DEFAULT_SIDE, DEFAULT_SIDE
    if isinstance(source, ArrayInput):
        return source.array.shape[1], source.array.shape[0]
    from clsco.files.images import image_size

    require_suffix(os.fspath(source))
    return image_size(source)


def image_files(scene: Scene) -> list[str | LayerInput]:
    """Image files of all objects, or layers of them, without duplicates."""
    named = (item.inputs()[key] for item in scene.objects for key in item.files() if key != "depth")
    return [image for image in dict.fromkeys(named) if not isinstance(image, ArrayInput)]


def load_scene_textures(
    scene: Scene, load: Callable[..., Texture] = load_texture,
    color: Callable[[str | LayerInput], Color] = lambda image: picture_of(image).color,
) -> tuple[Scene, tuple[Texture, ...]]:  # fmt: skip
    """Load the textures of all objects, each file once.

    Projected textures get the size of the frame; textures on surfaces keep their size. If images have different color
    profiles, all are converted to the primaries of sRGB. load: `load_texture`, or a replacement; color: returns the
    color space of an image file. Returns the scene with a resolution, by default that of the first object's texture,
    and a texture per object. Raises FileError as `load_texture`.
    """
    columns, rows = scene.camera.resolution or texture_size(scene.objects[0].textures()[0])
    camera = scene.camera.model_copy(update={"resolution": (columns, rows)})
    files, transfer = image_files(scene), scene.image.transfer
    to_srgb = len(files) > 1 and len({color(image) for image in files}) > 1
    loaded: dict[Hashable, Texture] = {}
    textures = []
    for item in scene.objects:
        key = of_item, is_projected = item.textures(), item.mapped is None
        if key not in loaded:
            sizes = ((name, (rows, columns) if is_projected else own_size(name)) for name in of_item)
            sides = [load(name, transfer, size, to_srgb) for name, size in sizes]
            loaded[key] = sides[0] if len(sides) == 1 else cube_map(sides)
        textures.append(loaded[key])
    return scene.model_copy(update={"camera": camera}), tuple(textures)


def find_stretched(scenes: Iterable[Scene]) -> list[str]:
    """Messages on projected images whose aspect ratio differs from the frame's, one per image, for its first object.

    scenes: scenes with a resolution. A message is like "object[0].texture: is stretched from 640 x 480 to the frame's
    512 x 512 px". Differences by less than a pixel in a side do not count, and neither do patterns. Raises FileError as
    `texture_size`.
    """
    size_of, notes = cache(texture_size), dict[str, None]()
    for scene in scenes:
        width, height = scene.camera.frame_size
        projected = [(item.inputs()["texture"], k) for k, item in enumerate(scene.objects) if item.mapped is None]
        first = {source: number for source, number in reversed(projected) if not is_drawn(source)}
        for source, number in sorted(first.items(), key=lambda each: each[1]):
            columns, rows = size_of(source)
            if abs(width * rows - height * columns) >= max(columns, rows):  # a side is off by a pixel or more
                size = f"{columns} x {rows} to the frame's {width} x {height} px"
                notes[f"object[{number}].texture: is stretched from {size}"] = None
    return list(notes)


def own_size(source: TextureSource) -> tuple[int, int] | None:
    """Size (rows, columns) at which to load a texture on a surface: one texel for a color, else None, its own size."""
    return (1, 1) if is_drawn(source) and source not in PATTERNS else None


def mapped_size(sources: tuple[TextureSource, ...]) -> tuple[int, int]:
    """Columns and rows of a texture on a surface, or of one side of a cube map. Raises FileError as `load_texture`."""
    known = {(1, 1) if own_size(source) else texture_size(source) for source in sources}
    sizes = known - {(1, 1)} or known
    if len(sizes) > 1:
        listed = ", ".join(f"{columns} x {rows}" for columns, rows in sorted(sizes))
        raise FileError(f"texture: the six sides of a cube map must have one size; got {listed} px")
    return sizes.pop()


def cube_map(sides: Sequence[Texture]) -> Texture:
    """One texture from the six sides of a cube map; colors are enlarged to the size of the others. Raises FileError."""
    is_color = any(side.radiance.ndim == 3 for side in sides)
    shape = (*max((side.radiance.shape[:2] for side in sides), key=math.prod), *((3,) if is_color else ()))
    wide = (side.radiance[..., None] if side.radiance.ndim < len(shape) else side.radiance for side in sides)
    first, *others = (image if image.shape == shape else np.broadcast_to(image, shape) for image in wide)
    contents = [side.content for side in sides]
    content = None if None in contents else ("cube map", *contents)
    return Texture(first, max(side.bits for side in sides), sides[-1].source, content, tuple(others))


def require_suffix(source: str) -> None:
    """Raise FileError if a source, which is neither pattern nor color, has no extension."""
    if not Path(source).suffix:
        raise FileError(f"texture: {missing_texture(source)}; got {Path(source).name!r}")


# Functions that draw patterns, either whole or only the rows from `first` to before `end`.


def bricks(rows: int, columns: int, first: int = 0, end: int | None = None) -> Codes:
    """Draw a brick wall in running bond with detail at all scales; 14 courses over the shorter side.

    Returns sRGB codes (rows, columns), the same on every machine: it uses only fixed random numbers and algebra.
    """
    scale = DEFAULT_SIDE / min(rows, columns)  # the wall is laid out in pixels of a 512 x 512 image
    step = max(1, round(2.5 / scale))  # length of a shadow, for which as many rows above `first` are needed
    top = max(first - step, 0)
    row = np.arange(rows)[top:end]
    y = (row.astype(np.float64) + 0.5) * scale
    x = (np.arange(columns, dtype=np.float64) + 0.5) * scale
    length, height, joint = 108.0, 36.6, 5.0

    # Courses are wavy; every second one is shifted by half a brick, and each one by a small random amount besides.
    wavy_y = y[:, None] + 3.0 * (_noise(x / 90, y / 40, 1) - 0.5) + 1.6 * (_noise(x / 17, y / 13, 2) - 0.5)
    wavy_x = x + 3.0 * (_noise(x / 40, y / 30, 3) - 0.5) + 1.6 * (_noise(x / 13, y / 17, 4) - 0.5)
    course = np.floor(wavy_y / height).astype(np.intp)
    wavy_x = wavy_x + length * (0.5 * (course % 2) + 0.16 * (_random(course, np.zeros_like(course), 5) - 0.5))
    brick = np.floor(wavy_x / length).astype(np.intp)

    # Distance inside each brick's outline, a rectangle with round corners, chipped.
    half_x = (length - joint) / 2 - 1.6 * _random(course, brick, 6)
    half_y = (height - joint) / 2 - 1.0 * _random(course, brick, 7)
    corner = 3.0
    across = np.abs(wavy_x - (brick + 0.5) * length) - half_x + corner
    along = np.abs(wavy_y - (course + 0.5) * height) - half_y + corner
    outside = np.sqrt(np.maximum(across, 0) ** 2 + np.maximum(along, 0) ** 2)
    outside += np.minimum(np.maximum(across, along), 0)
    inside = corner - outside - 2.2 * _noise(x / 5, y / 5, 8) * _noise(x / 23, y / 19, 9)
    face = np.clip(0.5 + inside / max(1.6, scale), 0, 1)

    # Brightness of the fired clay and of the mortar.
    grain = _random(row[:, None], np.arange(columns), 10) - 0.5
    sand = 0.6 * _noise(x / 2.3, y / 2.1, 11) + 0.6 * _noise(x / 1.4, y / 1.5, 17) - 0.6
    stain = _noise(x / 61, y / 47, 12) - 0.5
    coarse = 0.5 * _noise(x / 3.6, y / 2.9, 13) + 0.5 * _noise(x / 2.7, y / 3.5, 14)
    flecks = np.clip(coarse - 0.7, 0, 1) - np.clip(0.28 - coarse, 0, 1)
    streaks = _noise(x / 19, y / 5, 15) - 0.5
    shade = 0.44 + 0.26 * (_random(course, brick, 16) - 0.5)
    clay = shade + 0.10 * stain + 0.11 * streaks + 0.13 * sand + 0.08 * grain + 0.55 * flecks
    mortar = 0.66 + 0.10 * stain + 0.20 * sand + 0.13 * grain

    # Illumination from the upper left: relief on the faces, and the shadow that they cast into the joints.
    relief = 1.3 * np.clip(inside / 3.5, -0.4, 1) + 0.55 * sand * face + 0.8 * flecks * face
    light = np.zeros_like(relief)
    light[1:, 1:] = np.clip((relief[1:, 1:] - relief[:-1, :-1]) / max(scale, 0.35), -1, 1)
    shadow = np.zeros_like(face)
    shadow[step:, step:] = face[:-step, :-step]
    wall = face * clay + (1 - face) * mortar * (1 - 0.5 * shadow) + 0.16 * light
    codes: Codes = np.floor(255 * np.clip(wall[first - top :], 0.02, 0.98) + 0.5).astype(np.uint8)
    return codes


def _noise(x: Floats, y: Floats, layer: int) -> Floats:
    """Value noise from 0 to 1 on the grid of columns x and rows y: interpolated random lattice points."""
    left, top = np.floor(x), np.floor(y)
    u, v = x - left, (y - top)[:, None]
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    i, j = top.astype(np.intp), left.astype(np.intp)
    lattice = _random(np.arange(i[-1] + 2)[:, None], np.arange(j[-1] + 2), layer)
    rows = lattice[i] + v * (lattice[i + 1] - lattice[i])
    noise: Floats = rows[:, j] + u * (rows[:, j + 1] - rows[:, j])
    return noise


def _random(row: NDArray[np.intp], column: NDArray[np.intp], layer: int) -> Floats:
    """Fixed random numbers from 0 to 1 for pairs of integers; they repeat after 512."""
    numbers: Floats = _random_table()[(row + 37 * layer) & 511, (column + 151 * layer) & 511]
    return numbers


@cache
def _random_table() -> Floats:
    # Raw output of the bit generator is the one random stream that NumPy promises never to change.
    raw = np.asarray(np.random.PCG64(20).random_raw(512 * 512), np.uint64)
    return (raw >> np.uint64(11)).astype(np.float64).reshape(512, 512) * 2.0**-53


def checkerboard(rows: int, columns: int, first: int = 0, end: int | None = None) -> Codes:
    """Draw squares of sRGB codes 232 and 24, 16 along the shorter side; returns (rows, columns)."""
    side = max(1, round(min(rows, columns) / 16))
    odd = (np.arange(rows)[first:end, None] // side + np.arange(columns) // side) % 2
    return np.where(odd == 1, 24, 232).astype(np.uint8)


def slanted_edge(rows: int, columns: int, first: int = 0, end: int | None = None) -> Codes:
    """Draw a straight edge through the center, 5 degrees from the vertical, for an MTF after ISO 12233.

    Returns sRGB codes (rows, columns): radiance 0.2 on the left, 0.8 on the right, 4 : 1; pixels on the edge have the
    mean by exact area, to the nearest code.
    """
    angle = np.deg2rad(5.0)
    i, j = np.arange(rows)[first:end, None] - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2
    right = _area_beyond(j * np.cos(angle) + i * np.sin(angle), np.cos(angle), np.sin(angle))
    return encode(0.2 + 0.6 * right, 8, "srgb").astype(np.uint8)


def siemens_star(rows: int, columns: int, first: int = 0, end: int | None = None) -> Codes:
    """Draw 36 bright and 36 dark spokes, radiance 0.8 and 0.05, around the center.

    Returns sRGB codes (rows, columns). A pixel crossed by one edge has the mean by exact area, to the nearest code;
    near the center, where several edges cross, the mean of 16 x 16 samples.
    """
    i, j = np.arange(rows)[first:end, None] - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2
    edge = np.rint(np.arctan2(i, j) * 36 / np.pi)  # the nearest edge, between spoke edge - 1 and spoke edge
    angle = edge * np.pi / 36
    after = _area_beyond(i * np.cos(angle) - j * np.sin(angle), np.cos(angle), np.sin(angle))
    bright = np.where(edge % 2 == 0, after, 1 - after)

    near = np.nonzero(i * i + j * j < 20**2)  # beyond, spokes are wider than the diagonal of a pixel
    step = (np.arange(16) + 0.5) / 16 - 0.5
    samples_i = i[near[0], 0][:, None, None] + step[:, None]
    samples_j = j[near[1]][:, None, None] + step
    spoke = np.floor(np.arctan2(samples_i, samples_j) * 36 / np.pi)
    bright[near] = (spoke % 2 == 0).mean(axis=(1, 2))
    return encode(0.05 + 0.75 * bright, 8, "srgb").astype(np.uint8)


def _area_beyond(distance: Floats, normal_x: float | Floats, normal_y: float | Floats) -> Floats:
    """Area fraction of unit squares beyond a straight line.

    distance: signed distance of the square's center from the line along the unit normal, positive beyond. The square's
    sides, projected on the normal, are two intervals: along the longer one the area is a ramp, and averaging the ramp
    over the shorter one gives the result.
    """
    distance = np.clip(distance, -2, 2)
    a, b = np.maximum(np.abs(normal_x), 1e-7) / 2, np.maximum(np.abs(normal_y), 1e-7) / 2
    wide, narrow = np.maximum(a, b), np.minimum(a, b)

    def integral(s: Floats) -> Floats:  # of the ramp clip(1/2 + s / (2 wide), 0, 1)
        inner = np.clip(s, -wide, wide)
        area: Floats = (inner + wide) ** 2 / (4 * wide) + np.maximum(s - wide, 0)
        return area

    return np.asarray((integral(distance + narrow) - integral(distance - narrow)) / (2 * narrow))


PATTERNS = {"bricks": bricks, "checkerboard": checkerboard, "slanted_edge": slanted_edge, "siemens_star": siemens_star}
