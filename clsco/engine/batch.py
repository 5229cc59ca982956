"""Renders scenes to folders of files: selects the frames, and skips existing ones."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from clsco.engine.sequence import render_prepared
from clsco.errors import FileError, SceneError
from clsco.files.atomic import is_same_place, make_writable_folder
from clsco.frame.files import (
    TRUTH_FORMATS,
    frame_files,
    frame_json,
    holds_truth,
    read_complete,
    write_frame,
    write_scene_files,
)
from clsco.frame.frame import Frame
from clsco.frame.outputs import ATTRIBUTES, FILE_NAMES, IMAGE_NAMES
from clsco.frame.provenance import file_digests, record
from clsco.frame.truth_files import TruthFile
from clsco.opencl.session import Session, session_for
from clsco.plan.prepare import Prepared, PreparedFile
from clsco.resources import remove_left
from clsco.scene.model import Scene

Span = tuple[int | None, int | None]
TOGETHER, PIXELS_TOGETHER = 16, 2**24  # most scenes of a sweep on the device at a time, and most pixels of their frames


@dataclass(frozen=True)
class Job:
    """One scene to render.

    record: entries for the JSON files of its frames; folder: where to write; frames: numbers of the frames that are
    still to render; files: files to write besides PNG and JSON.
    """

    prepared: Prepared
    record: dict[str, Any]
    folder: Path
    frames: tuple[int, ...]
    files: tuple[TruthFile, ...]
    before: Mapping[int, int | None] = field(default_factory=dict)
    """Time in ns at which each frame to render was last written; None if the folder does not have the frame."""


def folders(scenes: Sequence[Path], out: Path) -> list[Path]:
    """Folder of each scene's frames: `out` for a single scene, else a folder in `out` named after the scene file.

    Raises SceneError if two scenes would share a folder, or a folder is outside of `out`.
    """
    if len(scenes) == 1:
        return [out]
    scenes_by_folder: dict[Path, Path] = {}
    for scene in scenes:
        folder = out / scene.stem
        _require_inside(folder, out, scene)
        if folder in scenes_by_folder:
            rule = f"scenes that are rendered together must have different names; got another {scene.name}"
            raise SceneError(f"{scene}: {rule}, {scenes_by_folder[folder]}")
        scenes_by_folder[folder] = scene
    return list(scenes_by_folder)


def _require_inside(folder: Path, out: Path, where: Path) -> None:
    """Raise SceneError if a folder of frames is not directly inside `out`, because of its name or a symbolic link."""
    if not is_same_place(Path(os.path.realpath(folder)).parent, out):
        raise SceneError(f"{where}: frames must stay inside {out}; got {folder}")


def frame_range(scene: Scene, span: Span, where: str) -> range:
    """Numbers of the frames from span[0] up to but not including span[1]; None means the start or the end.

    Raises SceneError if the scene does not have these frames.
    """
    count = scene.sequence.frames
    first, end = span[0] or 0, count if span[1] is None else span[1]
    if not first < end <= count:
        raise SceneError(f"{where}: frames: must lie within 0:{count} and hold a frame; got {first}:{end}")
    return range(first, end)


def prepare(
    prepared: Prepared,
    folder: Path,
    frames: Sequence[int],
    files: tuple[TruthFile, ...],
    resume: bool,
    digests: Mapping[str, str] | None = None,
) -> Job:
    """Make the folder; with `resume`, skip the frames of this scene that are in the folder and complete.

    digests: SHA-256 of the scene's input files (`provenance.file_digests`), if known. A frame is complete if its JSON
    file, which is written last, has the scene's hash, this version, the requested tolerance and precision, all
    requested files and arrays, and the SHA-256 that each file has now. Raises FileError if a texture or depth map
    cannot be read, or the folder is not writable.
    """
    scene, request = prepared.scene, prepared.request
    entries = record(scene, digests)
    make_writable_folder(folder)
    remove_left(folder)
    for _, item in scene.inputs:
        for kind, path in ((key, Path(name)) for key, name in item.files().items()):
            if path.stem.startswith("frame_") and is_same_place(path.parent, folder):
                raise FileError(f"{path}: a {kind} must not lie where frames are written; got {folder}")

    image = ["color"] if prepared.plan.color else []
    names = {FILE_NAMES[name] for name in (*image, *prepared.plan.truth, *(["alpha"] if prepared.plan.alpha else []))}
    subframes = prepared.plan.subframes if "subframes" in request.truth else 0
    tolerance = None if prepared.approximation is None else prepared.approximation.tolerance

    def is_complete(index: int) -> bool:
        content = read_complete(folder, index)
        if content is None or any(content.get(key) != entries[key] for key in ("version", "scene_sha256")):
            return False
        has_files = frame_files(index, scene.stereo is not None, files, subframes, names) <= set(content["files"])
        views = content["views"].values() if scene.stereo is not None else [content]
        same = all((view.get("approximation") or {}).get("tolerance") == tolerance for view in views)
        same = same and all(request.precision in (None, view.get("precision")) for view in views)
        return has_files and same and holds_truth(content, files)

    pending = tuple(index for index in frames if not (resume and is_complete(index)))
    before = {index: _write_time(folder, index) for index in pending}
    return Job(prepared, entries, folder, pending, files, before)


def prepare_all(
    planned: Sequence[PreparedFile], out: Path, files: tuple[TruthFile, ...], span: Span, resume: bool
) -> list[Job]:  # fmt: skip
    """`prepare` for every scene of several files, each file in its folder of `folders`. Raises the errors of `prepare`,
    `folders` and `frame_range`, and SceneError if `files` name arrays that a scene does not have.
    """
    _require_arrays(planned, files)
    places = list(zip(planned, folders([path for path, *_ in planned], out), strict=True))
    for (path, labels, _), folder in places:
        if path.stem.startswith("frame_") and is_same_place(path.parent, folder):
            raise SceneError(f"{path}: a scene file must not lie where frames are written; got {folder}")
        for label in filter(None, labels):
            _require_inside(folder / label, folder, path)
    chosen = [
        (entry, folder / label, frame_range(entry.scene, span, str(path)))
        for (path, labels, prepared), folder in places
        for label, entry in zip(labels, prepared, strict=True)
    ]
    digests = file_digests(entry.scene for entry, _, _ in chosen)
    return [prepare(*arguments, files, resume, digests) for arguments in chosen]


def _require_arrays(planned: Sequence[PreparedFile], files: Sequence[TruthFile]) -> None:
    """Raise SceneError if a scene does not have the arrays that the requested files need."""
    faults = dict[str, None]()
    files_by_name = {ATTRIBUTES[name]: file for file in files for name in _required(file)}
    for path, _, prepared in planned:
        missing = [name for entry in prepared for name in files_by_name if name not in entry.plan.truth]
        rule = f"{path}: truth: the scene must have"
        faults.update({f"{rule} {name}; got {files_by_name[name]}": None for name in missing})
    if faults:
        raise SceneError(list(faults))


def _required(file: TruthFile) -> list[str]:
    """Names of the arrays that a scene must have for a file. These are the arrays that are requested by name. If there
    are none, and the format has a file per array, it is the first array that the format can hold.
    """
    truth_format = TRUTH_FORMATS[file.format]
    names = file.names or (truth_format.arrays[:1] if truth_format.per == "array" else ())
    return [name for name in names if name not in ("color", *IMAGE_NAMES)]


def _write_time(folder: Path, index: int) -> int | None:
    """Time in ns at which a frame's JSON file was written; None if there is none."""
    try:
        return frame_json(folder, index).stat().st_mtime_ns
    except OSError:
        return None


