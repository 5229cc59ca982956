"""Scenes with depth, built and rendered in Blender: pictures without blur, their depths, and Cycles' depth of field.

    BLENDER_PYTHON benchmarks/truth/blender_scenes.py DIR [--scenes garden,fence,table] [--samples 256]

BLENDER_PYTHON has the package `bpy` (4.5). DIR/SCENE.npz gets float32 arrays of 384 x 384 px, linear colors and 1/Z in
1/m, 0 for the sky: `picture` and `inverse_depth` by one ray through the center of each pixel; `*_filtered` by Blender's
default filter, which mixes pixels at edges; `inverse_depth_averaged`, means of 4 x 4 points; `front*`, the foreground
alone as premultiplied RGBA, and `back*`, the rest without it. R in px is blur_scale_B (focus - 1/Z), whose largest
magnitude in the picture is B: `truth_B` are two independent pictures with depth of field by the default filter, and
`node_B`, `node_filtered_B` the pictures by Blender's Defocus node, which gets the magnitude of R.

Surfaces glow, or a sun without extent lights them, so that they look the same from all points of the lens; a path ends
at the first surface. All noise is that of the samples of filter and lens.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Point = tuple[float, float, float]
SIZE, FOCAL_LENGTH, SENSOR = 384, 35.0, 36.0  # px, mm, mm
SCALE = FOCAL_LENGTH / SENSOR * SIZE  # px per unit of slope
BLURS = {"garden": (5, 12, 25)}  # largest |R| in px, of other scenes 12 and 25
FINE = 4  # points per pixel and axis of averaged depths
AMBIENT = 0.25


def main() -> None:
    """Build and render."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--samples", type=int, default=256, help="per pixel of each picture")
    chosen = parser.parse_args()
    print(f"radius of a far lamp's disc: {calibration(chosen.samples):.4f} R", flush=True)
    for name in chosen.scenes.split(","):
        np.savez(chosen.folder / f"{name}.npz", **rendered(name, chosen.samples))


def rendered(name: str, samples: int) -> dict[str, Any]:
    """All arrays of a scene."""
    focus = 1.0 / SCENES[name](start())
    arrays: dict[str, Any] = {"focus": focus}
    arrays["picture"], arrays["inverse_depth"] = picture(1, 0.01)
    arrays["filtered"], arrays["inverse_depth_filtered"] = picture(samples, 1.5)
    arrays["inverse_depth_averaged"] = picture(1, 0.01, scale=FINE)[1].reshape(SIZE, FINE, SIZE, FINE).mean((1, 3))
    for layer in ("front", "back"):
        for item in bpy.context.scene.objects:  # hidden objects still cast shadows
            item.visible_camera = item["layer"] == layer
        arrays[layer], arrays[f"{layer}_inverse_depth"] = picture(1, 0.01, alpha=layer == "front")
        arrays[f"{layer}_filtered"], _ = picture(samples, 1.5, alpha=layer == "front")
    for item in bpy.context.scene.objects:
        item.visible_camera = True
    for blur in BLURS.get(name, (12, 25)):
        arrays[f"blur_scale_{blur}"] = scale = blur / np.abs(focus - arrays["inverse_depth"]).max()
        set_lens(scale, focus)
        arrays[f"truth_{blur}"] = np.stack([picture(samples, 1.5, seed=seed)[0] for seed in (1, 2)])
        set_lens(0.0, focus)
        for kind in ("", "_filtered"):
            radius = scale * np.abs(focus - arrays[f"inverse_depth{kind}"])
            arrays[f"node{kind}_{blur}"] = defocus_node(arrays[kind[1:] or "picture"], radius)
    return {key: np.asarray(value, np.float32) for key, value in arrays.items()}


