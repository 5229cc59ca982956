"""Jobs of Generate and its kin: scenes are stored beside their frames, with the command lines that make them."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from clsco.data.containers import CONTAINERS, DEFAULT
from clsco.errors import ClscoError, SceneError
from clsco.files.atomic import atomic_write_bytes, make_writable_folder
from clsco.files.png import png_parts
from clsco.files.transfer import encode
from clsco.files.video import PRESETS
from clsco.frame.files import TRUTH_FORMATS
from clsco.plan.prepare import prepare_sweep
from clsco.resources import folder, read_regular
from clsco.scene.file import absolute, swept_keys
from clsco.scene.model import Scene
from clsco.scene.sweep import parse_sweep
from clsco.scene.text import key_name
from clsco.scene.toml import toml_text
from clsco.studio.folder import listed
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.pictures import SMALL
from clsco.studio.session import Document
from clsco.studio.store import moved
from clsco.studio.tables import Table, sparse, with_value

SCENE_FILE = "scene.toml"
MOST_LOOKED_AT = 64  # frames of a stack
LARGEST_SHARD = 256  # samples, as of `clsco dataset make`
STEPS = 16  # at which the progress of a data set is seen, at least


@dataclass(frozen=True)
class Wanted:
    """Outputs besides the frames.

    formats: of ground truth, as for `clsco render --format`; preset: of a clip beside the frames, "" for none.
    """

    formats: str = ""
    subframes: bool = False
    preset: str = ""
    device: str = ""

    def options(self) -> list[str]:
        """Options of `clsco render` for these outputs."""
        found = ["--format", self.formats] if self.formats else []
        found += ["--subframes"] if self.subframes else []
        found += ["--video", self.preset] if self.preset else []
        return found + (["--device", self.device] if self.device else [])


def free_folder(session: Document, kind: str = "frames") -> str:
    """A name for an output folder, of the scene's file or title, that nothing has below the root."""
    stem = session.path.stem if session.path is not None else str(session.table.get("title", ""))
    stem = re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_")[:40] or "scene"
    names = (f"{kind}/{stem}" if k == 1 else f"{kind}/{stem}_{k}" for k in range(1, 10**6))
    return next(name for name in names if not (session.root / name).exists())


def generate(session: Document, jobs: Jobs, folder: str, wanted: Wanted = Wanted()) -> CommandJob:
    """Write all frames of the scene as `clsco render` does.

    Parameters
    ----------
    session : Document
    jobs : Jobs
    folder : str
        For the frames, and the scene file that they are made of; below the root.
    wanted : Wanted

    Raises
    ------
    ClscoError
        As `Jobs.add`; values that are not valid wait in their boxes.
    """
    return _render(session, jobs, folder, session.table, "Frames", wanted)


def focal_stack(
    session: Document, jobs: Jobs, folder: str, nearest: float, farthest: float, steps: int, wanted: Wanted = Wanted()
) -> CommandJob:  # fmt: skip
    """Write frames at focus distances at equal steps from `nearest` to `farthest`, mm. As `generate`."""
    table = _stack_table(session, nearest, farthest, steps)
    return _render(session, jobs, folder, table, f"Focal stack of {steps}", wanted)


def stack_scenes(session: Document, nearest: float, farthest: float, steps: int) -> tuple[Scene, ...]:
    """The scenes of a focal stack that is looked at, as `focal_stack` writes it.

    Raises SceneError: the distances cannot be, there are more than MOST_LOOKED_AT, or the scene has several values of
    another key.
    """
    if not 2 <= steps <= MOST_LOOKED_AT:
        raise SceneError(f"focal stack: must have 2 to {MOST_LOOKED_AT} steps to be looked at; got {steps}")
    table = _stack_table(session, nearest, farthest, steps)
    others = [key_name(place) for place, _ in swept_keys(table) if place != ("camera", "focus_distance")]
    if others:
        raise SceneError(f"focal stack: {others[0]} must have one value; got several")
    scenes = parse_sweep(table, "focal stack").scenes
    return tuple(absolute(scene, session.folder) for scene in scenes)


def _stack_table(session: Document, nearest: float, farthest: float, steps: int) -> Table:
    focus = {"from": nearest, "to": farthest, "steps": steps}
    return with_value(session.table, ["camera", "focus_distance"], focus)


def clip(session: Document, jobs: Jobs, frames: str, file: str, view: str = "color", preset: str = "") -> CommandJob:
    """Make a clip of frames that are there, by `clsco video`. Raises ClscoError as `Jobs.add`."""
    source, target = _name(session, frames), Path(_name(session, file))
    arguments = ["video", source, "-o", str(target), "--view", view] + (["--preset", preset] if preset else [])
    return jobs.add(f"Clip {target.name}", arguments, str(target.parent), target.name, 1)


