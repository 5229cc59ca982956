"""Bad scenes, listed: a valid scene, one key, and the values that it must not have; the message has to name the key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

PLANE = '[[object]]\nshape = "plane"\n'
MAP = '[[object]]\nshape = "depth_map"\ndepth = "z.png"\n'
BASES: dict[str, str] = {
    "plane": PLANE,
    "gaussian": '[psf]\nmodel = "gaussian"\n' + PLANE,
    "forward": '[motion]\nwarp = "forward"\n' + PLANE,
    "lit": "[light]\ndirection = [0.3, 0.8, 1.0]\n" + PLANE,
    "stereo": "[stereo]\nbaseline = 65.0\n" + PLANE,
    "sphere": '[[object]]\nshape = "sphere"\n',
    "cylinder": '[[object]]\nshape = "cylinder"\n',
    "cone": '[[object]]\nshape = "cone"\n',
    "ellipsoid": '[[object]]\nshape = "ellipsoid"\n',
    "rectangle": '[[object]]\nshape = "rectangle"\n',
    "disc": '[[object]]\nshape = "disc"\n',
    "box": '[[object]]\nshape = "box"\n',
    "background": '[[object]]\nshape = "background"\n',
    "laid": '[[object]]\nshape = "rectangle"\ntexture_mapping = "surface"\n',
    "laid plane": PLANE + 'texture_mapping = "surface"\ntexture_size = 9.0\n',
    "laid ball": '[[object]]\nshape = "sphere"\ntexture_mapping = "surface"\n',
    "cube": '[[object]]\nshape = "sphere"\ntexture_mapping = "cube"\n',
    "group": '[[group]]\nname = "cart"\n' + PLANE + 'group = "cart"\n',
    "quadric": '[[object]]\nshape = "quadric"\ncoefficients = [1, 1, 1, 0, 0, 0, 0, 0, 0, -900]\n',
    "map": MAP,
    "disparity": MAP + 'unit = "disparity"\nbaseline = 60.0\n',
}

# Values as TOML writes them, by what a key must hold.
NO_NUMBER = (
    "nan", "inf", "-inf", '"20"', '""', "true", "[]", "{}", "[true]", "[[1.0]]", "1979-05-27", "07:32:00", "{ a = 1 }",
)  # fmt: skip
TOO_FAR = ("1e99", "-1e99", "1e308", "-1e308", "9" * 80, "-" + "9" * 80)
LENGTH = (*NO_NUMBER, *TOO_FAR, "0", "-0.0", "-3.5", "1e-7", "5e-324", "2e9")
COUNT = (*NO_NUMBER, *TOO_FAR, "0", "-1", "1.0", "0.5", "0x7fffffffffffffff")
VECTOR = (
    "1", "true", '"1, 2, 3"', "[1]", "[1, 2]", "[1, 2, 3, 4]", '[1, 2, "3"]', "[1, 2, nan]", "[inf, 0, 0]",
    "[0, 0, -inf]",
    "[0, 2e9, 0]", "[0, 0, -1e99]", "[true, 0, 0]", "[[0, 0, 0]]", "[0, [0], 0]", "{ x = 1 }", "1979-05-27",
    f"[0, 0, {'9' * 80}]",
)  # fmt: skip
VELOCITY = tuple(value for value in VECTOR if value != "[[0, 0, 0]]")  # which is a sweep of one value
WORD = (
    "1", "true", '""', '"x"', '"Pillbox"', '" midpoint"', "[]", "{}", "nan", '["x"]', '["x", "y"]', '"a\\nb"',
    '"\\u0000"',
)  # fmt: skip
TEXT = ("1", "true", "[]", "{}", "nan", '"a\\nb"', '"\\u0000"', '"\\u001b[31m"', '"\\u007f"', f'"{"a" * 4097}"')
FLAG = ("0", "1", '"true"', '"yes"', "[]", "{}", "nan", "1979-05-27")
PAIRS = (
    "1", "[]", "[0, 1]", "[[0, 1]]", "[[0, 1], [0, 1]]", "[[0, 1], [0, 1], [0]]", "[[0, 1], [0, 1], [1, 0]]",
    "[[0, 1], [0, 1], [0, 0]]",
    "[[0, 1], [0, 1], [0, nan]]", "[[0, 1], [0, 1], [0, 2e9]]", '[[0, 1], [0, 1], ["0", 1]]',
    "[[0, 1], [0, 1], [-inf, 1]]", "true", "{}",
)  # fmt: skip
FEW = (*NO_NUMBER, *TOO_FAR, "0", "-1", "[1, 2, 3]", "[1, nan]", "[1, 0]", '[1, "2"]', "[[1, 2]]")  # one number or two
ROTATION = (
    *VECTOR, "{}", "{ axis = [0, 0, 1] }", "{ angle = 3.0 }", "{ axis = [0, 0, 0], angle = 3.0 }",
    "{ axis = [0, 0, 1], angle = nan }", "{ axis = [0, 1], angle = 3.0 }", "{ quaternion = [0, 0, 0, 0] }",
    "{ quaternion = [1, 0, 0] }", "{ quaternion = [1, 0, 0, inf] }", "{ quaternion = [1, 0, 0, 0], angle = 1.0 }",
    '"x"', "nan",
)  # fmt: skip
TABLE = ("1", "[]", '""', "true", "nan", "[{}]", "1979-05-27")

# Base, key, values. Of an object's keys the object is the first one.
KEYS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("plane", "title", TEXT),
    *(("plane", section, TABLE) for section in ("camera", "psf", "sequence", "motion", "image")),
    ("plane", "camera.motion", TABLE),
    ("plane", "object[0].motion", TABLE),
    ("forward", "fill", TABLE),
    ("stereo", "stereo", TABLE),
    ("plane", "object", ("1", '""', "true", "[]", "{}", "[1]", '["plane"]', "[[]]", "[{}]", '[{ shape = "x" }]',
        "nan")),
    ("plane", "camera.focal_length", LENGTH),
    ("plane", "camera.aperture_diameter", LENGTH),
    ("plane", "camera.f_number", (*NO_NUMBER, *TOO_FAR, "0", "-2", "1e-4", "1e7")),
    ("plane", "camera.sensor_distance", LENGTH),
    ("plane", "camera.focus_distance", (*(each for each in LENGTH if each != "inf"), "20", "19.9", "20.0000000001")),
    ("plane", "camera.normalization_distance", LENGTH),
    ("plane", "camera.pixel_pitch", LENGTH),
    ("plane", "camera.resolution", (
        "512", "[]", "[512]", "[0, 512]", "[512, -1]", "[512.0, 512]", "[512, 65537]", "[65536, 65536]", '["512", 512]',
        "[true, 512]",
        "[nan, 512]", "[1, 2, 3]", "[[1, 2], [1, 2]]", "{}", "[9223372036854775807, 1]", '"512x512"',
        "[512, 1979-05-27]",
    )),
    ("plane", "camera.motion.velocity", VELOCITY),
    ("plane", "camera.motion.angular_velocity", VELOCITY),
    ("plane", "camera.motion.acceleration", VELOCITY),
    ("plane", "camera.motion.keyframe", (*TABLE, "[{}]", "[{time = 0}, {time = 0}]", "[{time = nan}]")),
    ("plane", "camera.motion.interpolation", WORD),
    ("plane", "camera.motion.outside", WORD),
    ("plane", "camera.shake", ("1", '""', "true", "[{}]")),
    ("plane", "camera.shake.rotation_rms", (*NO_NUMBER, *TOO_FAR, "-0.1", "46")),
    ("plane", "camera.shake.band", (*NO_NUMBER, "[1]", "[2, 1]", "[0, 1]", "[1, nan]")),
    ("plane", "camera.shake.seed", (*NO_NUMBER, "-1", "0.5", "9223372036854775808")),
    ("plane", "psf.model", WORD),
    ("plane", "psf.edge", WORD),
    ("plane", "psf.tilt", FLAG),
    ("plane", "psf.silhouette_samples", (*COUNT, "17")),
    ("plane", "psf.occlusion", WORD),
    ("plane", "psf.border", WORD),
    ("plane", "psf.sigma_ratio", ("0.5",)),
    ("plane", "psf.truncation", ("2.0",)),
    ("gaussian", "psf.sigma_ratio", (*NO_NUMBER, *TOO_FAR, "0", "-1", "11", "1e-7")),
    ("gaussian", "psf.truncation", (*NO_NUMBER, *TOO_FAR, "0", "-1", "0.5", "7")),
    ("plane", "sequence.frames", (*COUNT, "1000001")),
    ("plane", "sequence.interval", (*NO_NUMBER, *TOO_FAR, "0", "-1", "1e-10", "1e10")),
    ("plane", "sequence.shutter", (*NO_NUMBER, *TOO_FAR, "0", "-1", "1.01", "1e-10")),
    ("plane", "sequence.samples", (*COUNT, "4097", '"Auto"', '"5"')),
    ("plane", "sequence.sampling", WORD),
    ("plane", "motion.warp", WORD),
    ("plane", "motion.rotation", WORD),
    ("plane", "motion.texture_filter", WORD),
    ("forward", "motion.texture_filter", ('"bicubic"', '"nearest"')),
    ("forward", "fill.method", WORD),
    ("forward", "fill.domain", WORD),
    ("plane", "fill.method", ('"ait"',)),
    ("plane", "fill.domain", ('"span"',)),
    ("plane", "image.transfer", WORD),
    *(("plane", f"light.{key}", VELOCITY) for key in ("direction", "position")),
    ("lit", "light", TABLE),
    ("lit", "light.ambient", (*NO_NUMBER, *TOO_FAR, "-0.1", "1.1")),
    ("stereo", "stereo.baseline", LENGTH),
    ("stereo", "stereo.toe_in", (*NO_NUMBER, *TOO_FAR, "-1", "45", "90")),
    ("plane", "object[0].shape", WORD),
    ("plane", "object[0].name", (*TEXT, '""')),
    ("plane", "object[0].texture", (*TEXT, '""')),
    ("plane", "object[0].bounds", PAIRS),
    ("plane", "object[0].distance", LENGTH),
    ("plane", "object[0].slope_x", (*NO_NUMBER, *TOO_FAR, "1e7")),
    ("plane", "object[0].slope_y", (*NO_NUMBER, *TOO_FAR, "-1e7")),
    ("plane", "object[0].motion.velocity", VELOCITY),
    ("plane", "object[0].motion.angular_velocity", VELOCITY),
    ("plane", "object[0].motion.angular_acceleration", VELOCITY),
    ("sphere", "object[0].radius", LENGTH),
    ("sphere", "object[0].center", (*VECTOR, "[0, 0, -31]", "[0, 0, -1e9]")),
    ("sphere", "object[0].bounds", (*PAIRS, "[[-1, 1], [-1, 1], [-400, -300]]")),
    *((base, "object[0].rotation", ROTATION) for base in ("plane", "cone", "box")),
    ("rectangle", "object[0].size", (*FEW, "3.0", "[2e9, 1]")),
    ("rectangle", "object[0].center", (*VECTOR, "[0, 0, -1]")),
    ("rectangle", "object[0].offset", (*NO_NUMBER, *TOO_FAR)),
    ("disc", "object[0].radius", LENGTH),
    ("disc", "object[0].offset", (*NO_NUMBER, *TOO_FAR)),
    ("box", "object[0].size", (*VECTOR, "[30, 0, 30]", "[30, -1, 30]")),
    ("box", "object[0].center", (*VECTOR, "[0, 0, -16]")),
    ("background", "object[0].rotation", ("[0.0, 1.0, 0.0]",)),
    ("background", "object[0].texture_mapping", ('"surface"', '"cube"', '"triplanar"')),
    ("laid", "object[0].texture_mapping", (*WORD, '"cube"')),
    ("laid", "object[0].texture_wrap", WORD),
    ("laid", "object[0].texture_size", FEW),
    ("laid", "object[0].texture_repeats", (*FEW, "1e-7", "1e7")),
    ("laid", "object[0].texture_offset", (*NO_NUMBER, *TOO_FAR, "1", "[1]", "[1, 2, 3]", "[1, nan]", "[1e7, 0]")),
    ("laid", "object[0].texture_angle", (*NO_NUMBER, *TOO_FAR, "[1, 2]")),
    ("laid plane", "object[0].texture_repeats", ("2", "[2, 3]")),
    ("laid ball", "object[0].texture_size", ("9.0",)),
    ("laid ball", "object[0].texture_angle", ("30.0",)),
    ("laid ball", "object[0].texture_left", (*TEXT, '""', '"bricks"')),
    ("cube", "object[0].texture_offset", ("[0.5, 0.0]",)),
    ("cube", "object[0].texture_left", (*TEXT, '""')),
    *(("plane", f"object[0].{key}", (value,)) for key, value in (
        ("texture_size", "9.0"), ("texture_repeats", "2"), ("texture_offset", "[0.5, 0.0]"), ("texture_angle", "30.0"),
        ("texture_wrap", '"mirror"'), ("group", '"cart"'))),
    ("group", "group", tuple(value for value in TABLE if value != "[]")),
    ("group", "group[0].name", TEXT),
    ("group", "group[0].origin", VECTOR),
    ("group", "group[0].motion.velocity", VELOCITY),
    ("group", "object[0].group", (*TEXT, '""', '"Cart"')),
    ("cylinder", "object[0].radius", LENGTH),
    ("cylinder", "object[0].axis", (*VECTOR, "[0, 0, 0]", "[1e-9, 0, 0]")),
    ("cylinder", "object[0].center", (*VECTOR, "[0, 0, -31]")),
    ("cone", "object[0].half_angle", (*NO_NUMBER, *TOO_FAR, "0", "90", "-45", "180")),
    ("cone", "object[0].nappe", WORD),
    ("cone", "object[0].apex", VECTOR),
    ("ellipsoid", "object[0].semi_axes", (*VECTOR, "[30, 0, 30]", "[30, -1, 30]")),
    ("ellipsoid", "object[0].center", (*VECTOR, "[0, 0, -51]")),
    ("quadric", "object[0].coefficients", (*VECTOR, "[0, 0, 0, 0, 0, 0, 0, 0, 0, 0]",
        "[0, 0, 0, 0, 0, 0, 0, 0, 0, 1]")),
    ("quadric", "object[0].center", VECTOR),
    ("map", "object[0].depth", (*TEXT, '""')),
    ("map", "object[0].unit", WORD),
    ("map", "object[0].scale", (*NO_NUMBER, *TOO_FAR, "0", "-1e-13", "1e-13", "1e13")),
    ("map", "object[0].baseline", ("60.0",)),
    ("map", "object[0].offset", (*NO_NUMBER, *TOO_FAR)),
    ("map", "object[0].far", ("1.0",)),
    ("map", "object[0].bounds", ("[[0, 1], [0, 1], [0, 1]]",)),
    ("map", "object[0].center", VECTOR),
    ("disparity", "object[0].baseline", LENGTH),
    ("disparity", "object[0].offset", (*NO_NUMBER, *TOO_FAR)),
    ("disparity", "object[0].near", LENGTH),
)  # fmt: skip

# Keys that another shape, or section, has; `fuzz` tries those of no table.
STRANGE = {
    "sphere": ("object[0].distance", "object[0].apex", "object[0].depth"),
    "map": ("object[0].radius", "object[0].coefficients"),
    "plane": ("object[0].center", "camera.frames", "psf.radius", "sequence.warp", "motion.velocity", "image.gamma"),
}
SWEPT = ("camera.f_number", "camera.focus_distance", "sequence.shutter", "object[0].motion.velocity")
# Ranges and lists that are none, of keys that may have several values.
SWEEPS = (
    "[]", "[3.0, 3.0]", '["a", "b"]', "[[], []]", "[1, {}]", "{ from = 1 }", "{ to = 1 }", "{ steps = 3 }",
    "{ from = 2, to = 4, steps = 1 }",
    "{ from = 2, to = 2, steps = 3 }", "{ from = 2, to = 4, steps = 4097 }", "{ from = 2, to = 4, steps = 2.0 }",
    '{ from = "2", to = 4, steps = 3 }',
    "{ from = nan, to = 4, steps = 3 }", "{ from = 2, to = inf, steps = 3 }", "{ from = 2, to = 4, steps = 3, by = 1 }",
    "{ from = [1], to = 4, steps = 3 }", "{ from = 1e308, to = -1e308, steps = 3 }",
)  # fmt: skip


@dataclass(frozen=True)
class Bad:
    """A scene with one fault; `key` is what the message must name."""

    mapping: dict[str, Any]
    key: str
    about: str


def listed() -> Iterator[Bad]:
    """All bad scenes of the tables."""
    for base, key, values in KEYS:
        for value in values:
            yield _bad(base, key, value)
    for base, keys in STRANGE.items():
        for key in keys:
            yield _bad(base, key, "1")
    for key in SWEPT:
        for value in SWEEPS:
            yield _bad("plane", key, value)


def _bad(base: str, key: str, value: str) -> Bad:
    mapping = tomllib.loads(BASES[base])
    node: Any = mapping
    *path, last = key.replace("[0]", ".0").split(".")
    for part in path:
        node = node[int(part)] if part.isdecimal() else node.setdefault(part, {})
    node[last] = tomllib.loads(f"value = {value}")["value"]
    return Bad(mapping, key, f"{base}: {key} = {value[:60]}")
