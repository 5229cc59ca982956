"""The sheet of Generate: recipes, the command line that they are, and its jobs."""

from __future__ import annotations

import re
import shlex
import time
from collections import ChainMap
from collections.abc import MutableMapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from clsco.errors import ClscoError
from clsco.plan.prepare import with_resolution
from clsco.scene.formatting import format_bytes, format_seconds
from clsco.studio import generate
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.session import Document
from clsco.studio.widgets.html import PagePart, check_box, choice, command_row, icon_button, page, say, text_box

KINDS = {"frames": "this scene", "stack": "a focal stack", "set": "a data set"}
_BOXES = {  # names and labels of the numbers of a kind
    "stack": {"nearest": "Nearest focus distance (mm)", "farthest": "Farthest focus distance (mm)", "steps": "Steps"},
    "set": {"count": "Samples", "seed": "Seed"},
}


class GenerateForm:
    """The form of Generate; cost: what its button makes, and the cost of that."""

    def __init__(self, session: Document, jobs: Jobs, device: str = "") -> None:
        self._session, self._jobs = session, jobs
        self._is_set, self._free = False, generate.free_folder(session)
        self._device = ["--device", device] if device else []
        self._chosen = {generate.PICTURE: True}
        self._answers: ChainMap[str, Any] = ChainMap({
            "kind": "frames", "folder": self._free, "subframes": False, "preset": "", "form": generate.first_format(),
            "steps": "9", "distribution": "", "count": "100", "seed": "0",
        }, session.ends)  # fmt: skip
        self._folder = PagePart(lambda: self._box("folder", "Into the folder"))
        self._kind, self._line = PagePart(self._draw_kind, lambda: [*session.ends.values()]), PagePart(self._draw_line)
        self.cost = PagePart(self._draw_cost, self._total)
        page().endings.append(session.subscribe(self._renew))

    def _renew(self) -> None:
        """Choose an output folder that is not in use if the scene has another name, and update the cost."""
        free = generate.free_folder(self._session, "sets" if self._is_set else "frames")
        if free != self._free:
            self._free = self._answers["folder"] = free
            self._folder.refresh()
            self._line.refresh()
        self._kind.changed()
        self.cost.changed()

    @property
    def _recipes(self) -> list[generate.Recipe]:
        return [recipe for recipe, is_on in self._chosen.items() if is_on]

    def draw(self) -> None:
        """Draw the form."""
        missing = generate.truth_formats()
        self._folder()
        with say("div", role="group", aria_label="What to write", class_="recipes"):
            for recipe in generate.RECIPES:
                lacks, is_on = next(filter(None, map(missing.get, recipe.formats)), ""), recipe is generate.PICTURE
                with say("label", class_="recipe"):
                    change = partial(self._answer, self._chosen, recipe)
                    say("input", type="checkbox", checked=is_on, disabled=bool(lacks), change=change)
                    say("b", recipe.title)
                    say("small", lacks or recipe.about)
        with say("details", class_="fold"):
            say("summary", f"All {len(missing)} formats, clips, stacks, sets")
            choice("Render", KINDS, "frames", self._turn, {})
            self._kind()
        with say("details", class_="fold"):
            say("summary", "The same by hand")
            self._line()

    def _answer(self, answers: MutableMapping[Any, Any], name: object, value: object) -> None:
        answers[name] = value
        self._line.refresh()
        self.cost.changed()

    def _turn(self, kind: str) -> None:
        self._is_set = kind == "set"
        self._answer(self._answers, "kind", kind)
        self._kind.refresh()
        self._renew()

    def _box(self, name: str, label: str) -> None:
        text_box(label, self._answers[name], partial(self._answer, self._answers, name))

    def _list(self, name: str, label: str, options: dict[str, str]) -> None:
        named = {option: option or "none" for option in options}
        choice(label, named, self._answers[name], partial(self._answer, self._answers, name), options)

    def _draw_kind(self) -> None:
        if self._is_set:
            names = dict.fromkeys(generate.distributions(self._session.root), "")
            self._answers["distribution"] = self._answers["distribution"] or next(iter(names))
            self._list("distribution", "Distribution file", names)
            self._list("form", "Format", generate.set_formats())
        for name, label in _BOXES.get(self._answers["kind"], {}).items():
            self._box(name, label)
        if self._is_set:
            return
        missing = generate.truth_formats()
        with say("div", role="group", aria_label="Formats of ground truth", class_="choices"):
            for recipe in generate.FORMATS:
                lacks, change = missing[recipe.title], partial(self._answer, self._chosen, recipe)
                label = f"{recipe.title} ({lacks})" if lacks else recipe.title
                check_box(label, self._chosen.get(recipe, False), change, disabled=bool(lacks))
        self._list("preset", "Clip beside the frames", {"": ""} | generate.clip_presets())
        change = partial(self._answer, self._answers, "subframes")
        check_box("Image of each time sample, too", self._answers["subframes"], change)

    def _of_set(self) -> tuple[str, str, int, list[str]]:
        """Distribution file, folder, number of samples, and further options."""
        answers = self._answers
        options = ["--seed", str(_whole(answers["seed"], "seed", 0)), "--format", answers["form"], *self._device]
        return answers["distribution"], answers["folder"], _whole(answers["count"], "samples"), options

    def _of_frames(self) -> tuple[str, list[str]]:
        """Folder and options."""
        options = generate.recipe_options(self._recipes) + (["--subframes"] if self._answers["subframes"] else [])
        clip = ["--video", self._answers["preset"]] if self._answers["preset"] else []
        return self._answers["folder"], options + clip + self._device

    def begin(self, _: object) -> None:
        session, jobs, answers, table = self._session, self._jobs, self._answers, None
        if self._is_set:
            generate.make_data_set(session, jobs, *self._of_set())
        else:
            if answers["kind"] == "stack":
                ends = _number(answers["nearest"], "nearest"), _number(answers["farthest"], "farthest")
                table = generate.stack_table(session, *ends, _whole(answers["steps"], "steps"))
            generate.render_frames(session, jobs, *self._of_frames(), table)
        self._renew()

    def _draw_line(self) -> None:
        with suppress(ClscoError):  # which the button shows
            of_set, of_frames = generate.set_command, generate.render_command
            session = self._session
            words = of_set(session, *self._of_set()) if self._is_set else of_frames(session, *self._of_frames())
            command_row(shlex.join(["clsco", *words]))
            say("small", f"in {session.root.name}, where Generate first writes the file that it reads")

    def _total(self) -> tuple[str, int, str]:
        """Amount that the button makes, number of frames that take time, and size of a frame and of all files."""
        answers, labels = self._answers, self._session.state.labels
        with suppress(ClscoError):
            if self._is_set:
                return f"{_whole(answers['count'], 'samples')} samples", 0, "time and size show once it runs"
            scene = with_resolution(self._session.scene)
            scenes = _whole(answers["steps"], "steps") if answers["kind"] == "stack" else len(labels)
            count, (columns, rows) = scenes * scene.sequence.frames, scene.camera.frame_size
            size = format_bytes(count * generate.frame_bytes(scene, self._recipes))
            return f"{count} frame{'s' if count > 1 else ''}", count, f"{columns} × {rows}, {size}"
        return "frames", 0, ""

    def _draw_cost(self) -> None:
        amount, count, size = self._total()
        with say("span", id="cost", class_="quiet"):
            say("span", size)
            say("span", data_took=count, data_amount=amount)


