"""Structs shared with the device: NumPy dtypes, from which the C typedefs are generated, and how to fill them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from clsco.motion import Pose
from clsco.occlusion import Layer, lens_extent
from clsco.optics import blur_scale, focus_power, lens_radius, ray_step
from clsco.psf import (
    MINIMUM_BLUR,
    PsfTable,
    octaves_from,
    sampled_key,
    sampled_steps,
    table_steps,
)
from clsco.scene import Camera, Object, Psf
from clsco.strips import Strip
from clsco.surfaces import PlacedSurface

Real = Literal["double", "float"]
Struct = np.void
WIDE_BYTES = 8  # of a number on the device: a double, or two floats
WIDE: dict[Real, np.dtype[Any]] = {"double": np.dtype("f8"), "float": np.dtype([("high", "f4"), ("low", "f4")])}
LOW = "_low"  # ends the name of a low part
EVERYWHERE = ((-np.inf, np.inf),) * 3  # bounds of an object that has none, beside one that has


@cache
def structs(real: Real) -> Mapping[str, np.dtype[Any]]:
    """C name -> dtype of every struct, in the order in which they are declared.

    In single precision every real number has a low part, what rounding to float left of it (kernels/wide.clh): a
    scalar x is followed by x_low, an array of n numbers is one of 2 n, the low parts last.

    camera_t: rows, columns of the frame, or of a strip of it (clsco/strips.py); frame_rows: of the frame; top: first
    row of the strip; guard: columns, above: rows of the grid before its own; width, height of the grid; step: slope
    between neighboring rays; blur_scale px mm; focus_power 1/mm; lens_radius mm. surface_t: see surfaces.PlacedSurface;
    texture: its number in the stack. pose_t: see motion.Pose. layer_t: see occlusion.Layer; count: of all objects.
    psf_t: how a blur radius becomes a coordinate in the tables, and which intervals they hold; the rest: see occlusion.
    """
    i, two, three, nine = "i4", (2,), (3,), (9,)
    camera: list[Any] = [
        (name, i) for name in ("rows", "columns", "frame_rows", "top", "guard", "above", "width", "height")
    ]
    camera += _reals(real, step=(), blur_scale=(), focus_power=(), lens_radius=())
    surface = _reals(real, turn=nine, body_turn=nine, offset=three, body_offset=three, rest=three, q=three, l=three)
    surface += _reals(real, bounds_low=three, bounds_high=three, k=(), at_lens=())
    surface += [("nappe", i), ("texture", i), *_reals(real, near_x=two, near_y=two, near_w=())]
    pose = _reals(real, rotation=nine, shift=three)
    layer = [("members", "u8"), ("blockers", "u8"), *((name, i) for name in ("count", "own", "sheet"))]
    psf: list[Any] = [(name, i) for name in ("first", "count", "reach", "sub_first", "sub_count")]
    psf += _reals(real, key=(), minimum_blur=(), fine_steps=(), fine_until=(), octaves_from=(), steps=(), sub_steps=())
    psf += _reals(real, lens_extent=())
    fields = {"camera_t": camera, "surface_t": surface, "pose_t": pose, "layer_t": layer, "psf_t": psf}
    return {name: np.dtype(members, align=True) for name, members in fields.items()}


def _reals(real: Real, **shapes: tuple[int, ...]) -> list[Any]:
    """Fields for real numbers and arrays (n,) of them, with low parts in single precision."""
    fields: list[Any] = []
    for name, shape in shapes.items():
        if real == "double":
            fields.append((name, "f8", shape))
        elif shape:
            fields.append((name, "f4", (2 * shape[0],)))
        else:
            fields += [(name, "f4"), (name + LOW, "f4")]
    return fields


def packed(name: str, records: NDArray[np.void], real: Real) -> NDArray[np.void]:
    """Structs `name` of double precision, any shape, as the device takes them."""
    if real == "double":
        return records
    out = np.zeros(records.shape, structs(real)[name])
    for field in structs("double")[name].fields or ():
        values = records[field]
        if values.dtype.kind in "iu":
            out[field] = values
            continue
        high = values.astype(np.float32)
        finite = np.isfinite(values)
        low = np.where(finite, values, 0.0) - np.where(finite, high, 0.0)
        if field + LOW in out.dtype.fields:
            out[field], out[field + LOW] = high, low
        else:
            out[field] = np.concatenate([high, low], axis=-1)
    return out


def in_parts(values: NDArray[Any], real: Real) -> NDArray[Any]:
    """Numbers (...) of double precision as the device's `wide_t`, (...) of dtype WIDE."""
    if real == "double":
        return values
    out = np.empty(values.shape, WIDE[real])
    out["high"] = values
    out["low"] = values - out["high"]
    return out


