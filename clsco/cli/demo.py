"""The demonstration: a list of examples, and a labeled contact sheet of their images and ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from clsco.frame.contact_sheet import PAPER, contact_sheet, split_into_rows
from clsco.frame.frame import GREEN, Frame
from clsco.frame.notebook import codes_to_show
from clsco.frame.views import Picture, flow_colors, viridis

DETAILS = ("cylinder_turning", "card", "road", "depth_map", "stereo")
WIDE, NARROW = 300, 196  # px
NOTHING, OCCLUDED = (225, 225, 222), (215, 60, 50)


def views(frames: Sequence[Frame]) -> dict[str, Picture]:
    """Pictures of a frame or a stereo pair with all ground truth, by a label with the range of values."""
    frame: Any = frames[0]
    seen, radius = frame.mask, frame.blur_radius
    radius = radius if radius.ndim == 2 else radius[..., GREEN]
    near, far = float(frame.depth[seen].min()), float(frame.depth[seen].max())
    least, most = (round(float(limit), 1) + 0.0 for limit in (radius[seen].min(), radius[seen].max()))
    bound = max(abs(least), abs(most), 1e-6)
    lengths = np.linalg.norm(frame.flow[seen], axis=-1)
    longest = float(lengths[np.isfinite(lengths)].max(initial=0.0))
    depth = viridis(np.where(seen, frame.depth, far), near, far)
    maps = {f"depth, {near:.0f} to {far:.0f} mm": depth}
    if frame.disparity is not None:
        low, high = (float(limit) for limit in (frame.disparity[seen].min(), frame.disparity[seen].max()))
        label = f"disparity, {low:.1f} to {high:.1f} px"
        covered = np.where(frame.occluded[..., None], OCCLUDED, codes_to_show(frame.sharp))
        maps |= {label: viridis(frame.disparity, low, high), "red: not in the right view": covered}
    else:
        maps[f"blur radius R, {least:.1f} to {most:.1f} px"] = viridis(radius, -bound, bound)
        maps["normal"] = (127.5 * (1 + frame.normal * np.array([1, 1, -1]))).round().astype(np.uint8)
    if longest >= 0.5:  # else rounding, or nothing that a picture shows
        maps[f"flow, up to {longest:.0f} px"] = flow_colors(frame.flow, longest)
    on_gray = {label: np.where(seen[..., None], m, NOTHING).astype(np.uint8) for label, m in maps.items()}
    photographs = {"color": codes_to_show(frame.color)}
    if len(frames) > 1:
        photographs = {"left": photographs["color"], "right": codes_to_show(frames[1].color)}
    return {**photographs, "sharp": codes_to_show(frame.sharp), **on_gray}


def demo_sheet(shown: Mapping[str, Frame], detailed: Sequence[Sequence[Frame]]) -> Picture:
    """Draw frames with their labels, and below them all outputs of the detailed frames or stereo pairs."""
    photographs = [(_fitted(codes_to_show(frame.color), WIDE), label) for label, frame in shown.items()]
    details = [[(_fitted(picture, NARROW), label) for label, picture in views(frames).items()] for frames in detailed]
    title = "The truth that comes with a frame, at the middle of the shutter"
    parts = (contact_sheet(split_into_rows(photographs), text=14), contact_sheet(details, title, text=14))
    width = max(part.shape[1] for part in parts)
    filled = [ImageOps.pad(Image.fromarray(part), (width, len(part)), color=PAPER, centering=(0, 0)) for part in parts]
    return np.concatenate([np.asarray(part) for part in filled])


def _fitted(picture: Picture, side: int) -> Picture:
    return np.asarray(ImageOps.fit(Image.fromarray(picture), (side, side), Image.Resampling.LANCZOS))
