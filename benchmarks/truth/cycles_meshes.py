"""Meshes in Blender's Cycles: what glows by its image, through a thin lens, moving while the shutter is open.

`Cycles` talks to a process of a Python that has the package `bpy`, which needs a NumPy of its own; this file is what
runs there. Blender gets meters in place of millimeters, as its f-number is of a lens in mm; x is to the right, y up,
and the camera looks along -z. Exposure is the mean over the shutter, a pixel's filter is a box of 1 px, and no path
goes on after its first hit.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
METERS = 1e-3
TOWARDS = np.diag([1.0, 1.0, -1.0, 1.0])


class Cycles:
    """A scene in Cycles, in a process of its own.

    Parameters
    ----------
    python : Path
        Python that has `bpy`.
    camera, meshes
        As `benchmarks.truth.mitsuba_meshes.render`.
    threads : int
        Number that the renderer has.
    exposed : float, optional
        Share of the shutter that each row is open for, by default all of it. Rows open one after another from the top;
        row i is in the middle of its exposure at ((i + 1) / rows - 1/2) (1 - exposed) + 1/2 of the shutter.
    aperture : mapping, optional
        "blades", "rotation" in deg and "ratio" of Cycles' own aperture; or "osl", a shader in place of the camera.
    """

    def __init__(
        self, python: Path, camera: Any, meshes: Sequence[Any], threads: int, exposed: float = 1.0,
        aperture: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        focus = 1.0 / (1.0 / camera.focal_length - 1.0 / camera.sensor_distance)
        described = {
            "size": camera.resolution, "lens": camera.normalization_distance, "focus": focus, "threads": threads,
            "width": camera.resolution[0] * camera.pixel_pitch, "aperture": camera.aperture_diameter,
            "exposed": exposed, "opening": dict(aperture or {}),
            "meshes": [{"wrap": mesh.wrap, "nearest": mesh.nearest, "moves": mesh.moves} for mesh in meshes],
        }  # fmt: skip
        (folder / "scene.json").write_text(json.dumps(described), "utf-8")
        for number, mesh in enumerate(meshes):
            names = ("vertices", "places", "faces", "image", "poses")
            np.savez(folder / f"{number}.npz", **{name: getattr(mesh, name) for name in names})
        command = (str(python), str(Path(__file__).resolve()), str(folder))
        environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        self._process = subprocess.Popen(command, text=True, env=environ, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def render(self, samples: int, seed: int) -> tuple[Array, float]:
        """A picture (rows, columns, 3) of linear radiance by so many rays per pixel, and its processor time in s."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{samples} {seed}\n")
        process.stdin.flush()
        for line in process.stdout:
            if line.startswith("seconds "):  # Blender speaks as well
                return np.load(Path(self._folder.name) / "picture.npy"), float(line.split()[1])
        raise RuntimeError("Cycles: the process ended; its messages are on stderr")

    def close(self) -> None:
        """End the process."""
        self._process.communicate()
        self._folder.cleanup()