def run(jobs: Sequence[Job], device: str | None, check: bool = False) -> Iterator[tuple[Job, tuple[Frame, ...]]]:
    """Render and write the frames of jobs; yields for each its job, and the frame or both views of a stereo pair.

    jobs: in rendering order; jobs of one sweep follow each other, and up to `TOGETHER` of them share their rays if
    possible; check: True to compare frames with rays, and add the result to their metadata. Files that a scene has only
    once are written after all frames of all jobs. Raises as `clsco.render` and `clsco.frame.files.write_frame`.
    """
    session = session_for(device)
    for _, group in groupby(
        (job for job in jobs if job.frames), key=lambda job: (job.frames, job.files, job.prepared.request)
    ):
        members = list(group)
        largest = max(job.prepared.plan.rows * job.prepared.plan.columns for job in members)
        count = max(1, min(TOGETHER, PIXELS_TOGETHER // largest))
        for start in range(0, len(members), count):
            yield from _run_together(session, members[start : start + count], check)
    for job in jobs:
        write_scene_files(job.folder, job.prepared.scene, job.files)


def _run_together(session: Session, jobs: Sequence[Job], check: bool) -> Iterator[tuple[Job, tuple[Frame, ...]]]:
    """Render as `run` does, for jobs with the same frames, files and request."""
    left: Frame | None = None
    for number, rendered in render_prepared(session, [job.prepared for job in jobs], jobs[0].frames):
        frame = rendered
        if check:
            from clsco.truth.judge import judged_frame

            frame = judged_frame(jobs[number].prepared.scene, rendered)
        if frame.eye == "left":
            left = frame
            continue
        job, views = jobs[number], (frame,) if left is None else (left, frame)
        if _write_time(job.folder, frame.index) != job.before[frame.index]:
            where = frame_json(job.folder, frame.index)
            raise FileError(f"{where}: frames must have one writer at a time; got one that another process wrote")
        scene = job.prepared.scene
        arguments = job.folder, views, frame.metadata["bits"], scene.image.transfer, job.files, job.record
        write_frame(*arguments, scene=scene, color=job.prepared.color)
        left = None
        yield job, views