def together(parts: NDArray[Any], real: Real) -> NDArray[Any]:
    """Numbers (...) of dtype WIDE in float64."""
    return parts if real == "double" else parts["high"] + parts["low"].astype(np.float64)


def _filled(name: str, real: Real, values: dict[str, Any]) -> Struct:
    record = np.zeros((), structs("double")[name])
    for field, value in values.items():
        record[field] = value
    return cast(Struct, packed(name, record, real)[()])


def frame_struct(
    rows: int, columns: int, guard: int, real: Real, strip: Strip | None = None, **optics: float
) -> Struct:
    """camera_t of a frame of rows x columns px in a guard band of `guard` px, with what of the lens is needed.

    strip: which of its rows, by default all of them.
    """
    part = strip or Strip(0, rows, guard, guard)
    size = {"rows": part.rows, "columns": columns, "frame_rows": rows, "top": part.top, "guard": guard}
    size |= {"above": part.above, "width": columns + 2 * guard, "height": part.height}
    return _filled("camera_t", real, size | optics)


def camera_struct(camera: Camera, guard: int, real: Real, strip: Strip | None = None) -> Struct:
    """camera_t of a camera with a resolution, for a guard band of `guard` px; strip as for `frame_struct`."""
    assert camera.resolution is not None  # known once the textures are loaded
    columns, rows = camera.resolution
    return frame_struct(
        rows, columns, guard, real, strip,
        step=ray_step(camera), blur_scale=blur_scale(camera), focus_power=focus_power(camera),
        lens_radius=lens_radius(camera),
    )  # fmt: skip


def surface_structs(
    items: Sequence[Object], surfaces: Sequence[PlacedSurface], real: Real, textures: Sequence[int] | None = None
) -> NDArray[np.void]:
    """surface_t of every object placed before the camera, (objects,); textures: number of each one's, by default 0."""
    numbers = textures or [0] * len(items)
    filled = [_surface_struct(*one, real) for one in zip(items, surfaces, numbers, strict=True)]
    return np.array(filled, structs(real)["surface_t"])


def _surface_struct(item: Object, surface: PlacedSurface, texture: int, real: Real) -> Struct:
    shape = surface.canonical
    low, high = np.array(item.bounds or EVERYWHERE, dtype=np.float64).T
    return _filled(
        "surface_t",
        real,
        {
            "turn": surface.turn.ravel(),
            "body_turn": surface.body_turn.ravel(),
            "offset": surface.offset,
            "body_offset": surface.body_offset,
            "rest": surface.rest,
            "q": shape.q,
            "l": shape.l,
            "bounds_low": low,
            "bounds_high": high,
            "k": shape.k,
            "at_lens": surface.constant,
            "nappe": shape.nappe,
            "texture": texture,
            "near_x": surface.seen.x,
            "near_y": surface.seen.y,
            "near_w": surface.seen.w[1],
        },
    )


def pose_structs(poses: Sequence[Pose], real: Real) -> NDArray[np.void]:
    """pose_t of every pose, (poses,)."""
    filled = [_filled("pose_t", real, {"rotation": p.rotation.ravel(), "shift": p.shift}) for p in poses]
    return np.array(filled, structs(real)["pose_t"])


def layer_struct(layer: Layer, objects: int) -> Struct:
    """layer_t of a layer of a scene of so many objects."""
    return _filled("layer_t", "double", vars(layer) | {"count": objects})


def psf_struct(psf: Psf, table: PsfTable, subpixel: PsfTable | None, real: Real) -> Struct:
    """psf_t for a main table and, where there are sub-pixel sources, theirs."""
    values: dict[str, Any] = {
        "first": table.first,
        "count": len(table.intervals),
        "reach": max(table.reach, subpixel.reach if subpixel else 0),
        "key": sampled_key(psf),
        "minimum_blur": MINIMUM_BLUR,
        "octaves_from": octaves_from(psf),
        "steps": table_steps(psf, False),
        "sub_steps": table_steps(psf, True),
        "lens_extent": lens_extent(psf),
    }
    values["fine_steps"], values["fine_until"] = sampled_steps(psf)
    if subpixel:
        values |= {"sub_first": subpixel.first, "sub_count": len(subpixel.intervals)}
    return _filled("psf_t", real, values)


def flat(values: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Channel planes (channels, rows, columns) of an image (rows, columns[, channels]), packed."""
    planes = values[None] if values.ndim == 2 else np.moveaxis(values, -1, 0)
    return np.ascontiguousarray(planes, dtype=dtype)