def calibration(samples: int) -> float:
    """Radius of the disc of a far lamp, by its second moment, over the R of 12 px that `set_lens` is asked for."""
    start()
    bpy.context.scene.world.color = (0.0, 0.0, 0.0)
    ball((6, 20, 4), 0.2, paint((1, 1, 1), glow=50.0))
    spreads = []
    for blur in (12.0, 0.0):
        set_lens(blur / (1 / 2 - 1 / 20), 1 / 2)
        weight = picture(samples, 1.5)[0].mean(-1)
        places = np.mgrid[:SIZE, :SIZE] * (weight := weight / weight.sum())
        spreads.append((places * np.mgrid[:SIZE, :SIZE]).sum() - (places.sum((1, 2)) ** 2).sum())
    return math.sqrt(2.0 * (spreads[0] - spreads[1])) / 12.0


def start() -> np.random.Generator:
    """An empty scene with camera, sun and sky, and a generator of random numbers."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.view_settings.view_transform = "CYCLES", "Raw"
    cycles = scene.cycles
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    cycles.max_bounces = cycles.transparent_max_bounces = 0
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    bpy.context.view_layer.use_pass_z = True
    data = bpy.data.cameras.new("camera")
    data.lens, data.sensor_width, data.clip_start, data.clip_end = FOCAL_LENGTH, SENSOR, 0.01, 1e6
    scene.camera = link(data, "none")
    scene.camera.rotation_euler = (math.pi / 2, 0.0, 0.0)
    sun = bpy.data.lights.new("sun", "SUN")
    sun.angle, sun.energy = 0.0, 3.0
    link(sun, "none").rotation_euler = (math.radians(42), math.radians(-28), 0.0)
    scene.world = bpy.data.worlds.new("sky")
    scene.world.color = (0.45, 0.6, 0.85)
    scene.world.cycles.sampling_method, scene.world.cycles_visibility.diffuse = "NONE", False
    return np.random.default_rng(7)


def nodes_of(owner: Any, *kinds: str) -> tuple[Any, list[Any]]:
    """The tree of a material or scene, with new nodes alone."""
    owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree, [owner.node_tree.nodes.new(kind) for kind in kinds]


def set_lens(blur_scale: float, focus: float) -> None:
    """Set depth of field whose R is blur_scale (focus - 1/Z) px, focus = 1/u in 1/m; 0 switches it off.

    A ray through a lens point at a distance A from the axis crosses depth Z off the ray through the lens's center by
    A (1 - Z/u), in slope A (1/Z - 1/u), so that the aperture's radius A is blur_scale / SCALE in m.
    """
    lens = bpy.context.scene.camera.data.dof
    lens.use_dof, lens.focus_distance = blur_scale > 0.0, 1 / focus
    lens.aperture_fstop = FOCAL_LENGTH * 1e-3 / (2.0 * max(blur_scale, 1e-6) / SCALE)


def picture(samples: int, width: float, *, seed: int = 0, scale: int = 1, alpha: bool = False) -> tuple[Array, Array]:
    """Colors, with alpha if asked for, and inverse depths. width: of the filter in px."""
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = SIZE * scale
    scene.render.film_transparent = alpha
    scene.cycles.samples, scene.cycles.seed, scene.cycles.filter_width = samples, seed, width
    tree, (layers,) = nodes_of(scene, "CompositorNodeRLayers")
    colors, depths = composed(tree, layers.outputs["Image"], layers.outputs["Depth"])
    depth = depths[..., 0].astype(float)
    return colors if alpha else colors[..., :3], np.where(depth < 1e6, 1 / depth, 0.0)


def defocus_node(image: Array, radius: Array) -> Array:
    """A picture by Blender's Defocus node."""
    bpy.context.scene.cycles.samples = 1
    kinds = ("CompositorNodeDefocus", "CompositorNodeImage", "CompositorNodeImage")
    tree, (node, *sources) = nodes_of(bpy.context.scene, *kinds)
    node.use_preview, node.use_zbuffer, node.bokeh, node.blur_max = False, False, "CIRCLE", 64.0
    for source, target, values in zip(sources, node.inputs, (image, np.stack([radius] * 3, 2)), strict=True):
        source.image = bpy.data.images.new("input", SIZE, SIZE, float_buffer=True)
        source.image.colorspace_settings.name = "Non-Color"
        rgba = np.concatenate([values, np.ones_like(values[..., :1])], axis=2)
        source.image.pixels.foreach_set(np.ascontiguousarray(rgba[::-1], np.float32).ravel())
        tree.links.new(source.outputs["Image"], target)
    return composed(tree, node.outputs["Image"])[0][..., :3]


