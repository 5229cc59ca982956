"""The ray tracer against Mitsuba 3: a textured sphere through a thin lens, once by each.

Mitsuba's `thinlens` camera knows no blur radius and no normalization distance: it gets the aperture's radius,
the distance in focus and the field of view of the frame at the distance s0. The sphere is a fine mesh whose
texture coordinates are the pinhole projection of its vertices; it glows by its texture without illumination.

With Mitsuba 3.9.1 and the defaults below both differ by 3.95e-4 RMS (68.1 dB, peak 1.0), where the noise of
both together is 3.93e-4; their means differ by 5e-6.

    python -m benchmarks.truth.mitsuba_check [--size 128] [--samples 4096] [--seeds 4]
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

import clsco
from benchmarks.truth.traced import traced

FRAME = 512
PITCH, S0, APERTURE, FOCAL_LENGTH, SENSOR = 0.01, 20.0, 10.0, 20.0, 21.739
CENTER, RADIUS = 280.0, 30.0

Array = NDArray[np.float64]


def sphere_scene() -> clsco.Scene:
    """The thesis' camera and a sphere of radius 30 mm at (0, 0, 280) mm."""
    camera: dict[str, Any] = {"focal_length": FOCAL_LENGTH, "aperture_diameter": APERTURE, "sensor_distance": SENSOR}
    camera |= {"normalization_distance": S0, "pixel_pitch": PITCH, "resolution": [FRAME, FRAME]}
    ball = {"shape": "sphere", "center": [0.0, 0.0, CENTER], "radius": RADIUS, "texture": texture()}
    return clsco.parse_scene({"camera": camera, "object": [ball]})


def texture() -> Array:
    """Linear radiance (512, 512): courses of bricks with mortar, and noise from texel to texel."""
    i, j = np.mgrid[:FRAME, :FRAME]
    mortar = (i % 32 < 3) | ((j + 32 * ((i // 32) % 2)) % 64 < 3)
    return np.where(mortar, 0.6, 0.2 + 0.2 * np.random.default_rng(0).random((FRAME, FRAME)))


def _mesh(rings: int, sectors: int) -> Any:
    """The glowing sphere in Mitsuba's axes (x to the left), poles on the optical axis, as triangles."""
    polar = np.pi * np.arange(rings + 1) / rings
    turn = 2 * np.pi * np.arange(sectors) / sectors
    x, y = (RADIUS * np.outer(np.sin(polar), side(turn)).ravel() for side in (np.cos, np.sin))
    z = CENTER - RADIUS * np.repeat(np.cos(polar), sectors)
    ring, sector = (index.ravel() for index in np.mgrid[:rings, :sectors])
    here, beside = ring * sectors + sector, ring * sectors + (sector + 1) % sectors
    # Both triangles of a cell run so that their normal, which is the side that glows, points outwards.
    faces = np.stack([here, here + sectors, beside, beside, here + sectors, beside + sectors], axis=1)
    width = FRAME * PITCH / S0
    coordinates = np.column_stack([0.5 + x / z / width, 0.5 - y / z / width])
    data = mi.TensorXf(texture().astype(np.float32)[:, :, None])
    bitmap = {"type": "bitmap", "data": data, "raw": True, "filter_type": "nearest", "wrap_mode": "mirror"}
    properties = mi.Properties()
    properties["emitter"] = mi.load_dict({"type": "area", "radiance": bitmap})
    mesh = mi.Mesh("ball", len(x), 2 * len(faces), has_vertex_texcoords=True, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = np.column_stack([-x, y, z]).ravel().astype(np.float32)
    values["vertex_texcoords"] = coordinates.ravel().astype(np.float32)
    values["faces"] = faces.ravel().astype(np.uint32)
    values.update()
    return mesh


def mitsuba_image(corner: tuple[int, int], size: int, samples: int, seeds: int) -> list[NDArray[Any]]:
    """Pictures (size, size), one per seed, of the window whose first pixel is `corner` (row, column)."""
    film = {
        "type": "hdrfilm",
        "width": FRAME,
        "height": FRAME,
        "crop_offset_x": corner[1],
        "crop_offset_y": corner[0],
        "crop_width": size,
        "crop_height": size,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    camera = {
        "type": "thinlens",
        "aperture_radius": APERTURE / 2,
        "focus_distance": 1 / (1 / FOCAL_LENGTH - 1 / SENSOR),
        "fov": 2 * math.degrees(math.atan(FRAME * PITCH / (2 * S0))),
        "fov_axis": "x",
        "near_clip": 1.0,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0]),
        "film": film,
        "sampler": {"type": "multijitter", "sample_count": samples},
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": camera,
            "ball": _mesh(1024, 2048),
        }
    )
    return [np.asarray(mi.render(scene, seed=mi.UInt32(seed)))[:, :, 0] for seed in range(seeds)]


def report(corner: tuple[int, int], size: int, samples: int, seeds: int) -> None:
    """Print the difference of both pictures, the noise of each, and how long each took."""
    window = np.s_[corner[0] : corner[0] + size, corner[1] : corner[1] + size]
    began = time.perf_counter()
    images = np.array(mitsuba_image(corner, size, samples, seeds), float)
    seconds = time.perf_counter() - began
    theirs, their_noise = images.mean(0), math.sqrt(np.mean(images.var(0, ddof=1)) / seeds)
    print(
        f"Mitsuba {mi.__version__} {mi.variant()}: {seeds} x {samples} samples, noise {their_noise:.2e}, "
        f"{seconds:.1f} s"
    )
    ours, errors = (each[window] for each in traced(sphere_scene(), 2e-4))
    our_noise = rms(errors)
    difference = ours - theirs
    print(f"tracer: noise {our_noise:.2e} in the window")
    print(f"RMSE {rms(difference):.2e}, PSNR {-20 * math.log10(rms(difference)):.1f} dB")
    print(f"both noises together {math.hypot(our_noise, their_noise):.2e}, mean {difference.mean():+.1e}")


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Read the command line and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=128, help="side of the compared window, px")
    parser.add_argument("--corner", type=int, nargs=2, default=(60, 100), help="its first row and column")
    parser.add_argument("--samples", type=int, default=4096, help="rays per pixel and seed in Mitsuba")
    parser.add_argument("--seeds", type=int, default=4, help="independent pictures by Mitsuba")
    parser.add_argument("--variant", default="scalar_rgb", help="llvm_ad_rgb is faster where its LLVM works")
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)
    report(tuple(arguments.corner), arguments.size, arguments.samples, arguments.seeds)


if __name__ == "__main__":
    main()