def serve(folder: Path) -> None:
    """Render what lines of standard input ask for: rays per pixel, and a seed."""
    import bpy

    described = json.loads((folder / "scene.json").read_text("utf-8"))
    set_up(bpy, folder, described)
    scene = bpy.context.scene
    path = folder / "picture.exr"
    scene.render.filepath = str(path)
    for line in sys.stdin:
        scene.cycles.samples, scene.cycles.seed = map(int, line.split())
        began = time.process_time()
        bpy.ops.render.render(write_still=True)
        seconds = time.process_time() - began
        columns, rows = described["size"]
        image = bpy.data.images.load(str(path), check_existing=False)
        image.colorspace_settings.name = "Non-Color"
        pixels = np.empty(columns * rows * 4, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        np.save(folder / "picture.npy", pixels.reshape(rows, columns, 4)[::-1, :, :3].astype(np.float64))
        print(f"\nseconds {seconds}", flush=True)


def set_up(bpy: Any, folder: Path, described: dict[str, Any]) -> None:
    """Make the scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x, render.resolution_y = described["size"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", described["threads"]
    render.use_persistent_data = True
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode, render.image_settings.exr_codec = "RGB", "NONE"
    scene.view_settings.view_transform = "Raw"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    cycles.max_bounces = cycles.transparent_max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    render.use_motion_blur = any(mesh["moves"] for mesh in described["meshes"])
    render.motion_blur_shutter, render.motion_blur_position = 1.0, "START"
    if described["exposed"] < 1.0:
        cycles.rolling_shutter_type, cycles.rolling_shutter_duration = "TOP", described["exposed"]
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    scene.camera = camera
    data.lens, data.sensor_width, data.sensor_fit = described["lens"], described["width"], "HORIZONTAL"
    data.clip_start, data.clip_end = 1e-3, 1e9
    data.dof.use_dof, data.dof.focus_distance = True, described["focus"] * METERS
    data.dof.aperture_fstop = described["lens"] / described["aperture"]
    opening = described["opening"]
    data.dof.aperture_blades, data.dof.aperture_ratio = opening.get("blades", 0), opening.get("ratio", 1.0)
    data.dof.aperture_rotation = math.radians(opening.get("rotation", 0.0))
    if "osl" in opening:
        cycles.shading_system = True
        use_shader(data, folder, opening["osl"])
    for number, mesh in enumerate(described["meshes"]):
        add(bpy, number, mesh, dict(np.load(folder / f"{number}.npz")))


def use_shader(camera: Any, folder: Path, source: str) -> None:
    """Cast rays by a shader, which Blender's own add-on cannot load where it has no module `oslquery`."""
    import _cycles  # type: ignore[import-not-found]

    text, code = folder / "camera.osl", folder / "camera.oso"
    text.write_text(source, "utf-8")
    if not _cycles.osl_compile(str(text), str(code)):
        raise RuntimeError("Cycles: the shader of the camera does not compile")
    camera.type, camera.custom_mode, camera.custom_filepath = "CUSTOM", "EXTERNAL", str(code)
    camera.custom_bytecode, camera.custom_bytecode_hash = code.read_text("utf-8"), "1"


def add(bpy: Any, number: int, mesh: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Add an object that glows by its image."""
    import mathutils

    name, vertices, faces = f"mesh {number}", arrays["vertices"] * METERS, arrays["faces"]
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    data.loops.add(faces.size)
    data.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    data.polygons.add(len(faces))
    data.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    layer = data.uv_layers.new(name="places")
    layer.data.foreach_set("uv", arrays["places"][faces.ravel()].astype(np.float32).ravel())
    data.update(calc_edges=True)
    material = bpy.data.materials.new(name)
    material.cycles.emission_sampling = "NONE"
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    glow, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    links.new(glow.outputs["Emission"], output.inputs["Surface"])
    texels = arrays["image"]
    if texels.shape[:2] == (1, 1):
        glow.inputs["Color"].default_value = (*texels[0, 0].tolist(), 1.0)
    else:
        image = bpy.data.images.new(name, texels.shape[1], texels.shape[0], alpha=False, float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        rgba = np.concatenate([texels[::-1], np.ones_like(texels[..., :1])], axis=2)
        image.pixels.foreach_set(np.ascontiguousarray(rgba, np.float32).ravel())
        image.update()
        node, places = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeUVMap")
        node.image, places.uv_map = image, "places"
        node.interpolation = "Closest" if mesh["nearest"] else "Linear"
        node.extension = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}[mesh["wrap"]]
        links.new(places.outputs["UV"], node.inputs["Vector"])
        links.new(node.outputs["Color"], glow.inputs["Color"])
    data.materials.append(material)
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    poses = TOWARDS @ arrays["poses"] @ TOWARDS
    data.transform(mathutils.Matrix(TOWARDS.tolist()))  # a mirrored frame has no rotation
    item.rotation_mode = "QUATERNION"
    times = len(poses) if mesh["moves"] else 1
    for k in range(times):
        matrix = mathutils.Matrix(poses[k].tolist())
        item.location, item.rotation_quaternion = matrix.translation * METERS, matrix.to_quaternion()
        if times > 1:
            frame = bpy.context.scene.frame_current + k / (times - 1)
            item.keyframe_insert("location", frame=frame)
            item.keyframe_insert("rotation_quaternion", frame=frame)
    if times > 1:
        item.cycles.motion_steps = 2  # five poses
        straight(item)


def straight(item: Any) -> None:
    """Let an object move evenly between its keys."""
    for layer in item.animation_data.action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                for curve in bag.fcurves:
                    for key in curve.keyframe_points:
                        key.interpolation = "LINEAR"


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
