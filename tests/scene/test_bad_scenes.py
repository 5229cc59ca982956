"""Every rule of a scene, broken: each case has one fault and must give exactly its message."""

from __future__ import annotations

import tomllib

import pytest

from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from tests.scenes import refusals

NAMES = {
    "CENTERED": "rectangle, disc, box, cylinder, sphere, ellipsoid, quadric or depth_map",
    "BOUNDED": "plane, cylinder, sphere, cone, ellipsoid, quadric, depth_map or background",
    "SHAPES": "plane, rectangle, disc, box, cylinder, sphere, cone, ellipsoid, quadric, depth_map or background",
    "ONE OPENING": 'cannot change with psf.model = "wave" or aberrations, whose blur is that of one opening',
    "SOME RIMS": ", ".join(5 * ["{distance = 1.0, diameter = 2.0}"]),
    "SOME OBJECTS": ", ".join(65 * ['{shape = "sphere"}']),
    "SOME GROUPS": ", ".join(65 * ['{name = "a"}']),
    "FORMS OF ROTATIONS": "must be a list of 3 angles, {axis, angle} or {quaternion}",
    "SOME KEYS": ", ".join(257 * ["{time = 0}"]),
}
"""Longer texts by their abbreviation in a table of cases."""


def cases(text: str) -> list[list[str]]:
    """Pairs of "input -> message", of lines between ";"; a message may have a line of its own."""
    for name, value in NAMES.items():
        text = text.replace(name, value)
    pairs = (line.split(" -> ") for line in text.replace("\n    ->", " ->").splitlines()[1:])
    return [[lines.replace(" ; ", "\n"), message] for lines, message in pairs]


