"""Labels and sliders of scene keys, changes to copies of a scene's table, and faults of a scene by key."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

from clsco.errors import SceneError
from clsco.scene.changes import displace, key_parts, put
from clsco.scene.file import SECTIONS, swept_keys
from clsco.scene.groups import Group
from clsco.scene.shapes import SHAPES
from clsco.scene.text import brief
from clsco.scene.texture_keys import Textured

THESIS_TITLES = (
    "Input Image File", "Select Object Type", "Select Object Properties", "Motion parameters", "Camera Specifications",
)  # fmt: skip
ON_THE_STRIP = ("camera.focus_distance", "camera.f_number")  # keys whose only boxes are on the strip of the lens
SHAPE_LABELS = {
    "plane": "Planar", "cylinder": "Cylindrical", "sphere": "Spherical", "cone": "Conical", "ellipsoid": "Elliptical",
    "quadric": "Quadric", "depth_map": "Depth map",
}  # fmt: skip
LABELS = {  # labels by key, in words of the thesis
    "texture": "Input image", "shape": "Object type", "distance": "Distance", "slope_x": "Slope along x",
    "slope_y": "Slope along y", "frames": "Number of frames", "interval": "Inter-frame interval",
    "focal_length": "Focal length", "aperture_diameter": "Aperture diameter", "pixel_pitch": "Pixel pitch",
    "sensor_distance": "Lens to sensor distance", "normalization_distance": "Magnification normalization distance",
    "focus_distance": "Focus distance", "f_number": "F-number", "velocity": "Translation",
    "angular_velocity": "Rotation", "outside": "Before and after keyframes", "half_angle": "Apex half angle",
}  # fmt: skip
LABELS_AT = {
    "aperture.shape": "Aperture", "aperture.rotation": "Turn of the aperture", "aperture.obstruction": "Covered middle",
    "aperture.image": "Image of the aperture", "aperture.exposure": "Light through the aperture",
    "motion.rotation": "Kind of rotation",
    "camera.motion.velocity": "Translation of the camera", "camera.motion.angular_velocity": "Rotation of the camera",
    "camera.shake.rotation_rms": "Shake by turning", "camera.shake.translation_rms": "Shake by moving",
    "camera.shake.band": "Frequencies of the shake", "camera.shake.seed": "Seed of the shake",
    "psf.model": "PSF model", "fill.method": "Filling", "stereo.baseline": "Baseline", "psf.edge": "Edge of the PSF",
    "light.direction": "Direction of the light", "light.position": "Position of the light",
    "light.ambient": "Ambient light", "sensor.seed": "Seed of the sensor",
    "sensor.noise_seed": "Seed of the noise", "sensor.iso_base": "ISO of the full well",
    "sensor.white_electrons": "Electrons of white", "sensor.bits": "Bits of a code", "image.transfer": "Transfer curve",
}  # fmt: skip
WORDS = {
    "ait": "AIT", "srgb": "sRGB", "coc": "Blur radius", "inverse_mm": "1/mm", "inverse_m": "1/m", "mm": "mm", "m": "m",
    "iso": "ISO", "prnu": "PRNU", "dsnu": "DSNU", "mean_median": "Mean and median", "toe_in": "Toe-in",
    "depth_map": "Depth map",
}  # fmt: skip
SYMBOLS = {
    "plane.distance": "a", "plane.slope_x": "b", "plane.slope_y": "c", "cylinder.radius": "ρ", "cylinder.center": "C",
    "sphere.radius": "ρ", "sphere.center": "C", "cone.apex": "C", "cone.half_angle": "θ", "ellipsoid.semi_axes": "",
    "camera.focal_length": "f", "camera.aperture_diameter": "D", "camera.pixel_pitch": "p",
    "camera.sensor_distance": "s", "camera.normalization_distance": "s0", "camera.focus_distance": "u",
    "camera.f_number": "f/D", "sequence.frames": "n", "sequence.interval": "t", "motion.velocity": "v",
    "motion.angular_velocity": "ω", "motion.acceleration": "a", "motion.angular_acceleration": "α",
}  # fmt: skip
COMPONENTS = {
    "resolution": ("columns", "rows"), "band": ("lowest", "highest"), "quantum_efficiency": ("red", "green", "blue"),
    "size": ("width", "height", "depth"), "texture_size": ("width", "height"), "texture_repeats": ("across", "up"),
    "texture_offset": ("right", "up"), "semi_axes": ("a", "b", "c"), "quaternion": ("w", "x", "y", "z"),
    "bounds": ("x from", "x to", "y from", "y to", "z from", "z to"),
    "coefficients": ("a200", "a020", "a002", "a110", "a011", "a101", "a100", "a010", "a001", "a000"),
}  # fmt: skip
SLIDERS = {  # ranges of useful values by key; values outside can be typed
    "focal_length": (5.0, 100.0), "aperture_diameter": (0.5, 40.0), "sensor_distance": (20.0, 30.0),
    "normalization_distance": (5.0, 100.0), "focus_distance": (50.0, 1000.0), "f_number": (0.7, 22.0),
    "pixel_pitch": (0.001, 0.05), "distance": (50.0, 1000.0), "slope_x": (-3.0, 3.0), "slope_y": (-3.0, 3.0),
    "radius": (1.0, 100.0), "center": (-100.0, 500.0), "apex": (-100.0, 500.0), "half_angle": (1.0, 89.0),
    "semi_axes": (1.0, 100.0), "axis": (-1.0, 1.0), "velocity": (-50.0, 50.0), "angular_velocity": (-90.0, 90.0),
    "frames": (1.0, 60.0), "interval": (0.01, 5.0), "shutter": (0.01, 5.0), "samples": (1.0, 64.0),
    "direction": (-1.0, 1.0), "position": (-100.0, 100.0), "baseline": (0.1, 100.0), "sigma_ratio": (0.1, 2.0),
    "white_electrons": (100.0, 50000.0), "full_well": (100.0, 50000.0), "read_noise": (0.0, 20.0),
    "dark_current": (0.0, 100.0), "prnu": (0.0, 0.05), "dsnu": (0.0, 20.0), "hot_pixels": (0.0, 0.01),
    "blade_curvature": (-1.0, 1.0), "squeeze": (0.25, 4.0),
    "iso": (50.0, 25600.0), "temperature": (-20.0, 60.0),
}  # fmt: skip
POINT = {"x": (-100.0, 100.0), "y": (-100.0, 100.0), "z": (50.0, 1000.0)}
BY_UNIT = {"mm": (-100.0, 500.0), "deg": (-180.0, 180.0), "deg/s": (-90.0, 90.0), "mm/s": (-50.0, 50.0)}
BY_FOCAL_LENGTH = {"sensor_distance": (1.01, 1.5), "focus_distance": (2.0, 200.0)}  # ends, in focal lengths
SCALES = {"focus_distance": "inverse", "f_number": "stops"}
WIDE = 20.0  # ratio of a slider's ends from which on its scale is logarithmic
OWN_ORDER = ("axis", "nappe", "unit", "scale", "baseline", "offset", "near", "far")  # they follow the thesis' keys


_POSE_LABELS = {  # labels of a static rotation; "Rotation" is the label of a motion
    "rotation": "Pose", "rotation.axis": "Axis of the pose", "rotation.angle": "Angle of the pose",
    "rotation.quaternion": "Pose as quaternion",
}  # fmt: skip


def label_of(path: str) -> str:
    """Label of a key. For a key of a keyframe, it has the keyframe's number, counted from 1."""
    number, _, part = path.partition(".keyframe.")[2].partition(".")
    if part:
        return f"{words(part)} of keyframe {int(number) + 1}"
    kind, _, rest = path.partition(".")
    of_pose = _POSE_LABELS.get(rest.partition(".")[2]) if kind == "object" else None
    key = path.rpartition(".")[2]
    return LABELS_AT.get(path) or of_pose or LABELS.get(key) or words(key)


