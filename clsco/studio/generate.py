"""Rendering and data sets from the studio: recipes, output folders with their scenes, and the commands of `clsco`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from clsco.data.containers import CONTAINERS, DEFAULT
from clsco.errors import ClscoError, SceneError
from clsco.files.atomic import atomic_write_bytes, make_writable_folder
from clsco.files.video import PRESETS
from clsco.frame.files import TRUTH_FORMATS, needed_truth
from clsco.frame.outputs import OUTPUTS
from clsco.frame.truth_files import TruthFile
from clsco.plan.decisions import POSSIBLE
from clsco.plan.prepare import prepare_sweep
from clsco.resources import folder, read_regular
from clsco.scene.file import absolute, swept_keys
from clsco.scene.model import Scene
from clsco.scene.sweep import parse_sweep
from clsco.scene.text import key_name
from clsco.scene.toml import toml_text
from clsco.studio.folder import listed
from clsco.studio.jobs import CommandJob, Jobs
from clsco.studio.pictures import small_png
from clsco.studio.session import Document
from clsco.studio.store import moved
from clsco.studio.tables import Table, sparse, with_value

MOST_LOOKED_AT = 64  # frames of a focal stack for viewing
LARGEST_SHARD = 256  # samples, the default of `clsco dataset make`
STEPS = 16  # least number of steps in which the progress of a data set is shown
_LARGEST = 2**20  # bytes of a file that may be a distribution
_SETS = "sets"  # folder of shipped distributions, and of their copies


@dataclass(frozen=True)
class Recipe:
    """Files for a purpose: formats of `clsco render --format`; () for the image."""

    title: str
    about: str
    formats: tuple[str, ...] = ()


PICTURE = Recipe("Picture", "PNG: to look at")
RECIPES = (
    PICTURE,
    Recipe("All truth", "NPZ: depth, R, flow, for training", ("npz",)),
    Recipe("For compositing", "EXR: Blender, Nuke", ("exr",)),
    Recipe("As KITTI", "PNG codes: depth, flow", ("kitti_depth", "kitti_flow")),
    Recipe("As Sintel", "FLO: flow; PFM: depth and more", ("flo", "pfm")),
    Recipe("As COLMAP", "cameras, for 3-D splats", ("colmap",)),
)
FORMATS = tuple(Recipe(name, "", (name,)) for name in TRUTH_FORMATS)


def recipe_options(recipes: Collection[Recipe]) -> list[str]:
    """Options of `clsco render` for recipes. Raises ClscoError if there are none."""
    if not recipes:
        raise ClscoError("recipes: must be at least one; got none")
    names = ",".join(_formats(recipes))
    return (["--format", names] if names else []) + ([] if PICTURE in recipes else ["--no-color"])


def frame_bytes(scene: Scene, recipes: Collection[Recipe]) -> int:
    """Bytes of the arrays of a frame in color, before compression; scene: one with a resolution."""
    (columns, rows), size = scene.camera.frame_size, 3 if PICTURE in recipes else 0
    impossible = {group for group, can, _ in POSSIBLE if not can(scene)}
    for name in _formats(recipes):
        rows_of = [OUTPUTS[each] for each in needed_truth([TruthFile(name)]) if TRUTH_FORMATS[name].arrays]
        size += sum((row.components or 3) * row.dtype(0).itemsize for row in rows_of if row.group not in impossible)
    return size * columns * rows * (1 if scene.stereo is None else 2)


def _formats(recipes: Collection[Recipe]) -> list[str]:
    return [name for name in TRUTH_FORMATS if any(name in recipe.formats for recipe in recipes)]


def free_folder(session: Document, kind: str = "frames") -> str:
    """An unused name for an output folder, relative to the root: `kind`/NAME, where NAME is from the file or title."""
    stem = session.path.stem if session.path is not None else str(session.table.get("title", ""))
    stem = re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_")[:40] or "scene"
    names = (f"{kind}/{stem}" if k == 1 else f"{kind}/{stem}_{k}" for k in range(1, 10**6))
    return next(name for name in names if not (session.root / name).exists())


def render_frames(
    session: Document, jobs: Jobs, folder: str, options: Sequence[str] = (), table: Table | None = None
) -> CommandJob:
    """Write a scene into a folder below the root, and render it by `clsco render`.

    table: scene to render, None for the session's. Raises ClscoError as `Jobs.add` and `clsco.render`, and if a box has
    an invalid value.
    """
    if session.refused:
        raise ClscoError(f"{next(iter(session.faults))}: must be valid before frames are generated")
    table = session.table if table is None else table
    name = _name(session, folder)
    target = session.root / name
    sweep = parse_sweep(table)
    scenes = tuple(absolute(scene, session.folder) for scene in sweep.scenes)  # the output folder may not exist yet
    jobs.require_free(name)
    prepare_sweep(replace(sweep, scenes=scenes))  # raises for too large scenes before anything is written
    path = make_writable_folder(target) / "scene.toml"
    atomic_write_bytes(path, toml_text(sparse(moved(table, session.folder, target))).encode())
    return jobs.add(str(table.get("title") or "Scene"), render_command(session, name, options), name)


def render_command(session: Document, folder: str, options: Sequence[str] = ()) -> list[str]:
    """Arguments of `clsco` that render the scene in a folder below the root into this folder. Raises SceneError."""
    name = _name(session, folder)
    return ["render", f"{name}/scene.toml", "-o", name, *options]


def stack_table(session: Document, nearest: float, farthest: float, steps: int) -> Table:
    """Table of a scene file for a focal stack: focus distances in equal steps from `nearest` to `farthest`, mm."""
    focus = {"from": nearest, "to": farthest, "steps": steps}
    return with_value(session.table, ["camera", "focus_distance"], focus)


def stack_scenes(session: Document, nearest: float, farthest: float, steps: int) -> tuple[Scene, ...]:
    """The scenes of a focal stack for viewing.

    Raises SceneError for invalid distances, steps outside 2 to MOST_LOOKED_AT, or another key with several values.
    """
    if not 2 <= steps <= MOST_LOOKED_AT:
        raise SceneError(f"focal stack: must have 2 to {MOST_LOOKED_AT} steps to be looked at; got {steps}")
    table = stack_table(session, nearest, farthest, steps)
    others = [key_name(place) for place, _ in swept_keys(table) if place != ("camera", "focus_distance")]
    if others:
        raise SceneError(f"focal stack: {others[0]} must have one value; got several")
    scenes = parse_sweep(table, "focal stack").scenes
    return tuple(absolute(scene, session.folder) for scene in scenes)


def make_data_set(
    session: Document, jobs: Jobs, distribution: str, folder: str, count: int, options: Sequence[str] = ()
) -> CommandJob:
    """Make a data set of `count` samples by `clsco dataset make`.

    distribution: name of a file below the root, to which one of `shipped_distributions` is copied first. Raises
    ClscoError as `Jobs.add`, or if the file does not exist.
    """
    source, name = _name(session, distribution), _name(session, folder)
    jobs.require_free(name)
    shipped = shipped_distributions().get(source)
    if shipped is not None and not (session.root / source).exists():
        atomic_write_bytes(make_writable_folder((session.root / source).parent) / shipped.name, shipped.read_bytes())
    if not (session.root / source).is_file():
        raise ClscoError(f"distribution: must be an existing file; got {distribution!r}")
    return jobs.add(f"Data set of {count}", set_command(session, source, name, count, options), name)


def set_command(session: Document, source: str, folder: str, count: int, options: Sequence[str] = ()) -> list[str]:
    """Arguments of `clsco` for `make_data_set`. Raises SceneError."""
    shard = min(LARGEST_SHARD, -(-count // STEPS))
    size = ["--count", str(count), "--shard-size", str(shard)]
    names = [_name(session, source), "-o", _name(session, folder)]
    return ["dataset", "make", *names, *size, *options, "--resume", "--quiet"]


def _name(session: Document, path: str) -> str:
    """The path relative to the root, in a form that a command cannot mistake for an option. Raises SceneError."""
    name = session.inside(Path(path)).relative_to(session.root).as_posix()
    return f"./{name}" if name.startswith("-") else name


def truth_formats() -> dict[str, str]:
    """Formats of `clsco render --format`, each with a message if a package is missing, else ""."""
    return {name: _missing(form.needs) for name, form in TRUTH_FORMATS.items()}


def clip_presets() -> dict[str, str]:
    """Presets of `clsco render --video`, each with a message if a package is missing, else ""."""
    return dict.fromkeys(PRESETS, _missing(("av", "video")))


def set_formats() -> dict[str, str]:
    """Formats of `clsco dataset make --format`, each with a message if a package is missing, else ""."""
    return {name: _missing(container.needs) for name, container in CONTAINERS.items()}


def first_format() -> str:
    """Format that a form selects at first: the default, or the first usable one if the default's extra is missing."""
    forms = set_formats()
    return next(name for name in (DEFAULT, *forms) if not forms[name])


