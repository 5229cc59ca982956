"""The options `--focus-distance`, `--focus-at` and `--focus-depth`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clsco.cli.options import NumberRange, option, parse_length, parse_pair
from clsco.errors import ClscoError, SceneError

if TYPE_CHECKING:
    from clsco.inputs.focus import Focus
    from clsco.scene.sweep import Sweep

    Loaded = Sequence[tuple[Path, Sweep | SceneError]]

FocusTrack = Mapping[int, float]
"""Distances in focus in mm, by the number of a frame."""


def _point(text: str) -> tuple[int, int]:
    return parse_pair(text, r"(\d{1,5}),(\d{1,5})", "X,Y, a pixel's column and row counted from 0")


def _distance(text: str) -> float | FocusTrack:
    is_file = text.lower().endswith(".csv")
    if not is_file and ":" not in text:
        return parse_length(text)
    rule = "must be a distance, like 3m, or distances by frame, like 1:3m,48:5m, or a CSV file of these"
    try:
        rows = Path(text).read_text().split("\n") if is_file else text.split(",")
        keys = [re.split(r"[:,;\s]+", row.strip()) for row in rows if row.strip()]
        first = int(is_file and not keys[0][0].isdecimal())  # after a heading
        track = {int(frame): parse_length(distance) for frame, distance in keys[first:]}
        if min(track.values()) > 0.0:
            return track
    except (OSError, ValueError, IndexError) as error:
        text += f": {error.strerror}" if isinstance(error, OSError) else ""
    raise click.BadParameter(f"{rule}; got {text}")


focus_distance_option = option(
    "--focus-distance", "LENGTH",
    "Distance in focus, mm or like 3m; of a sequence also by frame, linear in diopters: 1:3m,48:5m, or a CSV file.",
    _distance,
)  # fmt: skip
focus_at_option = option(
    "--focus-at", "X,Y",
    "Focus on what is in this pixel, column and row counted from 0, in place of a distance in focus.", _point,
)  # fmt: skip
focus_depth_option = option(
    "--focus-depth", "SHARE",
    "Focus on the depth that this share of the picture is nearer than: 0 the nearest, 0.5 the median, 1 the farthest.",
    NumberRange(0.0, 1.0),
)  # fmt: skip


def parse_focus(at: tuple[int, int] | None, share: float | None) -> Focus | None:
    """The focus that an option requests, or None if neither is given. Raises click.UsageError if both are given."""
    if at is not None and share is not None:
        raise click.UsageError("--focus-at: goes without --focus-depth; got both")
    return share if at is None else at


def focus_files(loaded: Loaded, focus: Focus | None) -> Loaded:
    """The loaded files with focused lenses. A SceneError replaces the scenes of a file that cannot be focused."""
    if focus is None:
        return loaded
    return [(path, _focused(path, item, focus) if not isinstance(item, SceneError) else item) for path, item in loaded]


def _focused(path: Path, sweep: Sweep, focus: Focus) -> Sweep | SceneError:
    from clsco.inputs.files import shared_files
    from clsco.inputs.focus import focus_scene
    from clsco.plan.prepare import with_resolution

    cameras = [scene.camera for scene in sweep.scenes]
    distances = {camera.focus_distance or camera.sensor_distance for camera in cameras}
    if len(distances) > 1:
        return SceneError(f"{path}: focus: goes without several values of the focus; got {len(distances)}")
    try:
        scenes = tuple(focus_scene(with_resolution(scene), shared_files().maps, focus) for scene in sweep.scenes)
    except ClscoError as error:
        return SceneError([f"{path}: {message}" for message in getattr(error, "messages", [error])])
    return replace(sweep, scenes=scenes)
