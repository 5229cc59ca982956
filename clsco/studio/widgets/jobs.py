"""Generate, and the list of what it and its kin have begun."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from clsco.errors import ClscoError
from clsco.scene.formatting import format_seconds
from clsco.studio.generate import (
    Wanted,
    clip,
    clip_name,
    clip_presets,
    data_set,
    distributions,
    first_format,
    focal_stack,
    free_folder,
    generate,
    set_formats,
    truth_formats,
)
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.session import Document
from clsco.studio.widgets.html import Dialog, PagePart, button, check_box, choice, notify, page, say, text_box

SHOWN = 12  # frames of a job as pictures
WORDS = {
    "waiting": "waits", "running": "runs", "done": "done", "failed": "failed", "canceled": "canceled",
    "interrupted": "interrupted",
}  # fmt: skip
VIEWS = {
    "color": "color", "sharp": "all in focus", "coc": "blur radius", "depth": "depth", "flow": "flow",
    "compare": "sharp and color side by side",
}  # fmt: skip
PLAYED = (".mp4", ".webm")


@dataclass
class _Answers:
    folder: str = ""
    set_folder: str = ""
    truth: dict[str, bool] = field(default_factory=dict)
    subframes: bool = False
    preset: str = ""
    nearest: str = "200"
    farthest: str = "400"
    steps: str = "9"
    distribution: str = ""
    count: str = "100"
    seed: str = "0"
    form: str = field(default_factory=first_format)

    def wanted(self, device: str) -> Wanted:
        truth = ",".join(name for name, is_on in self.truth.items() if is_on)
        return Wanted(truth, self.subframes, self.preset, device)


def generate_dialog(session: Document, jobs: Jobs, device: str = "") -> Callable[[], None]:
    """The dialog of Generate: frames, a focal stack or a data set, and where they go; returns what opens it."""
    dialog, answers = Dialog("Generate"), _Answers()

    def begin(action: Callable[[], CommandJob]) -> None:
        job = action()
        notify(f"Job {job.number}: {job.line}")
        dialog.close()

    def frames() -> None:
        begin(lambda: generate(session, jobs, answers.folder, answers.wanted(device)))

    def stack() -> None:
        ends = _number(answers.nearest, "nearest"), _number(answers.farthest, "farthest")
        steps = _whole(answers.steps, "steps")
        begin(lambda: focal_stack(session, jobs, answers.folder, *ends, steps, answers.wanted(device)))

    def many() -> None:
        count, seed = _whole(answers.count, "samples"), _whole(answers.seed, "seed", 0)
        chosen = answers.distribution, answers.set_folder
        begin(lambda: data_set(session, jobs, *chosen, count, seed, answers.form, device))

    def set_(name: str) -> Callable[[object], None]:
        return lambda value: setattr(answers, name, value)

    def truth() -> None:
        with say("fieldset", class_="vector"):
            say("legend", "Ground truth")
            with say("div", class_="choices"):
                for name, lacks in truth_formats().items():
                    is_on = answers.truth.get(name, False)
                    label = f"{name} ({lacks})" if lacks else name
                    check_box(label, is_on, partial(answers.truth.__setitem__, name), disabled=bool(lacks) or None)

    def sets() -> None:
        names = distributions(session.root)
        answers.distribution = answers.distribution if answers.distribution in names else names[0]
        choice("Distribution file", names, answers.distribution, set_("distribution"))
        text_box(f"Folder of the set in {session.root.name}", answers.set_folder, set_("set_folder"))
        text_box("Samples", answers.count, set_("count"), inputmode="numeric")
        text_box("Seed", answers.seed, set_("seed"), inputmode="numeric")
        forms = set_formats()
        choice("Format", list(forms), answers.form, set_("form"), forms)
        button("Make the set", many)

    def show() -> None:
        answers.folder, answers.set_folder = free_folder(session), free_folder(session, "sets")
        with dialog.filled():
            text_box(f"Output folder in {session.root.name}", answers.folder, set_("folder"))
            truth()
            clips = clip_presets()
            choice(
                "Clip beside the frames", {"": "none"} | {n: n for n in clips}, answers.preset, set_("preset"), clips
            )
            check_box("Image of each time sample, too", answers.subframes, set_("subframes"))
            with say("div", class_="row"):
                button(_all_frames(session), frames, class_="primary")
            with say("details"):
                say("summary", "Focal stack")
                text_box("Nearest focus distance (mm)", answers.nearest, set_("nearest"), inputmode="decimal")
                text_box("Farthest focus distance (mm)", answers.farthest, set_("farthest"), inputmode="decimal")
                text_box("Steps", answers.steps, set_("steps"), inputmode="numeric")
                button("Write the stack", stack)
            with say("details"):
                say("summary", "Data set")
                sets()
        dialog.open()

    return show


def _all_frames(session: Document) -> str:
    """Label of Generate: the number of frames or scenes that it writes."""
    scenes, frames = len(session.state.labels), session.scene.sequence.frames
    if scenes > 1:
        return f"Write the frames of {scenes} scenes"
    return f"Write {frames} frame{'s' if frames > 1 else ''}"


def clip_dialog(session: Document, jobs: Jobs) -> Callable[[CommandJob], None]:
    """The dialog of a clip of a job's frames; returns what opens it."""
    dialog = Dialog("Clip")
    answers = {"preset": "mp4", "view": "color"}

    def begin(job: CommandJob) -> None:
        file = Path(job.folder) / clip_name(answers["preset"])
        clip(session, jobs, job.folder, str(file), answers["view"], answers["preset"])
        dialog.close()

    def show(job: CommandJob) -> None:
        with dialog.filled():
            say("p", f"Of the frames in {job.folder}")
            clips = clip_presets()
            choice("Preset", list(clips), answers["preset"], lambda name: answers.update(preset=name), clips)
            needs = "" if "--format" in job.arguments else "needs ground truth beside the frames, in npz or exr"
            missing = {view: needs for view in VIEWS if view != "color"}
            choice("View", VIEWS, answers["view"], lambda view: answers.update(view=view), missing)
            button("Make the clip", lambda: begin(job), class_="primary")
        dialog.open()

    return show


