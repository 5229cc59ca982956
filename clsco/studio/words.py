"""Labels, symbols and useful ranges of the keys of a scene: those of the thesis where it has them."""

from __future__ import annotations

from typing import Any

THESIS_TITLES = (
    "Input Image File",
    "Select Object Type",
    "Select Object Properties",
    "Motion parameters",
    "Camera Specifications",
)
SHAPE_LABELS = {
    "plane": "Planar", "cylinder": "Cylindrical", "sphere": "Spherical", "cone": "Conical", "ellipsoid": "Elliptical",
    "quadric": "Quadric", "depth_map": "Depth map",
}  # fmt: skip
LABELS = {  # words of the thesis
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
    "light.ambient": "Ambient light", "sensor.seed": "Seed of the noise",
    "sensor.iso_base": "ISO of the full well",
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
    "resolution": ("columns", "rows"),
    "band": ("lowest", "highest"),
    "quantum_efficiency": ("red", "green", "blue"),
    "size": ("width", "height", "depth"),
    "texture_size": ("width", "height"),
    "texture_repeats": ("across", "up"),
    "texture_offset": ("right", "up"),
    "semi_axes": ("a", "b", "c"),
    "quaternion": ("w", "x", "y", "z"),
    "bounds": ("x from", "x to", "y from", "y to", "z from", "z to"),
    "coefficients": ("a200", "a020", "a002", "a110", "a011", "a101", "a100", "a010", "a001", "a000"),
}
SLIDERS = {  # where useful values are; what is typed may be beyond
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
BY_FOCAL_LENGTH = {"sensor_distance": (1.01, 1.5), "focus_distance": (2.0, 50.0)}  # times it
OWN_ORDER = ("axis", "nappe", "unit", "scale", "baseline", "offset")  # after what the thesis names


def pose_label(path: str) -> str:
    """Label of a key of a static rotation, "" of others: Rotation alone is that of a motion."""
    _, _, key = path.rpartition("rotation")
    labels = {
        "": "Pose",
        ".axis": "Axis of the pose",
        ".angle": "Angle of the pose",
        ".quaternion": "Pose as quaternion",
    }
    is_pose = path.startswith("object.") and ".rotation" in path and ".keyframe." not in path
    return labels.get(key, "") if is_pose else ""


def keyframe_label(path: str) -> str:
    """Label of a key of a keyframe, which are numbered from 1; "" of others."""
    number, _, key = path.partition(".keyframe.")[2].partition(".")
    return f"{words(key)} of keyframe {int(number) + 1}" if key else ""


def words(key: Any) -> str:
    """A key as words."""
    if key in WORDS:
        return WORDS[key]
    text = str(key).replace("_", " ")
    return text[:1].upper() + text[1:]