def composed(tree: Any, *outputs: Any) -> list[Array]:
    """Render, and get RGBA of outputs of the compositor's nodes."""
    files = tree.nodes.new("CompositorNodeOutputFile")
    files.format.file_format, files.format.color_depth, files.format.color_mode = "OPEN_EXR", "32", "RGBA"
    files.file_slots.clear()
    arrays = []
    with tempfile.TemporaryDirectory() as files.base_path:
        for number, output in enumerate(outputs):
            files.file_slots.new(f"{number}_")
            tree.links.new(output, files.inputs[number])
        bpy.ops.render.render()
        for path in sorted(Path(files.base_path).iterdir()):
            image = bpy.data.images.load(str(path))
            image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
            pixels = np.empty((image.size[1], image.size[0], 4), np.float32)
            image.pixels.foreach_get(pixels.ravel())
            bpy.data.images.remove(image)
            arrays.append(pixels[::-1])
    return arrays


def link(data: Any, layer: str) -> Any:
    """Add an object to the scene."""
    item = bpy.data.objects.new("object", data)
    item["layer"] = layer
    bpy.context.scene.collection.objects.link(item)
    return item


def paint(color: Point, scale: float = 1.0, pattern: str = "Noise", glow: float = AMBIENT) -> Any:
    """A dull material with a pattern in space, `scale` cycles per m, which glows by its color, too."""
    material = bpy.data.materials.new("paint")
    material.cycles.emission_sampling = "NONE"
    kinds = ("NewGeometry", f"Tex{pattern}", "ValToRGB", "BsdfDiffuse", "Emission", "AddShader", "OutputMaterial")
    tree, nodes = nodes_of(material, *(f"ShaderNode{kind}" for kind in kinds))
    place, texture, ramp, diffuse, emission, both, output = nodes
    texture.inputs["Scale"].default_value, emission.inputs["Strength"].default_value = scale, glow
    low, high = ramp.color_ramp.elements
    low.color, high.color = (*(0.3 * part for part in color), 1), (*color, 1)
    if pattern == "Noise":
        texture.inputs["Detail"].default_value, low.position, high.position = 1.0, 0.3, 0.7
    tree.links.new(place.outputs["Position"], texture.inputs["Vector"])
    tree.links.new(texture.outputs[pattern != "Noise"], ramp.inputs[0])
    for shader in (diffuse, emission):
        tree.links.new(ramp.outputs[0], shader.inputs["Color"])
        tree.links.new(shader.outputs[0], both.inputs[shader == emission])
    tree.links.new(both.outputs[0], output.inputs[0])
    return material


def mesh(vertices: Any, faces: Any, material: Any, layer: str = "back", smooth: bool = False) -> None:
    """Add an object by vertices and faces."""
    data = bpy.data.meshes.new("mesh")
    data.from_pydata(np.asarray(vertices).tolist(), [], [list(map(int, face)) for face in faces])
    data.materials.append(material)
    data.polygons.foreach_set("use_smooth", [smooth] * len(data.polygons))
    link(data, layer).visible_diffuse = False  # what glows lights nothing


def swept(points: Any, radii: Any, material: Any, layer: str = "back", sides: int = 16) -> None:
    """Add a surface of circles around points, whose radii may differ."""
    points, radii = np.asarray(points, float), np.broadcast_to(np.asarray(radii, float), len(points))
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    first = np.cross(along, np.eye(3)[np.abs(along).max(0).argmin()])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * np.cross(along, first)[:, None]
    corner = np.arange((len(points) - 1) * sides)
    beside = corner - corner % sides + (corner + 1) % sides
    faces = np.stack([corner, beside, beside + sides, corner + sides], axis=1)
    mesh((points[:, None] + radii[:, None, None] * ring).reshape(-1, 3), faces, material, layer, smooth=True)


