"""Structs shared with the device: NumPy dtypes, from which the C typedefs are generated."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

Real = Literal["double", "float"]
Struct = np.void
MOST_RIMS = 4  # largest number of rims of a lens, those before and behind it together
START = 7  # number of coefficients of the polynomial that first guesses undistorted slopes
REAL: dict[Real, np.dtype[Any]] = {"double": np.dtype("f8"), "float": np.dtype("f4")}
REAL_BYTES = 8  # bytes that plans reserve for a real number on the device, also in single precision


@cache
def structs(real: Real) -> Mapping[str, np.dtype[Any]]:
    """Dtype of every struct by its C name, in order of declaration.

    grid_t: rows, columns: size of the frame, or of a strip (`clsco.frame.strips`); frame_rows: rows of the whole frame;
    top: first row of the strip; guard: width of the guard band; above: rows of the source grid above the strip; width,
    height: size of the source grid; step: slope between neighboring rays on the axis; rest_step: that slope in the
    reference pose; radial, tangential, reach: see `clsco.optics.distortion.Distortion`; start, newton: first guess of
    the inverse distortion, and number of Newton steps.

    lens_t: see `clsco.optics.lens.Lens`. surface_t: see `clsco.optics.quadrics.PlacedSurface`; texture: number of the
    object's texture. texture_map_t: see `clsco.optics.texture_mapping.TextureMap`. light_t: see
    `clsco.optics.light.PlacedLight`. pose_t: see `clsco.optics.motion.Pose`; step: slope between neighboring rays at
    the pose's time. group_t: see `clsco.optics.visibility.OcclusionGroup`; count: number of objects in the scene.

    psf_t: first, count, low, end, reach, stride: see `clsco.optics.psf_tables.PsfTable`; with the prefix sub_: those of
    sub-pixel sources; key to sub_steps: conversion of a blur radius to a table coordinate; lens_extent: radius of the
    pupil in lens radii; rim_distance, rim_radius: see `clsco.optics.point_spread.Rim`; across, down, per_column,
    per_row: number of cells of `clsco.optics.field.SeidelField`, and cells per px.

    sensor_t: see `clsco.optics.sensor.sensor_values`.
    """
    i, two, three, nine = "i4", (2,), (3,), (9,)
    names = ("rows", "columns", "frame_rows", "top", "guard", "above", "width", "height", "newton")
    grid: list[Any] = [(name, i) for name in names]
    grid += _reals(real, step=(), rest_step=(), radial=three, tangential=two, reach=(), start=(START,))
    lens = _reals(real, blur_scale=(), focus_power=(), radius=(), detector_power=(), sag=(), sphere=())
    surface = _reals(real, turn=nine, body_turn=nine, own_turn=nine, offset=three, body_offset=three, own_offset=three)
    surface += _reals(real, rest=three, q=three, l=three)
    surface += _reals(real, bounds_low=three, bounds_high=three, k=(), at_lens=(), radius=())
    surface += [("nappe", i), ("texture", i), *_reals(real, near_x=two, near_y=two, near_w=(), width=())]
    mapping: list[Any] = [("base", "i8")]
    mapping += [(name, i) for name in ("kind", "wrap_x", "wrap_y", "columns", "rows", "levels")]
    mapping += _reals(real, frame=nine, scale=(4,), shift=two, slant=(), spread=(), least=(), outside=())
    light = [("members", "u8"), ("is_near", i), *_reals(real, x=(), y=(), z=(), ambient=())]
    pose = _reals(real, rotation=nine, shift=three, step=())
    group = [("members", "u8"), ("occluders", "u8"), *((name, i) for name in ("count", "own", "root"))]
    psf: list[Any] = [(name, i) for name in ("first", "count", "low", "end", "reach")]
    psf += [(name, i) for name in ("sub_first", "sub_count", "sub_low", "sub_end")]
    psf += [(name, i) for name in ("across", "down", "stride", "sub_stride")]
    psf += _reals(real, key=(), minimum_blur=(), fine_steps=(), fine_until=(), octaves_from=(), steps=(), sub_steps=())
    psf += _reals(real, lens_extent=(), rim_distance=(MOST_RIMS,), rim_radius=(MOST_RIMS,), per_column=(), per_row=())
    sensor: list[Any] = [("planes", i), ("channel", i, (12,)), ("maximum", i)]
    sensor += [(name, "u4") for name in ("seed_low", "seed_high", "noise_low", "noise_high", "hot")]
    sensor += _reals("float", scale=(12,), prnu=(), dsnu=(), dark=(), leak=(), most=(), full_well=(), read_noise=())
    sensor += _reals("float", gain=(), black=(), largest=())
    fields = {"grid_t": grid, "lens_t": lens, "surface_t": surface, "texture_map_t": mapping}
    fields |= {"light_t": light, "pose_t": pose, "group_t": group, "psf_t": psf, "sensor_t": sensor}
    return {name: np.dtype(members, align=True) for name, members in fields.items()}


def _reals(real: Real, **shapes: tuple[int, ...]) -> list[Any]:
    """Struct fields for real numbers; shapes: shape of each field by its name, () for a single number."""
    return [(name, REAL[real], shape) for name, shape in shapes.items()]


def filled(name: str, real: Real, values: dict[str, Any]) -> Struct:
    """Struct `name` with the fields in `values`, and 0 in the other fields."""
    record = np.zeros((), structs(real)[name])
    for field, value in values.items():
        record[field] = value
    return cast(Struct, record[()])


def flat(values: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Packed channel planes (channels, rows, columns) of an image (rows, columns[, channels])."""
    planes = values[None] if values.ndim == 2 else np.moveaxis(values, -1, 0)
    return np.ascontiguousarray(planes, dtype=dtype)