# A line of a scene file whose object is valid, and the message.
SCENES = cases(r"""
title = 3 -> title: must be text; got 3
title = "a\nb" -> title: must be one line of text without control characters; got "a\nb"
camera = 3 -> camera: must be a table; got 3
camera.focal_length = -3 -> camera.focal_length: must be greater than 0 mm; got -3
camera.focal_length = 1e-7 -> camera.focal_length: must be between 1e-06 and 1e+09 mm; got 1e-07
camera.focal_length = "20" -> camera.focal_length: must be a number; got "20"
camera.focal_length = nan -> camera.focal_length: must be a finite number; got nan
camera.focal_lenght = 20.0 -> camera.focal_lenght: unknown key (did you mean focal_length?); got 20.0
camera = {focal_length = 1e-4, f_number = 1e4}
    -> camera.f_number: must leave an aperture between 1e-06 and 1e+09 mm; got 10000.0
camera = {f_number = 2, aperture_diameter = 10}
    -> camera.aperture_diameter: give f_number or aperture_diameter, not both; got 10
camera = {focus_distance = 250, sensor_distance = 21.739}
    -> camera.sensor_distance: give focus_distance or sensor_distance, not both; got 21.739
camera.focus_distance = 20 -> camera.focus_distance: must be greater than focal_length = 20 mm; got 20
camera.focus_distance = 20.00000001
    -> camera.focus_distance: too close to focal_length = 20 mm: detector beyond 1e+09 mm; got 20.00000001
camera.resolution = 512 -> camera.resolution: must be a list of 2 integers; got 512
camera.resolution = [512.0, 512] -> camera.resolution[0]: must be an integer; got 512.0
camera.resolution = [32768, 8193] -> camera.resolution: must have at most 268435456 pixels in all; got [32768, 8193]
camera.frames = 3 -> camera.frames: unknown key (did you mean sequence.frames?); got 3
camera.motion.velocity = [1, 2] -> camera.motion.velocity: must be a list of 3 numbers; got [1, 2]
camera.motion.speed = [0, 0, 1] -> camera.motion.speed: unknown key; got [0, 0, 1]
camera.motion.velocty = [0, 0, 1] -> camera.motion.velocty: unknown key (did you mean velocity?); got [0, 0, 1]
camera.baseline = 65 -> camera.baseline: unknown key (did you mean stereo.baseline?); got 65
stereo = {} -> stereo.baseline: must be given; got nothing
stereo = {baseline = 65, toe_in = 45} -> stereo.toe_in: must be between 0 and 45 deg, 45 excluded; got 45
stereo = {baseline = 65, toein = 1} -> stereo.toein: unknown key (did you mean toe_in?); got 1
psf.model = "disc" -> psf.model: must be pillbox, gaussian or wave; got "disc"
psf.model = 1 -> psf.model: must be pillbox, gaussian or wave; got 1
psf.edge = "sharp" -> psf.edge: must be integrated, area or sampled; got "sharp"
psf.tilt = 1 -> psf.tilt: must be true or false; got 1
psf.occlusion = true -> psf.occlusion: must be visibility, layered or none; got true
psf.sigma_ratio = 0.7 -> psf.sigma_ratio: belongs to psf.model = "gaussian", not "pillbox"; got 0.7
psf.truncation = 2 -> psf.truncation: belongs to psf.model = "gaussian", not "pillbox"; got 2
psf.border = "gain" -> psf.border: must be lose or renormalize; got "gain"
psf.radius = 3 -> psf.radius: unknown key (did you mean object[0].radius?); got 3
sequence.shutter = 0
    -> sequence.shutter: must be greater than 0 s; for an instant give a short one, such as 1e-6; got 0
sequence.shutter = 0.0
    -> sequence.shutter: must be greater than 0 s; for an instant give a short one, such as 1e-6; got 0.0
sequence.shutter = 1.5 -> sequence.shutter: must be at most interval = 1 s; got 1.5
sequence = {interval = 0.04, shutter = 0.05} -> sequence.shutter: must be at most interval = 0.04 s; got 0.05
sequence.samples = 0 -> sequence.samples: must be an integer between 1 and 4096, or "auto"; got 0
sequence.samples = 4097 -> sequence.samples: must be an integer between 1 and 4096, or "auto"; got 4097
sequence.sampling = "start" -> sequence.sampling: must be midpoint or endpoint; got "start"
motion.warp = "backward" -> motion.warp: must be inverse or forward; got "backward"
motion.rotation = "quaternion" -> motion.rotation: must be euler or axis; got "quaternion"
motion.texture_filter = "linear" -> motion.texture_filter: must be bicubic, bilinear or nearest; got "linear"
motion = {warp = "forward", texture_filter = "nearest"}
    -> motion.texture_filter: belongs to motion.warp = "inverse", not "forward"; got "nearest"
motion.velocity = [1.0, 0.0, 0.0]
    -> motion.velocity: unknown key (did you mean object[0].motion.velocity?); got [1.0, 0.0, 0.0]
fill.method = "ait" -> fill.method: belongs to motion.warp = "forward", not "inverse"; got "ait"
fill.domain = "span" -> fill.domain: belongs to motion.warp = "forward", not "inverse"; got "span"
fill = {method = "magic"} -> fill.method: must be ait, mean_median or none; got "magic"
image.transfer = "rec709" -> image.transfer: must be srgb or linear; got "rec709"
light = {} -> light: must have a direction or a position; got neither
light.ambient = 0.2 -> light: must have a direction or a position; got neither
light.direction = [0, 0, 0]
    -> light.direction: must not be the zero vector (one component of 1e-06 at least); got [0, 0, 0]
light = {direction = [0, 0, 1], position = [1, 2, 3]}
    -> light.position: give direction or position, not both; got [1, 2, 3]
light = {direction = [0, 0, 1], color = 1} -> light.color: unknown key; got 1
objects = [] -> objects: unknown key (did you mean object?); got []
radius = 3 -> radius: unknown key (did you mean object[0].radius?); got 3
"a b" = 1 -> "a b": unknown key; got 1
sequence.shutter_curve = "round"
    -> sequence.shutter_curve: must be box, trapezoid, triangle, or a list of 2 to 256 weights; got "round"
sequence.shutter_curve = [1]
    -> sequence.shutter_curve: must be box, trapezoid, triangle, or a list of 2 to 256 weights; got [1]
sequence.shutter_curve = [1, true]
    -> sequence.shutter_curve: must be box, trapezoid, triangle, or a list of 2 to 256 weights; got [1, true]
sequence.shutter_curve = [0, -1, 1]
    -> sequence.shutter_curve: must have weights between 0 and 1e+09, one of them above 0; got [0, -1, 1]
sequence.shutter_curve = [0, nan]
    -> sequence.shutter_curve: must have weights between 0 and 1e+09, one of them above 0; got [0, nan]
sequence.shutter_curve = [0, 0.0]
    -> sequence.shutter_curve: must have weights between 0 and 1e+09, one of them above 0; got [0, 0.0]
sequence = {sampling = "endpoint", shutter_curve = "triangle"}
    -> sequence.shutter_curve: belongs to sequence.sampling = "midpoint", not "endpoint"; got "triangle"
sequence.readout = -0.1
    -> sequence.readout: must be at least 0 s; for the other order of the rows change scan; got -0.1
sequence.readout = 2e9 -> sequence.readout: must be between 0 and 1e+09 s; got 2000000000.0
sequence.shutter_start = 2e9 -> sequence.shutter_start: must be between -1e+09 and 1e+09 s; got 2000000000.0
sequence.readout = nan -> sequence.readout: must be a finite number; got nan
sequence.readout = "slow" -> sequence.readout: must be a number; got "slow"
sequence = {sampling = "endpoint", readout = 0.1}
    -> sequence.readout: belongs to sequence.sampling = "midpoint", not "endpoint"; got 0.1
sequence.scan = "upwards"
    -> sequence.scan: must be top_to_bottom, bottom_to_top, left_to_right or right_to_left; got "upwards"
aperture = {shape = 'ring', blades = 5} -> aperture.blades: belongs to aperture.shape = "polygon", not "ring"; got 5
aperture.rotation = 5.0 -> aperture.rotation: belongs to aperture.shape = "polygon" or "image", not "circle"; got 5.0
aperture = {shape = 'ring', blade_curvature = 0.5}
    -> aperture.blade_curvature: belongs to aperture.shape = "polygon", not "ring"; got 0.5
aperture = {shape = 'polygon', blade_curvature = 1.5} -> aperture.blade_curvature: must be between -1 and 1; got 1.5
aperture = {shape = 'polygon', blades = 3, blade_curvature = -0.5}
    -> aperture.blade_curvature: must be at least -0.464 with 3 blades, which would cross one another; got -0.5
aperture.squeeze = 0.2 -> aperture.squeeze: must be between 0.25 and 4; got 0.2
aperture.exposure = 'darker' -> aperture.exposure: must be normalized or area; got "darker"
aperture.squeeze = 2.0 ; psf.model = 'gaussian'
    -> aperture.squeeze: an aperture that is squeezed needs psf.model = "pillbox" or "wave"; got 2.0
aperture.squeeze = 2.0 ; psf.edge = 'sampled'
    -> aperture.squeeze: an aperture that is squeezed needs psf.edge = "integrated" or "area"; got 2.0
aperture.obstruction = 0.5 -> aperture.obstruction: belongs to aperture.shape = "ring", not "circle"; got 0.5
aperture = {shape = 'ring', obstruction = 1} -> aperture.obstruction: must be between 0.01 and 0.99; got 1
aperture.rim = 3 -> aperture.rim: must be an array of tables, [[aperture.rim]]; got 3
aperture.rim = [SOME RIMS] -> aperture.rim: must hold at most 4 rims; got 5
aperture.rim = [{distance = 1.0}] -> aperture.rim[0].diameter: must be given; got nothing
aperture.rim = [{distance = 2000.0, diameter = 2.0}]
    -> aperture.rim[0].distance: must be between -1000 and 1000 mm; got 2000.0
aperture.rim = [{distance = 1.0, diameter = 2.0}] ; psf.edge = 'sampled'
    -> aperture.rim: needs psf.edge = "integrated" or "area"; got "sampled"
aperture.rim = [{distance = -30.0, diameter = 2.0}]
    -> aperture.rim[0].distance: must be before the detector, 21.739 mm behind the lens; got -30.0
aperture.squeeze = 0.5 ; psf = {model = 'wave', seidel = {W040 = 1.0}}
    -> aperture.squeeze: must be at least 1 with psf.seidel or psf.zernike, which are of a circle; got 0.5
aperture.shape = 'image' -> aperture.image: is needed by aperture.shape = "image"; got none
psf.wavelengths = [620, 540, 460]
    -> psf.wavelengths: belongs to psf.model = "wave" or to aberrations; got [620.0, 540.0, 460.0]
psf = {model = "gaussian", bandwidth = 10} -> psf.bandwidth: belongs to psf.model = "wave", not "gaussian"; got 10
psf.tail = 0.1 -> psf.tail: belongs to psf.model = "wave", not "pillbox"; got 0.1
psf.rest = "lose" -> psf.rest: belongs to psf.model = "wave", not "pillbox"; got "lose"
psf = {model = "wave", sigma_ratio = 1} -> psf.sigma_ratio: belongs to psf.model = "gaussian", not "wave"; got 1
psf = {model = "wave", edge = "area"} -> psf.edge: must be "integrated" with psf.model = "wave"; got "area"
psf = {model = "wave", edge = "sampled"} -> psf.edge: must be "integrated" with psf.model = "wave"; got "sampled"
psf = {model = "wave", wavelengths = 550} -> psf.wavelengths: must be a list of 3 numbers; got 550
psf = {model = "wave", wavelengths = [99, 540, 465]} -> psf.wavelengths[0]: must be between 100 and 20000 nm; got 99
psf = {model = "wave", tail = 0.3} -> psf.tail: must be between 0.0001 and 0.2; got 0.3
psf = {model = "wave", rest = "keep"} -> psf.rest: must be renormalize or lose; got "keep"
psf = {model = "gaussian", seidel = {W040 = 1.0}}
    -> psf.seidel: belongs to psf.model = "wave" or "pillbox", not "gaussian"; got a table of 1 keys
psf = {edge = "area", seidel = {W040 = 1.0}}
    -> psf.edge: must be "integrated" with psf.seidel or psf.zernike; got "area"
psf.seidel = {W040 = 1.0} ; aperture.rim = [{distance = 20.0, diameter = 14.0}]
    -> aperture.rim: must be absent with psf.seidel or psf.zernike; got "some"
psf.seidel = {W040 = 1.0} ; lens.keyframe = [{time = 0.0, f_number = 2.0}, {time = 1.0, f_number = 4.0}]
    -> lens.keyframe[0].f_number: ONE OPENING; got 2.0
camera.resolution = [9, 9] ; psf.seidel = {W311 = 1.0} ; lens.keyframe = [{time = 0.0, f_number = 2.0}]
    -> lens.keyframe[0].f_number: ONE OPENING; got 2.0
psf = {model = "wave", seidel = {W131 = -20.5}} -> psf.seidel.W131: must be between -20 and 20 waves; got -20.5
psf = {model = "wave", seidel = {W404 = 1.0}} -> psf.seidel.W404: unknown key (did you mean W040?); got 1.0
psf = {model = "wave", zernike = {"3,1" = 21}} -> psf.zernike."3,1": must be between -20 and 20 waves; got 21
psf = {model = "wave", zernike = {"3,2" = 1}} -> psf.zernike."3,2": unknown key (did you mean 6,2?); got 1
psf = {model = "wave", zernike = 3} -> psf.zernike: must be a table; got 3
psf = {model = "wave", bandwidth = 470}
    -> psf.bandwidth: must be less than each of the wavelengths, of which one is 465 nm; got 470.0
sensor = "on" -> sensor: must be a table; got "on"
sensor.white = 1.0 -> sensor.white: unknown key; got 1.0
sensor.white_electrons = 0.5 -> sensor.white_electrons: must be between 1 and 1e+07 e-; got 0.5
sensor.white_electrons = 20000000.0 -> sensor.white_electrons: must be between 1 and 1e+07 e-; got 20000000.0
sensor.full_well = inf -> sensor.full_well: must be a finite number; got inf
sensor.full_well = 0 -> sensor.full_well: must be between 1 and 1e+07 e-; got 0
sensor.read_noise = -1.0 -> sensor.read_noise: must be between 0 and 1000000 e-; got -1.0
sensor.read_noise = "low" -> sensor.read_noise: must be a number; got "low"
sensor.dark_current = -0.1 -> sensor.dark_current: must be between 0 and 1e+09 e-/s; got -0.1
sensor.temperature = -300.0 -> sensor.temperature: must be between -273.15 and 1000 degC; got -300.0
sensor.temperature_reference = 2000.0 -> sensor.temperature_reference: must be between -273.15 and 1000 degC; got 2000.0
sensor.temperature_doubling = 0.0 -> sensor.temperature_doubling: must be greater than 0 degC; got 0.0
sensor.temperature_doubling = 2000.0 -> sensor.temperature_doubling: must be between 0.1 and 1000 degC; got 2000.0
sensor.prnu = 1.5 -> sensor.prnu: must be between 0 and 1; got 1.5
sensor.dsnu = -0.5 -> sensor.dsnu: must be between 0 and 1000000 e-; got -0.5
sensor.hot_pixels = 2.0 -> sensor.hot_pixels: must be between 0 and 1; got 2.0
sensor.bits = 17 -> sensor.bits: must be between 1 and 16; got 17
sensor.bits = 12.0 -> sensor.bits: must be an integer; got 12.0
sensor.black_level = -1 -> sensor.black_level: must be between 0 and 65535 DN; got -1
sensor.black_level = 4096 -> sensor.black_level: must be at most 4095 with bits = 12; got 4096
sensor.black_level = 4095
    -> sensor.black_level: must be below 4095, or with a gain, which else follows from the codes above; got 4095
sensor.iso = 0.0 -> sensor.iso: must be between 1 and 1e+07; got 0.0
sensor.iso_base = 200.0 -> sensor.iso_base: belongs to iso, which is not given; got 200.0
sensor = {iso = 100.0, iso_base = 0.5} -> sensor.iso_base: must be between 1 and 1e+07; got 0.5
sensor.gain = 0.0 -> sensor.gain: must be greater than 0 DN/e-; got 0.0
sensor = {gain = 0.5, iso = 100.0} -> sensor.gain: give iso or gain, not both; got 0.5
sensor.quantum_efficiency = [1.0, 1.0] -> sensor.quantum_efficiency: must be a list of 3 numbers; got [1.0, 1.0]
sensor.quantum_efficiency = [1.0, 1.2, 1.0] -> sensor.quantum_efficiency[1]: must be between 1e-06 and 1; got 1.2
sensor.mosaic = "rgbg" -> sensor.mosaic: must be none, rggb, bggr, grbg or gbrg; got "rgbg"
sensor.demosaic = "malvar" -> sensor.demosaic: needs a mosaic, not "none"; got "malvar"
sensor = {mosaic = "rggb", demosaic = "linear"}
    -> sensor.demosaic: must be none, bilinear, malvar or menon; got "linear"
sensor.seed = -1 -> sensor.seed: must be between 0 and 9.223372e+18; got -1
sensor.exposure = "manual" -> sensor.exposure: must be normalized or physical; got "manual"
sensor.reference_shutter = 0.5 -> sensor.reference_shutter: belongs to exposure = "physical", not "normalized"; got 0.5
sensor = {exposure = "physical", reference_f_number = 0.0} -> sensor.reference_f_number: must be greater than 0; got 0.0
sensor.noise_seed = 9007199254740992 -> sensor.noise_seed: must be between 0 and 9.007199e+15; got 9007199254740992
sensor.seed = 9223372036854775808 -> sensor.seed: must be between 0 and 9.223372e+18; got 9223372036854775808
group = 3 -> group: must be an array of tables, [[group]]; got 3
group = {name = "a"} -> group: must be an array of tables, [[group]]; got a table of 1 keys
group = [3] -> group[0]: must be a table; got 3
group = [{}] -> group[0].name: must be given; got nothing
group = [{name = ""}] -> group[0].name: must not be empty; got ""
group = [{name = "a", origin = [1, 2]}] -> group[0].origin: must be a list of 3 numbers; got [1, 2]
group = [{name = "a", motion.velocity = [1, 2, inf]}] -> group[0].motion.velocity[2]: must be a finite number; got inf
group = [{name = "a", motion.speed = 1}] -> group[0].motion.speed: unknown key; got 1
group = [{name = "a", orign = 1}] -> group[0].orign: unknown key (did you mean origin?); got 1
group = [{name = "a", radius = 1}] -> group[0].radius: unknown key (did you mean object[0].radius?); got 1
group = [{name = "a"}, {name = "a"}] -> group[1].name: names must differ; group[0] has the same; got "a"
group = [SOME GROUPS] -> group: must hold at most 64 groups; got 65
groups = [] -> groups: unknown key (did you mean group?); got []
origin = [0, 0, 1] -> origin: unknown key (did you mean group[0].origin?); got [0, 0, 1]
""")

