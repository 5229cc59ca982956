"""Outputs of a frame: a table with one row per output.

To add one, add a row here, an attribute of `clsco.frame.frame.Frame`, and its computation in kernels/trace/truth.cl
(`by_rays`) or clsco/passes/truth.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from clsco.errors import SceneError
from clsco.scene.text import meant

Group = Literal["always", "motion", "surfaces", "stereo", "readout", "lens", "sensor", "image"]


@dataclass(frozen=True)
class Output:
    """An array of a frame.

    name: attribute of `Frame`. components: numbers per pixel, 0 for as many as the image has channels. group: scenes
    that have the output, a key of `clsco.plan.decisions.POSSIBLE`; "always": all scenes; "image": all, but only if it
    is requested by name. empty: value without a surface; None if the background has values of its own. by_rays: True if
    the kernel `ground_truth` computes it. figure: tolerance of comparisons, about the rounding of float32, for color
    1/400 of an 8-bit code; measure: unit of `figure`, by default `unit`. in_file: name in files, by default `name`.
    layer: name of the layer in an EXR, by default the name in files; letters: channels of that layer.
    """

    name: str
    dtype: type[np.generic]
    components: int
    unit: str
    about: str
    group: Group = "always"
    empty: float | None = None
    by_rays: bool = False
    figure: float = 0.0
    measure: str = ""
    in_file: str = ""
    layer: str | None = None
    letters: str = ""


_F32, _BOOL = np.float32, np.bool_
_LINEAR = "linear, or codes of the transfer curve"
_WHITE: dict[str, Any] = {"figure": 1e-5, "measure": "of white", "letters": "RGB"}
_RAYS: dict[str, Any] = {"by_rays": True}
_FLOW: dict[str, Any] = {"empty": 0.0, "figure": 1e-4, "letters": "uv", **_RAYS}
_MOVES: dict[str, Any] = {"group": "motion"}
_PAIR: dict[str, Any] = {"group": "stereo", "empty": 0.0, **_RAYS}
_SENSOR: dict[str, Any] = {"group": "sensor", "letters": "Y"}
_ROWS = (
    Output("color", _F32, 0, "1 = white", f"radiance, blurred by defocus and motion; {_LINEAR}", layer="", **_WHITE),
    Output("sharp", _F32, 0, "1 = white", f"radiance, all in focus; {_LINEAR}", **_RAYS, **_WHITE),
    Output(
        "depth", _F32, 1, "mm", "planar Z at the pixel center, +inf where nothing is", empty=np.inf, figure=1e-6,
        measure="relative", layer="Z", **_RAYS,
    ),
    Output(
        "blur_radius", _F32, 1, "px", "signed radius of the blur, positive behind the focal surface", figure=1e-4,
        in_file="coc", **_RAYS,
    ),
    Output("mask", _BOOL, 1, "", "True where a surface is", empty=False),
    Output("filled", np.uint8, 1, "", "0 known, 1 filled, 2 could not be filled"),
    Output("missing", _BOOL, 1, "", "True where the forward warp left the pixel missing in a time sample"),
    Output("object_id", np.int32, 1, "", "position in the scene's objects, -1 none", empty=-1, layer="id", **_RAYS),
    Output(
        "normal", _F32, 3, "", "unit vector in the camera frame, x right, y up, z into the scene", empty=0.0,
        figure=1e-5, layer="N", letters="XYZ", **_RAYS,
    ),
    Output("flow", _F32, 2, "px", "x right, y down, to the next frame", **_FLOW),
    Output("hidden", _BOOL, 1, "", "True where the point is hidden in the reference pose", empty=False, **_RAYS),
    Output("flow_backward", _F32, 2, "px", "x right, y down, to the frame before", **_FLOW, **_MOVES),
    Output(
        "flow_occluded", _BOOL, 1, "", "True where the point is not visible in the next frame", empty=False, **_RAYS,
        **_MOVES,
    ),
    Output(
        "uv", _F32, 2, "images", "place in the image of the texture, right and up from the lower left corner",
        "surfaces", empty=0.0, figure=1e-5, measure="relative beyond 1", letters="uv", **_RAYS,
    ),
    Output(
        "disparity", _F32, 1, "px", "column in the left view less column in the right one, 0 where nothing is",
        figure=1e-4, **_PAIR,
    ),
    Output("occluded", _BOOL, 1, "", "True where the point is not visible in the other view", **_PAIR),
    Output(
        "row_time", np.float64, 1, "s", "middle of the exposure of each row, or column, since the reference pose",
        "readout",
    ),
    Output(
        "throughput", _F32, 1, "", "share of the light of the middle of the frame that the lens gives the pixel",
        "lens", figure=1e-6,
    ),
    Output("raw", np.uint16, 0, "DN", "codes of the sensor, with all noise", **_SENSOR),
    Output("electrons", _F32, 0, "e-", "electrons to be expected, without noise", **_SENSOR),
    Output("noise_sigma", _F32, 0, "e-", "standard deviation of (raw - black level) / gain", **_SENSOR),
    Output("saturated", _BOOL, 0, "", "True where the full well or the largest code was reached", **_SENSOR),
    Output("alpha", _F32, 1, "", "share of the light that comes from surfaces", "image", layer="A"),
    Output("subframes", _F32, 0, "1 = white", "linear radiance of each time sample", "image"),
)  # fmt: skip
OUTPUTS = {row.name: row for row in _ROWS}


def _names(*groups: Group) -> tuple[str, ...]:
    return tuple(row.name for row in _ROWS if row.group in groups and row.name != "color")


TRUTH_NAMES, MOTION_NAMES, MAPPING_NAMES = _names("always"), _names("motion"), _names("surfaces")
STEREO_NAMES, ROLLING_NAMES, LENS_NAMES = _names("stereo"), _names("readout"), _names("lens")
SENSOR_NAMES, IMAGE_NAMES = _names("sensor"), _names("image")
ALL_TRUTH = tuple(name for name in OUTPUTS if name != "color" and name not in IMAGE_NAMES)
RAY_OUTPUTS = tuple(row.name for row in _ROWS if row.by_rays)
FILE_NAMES = {row.name: row.in_file or row.name for row in _ROWS}
ATTRIBUTES = {in_file: name for name, in_file in FILE_NAMES.items()}
OF_THE_IMAGE = frozenset({"color", *IMAGE_NAMES, *SENSOR_NAMES})
"""Outputs that are made only if color is made."""


def truth_names(truth: str | Iterable[str]) -> tuple[str, ...]:
    """Attributes of the outputs besides color that a user requests: some of ALL_TRUTH and IMAGE_NAMES.

    truth: iterable or comma-separated text of attributes or names in files, or "all" for ALL_TRUTH. Raises SceneError.
    """
    if truth == "all":
        return ALL_TRUTH
    if not isinstance(truth, Iterable):
        raise SceneError(f"truth: must be names of outputs; got {truth!r}")
    return attributes_of(truth, (*ALL_TRUTH, *IMAGE_NAMES))


def attributes_of(names: str | Iterable[str], known: Sequence[str]) -> tuple[str, ...]:
    """Attributes of `Frame` for outputs named by attribute or as in files. Raises SceneError unless all are `known`."""
    listed = [name for name in names.split(",") if name] if isinstance(names, str) else [*names]
    attributes = [ATTRIBUTES.get(name, name) for name in listed]
    for name, attribute in zip(listed, attributes, strict=True):
        if attribute not in known:
            listed = [FILE_NAMES[each] for each in known]
            hint = meant(name, [*listed, *known])
            raise SceneError(f'truth: must be "all" or some of {", ".join(listed)}; got {name!r}{hint}')
    return tuple(dict.fromkeys(attributes))