def _missing(needs: tuple[str, str] | None) -> str:
    if needs is None or find_spec(needs[0]) is not None:
        return ""
    return f"needs {needs[0]}: pip install 'clsco[{needs[1]}]'"


def distributions(root: Path) -> list[str]:
    """Names of distribution files below a folder, and of shipped ones as if they were copied there."""
    own = [name for name in listed(root, (".toml",)) if _is_distribution(root / name)]
    return own + [name for name in shipped_distributions() if name not in own]


def shipped_distributions() -> dict[str, Path]:
    """Distribution files of the package, by the name of their copy in a studio's folder."""
    paths = Path(str(folder("examples"))) / _SETS
    return {f"{_SETS}/{path.name}": path for path in sorted(paths.glob("*.toml"))}


def _is_distribution(path: Path) -> bool:
    try:
        content = tomllib.loads(read_regular(path, _LARGEST, follow=True).decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return bool({"vary", "derive", "accept"} & content.keys())


def sample_picture(folder: Path) -> bytes:
    """A small PNG with the color of the first sample of a set."""
    from clsco.data import dataset

    opened = dataset.open(folder)
    try:
        record = opened[0]
        name = next(name for name in record.arrays if name.rpartition(".")[2] == "color")  # of the first frame and view
        return small_png(record.radiance(name))
    finally:
        opened.close()