def draw_jobs(session: Document, jobs: Jobs) -> None:
    """Draw the jobs, and draw them again when they change.

    While they only get on, what can be pressed stays: else clicks and the focus would be lost.
    """
    followed: dict[int, tuple[PagePart, PagePart]] = {}

    def listed() -> list[tuple[Any, ...]]:
        return [(job.number, job.status, job.message, job.total) for job in jobs.listed]

    clips = clip_dialog(session, jobs)

    def draw() -> None:
        with say("section", aria_label="Jobs"):
            say("h2", "Jobs")
            if not jobs.listed:
                say("p", "Generate writes frames; what runs is seen here.", class_="quiet")
            for job in jobs.listed:
                followed[job.number] = _draw(jobs, job, clips)

    said, area = PagePart(lambda: say("span", last["text"])), PagePart(draw)
    last: dict[str, Any] = {"told": 0.0, "text": "", "listed": listed()}
    with say("div", role="status", aria_live="polite", class_="for-listeners"):
        said()
    area()

    def changed() -> None:
        if (now_listed := listed()) != last["listed"]:
            last["listed"] = now_listed
            area.refresh()
        for job in jobs.listed:
            if job.status == "running" and job.number in followed:  # else it is drawn in a moment
                for part in followed[job.number]:
                    part.refresh()
        text = "; ".join(f"job {job.number} {_state(job)}" for job in jobs.listed if job.is_unfinished)
        now = time.monotonic()
        if text != last["text"] and now - last["told"] > 2.0:  # not more often than can be listened to
            last.update(told=now, text=text)
            said.refresh()

    page().endings.append(jobs.subscribe(changed))


def _state(job: CommandJob) -> str:
    """State and progress of a job, in words."""
    if job.status != "running":
        return WORDS[job.status]
    left = job.seconds_left(time.time())
    rest = f", about {format_seconds(left)} left" if left is not None else ""
    return f"{job.done} of {job.total}{rest}" if job.total else f"{job.done} files"


def _draw(jobs: Jobs, job: CommandJob, make_clip: Callable[[CommandJob], None]) -> tuple[PagePart, PagePart]:
    """Draw a job; returns the parts that show how far it is."""
    progress, made = PagePart(partial(_progress, jobs, job.number)), PagePart(partial(_pictures, jobs, job.number))
    with say("article", aria_label=f"Job {job.number}", class_=f"job {job.status}"):
        say("h3", f"{job.number} {job.title}")
        progress()
        with say("div", class_="row"):
            say("code", job.line)
            say("button", "Copy", type="button", data_copy=job.line, aria_label="Copy the command line")
        if job.message:
            say("pre", job.message, role="alert", class_="difference")
        made()
        with say("div", class_="row"):
            if job.is_unfinished:
                button("Cancel", partial(jobs.cancel, job.number), aria_label=f"Cancel job {job.number}")
            else:
                if job.status != "done":
                    button("Again", partial(jobs.again, job.number), aria_label=f"Run job {job.number} again")
                elif job.command == "render" and len(_images(jobs, job)) > 1 and "/" not in job.pattern:  # of one scene
                    button("Make a clip", partial(make_clip, job))
                button("Off the list", partial(jobs.forget, job.number), aria_label=f"Take job {job.number} off")

    return progress, made


def _progress(jobs: Jobs, number: int) -> None:
    job = jobs.job(number)
    say("p", f"{_state(job).capitalize()}, in {job.folder}")
    if job.status == "running":
        value = job.done if job.total else None
        say("progress", value=value, max=max(job.total, 1), aria_label=f"Progress of job {number}")


def _images(jobs: Jobs, job: CommandJob) -> list[Path]:
    return [path for path in jobs.files(job.number) if path.suffix == ".png" and "sample" not in path.name]


def _pictures(jobs: Jobs, number: int) -> None:
    """Show a job's results as small pictures and clips."""
    job = jobs.job(number)
    with say("div", class_="pictures"):
        if job.command == "dataset":
            parts = min(job.done, SHOWN) if job.status == "done" else 0
            for part in range(parts):
                place = f"sample?job={number}&part={part}&parts={parts}&at={job.ended:.0f}"
                say("img", src=place, alt=f"Sample {part + 1} of {parts}", loading="lazy")
            return
        for path in _images(jobs, job)[-SHOWN:]:
            say("img", src=_address(jobs, job, path), alt=path.stem, loading="lazy")
        for path in jobs.files(number) if job.status == "done" else ():
            if path.suffix in PLAYED and (job.command == "render" or path.name == job.pattern):
                say("video", src=_address(jobs, job, path), controls=True, preload="metadata", aria_label=path.name)


def _address(jobs: Jobs, job: CommandJob, path: Path) -> str:
    return f"result?job={job.number}&name={quote(path.relative_to(jobs.root / job.folder).as_posix())}"


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ClscoError(f"{what}: must be a number; got {text!r}") from None


def _whole(text: str, what: str, least: int = 1) -> int:
    digits = text.strip()
    if not (digits.isascii() and digits.isdecimal() and len(digits) < 19 and int(digits) >= least):
        raise ClscoError(f"{what}: must be an integer from {least} on; got {text[:40]!r}")
    return int(digits)
