"""Generate, and the list of what it and its kin have begun."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import ui

from clsco.errors import ClscoError
from clsco.studio.generate import Wanted, clip, data_set, focal_stack, free_folder, generate, has_data_sets
from clsco.studio.jobs import Job, Jobs
from clsco.studio.session import Session
from clsco.studio.widgets.plain import Dialog, button, check_box, choice, say, text_box

SHOWN = 12  # frames of a job as pictures
WORDS = {
    "waiting": "waits", "running": "runs", "done": "done", "failed": "failed", "canceled": "canceled",
    "interrupted": "interrupted",
}  # fmt: skip
_TRUTH = {"": "none", "npz": "npz", "exr": "exr", "npz,exr": "npz and exr"}
_CLIPS = {"": "none", "mp4": "mp4", "ffv1": "ffv1", "prores": "prores"}


@dataclass
class _Answers:
    folder: str = ""
    truth: str = ""
    subframes: bool = False
    preset: str = ""
    nearest: str = "200"
    farthest: str = "400"
    steps: str = "9"
    distribution: str = ""
    count: str = "100"
    seed: str = "0"

    def wanted(self, device: str) -> Wanted:
        return Wanted(self.truth, self.subframes, self.preset, device)


def generate_dialog(session: Session, jobs: Jobs, device: str = "") -> Callable[[], None]:
    """The dialog of Generate: frames, a focal stack or a data set, and where they go; returns what opens it."""
    dialog, answers = Dialog("Generate"), _Answers()

    def begin(action: Callable[[], Job]) -> None:
        job = action()
        ui.notify(f"Job {job.number}: {job.line}", multi_line=True)
        dialog.close()

    def frames() -> None:
        begin(lambda: generate(session, jobs, answers.folder, answers.wanted(device)))

    def stack() -> None:
        ends = _number(answers.nearest, "nearest"), _number(answers.farthest, "farthest")
        steps = _whole(answers.steps, "steps")
        begin(lambda: focal_stack(session, jobs, answers.folder, *ends, steps, answers.wanted(device)))

    def many() -> None:
        count, seed = _whole(answers.count, "samples"), _whole(answers.seed, "seed")
        begin(lambda: data_set(session, jobs, answers.distribution, answers.folder, count, seed))

    def set_(name: str) -> Callable[[object], None]:
        return lambda value: setattr(answers, name, value)

    def show() -> None:
        answers.folder = free_folder(session)
        with dialog.filled():
            text_box(f"Output folder in {session.root.name}", answers.folder, set_("folder"))
            choice("Ground truth", _TRUTH, answers.truth, set_("truth"))
            choice("Clip beside the frames", _CLIPS, answers.preset, set_("preset"))
            check_box("Image of each time sample, too", answers.subframes, set_("subframes"))
            count = session.scene.sequence.frames
            with ui.element("div").classes("row"):
                button(f"Write {count} frame{'s' if count > 1 else ''}", frames).classes("primary")
            with say("details"):
                say("summary", "Focal stack")
                text_box("Nearest focus distance (mm)", answers.nearest, set_("nearest"), inputmode="decimal")
                text_box("Farthest focus distance (mm)", answers.farthest, set_("farthest"), inputmode="decimal")
                text_box("Steps", answers.steps, set_("steps"), inputmode="numeric")
                button("Write the stack", stack)
            if has_data_sets():
                with say("details"):
                    say("summary", "Data set")
                    text_box("Distribution file", answers.distribution, set_("distribution"))
                    text_box("Samples", answers.count, set_("count"), inputmode="numeric")
                    text_box("Seed", answers.seed, set_("seed"), inputmode="numeric")
                    button("Make the set", many)
        dialog.open()

    return show


def draw_jobs(session: Session, jobs: Jobs) -> Callable[[], None]:
    """Draw the jobs, and draw them again when they change.

    While they only get on, what can be pressed stays: else clicks and the focus would be lost.

    Returns
    -------
    function
        Ends it, when the page is closed.
    """

    followed: dict[int, Callable[[Job], None]] = {}

    def listed() -> list[tuple[Any, ...]]:
        return [(job.number, job.status, job.message, job.total) for job in jobs.listed]

    @ui.refreshable
    def area() -> None:
        with say("section", aria_label="Jobs"):
            say("h2", "Jobs")
            if not jobs.listed:
                say("p", "Generate writes frames; what runs is seen here.").classes("quiet")
            for job in jobs.listed:
                followed[job.number] = _draw(session, jobs, job)

    said = say("div", role="status", aria_live="polite").classes("for-listeners")
    area()
    last: dict[str, Any] = {"told": 0.0, "text": "", "listed": listed()}

    def changed() -> None:
        if (now_listed := listed()) != last["listed"]:
            last["listed"] = now_listed
            area.refresh()
        for job in jobs.listed:
            if job.status == "running":
                followed[job.number](job)
        text = "; ".join(f"job {job.number} {_state(job)}" for job in jobs.listed if job.is_unfinished)
        now = time.monotonic()
        if text != last["text"] and now - last["told"] > 2.0:  # not more often than can be listened to
            last.update(told=now, text=text)
            said.props["innerText"] = text
            said.update()

    return jobs.subscribe(changed)


def _state(job: Job) -> str:
    """How far a job is, in words."""
    if job.status != "running":
        return WORDS[job.status]
    left = job.seconds_left(time.time())
    rest = f", about {_duration(left)} left" if left is not None else ""
    return f"{job.done} of {job.total}{rest}" if job.total else f"{job.done} files"


def _duration(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 100
        else f"{seconds / 60:.0f} min"
        if seconds < 6000
        else f"{seconds / 3600:.1f} h"
    )


def _draw(session: Session, jobs: Jobs, job: Job) -> Callable[[Job], None]:
    """Draw a job; returns what shows how far it is."""
    bar = None
    with say("article", aria_label=f"Job {job.number}").classes(f"job {job.status}"):
        say("h3", f"{job.number} {job.title}")
        words = say("p", _how_far(job))
        if job.status == "running":
            value = str(job.done) if job.total else None
            bar = say("progress", value=value, max=str(max(job.total, 1)), aria_label=f"Progress of job {job.number}")
        with say("div").classes("row"):
            say("code", job.line)
            say("button", "Copy", type="button", data_copy=job.line, aria_label="Copy the command line")
        if job.message:
            say("pre", job.message, role="alert").classes("difference")
        with say("div").classes("pictures") as frame:
            pictures = _pictures(jobs, job)
        with say("div").classes("row"):
            if job.is_unfinished:
                button("Cancel", partial(jobs.cancel, job.number), aria_label=f"Cancel job {job.number}")
            else:
                if job.status != "done":
                    button("Again", partial(jobs.again, job.number), aria_label=f"Run job {job.number} again")
                elif job.arguments[0] == "render" and len(pictures) > 1:
                    button("Make a clip", partial(_clip, session, jobs, job))
                button("Off the list", partial(jobs.forget, job.number), aria_label=f"Take job {job.number} off")

    def follow(now: Job) -> None:
        words.props["innerText"] = _how_far(now)
        words.update()
        if bar is not None and now.total:
            bar.props["value"] = str(now.done)
            bar.update()
        frame.clear()
        with frame:
            _pictures(jobs, now)

    return follow


def _how_far(job: Job) -> str:
    return f"{_state(job).capitalize()}, in {job.folder}"


def _pictures(jobs: Jobs, job: Job) -> list[Path]:
    """Draw the latest frames of a job; returns all."""
    files = jobs.files(job.number) if job.arguments[0] in ("render", "video") else []
    pictures = [path for path in files if path.suffix == ".png" and "sample" not in path.name]
    for path in pictures[-SHOWN:]:
        name = path.relative_to(jobs.root / job.folder).as_posix()
        say("img", src=f"/result?job={job.number}&name={quote(name)}", alt=path.stem, loading="lazy")
    return pictures


def _clip(session: Session, jobs: Jobs, job: Job) -> None:
    clip(session, jobs, job.folder, str(Path(job.folder) / "clip.mp4"))


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ClscoError(f"{what}: must be a number; got {text!r}") from None


def _whole(text: str, what: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ClscoError(f"{what}: must be an integer; got {text!r}") from None