def draw_jobs(jobs: Jobs) -> None:
    """Draw the jobs, and redraw them when they change; progress redraws no buttons, which would lose the focus."""
    parts: dict[int, list[PagePart]] = {}

    def draw() -> None:
        if jobs.listed:
            say("h3", "Jobs")
        for job in jobs.listed:
            parts[job.number] = _draw(jobs, job)

    area = PagePart(draw, lambda: [(job.number, job.status) for job in jobs.listed])
    area()

    def changed() -> None:
        area.changed()
        for part in [part for job in jobs.listed if job.status == "running" for part in parts[job.number]]:
            part.refresh()

    page().endings.append(jobs.subscribe(changed))


def _state(job: CommandJob) -> str:
    if job.status != "running" or not job.total:
        return {"waiting": "waits", "running": "runs"}.get(job.status, job.status)
    left = job.seconds_left(time.time())
    rest = f", about {format_seconds(left)} left" if left is not None else ""
    return f"{job.done} of {job.total}{rest}"


def _draw(jobs: Jobs, job: CommandJob) -> list[PagePart]:
    """Draw a job as a row, with its command and clip folded; returns the parts that change as it gets on."""
    parts = [PagePart(partial(draw, jobs, job)) for draw in (_picture, _progress)]
    with say("article", aria_label=f"Job {job.number}", class_=f"job {job.status}"):
        parts[0]()
        with say("div"):
            say("b", job.title)
            parts[1]()
        with say("div", class_="row"):
            if job.is_unfinished:
                icon_button("x", f"Cancel job {job.number}", partial(jobs.cancel, job))
            else:
                if job.status != "done":
                    icon_button("rotate-ccw", f"Run job {job.number} again", partial(jobs.run_again, job))
                icon_button("x", f"Take job {job.number} off the list", partial(jobs.forget, job))
        if job.message:
            say("pre", job.message, role="alert", class_="difference")
        with say("details", class_="fold"):
            say("summary", f"{job.output}, command")
            command_row(job.line, f" of job {job.number}")
            for path in jobs.results(job) if job.status == "done" else ():
                if path.suffix != ".png":
                    say("video", src=_address(jobs, job, path), controls=True, preload="metadata", aria_label=path.name)
    return parts


def _progress(_: Jobs, job: CommandJob) -> None:
    if job.status == "running":
        value = job.done if job.total else None
        say("progress", value=value, max=max(job.total, 1), aria_label=f"Progress of job {job.number}")
    say("small", _state(job))


def _picture(jobs: Jobs, job: CommandJob) -> None:
    """Draw the latest frame, or the first sample."""
    frames = [path for path in jobs.results(job) if re.fullmatch(r"frame_\d+(_left|_right)?\.png", path.name)]
    address = _address(jobs, job, frames[-1]) if frames else ""
    if job.command == "dataset" and job.status == "done":
        address = f"sample?job={job.number}&at={job.began:.0f}"
    say("img" if address else "span", src=address or None, alt="" if address else None)


def _address(jobs: Jobs, job: CommandJob, path: Path) -> str:
    return f"result?job={job.number}&name={quote(path.relative_to(jobs.root / job.output).as_posix())}"


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ClscoError(f"{what}: must be a number; got {text!r}") from None


def _whole(text: str, what: str, least: int = 1) -> int:
    value = _number(text, what)
    if value < least or value != value // 1 or value > 1e15:
        raise ClscoError(f"{what}: must be an integer from {least} on; got {text[:40]!r}")
    return int(value)
