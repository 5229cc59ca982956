"""Contact sheets: of example frames and their ground truth for `clsco demo`, of weights for `clsco psf`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from clsco.frame.contact_sheet import PAPER, contact_sheet, split_into_rows
from clsco.frame.frame import GREEN, Frame
from clsco.frame.notebook import codes_to_show
from clsco.frame.views import Picture, flow_colors, viridis

if TYPE_CHECKING:
    from clsco.reference.spreads import PsfStack

DETAILS = ("evening", "card", "road", "depth_map", "stereo")
WIDE, NARROW = 300, 196  # px
NOTHING, OCCLUDED = (225, 225, 222), (215, 60, 50)
CELL, MOST_ACROSS = 144, 14  # px a side of a point spread function, and functions in a row
EMPTY = (12, 12, 16)


def views(frames: Sequence[Frame]) -> dict[str, Picture]:
    """Pictures of all outputs of a frame or a stereo pair, by labels that state the range of values."""
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
    if longest >= 0.5:  # shorter flow is rounding, or too small to be seen
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


def psf_sheet(stack: PsfStack) -> Picture:
    """Draw a stack: a row for each channel and place, a column for each depth. All cells have the same scale."""
    channels, places, depths, side, _ = stack.weights.shape
    rows = []
    for channel, place in np.ndindex(channels, places):
        x, y = stack.at[place]
        where = f" at {x:g}, {y:g}" if places > 1 else ""
        tiles = []
        for depth in range(depths):
            weights, radius = stack.weights[channel, place, depth], stack.radius[channel, place, depth]
            distance = f"{stack.depth[depth]:.5g} mm" if np.isfinite(stack.depth[depth]) else "infinite"
            label = f"Z {distance}, R {radius:+.3g}{f', {stack.channels[channel]}' if channels > 1 else ''}{where}"
            tiles.append((_cell(weights), f"{label}\nw {weights.max():.2g}"))
        rows += split_into_rows(tiles, MOST_ACROSS)
    return contact_sheet(rows, f"{stack.name}; {side} x {side} px; each as bright as its largest weight, w", lines=2)


def _cell(weights: NDArray[np.float32]) -> Picture:
    """A point spread function as a picture of CELL px a side, enlarged by a whole factor if there is room."""
    shown = np.round(255.0 * np.clip(weights / max(float(weights.max()), 1e-30), 0.0, 1.0)).astype(np.uint8)
    side = shown.shape[0]
    if side > CELL:  # each pixel of the picture shows the largest of its weights, so that points stay visible
        first = np.arange(CELL) * side // CELL
        shown = np.maximum.reduceat(np.maximum.reduceat(shown, first, axis=0), first, axis=1)
    times = CELL // shown.shape[0]
    grown = Image.fromarray(np.kron(shown, np.ones((times, times), np.uint8)))
    cell = Image.new("RGB", (CELL, CELL), EMPTY)
    cell.paste(grown, ((CELL - grown.width) // 2, (CELL - grown.height) // 2))
    return np.asarray(cell)
