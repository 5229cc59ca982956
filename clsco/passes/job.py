"""Jobs: parts of an image, or of a scene at a time sample, that passes process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import Strip
from clsco.optics.depth_layers import LayerBounds
from clsco.optics.motion import Pose
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.still import StillSplit
from clsco.passes.blur import Events
from clsco.records import Struct
from clsco.scene.model import Camera

Surfaces = tuple[PlacedSurface | None, ...]  # surface of every object, None for a depth map


@dataclass(frozen=True, kw_only=True)
class Job:
    """Part of an image that passes process.

    Attributes
    ----------
    strip : Strip
    grid : numpy.void
        grid_t of the strip.
    events : list
        List to which launches are appended.
    bounds : tuple of LayerBounds, optional
        Bounds between depth layers, if they were computed from all strips: one for all colors, or one per color.
    """

    strip: Strip
    grid: Struct
    events: Events
    bounds: tuple[LayerBounds, ...] | None = None


@dataclass(frozen=True)
class TimeSample:
    """The objects of a scene at one time.

    Attributes
    ----------
    time : float
        Seconds.
    camera : Camera
        The camera with its lens at that time.
    poses : tuple of Pose
        Pose of every object relative to the camera, which may move itself.
    placed : tuple of PlacedSurface or None
        The objects in their poses.
    packed : ndarray
        surface_t of every object.
    surfaces : Buffer
        `packed` on the device.
    light : (numpy.void,), optional
        light_t, if the scene has a light.
    """

    time: float
    camera: Camera
    poses: tuple[Pose, ...]
    placed: Surfaces
    packed: NDArray[np.void]
    surfaces: cl.Buffer
    light: tuple[Struct, ...] = ()


@dataclass(frozen=True, eq=False)
class SourcePart:
    r"""Part of the sources of an exposure: all still sources, or the moving sources of a time sample.

        Attributes
        ----------
    split : StillSplit
        places : Buffer
        `split.places` on the device.
        still : bool
    """

    split: StillSplit
    places: cl.Buffer
    still: bool


@dataclass(frozen=True, kw_only=True)
class SceneJob(Job):
    """Part of a frame of a scene, at a time sample.

    Attributes
    ----------
    sample : TimeSample
    weights : ndarray of float64, (rows,) or (columns,)
        Weights of the time sample in the strip.
    is_first : bool
        True for the first time sample of the frame.
    whole_strip : Strip
        The strip that `strip` is a part of, or equals.
    noise_stream : int, optional
        `clsco.optics.sensor.camera_word` of the frame, set only for its last time sample.
    part : SourcePart, optional
        Sources to trace, if the frame splits them into still and moving sources.
    """

    sample: TimeSample
    weights: NDArray[np.float64]
    is_first: bool
    whole_strip: Strip
    noise_stream: int | None = None
    part: SourcePart | None = None