def words(key: Any) -> str:
    """A key as words, with spaces for underscores."""
    if key in WORDS:
        return WORDS[key]
    text = str(key).replace("_", " ")
    return text[:1].upper() + text[1:]


Table = dict[str, Any]
DEEPEST = 8  # parts of a path
LONGEST = 200  # characters of a path
_ALIKE = {*Textured.model_fields, "name", "motion", "group"}  # keys that an object keeps when its shape changes
_SEEDS: dict[str, list[Any]] = {  # initial values of vectors without a default, when a component is entered
    "direction": [0.0, 0.0, 1.0], "bounds": [[-1000.0, 1000.0]] * 3, "position": [0.0, 0.0, 0.0],
    "origin": [0.0, 0.0, 0.0], "texture_offset": [0.0, 0.0],
}  # fmt: skip
_ALL_ALIKE = ("resolution", "texture_size", "texture_repeats")  # all components start equal to the entered one
_START: dict[str, Table] = {  # initial keys of shapes without defaults
    "quadric": {"coefficients": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -900.0], "center": [0.0, 0.0, 280.0]}
}


def is_path(path: str) -> bool:
    """True if the text can be the path of a key."""
    try:
        path_parts(path)
    except SceneError:
        return False
    return True


def path_parts(path: str) -> list[str]:
    """Parts of a key's path, "object.0.radius". Raises SceneError for an invalid path."""
    parts = key_parts(path) if len(path) <= LONGEST else []
    if not all(parts) or not 1 <= len(parts) <= DEEPEST:
        raise SceneError(f"scene: {brief(path)}: must be the path of a key, like object.0.radius")
    return parts


def at(node: Any, parts: Sequence[str]) -> Any:
    """The entry of nested tables and lists at the keys and indices `parts`; None if there is none."""
    for part in parts:
        if isinstance(node, list | tuple):
            node = node[int(part)] if part.isdecimal() and len(part) < 10 and int(part) < len(node) else None
        else:
            node = node.get(part) if isinstance(node, Mapping) else None
    return node


def as_lists(value: Any) -> Any:
    """A value with lists instead of tuples, as in a scene file."""
    return [as_lists(entry) for entry in value] if isinstance(value, list | tuple) else value


