"""Images of moving objects out of focus, with their ground truth, computed with OpenCL.

A scene is built from its types, or read from a file, and rendered frame by frame::

    import clsco

    ball = clsco.Sphere(center=(0, 0, 280), radius=30, texture="bricks")
    frame = clsco.render_frame(clsco.Scene(objects=(ball,)))
    frame.color, frame.depth, frame.blur_radius         # NumPy arrays (rows, columns[, channels])

    scene = clsco.load_scene("ball.toml").replace("camera.f_number", 4)
    for frame in clsco.render(scene, truth=("depth", "flow")):
        ...

The two engines work on any arrays, of NumPy or pyopencl::

    blurred = clsco.defocus(image, blur_radius, "gaussian")   # signed radius per pixel, px
    filled = clsco.inpaint(image, mask)                       # True = missing

Functions
---------
render, render_frame, render_sweep
    All frames of a scene, one frame, the frames of several scenes.
response
    The response of a frame to one source: its point spread function with occlusion, motion and border.
psf
    The point spread functions of a scene's lens over depth, as frames are made with them.
defocus, inpaint
    Blur an image by its map of blur radii; fill its missing pixels.
load_scene, parse_scene
    A scene from a file, or from a mapping or the text of a file.
load_sweep, parse_sweep
    The same where keys have several values: all scenes.
dump_scene
    The text of a scene file from a scene.
write_video
    Frames, or arrays, to a video file.
list_devices
    The OpenCL devices, and which one is used.
reference
    A module: `reference.render` renders in NumPy float64 without OpenCL.

Types
-----
Scene, Camera, Aperture, Psf, Sequence, Motion, Fill, ImageOptions, Light, Stereo, Sensor, Group
    A scene and its sections, frozen and validated; lengths in mm, angles in degrees, times in s.
ObjectMotion, CameraMotion, Keyframe, CameraShake, Lens, LensKeyframe
    Velocities of an object or a group, and of the camera.
Plane, Rectangle, Disc, Box, Sphere, Cylinder, Cone, Ellipsoid, Quadric, DepthMap, Background
    The objects of a scene.
Frame
    A rendered image with its ground truth.
PsfStack
    Weights of point spread functions with their axes.
Live
    Renders scenes that differ in little one after the other, and keeps what is the same.
MeanMedian
    Options of one method of `inpaint`.
ClscoError
    Base of all errors that are raised on purpose: SceneError, ImageError, DeviceError, KernelError,
    CanceledError.

`device=` takes a part of a device's name, "cpu", "gpu", or a Device, Context or CommandQueue of pyopencl. Each name is
imported when it is first used: without OpenCL everything but `render`, `render_frame`, `render_sweep`,
`response`, `Live`, `defocus`, `inpaint` and `list_devices` works.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsco import reference as reference
    from clsco.engine.defocus import defocus as defocus
    from clsco.engine.inpaint import inpaint as inpaint
    from clsco.engine.live import Live as Live
    from clsco.engine.response import response as response
    from clsco.engine.sequence import render as render
    from clsco.engine.sequence import render_frame as render_frame
    from clsco.engine.sequence import render_sweep as render_sweep
    from clsco.errors import CanceledError as CanceledError
    from clsco.errors import ClscoError as ClscoError
    from clsco.errors import DeviceError as DeviceError
    from clsco.errors import ImageError as ImageError
    from clsco.errors import KernelError as KernelError
    from clsco.errors import SceneError as SceneError
    from clsco.frame.frame import Frame as Frame
    from clsco.frame.video import write_video as write_video
    from clsco.inpainting.rules import MeanMedian as MeanMedian
    from clsco.inputs.dump import dump_scene as dump_scene
    from clsco.opencl.device import list_devices as list_devices
    from clsco.reference.spreads import PsfStack as PsfStack
    from clsco.reference.spreads import psf as psf
    from clsco.scene.file import load_scene as load_scene
    from clsco.scene.file import parse_scene as parse_scene
    from clsco.scene.model import Aperture as Aperture
    from clsco.scene.model import Background as Background
    from clsco.scene.model import Box as Box
    from clsco.scene.model import Camera as Camera
    from clsco.scene.model import CameraMotion as CameraMotion
    from clsco.scene.model import CameraShake as CameraShake
    from clsco.scene.model import Cone as Cone
    from clsco.scene.model import Cylinder as Cylinder
    from clsco.scene.model import DepthMap as DepthMap
    from clsco.scene.model import Disc as Disc
    from clsco.scene.model import Ellipsoid as Ellipsoid
    from clsco.scene.model import Fill as Fill
    from clsco.scene.model import Group as Group
    from clsco.scene.model import ImageOptions as ImageOptions
    from clsco.scene.model import Keyframe as Keyframe
    from clsco.scene.model import Lens as Lens
    from clsco.scene.model import LensKeyframe as LensKeyframe
    from clsco.scene.model import Light as Light
    from clsco.scene.model import Motion as Motion
    from clsco.scene.model import ObjectMotion as ObjectMotion
    from clsco.scene.model import Plane as Plane
    from clsco.scene.model import Psf as Psf
    from clsco.scene.model import Quadric as Quadric
    from clsco.scene.model import Rectangle as Rectangle
    from clsco.scene.model import Scene as Scene
    from clsco.scene.model import Sensor as Sensor
    from clsco.scene.model import Sequence as Sequence
    from clsco.scene.model import Sphere as Sphere
    from clsco.scene.model import Stereo as Stereo
    from clsco.scene.sweep import load_sweep as load_sweep
    from clsco.scene.sweep import parse_sweep as parse_sweep

__version__ = "0.1.0"

# pyopencl keeps what it generates in the user's cache folder, as pickles, which it runs whoever has put them there, and
# fails where it cannot write there. To generate it takes less time than to look it up.
os.environ.setdefault("PYOPENCL_NO_CACHE", "1")

_NAMES = {
    "clsco.engine.sequence": ("render", "render_frame", "render_sweep"),
    "clsco.engine.defocus": ("defocus",),
    "clsco.engine.inpaint": ("inpaint",),
    "clsco.engine.live": ("Live",),
    "clsco.engine.response": ("response",),
    "clsco.scene.file": ("load_scene", "parse_scene"),
    "clsco.scene.sweep": ("load_sweep", "parse_sweep"),
    "clsco.inputs.dump": ("dump_scene",),
    "clsco.opencl.device": ("list_devices",),
    "clsco.reference.spreads": ("psf", "PsfStack"),
    "clsco.scene.model": (
        *(
            "Scene",
            "Camera",
            "Aperture",
            "Psf",
            "Sequence",
            "Motion",
            "Fill",
            "ImageOptions",
            "Light",
            "Stereo",
            "Sensor",
            "Group",
        ),
        *("ObjectMotion", "CameraMotion", "Keyframe", "CameraShake", "Lens", "LensKeyframe"),
        *("Plane", "Rectangle", "Disc", "Box", "Sphere", "Cylinder", "Cone", "Ellipsoid", "Quadric"),
        *("DepthMap", "Background"),
    ),
    "clsco.frame.frame": ("Frame",),
    "clsco.frame.video": ("write_video",),
    "clsco.inpainting.rules": ("MeanMedian",),
    "clsco.errors": ("ClscoError", "SceneError", "ImageError", "DeviceError", "KernelError", "CanceledError"),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}
__all__ = [  # noqa: RUF022, verbs and then types
    "render", "render_frame", "render_sweep", "response", "psf", "defocus", "inpaint", "load_scene", "parse_scene",
    "load_sweep", "parse_sweep", "dump_scene", "write_video", "list_devices", "reference",
    "Scene", "Camera", "Aperture", "Psf", "Sequence", "Motion", "Fill", "ImageOptions", "Light", "Stereo", "Sensor",
    "Group", "ObjectMotion", "CameraMotion", "Keyframe", "CameraShake", "Lens", "LensKeyframe",
    "Plane", "Rectangle", "Disc", "Box", "Sphere", "Cylinder", "Cone", "Ellipsoid", "Quadric", "DepthMap", "Background",
    "Frame", "Live", "PsfStack", "MeanMedian",
    "ClscoError", "SceneError", "ImageError", "DeviceError", "KernelError", "CanceledError",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "reference":
        return import_module("clsco.reference")
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module clsco has no attribute {name}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