# Keys of the one object, and the message.
OBJECTS = cases(r"""
 -> object[0].shape: must be SHAPES; got nothing
shape = "depth_map" -> object[0].depth: must be given; got nothing
shape = "depth_map", depth = "z.npy", depth_kind = "euclid" -> object[0].depth_kind: must be z or ray; got "euclid"
shape = "depth_map", depth = "z.npy", unit = "coc", depth_kind = "ray"
    -> object[0].depth_kind: "ray" belongs to units of length and their inverse, not to "coc"; got "ray"
shape = "depth_map", depth = "z.npy", no_depth = "near" -> object[0].no_depth: must be around or far; got "near"
shape = "depth_map", depth = "" -> object[0].depth: must not be empty; got ""
shape = "depth_map", depth = "z.exr", depth_layer = "" -> object[0].depth_layer: must not be empty; got ""
shape = "plane", texture_layer = "a" -> object[0].texture_layer: belongs to images in EXR files; got "a"
shape = "plane", texture = "#ff8000", texture_layer = "a"
    -> object[0].texture_layer: belongs to images in EXR files; got "a"
shape = "plane", texture = "a.exr", depth_layer = "a"
    -> object[0].depth_layer: belongs to depth_map, not to plane; got "a"
shape = "depth_map", depth = "z.png", unit = "cm"
    -> object[0].unit: must be mm, m, inverse_mm, inverse_m, disparity or coc; got "cm"
shape = "depth_map", depth = "z.png", scale = inf -> object[0].scale: must be a finite number; got inf
shape = "depth_map", depth = "z.png", unit = "disparity"
    -> object[0].baseline: must be given with unit = "disparity"; got nothing
shape = "depth_map", depth = "z.png", unit = "m", baseline = 60
    -> object[0].baseline: belongs to unit = "disparity", not "m"; got 60
shape = "depth_map", depth = "z.png", unit = "inverse_m", near = 300, offset = 1
    -> object[0].near: must be without offset, as it maps the range of all numbers; got 300
shape = "depth_map", depth = "z.png", unit = "disparity", baseline = 6, near = 300
    -> object[0].near: belongs to units of length and their inverse, not to "disparity"; got 300
shape = "depth_map", depth = "z.png", near = 300
    -> object[0].far: must be given with near, in units of length; got nothing
shape = "depth_map", depth = "z.png", far = 300 -> object[0].far: must be with near; got 300
shape = "depth_map", depth = "z.png", near = 300, far = 300
    -> object[0].far: must be greater than near, 300 mm; got 300
shape = "depth_map", depth = "z.png", scale = 0 -> object[0].scale: must be at least 1e-12 in size; got 0
shape = "depth_map", depth = "z.png", unit = "disparity", baseline = -1
    -> object[0].baseline: must be greater than 0 mm; got -1
shape = "depth_map", depth = "z.png", bounds = [[0, 1], [0, 1], [0, 1]]
    -> object[0].bounds: belongs to analytic shapes, not to depth_map; got a list of 3 entries
shape = "background", distance = 3 -> object[0].distance: belongs to plane, not to background; got 3
shape = "background", bounds = [[0, 1], [0, 1], [0, 1]]
    -> object[0].bounds: belongs to shapes with a surface, not to background; got a list of 3 entries
shape = "background", group = "g" -> object[0].group: belongs to shapes with a surface, not to background; got "g"
shape = "depth_map", depth = "z.npy", rotation = [0, 10, 0]
    -> object[0].rotation: belongs to analytic shapes, not to depth_map; got [0, 10, 0]
shape = "background", motion.velocity = [1, 0, 0]
    -> object[0].motion: a background stays where it is; turn the camera by camera.motion; got a motion
shape = "sphere", depth = "z.png" -> object[0].depth: belongs to depth_map, not to sphere; got "z.png"
shape = "spheer" -> object[0].shape: must be SHAPES; got "spheer"
shape = 3 -> object[0].shape: must be SHAPES; got 3
shape = "plane", slope_x = 1e7 -> object[0].slope_x: must be between -1000000 and 1000000 mm per mm; got 10000000.0
shape = "plane", radius = 3 -> object[0].radius: belongs to disc, cylinder or sphere, not to plane; got 3
shape = "plane", nappe = "away" -> object[0].nappe: belongs to cone, not to plane; got "away"
shape = "plane", colour = "red" -> object[0].colour: unknown key; got "red"
shape = "plane", name = 3 -> object[0].name: must be text; got 3
shape = "plane", texture = "a\u0000b"
    -> object[0].texture: must be one line of text without control characters; got "a\u0000b"
shape = "plane", bounds = [0, 1] -> object[0].bounds: must be a list of 3 pairs [low, high]; got [0, 1]
shape = "plane", bounds = [[0, 1], [0, 1], [1, 1]]
    -> object[0].bounds[2]: lower bound must be less than the upper bound; got [1, 1]
shape = "plane", bounds = [[0, 1], [0, 1], [0, 1, 2]]
    -> object[0].bounds[2]: must be a list of 2 numbers; got [0, 1, 2]
shape = "plane", distance = 9, bounds = [[0, 1], [0, 1], [-40, -30]]
    -> object[0].bounds[2]: must leave part of the object in front of the lens (z > 0); got [-40.0, -30.0]
shape = "plane", motion = 3 -> object[0].motion: must be a table; got 3
shape = "plane", motion = {angular_velocity = [0, "5", 0]}
    -> object[0].motion.angular_velocity[1]: must be a number; got "5"
shape = "plane", motion = {angular = [0, 5, 0]}
    -> object[0].motion.angular: unknown key (did you mean angular_velocity?); got [0, 5, 0]
shape = "rectangle", bounds = [[0, 1], [0, 1], [0, 1]]
    -> object[0].bounds: belongs to BOUNDED, not to rectangle; got a list of 3 entries
shape = "disc", bounds = [[0, 1], [0, 1], [0, 1]]
    -> object[0].bounds: belongs to BOUNDED, not to disc; got a list of 3 entries
shape = "cylinder", axis = [0, 0, 0]
    -> object[0].axis: must not be the zero vector (one component of 1e-06 at least); got [0, 0, 0]
shape = "cylinder", distance = 250 -> object[0].distance: belongs to plane, not to cylinder; got 250
shape = "sphere", semi_axes = [1, 1, 1] -> object[0].semi_axes: belongs to ellipsoid, not to sphere; got [1, 1, 1]
shape = "cone", half_angle = 0 -> object[0].half_angle: must be between 0 and 90 deg, ends excluded; got 0
shape = "cone", nappe = "both" -> object[0].nappe: must be away or towards; got "both"
shape = "cone", center = [0, 0, 250] -> object[0].center: belongs to CENTERED, not to cone; got [0, 0, 250]
shape = "quadric", coefficients = [0, 0, 0, 0, 0, 0, 0, 0, 0, 5]
    -> object[0].coefficients: must not all be 0, or all but a000; got [0, 0, 0, 0, 0, 0, 0, 0, 0, 5]
shape = "quadric", coefficients = [1, 1, 1e31, 0, 0, 0, 0, 0, 0, 5]
    -> object[0].coefficients[2]: must be between -1e+30 and 1e+30; got 1e+31
shape = "cone", rotation = 3 -> object[0].rotation: FORMS OF ROTATIONS; got 3
shape = "cone", rotation = [1, 2] -> object[0].rotation: FORMS OF ROTATIONS; got [1, 2]
shape = "cone", rotation = {} -> object[0].rotation: FORMS OF ROTATIONS; got a table of 0 keys
shape = "cone", rotation = {axis = [1, 0, 0], quaternion = [1, 0, 0, 0]}
    -> object[0].rotation: FORMS OF ROTATIONS; got a table of 2 keys
shape = "cone", rotation = {euler = [1, 0, 0]} -> object[0].rotation: FORMS OF ROTATIONS; got a table of 1 keys
shape = "cone", rotation = [1, "2", 3] -> object[0].rotation[1]: must be a number; got "2"
shape = "cone", rotation = [1, 2, inf] -> object[0].rotation[2]: must be a finite number; got inf
shape = "cone", rotation = [2e9, 0, 0] -> object[0].rotation[0]: must be between -1e+09 and 1e+09 deg; got 2000000000.0
shape = "cone", rotation = {axis = [1, 0, 0]} -> object[0].rotation.angle: must be given; got nothing
shape = "cone", rotation = {axis = [0, 0, 0], angle = 5}
    -> object[0].rotation.axis: must not be the zero vector (one component of 1e-06 at least); got [0, 0, 0]
shape = "cone", rotation = {quaternion = [1, 0, 0]}
    -> object[0].rotation.quaternion: must be a list of 4 numbers; got [1, 0, 0]
shape = "cone", rotation = {quaternion = [1e-7, 0, 0, 0]}
    -> object[0].rotation.quaternion: must not be zero (length of 1e-06 at least); got [1e-07, 0, 0, 0]
""")


