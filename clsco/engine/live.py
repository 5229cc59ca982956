"""Renderer for a series of similar scenes, which reuses intermediate results that do not change."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self, Unpack

import numpy as np
from numpy.typing import NDArray

from clsco.engine.response import isolate_source
from clsco.engine.sequence import Options, checked_request, frame_numbers, render_prepared
from clsco.engine.warm import warm
from clsco.errors import SceneError
from clsco.frame.frame import Frame
from clsco.inputs.files import InputFiles
from clsco.opencl.session import DeviceLike, session_for
from clsco.plan.memory import parse_size
from clsco.plan.prepare import prepare
from clsco.scene.file import SceneLike, scene_of


class Live:
    """Renders a series of similar scenes, as when a user drags a slider.

    Ray hits, textures, depth maps and tables of weights are cached by their inputs, so a render computes only what
    changed. Frames are bit-identical to those of `clsco.render_frame`.

    Parameters
    ----------
    device : str, pyopencl.Device, Context or CommandQueue, optional
        As for `clsco.render`.
    keep : int or str
        Limit of each of two caches, on the device and on the host, in bytes or like "1.5GiB"; the least recently used
        entries are evicted.

    Raises
    ------
    DeviceError
        The device does not exist.
    SceneError
        `keep` is not a size.

    Notes
    -----
    A `Live` renders one scene at a time. Threads that render at the same time need a `Live` each; these share compiled
    kernels. Validated: the same bits as in a new process (tests/engine/test_live.py); benchmarks/speed/live.py measures
    times.

    Examples
    --------
    >>> import clsco
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30)
    >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(32, 24), pixel_pitch=0.2), objects=(ball,))
    >>> with clsco.Live() as live:
    ...     for distance in (250, 260, 270):
    ...         frame = live.render(scene.replace("camera.focus_distance", distance), truth=())
    """

    def __init__(self, device: DeviceLike = None, *, keep: int | str = "512MiB") -> None:
        limit = parse_size(keep, "keep")
        self.session = session_for(device).with_cache(limit)
        self.files = InputFiles(limit)
        self._lock = threading.Lock()
        self._warming: list[threading.Thread] = []

    def render(self, scene: SceneLike, index: int = 0, **options: Unpack[Options]) -> Frame:
        """Render one frame of a scene.

        Parameters
        ----------
        scene, index, truth, color, precision, method, tolerance, memory
            As for `clsco.render_frame`.

        Returns
        -------
        Frame

        Raises
        ------
        CanceledError
            `cancel` was called during the render.
        SceneError, FileError, DeviceError, KernelError
            As `clsco.render_frame`.
        """
        scene = scene_of(scene)
        if scene.stereo is not None:
            raise SceneError("scene: must have one view; got a stereo pair, which clsco.render gives")
        (number,) = frame_numbers([scene], [index])
        request = checked_request(**options)
        with self._lock:
            self.session.canceled.clear()
            prepared = prepare(scene, request, self.session.device, self.files)
            ((_, frame),) = render_prepared(self.session, [prepared], [number], keeps_rays=True)
        return frame

    def response(
        self, scene: SceneLike, x: int, y: int, index: int = 0, *, item: int | None = None
    ) -> NDArray[np.float32]:
        """Response of a frame to one source.

        Parameters
        ----------
        scene, x, y, index, item
            As for `clsco.response`.

        Returns
        -------
        ndarray of float32, (rows, columns)

        Raises
        ------
        CanceledError
            `cancel` was called during the render.
        SceneError, FileError, DeviceError, KernelError
            As `clsco.response`.
        """
        isolated = isolate_source(scene_of(scene), x, y, index, item, self.files)
        return isolated.inside(self.render(isolated.scene, index, truth=()))

    def cancel(self) -> None:
        """Cancel the render that another thread runs, within a fraction of a second; does nothing if none runs."""
        if self._lock.locked():
            self.session.canceled.set()

    def warm(self, scene: SceneLike) -> threading.Thread:
        """Compile in the background the kernels that this scene and similar ones need.

        Parameters
        ----------
        scene : Scene, mapping or path

        Returns
        -------
        threading.Thread
            Ends when all kernels are compiled; you need not wait for it.
        """
        scene = scene_of(scene)
        thread = threading.Thread(target=warm, args=(self.session.unwatched(), scene, self.files), daemon=True)
        self._warming.append(thread)
        thread.start()
        return thread

    def close(self) -> None:
        """Wait for kernels that are being compiled, and release the cache."""
        for thread in self._warming:
            thread.join()
        self._warming.clear()
        self.session.settle()
        self.session.cache.clear()
        self.files.cache.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
