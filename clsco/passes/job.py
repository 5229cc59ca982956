"""Jobs: the part of an image, or of a scene's frame at a time sample, that passes process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import Strip
from clsco.opencl.program import Events
from clsco.optics.motion import Pose
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.visibility import OcclusionGroup
from clsco.records import Struct
from clsco.scene.model import Camera

Surfaces = tuple[PlacedSurface | None, ...]  # surface of every object, None for a depth map


@dataclass(frozen=True, kw_only=True)
class Job:
    """The part of an image that passes process.

    grid: grid_t of the strip; events: list to which passes append pairs of a kernel's name and the event of its launch;
    bounds: bounds of depth layers, if they were computed from all strips: one entry for all colors, or one per color.
    """

    strip: Strip
    grid: Struct
    events: Events
    bounds: tuple[tuple[int, ...], ...] | None = None


@dataclass(frozen=True)
class TimeSample:
    """The objects of a scene at one time.

    time: in s since the reference pose; camera: the camera at that time; poses: pose of each object relative to the
    camera, which may also move; packed: surface_t of each object on the host; surfaces: the same on the device; light:
    a tuple with light_t, empty if the scene has no light.
    """

    time: float
    camera: Camera
    poses: tuple[Pose, ...]
    placed: Surfaces
    packed: NDArray[np.void]
    surfaces: cl.Buffer
    light: tuple[Struct, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SceneJob(Job):
    """The part of a scene's frame at a time sample that passes process.

    whole_strip: a strip of the frame; the inherited `strip` is the part of it in which the time sample has a weight.
    weights: weights of the time sample in the rows of `strip`, or in all columns of the frame. is_first: True for the
    first time sample of `whole_strip`, which begins the sum. noise_stream: `clsco.optics.sensor.camera_word` for the
    last time sample of `whole_strip`, None for the earlier ones. changes: for each occlusion group, kernel arguments:
    its map of changes (`clsco.optics.still`), and 1 to make the sources that change, 0 for the others; None if it has
    none of these. Empty if all sources of each time sample are made.
    """

    sample: TimeSample
    weights: NDArray[np.float64]
    is_first: bool
    whole_strip: Strip
    noise_stream: int | None = None
    changes: Mapping[OcclusionGroup, tuple[Any, ...] | None] = field(default_factory=dict)