# Text of a file, and the message.
FILES = cases(r"""
 -> object: must hold 1 to 64 objects; got 0
object = [] -> object: must hold 1 to 64 objects; got 0
object = [SOME OBJECTS] -> object: must hold 1 to 64 objects; got 65
object = [{shape = "plane", name = "a"}, {shape = "cone"}, {shape = "sphere", name = "a"}]
    -> object[2].name: names must differ; object[0] has the same; got "a"
object = {shape = "plane"} -> object: must be an array of tables, [[object]]; got a table of 1 keys
object = 3 -> object: must be an array of tables, [[object]]; got 3
object = [3] -> object[0]: must be a table; got 3
sequence.readout = 0.1 ; motion.warp = "forward" ; object = [{shape = "sphere", motion.velocity = [1, 0, 0]}]
    -> sequence.readout: belongs to scenes of analytic surfaces with motion.warp = "inverse"; got 0.1
""")


def messages_of(text: str) -> tuple[str, ...]:
    return refusals(parse_scene, tomllib.loads(text), "bad.toml")


@pytest.mark.parametrize(("line", "message"), SCENES)
def test_bad_scene(line: str, message: str) -> None:
    assert messages_of(f'{line}\nobject = [{{shape = "sphere"}}]') == (f"bad.toml: {message}",)


