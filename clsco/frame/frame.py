"""One frame and its ground truth."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ArgumentError
from clsco.frame.channels import exr_channels
from clsco.frame.notebook import codes_to_show, html_to_show
from clsco.frame.outputs import FILE_NAMES

GREEN = 1  # number of the channel that stands for all colors where a single channel is used


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """A rendered frame: the image and its ground truth.

    Row 0 is on top, column 0 on the left, pixel centers at integer coordinates. Channels are red, green, blue; arrays
    of a gray scene have none. Truth that was not requested is None. `sharp`, `depth`, `blur_radius`, `mask`,
    `object_id`, `normal`, `flow`, `flow_backward` and `uv` show the scene at the middle of the shutter. They are never
    anti-aliased, except `sharp` of a texture on a surface, which is the mean over the pixel. With a rolling shutter
    they show the middle of the exposure of the pixel's own row, or column, as in `row_time`.

    Attributes
    ----------
    index : int
        Number of the frame in its sequence, from 0.
    color : float32 (rows, columns[, 3])
        Linear radiance, 1 = white, blurred by defocus and motion. None with `color=False`. With a sensor, the radiance
        is computed from its codes, with their noise, and demosaiced unless sensor.demosaic is "none".
    sharp : float32 (rows, columns[, 3])
        Linear radiance with everything in focus.
    depth : float32 (rows, columns), mm
        Planar Z at the pixel center, +inf without a surface.
    blur_radius : float32 (rows, columns[, 3]), px
        Signed blur radius R, positive behind the focus; `coc` in files. One for each of red, green and blue if the
        lens has longitudinal chromatic aberration.
    mask : bool (rows, columns)
        True if a surface is visible.
    filled : uint8 (rows, columns)
        0 for known pixels, 1 for filled ones, 2 for pixels that could not be filled.
    missing : bool (rows, columns)
        True if the forward warp left the pixel missing in any time sample of the frame, even if it was filled.
    object_id : int32 (rows, columns)
        Number of the visible object in the scene's objects, from 0; -1 for none.
    normal : float32 (rows, columns, 3)
        Unit vector in the camera frame, x right, y up, z into the scene.
    flow : float32 (rows, columns, 2), px
        Displacement of the surface point to the next frame, x right, y down. With a rolling shutter, to the row that
        shows the point there, and inf if no row or several rows do.
    hidden : bool (rows, columns)
        True if the point is hidden in the reference pose, so that its radiance is extrapolated.
    flow_backward : float32 (rows, columns, 2), px
        Displacement to the previous frame, x right, y down. This and `flow_occluded` exist only if something moves.
    flow_occluded : bool (rows, columns)
        True if the point is not visible in the next frame: a surface hides it, or it is outside the frame.
    uv : float32 (rows, columns, 2)
        Position of the surface point in its texture, right and up from the lower left corner, in units of the image's
        size; for a cube map, in its six images side by side. Only with textures on surfaces.
    disparity : float32 (rows, columns), px
        Column of the surface point in the left view minus its column in the right view; 0 without a surface. This and
        `occluded` exist only for stereo pairs.
    occluded : bool (rows, columns)
        True if the point is not visible in the other view: an occluder hides it, or it is outside the frame.
    row_time : float64 (rows,), or (columns,) if columns are exposed one after another, s
        Middle of the exposure of each row since t = 0. Only with a rolling shutter.
    throughput : float32 (rows, columns)
        Ratio of the pixel's light to the light in the middle of the frame. Only with vignetting or rims.
    raw : uint16 (rows, columns[, 3]), DN
        Codes of the sensor, with all noise; with a mosaic, one for each pixel. This, `electrons`, `noise_sigma` and
        `saturated` have one shape, and exist only with a sensor.
    electrons : float32 (rows, columns[, 3]), e-
        Expected number of electrons from light and dark current, without noise.
    noise_sigma : float32 (rows, columns[, 3]), e-
        Standard deviation of (raw - black_level) / gain from `electrons`, over exposures and sensors: by shot noise,
        read noise, PRNU, DSNU and rounding, if nothing is saturated. Hot pixels are not included.
    saturated : bool (rows, columns[, 3])
        True if the full well or the largest code was reached.
    alpha : float32 (rows, columns)
        Fraction of a pixel's light that comes from surfaces, blurred like `color`, which is premultiplied by it
        (associated alpha). The background is no surface.
    subframes : float32 (samples, rows, columns[, 3])
        Linear radiance of each time sample, blurred by defocus. Without a sensor `color` is their weighted mean.
        `metadata["intermediate"]` has their times and weights.
    eye : str
        View of a stereo pair, "left" or "right"; "" for the only view of a scene.
    metadata : mapping
        Parameters, times, device and version of the render, in values that JSON can hold.
    """

    index: int
    color: NDArray[np.float32]
    sharp: NDArray[np.float32] | None = None
    depth: NDArray[np.float32] | None = None
    blur_radius: NDArray[np.float32] | None = None
    mask: NDArray[np.bool_] | None = None
    filled: NDArray[np.uint8] | None = None
    missing: NDArray[np.bool_] | None = None
    object_id: NDArray[np.int32] | None = None
    normal: NDArray[np.float32] | None = None
    flow: NDArray[np.float32] | None = None
    hidden: NDArray[np.bool_] | None = None
    flow_backward: NDArray[np.float32] | None = None
    flow_occluded: NDArray[np.bool_] | None = None
    uv: NDArray[np.float32] | None = None
    disparity: NDArray[np.float32] | None = None
    occluded: NDArray[np.bool_] | None = None
    row_time: NDArray[np.float64] | None = None
    throughput: NDArray[np.float32] | None = None
    raw: NDArray[np.uint16] | None = None
    electrons: NDArray[np.float32] | None = None
    noise_sigma: NDArray[np.float32] | None = None
    saturated: NDArray[np.bool_] | None = None
    alpha: NDArray[np.float32] | None = None
    subframes: NDArray[np.float32] | None = None
    eye: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The image and all requested ground truth by their names in files, such as "color" and "coc"."""
        by_name = {in_file: getattr(self, name) for name, in_file in FILE_NAMES.items()}
        return {name: array for name, array in by_name.items() if array is not None}

    def require(self, name: str) -> NDArray[Any]:
        """An output that the frame must have, so that type checkers know that it is not None.

        Parameters
        ----------
        name : str
            An attribute such as "depth", or its name in files.

        Returns
        -------
        ndarray

        Raises
        ------
        ArgumentError
            The frame has no such output.

        Examples
        --------
        >>> import clsco
        >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(8, 6)), objects=(clsco.Plane(),))
        >>> clsco.render_frame(scene, truth="depth").require("depth").shape
        (6, 8)
        """
        arrays = self.arrays()
        if (array := arrays.get(FILE_NAMES.get(name, name))) is None:
            raise ArgumentError(f"frame {self.index}: must have {name}; got {', '.join(arrays) or 'no output'}")
        return array

    def image(self) -> NDArray[np.uint8]:
        """The image as 8-bit codes of sRGB, for `matplotlib.pyplot.imshow`, Pillow and OpenCV.

        Returns
        -------
        ndarray of uint8, (rows, columns, 3)
            Red, green, blue, also of a gray scene. Radiance below 0 and above 1 is clipped.

        Examples
        --------
        >>> import clsco
        >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(8, 6)), objects=(clsco.Plane(),))
        >>> clsco.render_frame(scene).image().shape
        (6, 8, 3)
        """
        return codes_to_show(self._image())

    def _image(self) -> NDArray[np.float32]:
        image: NDArray[np.float32] | None = self.color
        if image is None:
            raise ArgumentError(f"frame {self.index}: must have color for an image; got one rendered with color=False")
        return image

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the image, or the frame with all its truth, to one file, by the file's extension.

        Parameters
        ----------
        path : path
            .png: the image in sRGB codes of 8 bits, or of 16 bits if the textures have more. .tif, .tiff: the image
            in linear float32. .exr, .npz: the image and all truth of the frame, linear, as `clsco render --format`
            writes them.

        Raises
        ------
        FileError
            The extension is another one, or the file cannot be written.
        ArgumentError
            The frame has no color for an image.
        MissingDependencyError
            The extra that the format needs is missing.

        Examples
        --------
        >>> import clsco, tempfile
        >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(8, 6)), objects=(clsco.Plane(),))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     clsco.render_frame(scene).save(f"{folder}/plane.png")
        """
        from clsco.files.color import exr_color
        from clsco.files.images import save_image, write_exr, write_npz

        color = exr_color(self.metadata.get("chromaticities", ()))
        ending = Path(path).suffix.lower()
        if ending == ".npz":
            write_npz(path, self.arrays())
        elif ending == ".exr":
            write_exr(path, exr_channels(self.arrays()), attributes=[color.exr_attributes()])
        else:
            save_image(path, self._image(), self.metadata.get("bits", 8), color)

    def __repr__(self) -> str:
        held = self.arrays()
        rows, columns = next(iter(held.values())).shape[:2] if held else (0, 0)
        kind = "no image" if "color" not in held else "gray" if self.color.ndim == 2 else "color"
        parts = [f"Frame {self.index}" + (f" ({self.eye})" if self.eye else "")]
        parts.append(f"{columns} x {rows} px, {kind}")
        if "f_number" in self.metadata:
            parts.append(f"f/{self.metadata['f_number']:.3g}")
        if self.blur_radius is not None:
            known = self.blur_radius[np.isfinite(self.blur_radius)]
            ends = [f"{round(float(end), 2) + 0.0:g}" for end in (known.min(), known.max())] if known.size else []
            parts.append(f"R {ends[0]} to {ends[1]} px" if ends else "R nowhere")
        names = [name for name in FILE_NAMES if name != "color" and getattr(self, name) is not None]
        return f"<{parts[0]}: {', '.join(parts[1:])}; {' '.join(names) or 'no truth'}>"

    def _repr_html_(self) -> str:
        """The line that `print` shows, and the image, as HTML for notebooks."""
        return html_to_show(repr(self), [self.color] if "color" in self.arrays() else [])