def data_set(
    session: Document, jobs: Jobs, distribution: str, folder: str, count: int, seed: int = 0, form: str = DEFAULT,
    device: str = "",
) -> CommandJob:  # fmt: skip
    """Make a data set from a distribution file, by `clsco dataset make`.

    Parameters
    ----------
    session : Document
    jobs : Jobs
    distribution : str
        Its name below the root; one of `offers.shipped_distributions` is copied there first.
    folder : str
        For the set.
    count, seed : int
    form : str
        As for `clsco dataset make --format`.
    device : str

    Raises
    ------
    ClscoError
        As `Jobs.add`.
    """
    source, name = _name(session, distribution), _name(session, folder)
    jobs.require_free(name)
    shipped = shipped_distributions().get(source)
    if shipped is not None and not (session.root / source).exists():
        atomic_write_bytes(make_writable_folder((session.root / source).parent) / shipped.name, shipped.read_bytes())
    if not (session.root / source).is_file():
        raise ClscoError(f"distribution: must be an existing file; got {distribution!r}")
    shard = min(LARGEST_SHARD, -(-count // STEPS))
    arguments = [
        "dataset",
        "make",
        source,
        "-o",
        name,
        "--count",
        str(count),
        "--seed",
        str(seed),
        "--shard-size",
        str(shard),
    ]
    arguments += ["--format", form]
    arguments += ["--device", device] if device else []
    return jobs.add(f"Data set of {count}", [*arguments, "--resume", "--quiet"], name, "", count)


def _render(session: Document, jobs: Jobs, folder: str, table: Table, what: str, wanted: Wanted) -> CommandJob:
    """Write a scene into a folder, and begin to render it."""
    if session.refused:
        raise ClscoError(f"{next(iter(session.faults))}: must be valid before frames are generated")
    name = _name(session, folder)
    target = session.root / name
    sweep = parse_sweep(table)
    scenes = tuple(absolute(scene, session.folder) for scene in sweep.scenes)  # the other folder may not be there yet
    jobs.require_free(name)
    prepare_sweep(replace(sweep, scenes=scenes))  # says what is beyond the limits, before anything is begun
    target.mkdir(parents=True, exist_ok=True)
    atomic_write_bytes(target / SCENE_FILE, toml_text(sparse(moved(table, session.folder, target))).encode())
    title = str(table.get("title", "")) or "scene"
    arguments = ["render", f"{name}/{SCENE_FILE}", "-o", name, *wanted.options()]
    pattern = "frame_[0-9]*.json" if len(scenes) == 1 else "*/frame_[0-9]*.json"
    count = sum(scene.sequence.frames for scene in scenes)
    return jobs.add(f"{what}: {title}", arguments, name, pattern, count)


def _name(session: Document, path: str) -> str:
    """A path below the root, relative to it, that is no option of a command. Raises SceneError."""
    name = session.inside(Path(path)).relative_to(session.root).as_posix()
    return f"./{name}" if name.startswith("-") else name


_LARGEST = 2**20  # bytes of a file that may be a distribution
_VIDEO = ("av", "video")
_SETS = "sets"  # folder of the distributions that are shipped, and of their copies


def truth_formats() -> dict[str, str]:
    """Formats of `clsco render --format`, each with the extra that it lacks; "" for none."""
    return {name: _missing(form.needs) for name, form in TRUTH_FORMATS.items()}


def clip_presets() -> dict[str, str]:
    """Presets of `clsco video`, likewise."""
    return dict.fromkeys(PRESETS, _missing(_VIDEO))


def clip_name(preset: str) -> str:
    """Name of a clip that is made by a preset."""
    return f"clip{PRESETS[preset].suffix}"


def set_formats() -> dict[str, str]:
    """Formats of `clsco dataset make --format`, likewise."""
    return {name: _missing(container.needs) for name, container in CONTAINERS.items()}


def first_format() -> str:
    """The format that a form shows at first: the default, or where its extra is not installed the first that is."""
    forms = set_formats()
    return next(name for name in (DEFAULT, *forms) if not forms[name])


def distributions(root: Path) -> list[str]:
    """Distribution files below a folder, and those that are shipped, by the names that their copies would have."""
    found = [name for name in listed(root, (".toml",)) if _is_distribution(root / name)]
    return found + [name for name in shipped_distributions() if name not in found]


def shipped_distributions() -> dict[str, Path]:
    """Distribution files of the package, by the names of their copies in a studio's folder."""
    paths = Path(str(folder("examples"))) / _SETS
    return {f"{_SETS}/{path.name}": path for path in sorted(paths.glob("*.toml"))}


def _is_distribution(path: Path) -> bool:
    try:
        content = tomllib.loads(read_regular(path, _LARGEST, follow=True).decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return bool({"vary", "derive", "accept"} & content.keys())


def _missing(needs: tuple[str, str] | None) -> str:
    if needs is None or find_spec(needs[0]) is not None:
        return ""
    return f"needs {needs[0]}: pip install 'clsco[{needs[1]}]'"


def sample_picture(folder: Path, part: int, parts: int) -> bytes:
    """A small PNG of the color of a sample.

    Parameters
    ----------
    folder : Path
    part, parts : int
        The first sample of the part-th of equal parts of the set.

    Raises
    ------
    ClscoError, OSError, IndexError
        There is no such sample.
    """
    from clsco.data import dataset

    opened = dataset.open(folder)
    try:
        record = opened[part * len(opened) // parts]
        name = next(name for name in record.arrays if name.rpartition(".")[2] == "color")  # of the first frame and view
        radiance = record.radiance(name)
    finally:
        opened.close()
    step = max(1, -(-max(radiance.shape[:2]) // SMALL))
    codes = encode(np.ascontiguousarray(radiance[::step, ::step]), 8, "srgb").astype(np.uint8)
    return b"".join(png_parts(codes))