@pytest.mark.parametrize(("keys", "message"), OBJECTS)
def test_bad_object(keys: str, message: str) -> None:
    assert messages_of(f"object = [{{{keys}}}]") == (f"bad.toml: {message}",)


@pytest.mark.parametrize(("text", "message"), FILES)
def test_bad_file(text: str, message: str) -> None:
    assert messages_of(text) == (f"bad.toml: {message}",)


@pytest.mark.parametrize(
    "rest",
    [
        '[[object]]\nshape = "depth_map"\ndepth = "z.png"',
        '[motion]\nwarp = "forward"\n[[object]]\nshape = "sphere"\nmotion.velocity = [1, 0, 0]',
        '[motion]\nwarp = "forward"\n[camera.motion]\nvelocity = [1, 0, 0]\n[[object]]\nshape = "sphere"',
    ],
)
def test_visibility_needs_rays(rest: str) -> None:
    rule = '"visibility" needs analytic surfaces, which rays can be cast at; use "layered" or "none"'
    message = f'bad.toml: psf.occlusion: {rule}; got "visibility"'
    assert messages_of(f'psf.occlusion = "visibility"\n{rest}') == (message,)
    for fine in ("", 'psf.occlusion = "layered"\n', 'psf.occlusion = "none"\n'):
        scene = parse_scene(tomllib.loads(fine + rest))
        assert parse_scene(dump(scene)) == scene


def test_names_are_reported_with_the_other_faults() -> None:
    assert messages_of('object = [{shape = "plane", name = "a"}, {shape = "plane", name = "a", distance = 0}]') == (
        "bad.toml: object[1].distance: must be greater than 0 mm; got 0",
        'bad.toml: object[1].name: names must differ; object[0] has the same; got "a"',
    )
