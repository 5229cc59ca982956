"""Lenses against Cycles: python -m benchmarks.truth.lenses --blender-python PYTHON [--samples N] [NAME ...]

A card with points of light, out of focus. Blades, their turn and the ratio of an anamorphic lens are those of Cycles'
camera; rims, distortion and what is in focus are in a shader in place of it, which traces each ray through a point of
the lens. Of longitudinal color red is compared, through the lens of red. The last line is the plain disc.

A PSNR is that of the mean of (x - a)(x - b), a and b being two pictures by Cycles with other seeds, whose noise is in
no such mean but for its scatter; noise is that of a against b. The plain disc against the same pictures says how much
there is to see.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco
from benchmarks.truth.cycles_meshes import Cycles
from benchmarks.truth.meshes import meshes_of
from benchmarks.truth.rolling_shutter import decibels
from clsco.inputs.textures import load_scene_textures

Array = NDArray[Any]
ROWS, COLUMNS, THREADS = 96, 128, 2
RIMS = ({"distance": 30.0, "diameter": 14.0}, {"distance": -6.0, "diameter": 12.0})

# Lengths in m, as Blender has them.
SHADER = """
shader lens(output point position = 0.0, output vector direction = 0.0, output color throughput = 1.0)
{
  vector at = camera_shader_raster_position() - vector(0.5);
  vector seen = vector(at[0] * %(across)g, at[1] * %(down)g, 1.0), slope = seen;
  float square;
  for (int turn = 0; turn < 30; turn++) {
    square = slope[0] * slope[0] + slope[1] * slope[1];
    float larger = 1.0 + square * (%(k1)g + square * %(k2)g);
    slope = vector(seen[0] / larger, seen[1] / larger, 1.0);
  }
  float image = %(detector)g - 0.5 * %(curvature)g * %(image)g * %(image)g * square;
  float depth = 1.0 / (1.0 / %(focal)g - 1.0 / image);
  vector drawn = camera_shader_random_sample();
  float size = %(radius)g * sqrt(drawn[0]), turn = 6.283185307179586 * drawn[1];
  vector lens = vector(size * cos(turn), size * sin(turn), 0.0);
  vector focus = slope * (%(sphere)d ? depth / sqrt(1.0 + square) : depth), detector = slope * -%(detector)g;
  int passes = 1;
  %(tests)s
  position = lens;
  direction = normalize(focus - lens);
  throughput = passes ? color(1.0) : color(0.0);
}
"""
TEST = "{ vector p = lens + (%s - lens) * %.9g; if (hypot(p[0], p[1]) > %.9g) passes = 0; }"


def texture() -> Array:
    """Points of light (256, 256), smooth enough for programs to interpolate them alike."""
    at, found = np.arange(256.0), np.full((256, 256), 0.02)
    for x, y in np.random.default_rng(2).uniform(16.0, 240.0, (60, 2)):
        found += np.exp(-((at - x) ** 2 + (at[:, None] - y) ** 2) / 8.0)
    return found.astype(np.float32)


def scene(sections: dict[str, Any], depth: float) -> clsco.Scene:
    """The card at a depth behind or before the focus, through a lens by sections of a scene file."""
    camera = clsco.Camera(resolution=(COLUMNS, ROWS), pixel_pitch=0.08, focus_distance=200.0, aperture_diameter=12.0)
    size = 1.3 * depth * 0.08 / 20.0
    card = clsco.Rectangle(
        center=(0.0, 0.0, depth), size=(size * COLUMNS, size * ROWS), texture=texture(), texture_mapping="surface"
    )
    return clsco.Scene(camera=camera, objects=(card,), **sections)


def shader(wanted: clsco.Scene) -> str:
    """A shader of the lens of a scene, for red light."""
    camera, lens = wanted.camera, wanted.lens or clsco.Lens()
    sensor, diameter, focus = camera.sensor_distance, camera.aperture_diameter, camera.focus_distance
    assert sensor is not None
    assert diameter is not None
    assert focus is not None
    tests = []
    for rim in wanted.aperture.rim:
        end, far = ("focus", focus) if rim.distance > 0 else ("detector", sensor)
        tests.append(TEST % (end, abs(rim.distance) / far, 0.5e-3 * rim.diameter))
    step = camera.pixel_pitch / camera.normalization_distance
    values = {
        "focal": 1e-3 * (camera.focal_length + lens.axial[0]), "image": 1e-3 * camera.normalization_distance,
        "k1": lens.distortion[0], "k2": lens.distortion[1], "curvature": 1e3 * lens.field_curvature,
        "sphere": lens.focus_surface == "sphere", "across": COLUMNS * step, "down": ROWS * step,
        "radius": 0.5e-3 * diameter, "detector": 1e-3 * sensor, "tests": "\n  ".join(tests),
    }  # fmt: skip
    return SHADER % values


PENTAGON, HEXAGON = {"shape": "polygon", "blades": 5}, {"shape": "polygon", "blades": 6, "rotation": 20.0}
DISTORTED, CURVED, AXIAL = {"distortion": [-0.3, 0.1, 0.0]}, {"field_curvature": -0.01}, {"axial": [0.2, 0.0, -0.15]}
# Sections of a scene file, and the opening of Cycles' camera: none where a shader stands in its place.
CASES: dict[str, tuple[dict[str, Any], dict[str, Any] | None]] = {
    "pentagon": ({"aperture": PENTAGON}, {"blades": 5}),
    "hexagon, turned by 20 deg": ({"aperture": HEXAGON}, {"blades": 6, "rotation": 20.0}),
    "squeeze of 2": ({"aperture": {"squeeze": 2.0}}, {"ratio": 2.0}),
    "cat-eyes by a front and a rear rim": ({"aperture": {"rim": RIMS}}, None),
    "distortion": ({"lens": DISTORTED}, None),
    "focus on a sphere": ({"lens": {"focus_surface": "sphere"}}, None),
    "field curvature": ({"lens": CURVED}, None),
    "longitudinal color": ({"lens": AXIAL}, None),
    "plain disc": ({}, {}),
}


def pictures(wanted: clsco.Scene, opening: dict[str, Any], python: Path, samples: int) -> tuple[Array, Array]:
    """Two pictures by Cycles with other seeds."""
    loaded, textures = load_scene_textures(wanted.model_copy(update={"lens": None}))
    meshes = meshes_of(loaded, [each.radiance for each in textures], 2)
    cycles = Cycles(python, wanted.camera, meshes, THREADS, aperture=opening)
    try:
        one, other = (cycles.render(samples, seed)[0].mean(axis=2) for seed in (1, 2))
    finally:
        cycles.close()
    return one, other


def red(frame: clsco.Frame) -> Array:
    """Red light of a frame, or that of a gray one."""
    return np.asarray(np.atleast_3d(frame.color)[..., 0])


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blender-python", type=Path, required=True, help="Python that has the package bpy")
    parser.add_argument("names", nargs="*", help="lenses, by default all", metavar="NAME")
    parser.add_argument("--samples", type=int, default=1024, help="rays per pixel")
    given = parser.parse_args()
    print("| lens | behind the focus, dB | noise | plain disc | before it, dB | noise | plain disc |")
    print("|---|---|---|---|---|---|---|")
    for name in given.names or CASES:
        found, (sections, opening) = [name], CASES[name]
        for depth in (400.0, 130.0):
            wanted = scene(sections, depth)
            of_cycles = {"osl": shader(wanted)} if opening is None else opening
            one, other = pictures(wanted, of_cycles, given.blender_python, given.samples)
            image, plain = (red(clsco.render_frame(each, truth=())) for each in (wanted, scene({}, depth)))
            squares = [(image - one) * (image - other), (one - other) ** 2, (plain - one) * (plain - other)]
            found += [decibels(float(np.mean(square))) for square in squares]
        print(f"| {' | '.join(found)} |", flush=True)


if __name__ == "__main__":
    main()