def wire(a: Point, b: Point, radius: float, material: Any, layer: str = "back", sag: float = 0.0) -> None:
    """Add a wire that hangs between two points."""
    t = np.linspace(0, 1, 25 if sag else 2)[:, None]
    points = (1 - t) * np.asarray(a, float) + t * np.asarray(b, float) - sag * 4 * t * (1 - t) * [0, 0, 1]
    swept(points, radius, material, layer, sides=8)


def ball(center: Point, radius: float, material: Any, layer: str = "back") -> None:
    """Add a ball."""
    angle = np.linspace(1e-3, np.pi - 1e-3, 33)
    height = np.stack([0 * angle, 0 * angle, -radius * np.cos(angle)], 1)
    swept(height + np.asarray(center, float), radius * np.sin(angle), material, layer, sides=48)


def box(low: Point, high: Point, material: Any) -> None:
    """Add a box."""
    corners = [[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    mesh(corners, faces, material)


def leaves(rng: Any, center: Point, spread: Point, count: int, size: float, material: Any, layer: str = "back") -> None:
    """Add leaves, turned at random."""
    side = [(0.45, -0.3, 0.1), (0.35, 0.5, 0.1)]
    shape = size * np.array([(0, -1, 0), *side, (0, 1, 0), *((-x, y, z) for x, y, z in reversed(side))])
    vertices = []
    for offset in rng.uniform(-1, 1, (count, 3)):
        turn = mathutils.Quaternion(rng.normal(size=4)).normalized().to_matrix()
        vertices.append(shape @ np.array(turn).T + np.asarray(center) + offset * np.asarray(spread))
    mesh(np.concatenate(vertices), np.arange(6 * count).reshape(-1, 6), material, layer)


def garden(rng: Any) -> float:
    """A tree and a ball in focus, leaves and grass before them, stakes and trees behind. Returns the focus in m."""
    box((-80, -1, -2), (80, 90, -1), paint((0.25, 0.4, 0.1), 3))
    bark, leaf, stake = paint((0.4, 0.25, 0.15), 30), paint((0.4, 0.6, 0.15), 9), paint((0.75, 0.7, 0.6), 6)
    swept([(0.25, 3, -1), (0.2, 3, 0), (0.3, 3, 0.7), (0.2, 3.1, 1.4)], (0.09, 0.07, 0.05, 0.02), bark)
    for x, y, z in rng.uniform(-0.6, 0.6, (9, 3)):
        wire((0.25, 3, 0.2 + 0.3 * abs(z)), (0.25 + x, 3 + 0.6 * y, 0.9 + 0.5 * z), 0.012, bark)
    leaves(rng, (0.25, 3, 0.85), (0.6, 0.4, 0.4), 300, 0.06, leaf)
    ball((-0.7, 3, -0.6), 0.38, paint((0.9, 0.6, 0.55), 4, "Checker"))
    for number in range(13):
        wire((0.5 * number - 3.2, 6, -1), (0.5 * number - 3.2, 6, -0.1), 0.025, stake)
    wire((-3.5, 6, -0.2), (3.5, 6, -0.2), 0.015, stake)
    for x, y, size in rng.uniform((-12, 14, 1), (12, 30, 2.2), (16, 3)):
        ball((x, y, size - 0.8), size, paint((0.2, 0.34, 0.12), 1.2))
    wire((-0.9, 1.55, 0.75), (-0.1, 1.5, 0.45), 0.008, bark, "front", sag=0.05)
    leaves(rng, (-0.5, 1.55, 0.55), (0.35, 0.06, 0.13), 34, 0.05, paint((0.6, 0.75, 0.2), 25), "front")
    leaves(rng, (0.62, 1.6, -0.5), (0.15, 0.06, 0.25), 22, 0.05, paint((0.6, 0.75, 0.2), 25), "front")
    for x, lean, top in rng.uniform((-0.9, -0.15, -0.75), (0.9, 0.15, -0.35), (26, 3)):
        mesh([(x - 0.01, 1.5, -1), (x + 0.01, 1.5, -1), (x + lean, 1.5, top)], [(0, 1, 2)], leaf, "front")
    return 3.0


def fence(rng: Any) -> float:
    """A fence before a head and blocks in focus, a wall, lamps and a tree behind. Returns the focus in m."""
    box((-80, -1, -2), (80, 90, -1), paint((0.55, 0.5, 0.45), 1.5, "Checker"))
    ball((0, 2.6, 0.2), 0.36, paint((0.9, 0.65, 0.5), 6))
    for x in (-0.13, 0.13):
        ball((x, 2.28, 0.28), 0.05, paint((0.1, 0.1, 0.1)))
    swept([(0, 2.7, -1), (0, 2.7, -0.3), (0, 2.65, 0)], (0.55, 0.45, 0.12), paint((0.3, 0.4, 0.8), 9, "Wave"))
    box((-1.1, 2.5, -1), (-0.65, 2.9, 0.1), paint((0.65, 0.5, 0.28), 8, "Wave"))
    box((0.75, 2.4, -1), (1.15, 2.8, -0.3), paint((0.45, 0.75, 0.7), 7.1, "Checker"))
    box((-8, 7, -1), (1, 7.3, 1.3), paint((0.65, 0.4, 0.3), 1.6))
    for x, z in rng.uniform((-3, -0.3), (3, 2.2), (14, 2)):
        ball((x, 6.5, z), 0.03, paint((1, 0.85, 0.6), glow=4.0))
    leaves(rng, (2.6, 8, 1.2), (1.4, 0.8, 1.4), 500, 0.16, paint((0.35, 0.5, 0.15), 3))
    steel = paint((0.75, 0.77, 0.8), 40)
    for number in range(-14, 16):
        x, slope = 0.26 * (number // 2) + 0.06, number % 2 * 1.6 - 0.8
        wire((x - 0.8, 1.35, -slope), (x + 0.8, 1.35, slope), 0.006, steel, "front")
    wire((-0.48, 1.33, -1), (-0.48, 1.33, 1), 0.025, steel, "front")
    return 2.6


def table(rng: Any) -> float:
    """A table with things on it from near to far, and a wall behind. Returns the focus in m."""
    box((-2, 0.3, -0.45), (2, 3.2, -0.4), paint((0.6, 0.4, 0.22), 5))
    box((-5, 4.5, -3), (5, 4.6, 4), paint((0.75, 0.72, 0.65), 2.1, "Checker"))
    for x, y, size, color in ((-0.25, 1.6, 0.16, (0.9, 0.4, 0.3)), (0.35, 2.2, 0.2, (0.3, 0.5, 0.9))):
        ball((x, y, size - 0.4), size, paint(color, 9, "Checker"))
    ball((-0.8, 2.6, -0.15), 0.25, paint((0.5, 0.8, 0.4), 12))
    bottle = [(0.1, 1.75, -0.4), (0.1, 1.75, -0.1), (0.1, 1.75, 0), (0.1, 1.75, 0.2)]
    swept(bottle, (0.09, 0.09, 0.03, 0.03), paint((0.2, 0.45, 0.25), 7))
    pencil = paint((0.95, 0.8, 0.3), 20)
    for number in range(6):
        wire((0.3 + 0.03 * number, 1.5, -0.4), (0.1 + 0.13 * number, 1.5, 0.25), 0.008, pencil)
    for x in (0.22, 0.3, 0.36):
        wire((x, 0.9, -0.4), (x + 0.12, 0.85, 0.45), 0.006, pencil, "front")
    turn = np.linspace(0, 2 * np.pi, 65)[:, None]
    ring = 0.13 * (np.cos(turn) * [1, 0, 0] + np.sin(turn) * [0, 0.5, 0.87]) + [-0.12, 0.85, -0.24]
    swept(ring, 0.022, paint((0.9, 0.6, 0.8), 25), "front")
    leaves(rng, (0.8, 2.8, 0.3), (0.3, 0.2, 0.4), 70, 0.07, paint((0.3, 0.6, 0.2), 9))
    return 1.6


SCENES = {"garden": garden, "fence": fence, "table": table}

if __name__ == "__main__":
    main()