def with_value(table: Table, parts: list[str], value: Any) -> Table:
    """A copy of the table with a value at `parts`, without keys that contradict it. Raises SceneError."""
    changed: Table = _copied({key: copy(entry) for key, entry in table.items()}, parts)
    displace(changed, ".".join(parts), value)
    if (fault := put(changed, parts, value)) is not None:
        raise SceneError(f"scene: {brief('.'.join(parts))}: {fault}")
    return changed


def without(table: Table, parts: list[str]) -> Table:
    """The table without a key, and without tables that become empty."""
    if at(table, parts) is None:
        return table
    changed: Table = _copied(table, parts)
    *outer, last = parts
    node = at(changed, outer)
    if not isinstance(node, dict):
        raise SceneError(f"scene: {brief('.'.join(parts))}: must be one of several keys; got a component")
    del node[last]
    return without(changed, outer) if outer and not node and not outer[-1].isdecimal() else changed


def _copied(node: Any, parts: Sequence[str]) -> Any:
    """A copy of the tables and lists along `parts`; other values are shared."""
    if not isinstance(node, dict | list):
        return node
    changed = node.copy()
    if parts and (inner := at(node, parts[:1])) is not None:
        key: Any = int(parts[0]) if isinstance(node, list) else parts[0]
        changed[key] = _copied(inner, parts[1:])
    return changed


def reshaped(item: Table, shape: Any, kept: Mapping[str, Table]) -> tuple[Table, dict[str, Table]]:
    """Change the shape of an object. Returns the object, and the keys that it had with other shapes, by shape.

    kept: such keys from former changes, which are restored. An invalid shape is left for validation to reject.
    """
    own = {key: value for key, value in item.items() if key not in _ALIKE}
    alike = {key: value for key, value in item.items() if key in _ALIKE}
    old = str(item.get("shape"))
    if isinstance(shape, str) and shape in SHAPES:
        mapping = alike.get("texture_mapping", "projected")
        fits = mapping == "projected" or mapping in SHAPES[shape].MAPPINGS
        known = SHAPES[shape].model_fields
        alike = {
            key: value
            for key, value in alike.items()
            if key in known and (fits or key == "texture" or key not in Textured.model_fields)
        }
    back = kept.get(shape, _START.get(shape, {})) if isinstance(shape, str) else {}
    return {"shape": shape} | alike | back | {"shape": shape}, {**kept, old: own}


def seed(key: str, value: Any) -> list[Any] | None:
    """Initial value of a vector without a default when one component is entered; None for other keys."""
    return [value, value] if key in _ALL_ALIKE else _SEEDS.get(key)


def pose_for(rotation: Any, part: str) -> Any:
    """A static rotation in the form that has the key `part`: unchanged if it has this form, else one by 0 deg."""
    if part.isdecimal():
        return rotation if isinstance(rotation, list) else [0.0, 0.0, 0.0]
    if part in ("axis", "angle"):
        is_one = isinstance(rotation, Mapping) and "axis" in rotation
        return rotation if is_one else {"axis": [0.0, 1.0, 0.0], "angle": 0.0}
    is_one = isinstance(rotation, Mapping) and "quaternion" in rotation
    return rotation if is_one else {"quaternion": [1.0, 0.0, 0.0, 0.0]}


def placed(error: SceneError) -> dict[str, str]:
    """Messages of a SceneError by path of the key; "" for a message without a key."""
    found: dict[str, str] = {}
    for message in error.messages:
        match = re.fullmatch(r"[^:]*: ([^:]+): (.*)", message)
        key, rule = match.groups() if match else ("scene", message)
        found.setdefault("" if key == "scene" else ".".join(key_parts(key)), rule)
    return found


def sparse(table: Mapping[str, Any]) -> Table:
    """The valid table of a scene without the keys that have their defaults.

    Each table is processed by itself, because defaults depend only on keys of the same table. Tables in which a key has
    several values stay as they are.
    """
    swept = {location[:2] if location[0] in ("object", "group") else location[:1] for location, _ in swept_keys(table)}
    found: Table = {}
    for key, value in table.items():
        if key in ("object", "group"):
            models = [SHAPES[item["shape"]] if key == "object" else Group for item in value]
            items = enumerate(zip(models, value, strict=True))
            found[key] = [dict(item) if (key, k) in swept else _sparse(model, item) for k, (model, item) in items]
        elif key in SECTIONS:
            if part := dict(value) if (key,) in swept else _sparse(SECTIONS[key], value):
                found[key] = part
        elif value != "":  # the title
            found[key] = value
    return found


def _sparse(model: Any, table: Mapping[str, Any]) -> Table:
    whole, left = model.model_validate(dict(table)), dict(table)
    leaves = [[key] for key in table if key not in ("shape", "name", "motion")]
    leaves += [["motion", key] for key in table.get("motion", ())]
    for leaf in leaves:
        fewer = without(left, leaf)
        try:
            if model.model_validate(fewer) == whole:
                left = fewer
        except ValueError:  # it must be given
            continue
    return left
