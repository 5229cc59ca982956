"""The Generate dialog, and the list of its jobs."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from clsco.errors import ClscoError
from clsco.scene.formatting import format_seconds
from clsco.studio import generate
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.session import Document
from clsco.studio.widgets.html import Dialog, PagePart, button, check_box, choice, notify, page, say, text_box

SHOWN = 12  # frames of a job as pictures
SPOKEN_S = 2.0  # between announcements of progress to screen readers


def generate_dialog(session: Document, jobs: Jobs, device: str = "") -> Callable[[], None]:
    """The dialog that writes frames, a focal stack or a data set to a folder; returns a function that opens it."""
    dialog, truth = Dialog("Generate"), dict[str, bool]()
    answers: dict[str, Any] = {
        "folder": "", "set_folder": "", "subframes": False, "preset": "", "nearest": "200", "farthest": "400",
        "steps": "9", "distribution": "", "count": "100", "seed": "0", "form": generate.first_format(),
    }  # fmt: skip
    on_device = ["--device", device] if device else []

    def begin(action: Callable[[], CommandJob]) -> None:
        job = action()
        notify(f"Job {job.number}: {job.line}")
        dialog.close()

    def options() -> list[str]:
        names = ",".join(filter(truth.get, truth))
        words = ["--format", names] if names else []
        words += ["--subframes"] if answers["subframes"] else []
        return words + (["--video", answers["preset"]] if answers["preset"] else []) + on_device

    def frames() -> CommandJob:
        return generate.render_frames(session, jobs, answers["folder"], options())

    def stack() -> CommandJob:
        ends = _number(answers["nearest"], "nearest"), _number(answers["farthest"], "farthest")
        table = generate.stack_table(session, *ends, _whole(answers["steps"], "steps"))
        return generate.render_frames(session, jobs, answers["folder"], options(), table)

    def data_set() -> CommandJob:
        count, seed = _whole(answers["count"], "samples"), _whole(answers["seed"], "seed", 0)
        words = ["--seed", str(seed), "--format", answers["form"], *on_device]
        return generate.make_data_set(session, jobs, answers["distribution"], answers["set_folder"], count, words)

    def box(label: str, name: str, mode: str = "text") -> None:
        text_box(label, answers[name], partial(answers.__setitem__, name), inputmode=mode)

    def draw_frames() -> None:
        box(f"Output folder in {session.root.name}", "folder")
        _draw_truth(truth)
        clips = generate.clip_presets()
        named = {"": "none"} | {name: name for name in clips}
        choice("Clip beside the frames", named, answers["preset"], partial(answers.__setitem__, "preset"), clips)
        check_box("Image of each time sample, too", answers["subframes"], partial(answers.__setitem__, "subframes"))
        with say("div", class_="row"):
            button(_all_frames(session), partial(begin, frames), class_="primary")

    def draw_stack() -> None:
        box("Nearest focus distance (mm)", "nearest", "decimal")
        box("Farthest focus distance (mm)", "farthest", "decimal")
        box("Steps", "steps", "numeric")
        button("Write the stack", partial(begin, stack))

    def draw_set() -> None:
        names, forms = generate.distributions(session.root), generate.set_formats()
        answers["distribution"] = answers["distribution"] if answers["distribution"] in names else names[0]
        named = {name: name for name in names}
        choice("Distribution file", named, answers["distribution"], partial(answers.__setitem__, "distribution"), {})
        box(f"Folder of the set in {session.root.name}", "set_folder")
        box("Samples", "count", "numeric")
        box("Seed", "seed", "numeric")
        choice("Format", {form: form for form in forms}, answers["form"], partial(answers.__setitem__, "form"), forms)
        button("Make the set", partial(begin, data_set))

    def show() -> None:
        answers.update(folder=generate.free_folder(session), set_folder=generate.free_folder(session, "sets"))
        with dialog.filled():
            draw_frames()
            for title, draw in (("Focal stack", draw_stack), ("Data set", draw_set)):
                with say("details"):
                    say("summary", title)
                    draw()
        dialog.open()

    return show


def _draw_truth(chosen: dict[str, bool]) -> None:
    with say("fieldset", class_="vector"):
        say("legend", "Ground truth")
        with say("div", class_="choices"):
            for name, lacks in generate.truth_formats().items():
                label = f"{name} ({lacks})" if lacks else name
                check_box(label, chosen.get(name, False), partial(chosen.__setitem__, name), disabled=bool(lacks))


def _all_frames(session: Document) -> str:
    """Label of the Generate button: the number of frames or scenes to write."""
    scenes, frames = len(session.state.labels), session.scene.sequence.frames
    if scenes > 1:
        return f"Write the frames of {scenes} scenes"
    return f"Write {frames} frame{'s' if frames > 1 else ''}"


def draw_jobs(jobs: Jobs) -> None:
    """Draw the jobs, and redraw them when they change; progress redraws no buttons, which would lose the focus."""
    parts: dict[int, tuple[PagePart, PagePart]] = {}
    before: dict[str, Any] = {"spoken": 0.0, "text": ""}

    def draw() -> None:
        with say("section", aria_label="Jobs"):
            say("h2", "Jobs")
            if not jobs.listed:
                say("p", "Generate writes frames; what runs is seen here.", class_="quiet")
            for job in jobs.listed:
                parts[job.number] = _draw(jobs, job)

    spoken = PagePart(lambda: say("span", before["text"]))
    area = PagePart(draw, lambda: [(job.number, job.status) for job in jobs.listed])
    with say("div", role="status", aria_live="polite", class_="for-listeners"):
        spoken()
    area()

    def changed() -> None:
        area.changed()
        for job in jobs.listed:
            if job.status == "running":
                for part in parts[job.number]:
                    part.refresh()
        now = time.time()
        text = "; ".join(f"job {job.number} {_state(job)}" for job in jobs.listed if job.is_unfinished)
        if text != before["text"] and now - before["spoken"] > SPOKEN_S:
            before.update(spoken=now, text=text)
            spoken.refresh()

    page().endings.append(jobs.subscribe(changed))


def _state(job: CommandJob) -> str:
    if job.status != "running" or not job.total:
        return {"waiting": "waits", "running": "runs"}.get(job.status, job.status)
    left = job.seconds_left(time.time())
    rest = f", about {format_seconds(left)} left" if left is not None else ""
    return f"{job.done} of {job.total}{rest}"


def _draw(jobs: Jobs, job: CommandJob) -> tuple[PagePart, PagePart]:
    """Draw a job; returns the parts with its progress and with its results."""
    progress, results = PagePart(partial(_progress, job)), PagePart(partial(_results, jobs, job))
    with say("article", aria_label=f"Job {job.number}", class_=f"job {job.status}"):
        say("h3", f"{job.number} {job.title}")
        progress()
        with say("div", class_="row"):
            say("code", job.line)
            say("button", "Copy", type="button", data_copy=job.line, aria_label="Copy the command line")
        if job.message:
            say("pre", job.message, role="alert", class_="difference")
        results()
        with say("div", class_="row"):
            if job.is_unfinished:
                button("Cancel", partial(jobs.cancel, job), aria_label=f"Cancel job {job.number}")
            else:
                if job.status != "done":
                    button("Again", partial(jobs.run_again, job), aria_label=f"Run job {job.number} again")
                button("Off the list", partial(jobs.forget, job), aria_label=f"Take job {job.number} off")
    return progress, results


def _progress(job: CommandJob) -> None:
    say("p", f"{_state(job).capitalize()}, in {job.output}")
    if job.status == "running":
        value = job.done if job.total else None
        say("progress", value=value, max=max(job.total, 1), aria_label=f"Progress of job {job.number}")


def _results(jobs: Jobs, job: CommandJob) -> None:
    with say("div", class_="pictures"):
        if job.command == "dataset":
            parts = min(job.done, SHOWN) if job.status == "done" else 0
            for part in range(parts):
                place = f"sample?job={job.number}&part={part}&parts={parts}&at={job.began:.0f}"
                say("img", src=place, alt=f"Sample {part + 1} of {parts}", loading="lazy")
            return
        paths = jobs.results(job)
        for path in [path for path in paths if path.suffix == ".png" and "sample" not in path.name][-SHOWN:]:
            say("img", src=_address(jobs, job, path), alt=path.stem, loading="lazy")
        for path in paths:
            if path.suffix != ".png" and job.status == "done":
                say("video", src=_address(jobs, job, path), controls=True, preload="metadata", aria_label=path.name)


def _address(jobs: Jobs, job: CommandJob, path: Path) -> str:
    return f"result?job={job.number}&name={quote(path.relative_to(jobs.root / job.output).as_posix())}"


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
