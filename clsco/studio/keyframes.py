"""Lists, adds and removes the keyframes in the time line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from clsco.errors import SceneError
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import keyframe_at
from clsco.scene.model import Scene
from clsco.scene.motions import ObjectMotion
from clsco.scene.text import brief, shown
from clsco.studio.session import Document
from clsco.studio.tables import SHAPE_LABELS, Table, as_lists, at, with_value, without, words

LATEST = 1e9  # s, of a keyframe
LENS = "lens.keyframe"
# Attribute of the camera for each key of a lens keyframe.
_OF_LENS = {"focal_length": "focal_length", "focus_distance": "focused_distance", "f_number": "opening"}
_FIRST_OF_LENS = ("focus_distance", "f_number")
_TURN = 90.0  # deg: largest rotation between keyframes that replace angular velocities about several axes


@dataclass(frozen=True)
class Track:
    """An object, group, camera or lens that can have keyframes."""

    path: str  # path of its keyframes: "object.0.motion.keyframe"
    name: str  # its name for users
    times: tuple[float | None, ...]  # times of its keyframes, s; None for a time with several values


def tracks(session: Document) -> tuple[Track, ...]:
    """Tracks of the camera, its lens, groups and objects of a scene, except backgrounds, which cannot move."""
    return tuple(Track(path, name, _times(session, path)) for path, name in _named(session))


def add_keyframe(session: Document, path: str, time: float) -> None:
    """Add a keyframe to a track, as one undo step. It has the pose, or the lens settings, of that time.

    path: path of a `Track`; time: s. A motion with velocities is converted to keyframes at t = 0, at `time` and at the
    end of the sequence, and at more times if it rotates about several axes. Raises SceneError if there is no such
    track, or the time is invalid or has a keyframe already.
    """
    _known(session, path)
    if not abs(time) <= LATEST:
        raise SceneError(f"keyframe: time must be within {LATEST:g} s; got {brief(str(time))}")
    scene, (outer, _, _) = session.scene, path.rpartition(".")
    table = session.table
    old = at(table, path.split(".")) or []
    if path == LENS:
        new = [_lens_keyframe(scene, time)]
    else:
        motion = _motion(session, path)
        times = [time]
        if not old and motion.moves:
            times = _moving_times(scene, motion, time)
            section: Table = at(table, outer.split("."))
            rest = {key: value for key, value in section.items() if not key.endswith(("velocity", "acceleration"))}
            table = with_value(table, outer.split("."), {"outside": "linear"} | rest)
        new = [
            {key: as_lists(value) for key, value in keyframe_at(motion, t, scene.motion.rotation).model_dump().items()}
            for t in times
        ]
    if any(_time(each) == time for each in old):
        raise SceneError(f"keyframe: there must be none at this time; got one at {time:g} s")
    keys = sorted([*old, *new], key=lambda each: math.inf if (t := _time(each)) is None else t)
    session.take(replace(session.state, table=with_value(table, path.split("."), keys)))


def remove_keyframe(session: Document, path: str, index: int) -> None:
    """Remove a keyframe. If it is the last one, also remove keys that only keyframes use. Raises SceneError."""
    _known(session, path)
    table, parts = session.table, path.split(".")
    keys = list(at(table, parts) or [])
    if not 0 <= index < len(keys):
        raise SceneError(f"keyframe: must be one of {len(keys)}, counted from 0; got {shown(index)}")
    del keys[index]
    if keys:
        table = with_value(table, parts, keys)
    else:
        for key in ("interpolation", "outside", "keyframe"):
            table = without(table, [*parts[:-1], key])
    session.take(replace(session.state, table=table))


def _named(session: Document) -> Iterator[tuple[str, str]]:
    yield "camera.motion.keyframe", "Camera"
    yield LENS, "Lens"
    for number, group in enumerate(session.table.get("group", ())):
        yield f"group.{number}.motion.keyframe", f"Group {group.get('name', number + 1)}"
    for number, item in enumerate(session.table["object"]):
        if item["shape"] != "background":
            name = item.get("name") or SHAPE_LABELS.get(item["shape"], words(item["shape"]))
            yield f"object.{number}.motion.keyframe", f"{number + 1} {name}"


def _known(session: Document, path: str) -> None:
    if path not in (known for known, _ in _named(session)):
        raise SceneError(f"keyframe: must be of the camera, its lens, a group or an object; got {brief(path)}")


def _times(session: Document, path: str) -> tuple[float | None, ...]:
    """Times of keyframes, as typed in their boxes or else from the scene; None for a time that is not a number."""
    keys = at(session.table, path.split("."))
    if not isinstance(keys, list):
        return ()
    typed = [session.refused.get(f"{path}.{number}.time") for number in range(len(keys))]
    return tuple(_number(new) if _number(new) is not None else _time(key) for new, key in zip(typed, keys, strict=True))


def _time(key: Any) -> float | None:
    """Time in a keyframe's table, None if it has several values."""
    return _number(key.get("time")) if isinstance(key, dict) else None


def _number(value: Any) -> float | None:
    is_one = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_one and abs(value) <= LATEST else None


def _motion(session: Document, path: str) -> ObjectMotion:
    """The motion with keyframes at a path, in the displayed scene."""
    scene, parts = session.scene, path.split(".")
    if parts[0] == "camera":
        return scene.camera.motion
    if parts[0] == "group":
        return scene.groups[int(parts[1])].motion
    return scene.objects[session.object_entries.index(int(parts[1]))].motion


def _moving_times(scene: Scene, motion: ObjectMotion, time: float) -> list[float]:
    """Times of the keyframes that replace velocities and accelerations."""
    end = scene.sequence.frames * scene.sequence.interval
    times = {0.0, time, end}
    if sum(motion.turns) > 1:
        last = max(times)
        angle = max(map(math.hypot, *zip(keyframe_at(motion, last, scene.motion.rotation).rotation, strict=True)))
        count = math.ceil(angle / _TURN)
        times |= {last * k / count for k in range(1, count)}
    return sorted(times)


def _lens_keyframe(scene: Scene, time: float) -> Table:
    """Table of a lens keyframe. It has the quantities that other keyframes have, or all if it is the first one."""
    camera = camera_at(scene, time)
    keys = () if scene.lens is None else scene.lens.keyframe or ()
    names: Iterable[str] = {name for key in keys for name in key.model_fields_set} or _FIRST_OF_LENS
    values = {name: float(getattr(camera, of_camera)) for name, of_camera in _OF_LENS.items() if name in names}
    return {"time": time} | {name: float(f"{value:.9g}") for name, value in values.items() if math.isfinite(value)}
