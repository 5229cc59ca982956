"""Distribution files: scene files in which values vary, and the samples that are drawn from them."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.acceptance import Bounds, UnfitError, bounds_of, refusal
from clsco.data.build import Builder, corner_faults
from clsco.data.compile import Parameter, Reader, VariedKeys
from clsco.data.draws import MAX_SEED, Splits, SplitsLike, split_of, split_of_value, splits_of, stream_words
from clsco.data.folder import Folder
from clsco.data.tables import DistributionTables, as_json, read_tables
from clsco.errors import ClscoError, SceneError
from clsco.resources import read_regular
from clsco.scene.changes import MAX_VARIANTS, VARIANT, dump, table_at
from clsco.scene.faults import at_most
from clsco.scene.file import MAX_FILE_BYTES, absolute, scene_of
from clsco.scene.model import Scene
from clsco.scene.quantities import as_python
from clsco.scene.sensor import NOISE_SEEDS
from clsco.scene.sweep import Sweep, exposed_again, load_sweep, parse_sweep
from clsco.scene.text import shown
from clsco.scene.toml import toml_text

VERSION = 3  # changed whenever the same file gives other samples
MAX_ATTEMPTS = 100
MAX_NUMBER = 2**63 - 1


@dataclass(frozen=True)
class Sample:
    """One sample: its drawn values and its scenes."""

    number: int
    split: str  # "" without splits
    attempts: int  # number of draws until the sample was accepted, at least 1
    parameters: dict[str, Any]  # drawn values, of JSON types, by name, such as "camera.focus_distance"
    table: dict[str, Any]  # content of a scene file, with paths relative to the folder of the distribution file
    labels: tuple[str, ...]  # one for each variant, as in a sweep; ("",) for a single scene
    scenes: tuple[Scene, ...]  # one for each label


Drawn = tuple[int, dict[str, Any], dict[str, Any], tuple[str, ...], tuple[Scene, ...]]
"""Attempts, parameters, table, labels and scenes of a `Sample`."""


@dataclass(frozen=True, eq=False)
class _Distribution(ABC):
    """A distribution, whose samples are a function of seed and number. It can be pickled."""

    where: str  # name of the file or function
    folder: Path  # base folder of relative paths, links resolved
    splits: Splits
    split_by: str  # name of the parameter that decides the split of a sample; "" if its number does

    def draw(self, seed: int, number: int) -> Sample:
        """Draw a sample; seed: 0 to 2^64 - 1; number: 0 to 2^63 - 1.

        The sample depends only on seed, number, the distribution, the files that it names, and the version of this
        package. Raises SceneError if the sample is no valid scene, or none of 100 attempts is accepted.
        """
        for name, value, most in (("seed", seed, MAX_SEED), ("number", number, MAX_NUMBER)):
            if type(value) is not int or not 0 <= value <= most:
                raise SceneError(f"{name}: must be an integer between 0 and {most}; got {shown(value)}")
        position = 0 if self.split_by else split_of(self.splits, seed, number)
        noise_seed = int(stream_words(seed, number, "sensor.noise_seed", 1)[0]) % NOISE_SEEDS
        try:
            drawn = self._draw(seed, number, position, noise_seed)
            if self.split_by:
                if not self.splits or self.split_by not in drawn[1]:
                    raise SceneError(f"split_by: must be a parameter of samples in splits; got {shown(self.split_by)}")
                position = split_of_value(self.splits, seed, drawn[1][self.split_by])
        except ClscoError as error:
            messages = [f"{message} (sample {number}, seed {seed})" for message in str(error).splitlines()]
            raise SceneError(at_most(self.where, messages)) from error
        return Sample(number, self.splits[position][0] if self.splits else "", *drawn)

    @abstractmethod
    def _draw(self, seed: int, number: int, split: int, noise_seed: int) -> Drawn:
        """Draw a sample; split: position of its split in `splits`; noise_seed: seed for a sensor that has none."""


@dataclass(frozen=True, eq=False)
class Distribution(_Distribution):
    """The distribution in a file.

    digest: SHA-256 of everything that samples depend on: the joined tables, the splits, and names and contents of the
    files that samples may use.
    """

    digest: str
    parts: VariedKeys
    accept: Bounds
    tables: DistributionTables  # joined with the base and overrides
    recipe: str  # text of the file; if it has a base or overrides, text of the joined tables

    @property
    def about(self) -> dict[str, Any]:
        """Entries of the data card: `recipe` for readers, and `distribution`, from which the set can be made again."""
        return {"recipe": self.recipe, "distribution": self.tables.content()}

    def _draw(self, seed: int, number: int, split: int, noise_seed: int) -> Drawn:
        reason: str | None = None
        for attempt in range(1, MAX_ATTEMPTS + 1):
            try:
                value_of = partial(draw_value, seed, number, split, attempt)
                table, parameters, sweep = Builder(self.parts, self.folder).build(value_of, noise_seed=noise_seed)
                reason = refusal(self.accept, sweep.scenes)
            except UnfitError as error:
                reason = str(error)
            if reason is None:
                return attempt, parameters, table, sweep.labels, sweep.scenes
        raise SceneError(f"accept: must hold for one of {MAX_ATTEMPTS} attempts; got of the last one: {reason}")


def draw_value(seed: int, number: int, split: int, attempt: int, parameter: Parameter, element: int) -> Any:
    """Draw the value of a parameter.

    split: position of the sample's split; attempt: number of the draw of the sample; element: number of the object in
    its population, 0 for other parameters.
    """
    words = stream_words(seed, number, parameter.name, parameter.form.words, attempt, element)
    return parameter.form.value(words, split)


def load_distribution(
    distribution: str | os.PathLike[str] | Mapping[str, Any], overrides: Sequence[str] = (),
    splits: SplitsLike = None, folder: Path | None = None, split_by: str = "",
) -> Distribution:  # fmt: skip
    """Read a distribution: a .toml or .json file of at most 1 MiB, see docs/distributions.md, or its content.

    overrides: as for `clsco.load_scene`; an overridden key no longer varies. folder: base folder of relative paths, if
    the content is given. Scenes with extreme values are validated, too. Raises SceneError with one message per fault.
    """
    if isinstance(distribution, Mapping):
        content, where, inside = distribution, "distribution", Folder((folder or Path()).absolute())
    else:
        content, where = None, os.fspath(distribution)
        inside = Folder(Path(where).absolute().parent)
    shares = splits_of(splits)
    tables = read_tables(where, overrides, inside, content)
    reader = Reader(tables, inside, None if split_by else shares)
    parts = reader.parts()
    accept, faults = bounds_of(tables.accept)
    faults = [*reader.faults, *faults]
    if not faults:
        faults = corner_faults(parts, inside.path)
    if not faults and (accept or parts.derived):
        faults = _not_analytic(parts)
    if faults:
        raise SceneError(at_most(where, dict.fromkeys(faults)))
    digest, recipe = _digest(tables, shares, inside, split_by), toml_text(tables.content())
    if content is None and not overrides and not tables.is_joined:
        recipe = read_regular(where, MAX_FILE_BYTES, follow=True).decode("utf-8-sig")
    return Distribution(where, inside.path, shares, split_by, digest, parts, accept, tables, recipe)


def _not_analytic(parts: VariedKeys) -> list[str]:
    """Messages on depth maps, at which rays cannot be cast because they have no formula."""
    shapes = [(f"object[{k}]", item.get("shape")) for k, item in enumerate(parts.scene.get("object", ()))]
    shapes += [(f"vary.object[{p.entry}]", shape) for p in parts.populations for shape in p.shapes]
    rule = "accept and derive need analytic objects, which rays can be cast at"
    return [f'{key}.shape: {rule}; got "depth_map"' for key, shape in shapes if shape == "depth_map"]


def _digest(tables: DistributionTables, splits: Splits, folder: Folder, split_by: str) -> str:
    content = [VERSION, tables.scene, tables.vary, tables.accept, tables.derive, splits, sorted(folder.digests.items())]
    content += [each for each in (tables.check, split_by) if each]
    return hashlib.sha256(json.dumps(content, default=str).encode()).hexdigest()


DrawScene = Callable[[np.random.Generator, int], Any]
"""Takes a random generator and the number of a sample; returns the sample's scene or a list of scenes, its variants, or
a tuple of either and a mapping of parameters."""


@dataclass(frozen=True, eq=False)
class ScriptedDistribution(_Distribution):
    """A distribution whose samples a function draws; source: text of its module. Only its name is pickled."""

    function: DrawScene
    source: str

    @property
    def digest(self) -> str:
        """SHA-256 of the known inputs of samples. The version of NumPy is one, because its generators may change."""
        content = [VERSION, self.function.__qualname__, self.source, np.__version__, self.splits]
        content += [self.split_by] if self.split_by else []
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    @property
    def about(self) -> dict[str, Any]:
        """Entries of the data card: `recipe`, the source text, and `function`, the name of the function in it."""
        return {"recipe": self.source, "function": self.function.__qualname__}

    def _draw(self, seed: int, number: int, split: int, noise_seed: int) -> Drawn:  # noqa: ARG002
        rng = np.random.Generator(np.random.Philox(key=[seed, number]))  # its bits depend on the key alone
        try:
            drawn = self.function(rng, number)
            content, parameters = drawn if isinstance(drawn, tuple) and len(drawn) == 2 else (drawn, {})
            sweep = _sweep_of(content, noise_seed)
            tables = [self._table(scene) for scene in sweep.scenes]
            rule = "parameters: must be a mapping of numbers, texts, lists and mappings"
            parameters = as_json(parameters, rule, _of_numpy, allow_nan=False)
        except ClscoError:
            raise
        except Exception as error:
            raise SceneError(f"must give a scene; got {error!r}") from error
        scenes = tuple(absolute(scene, self.folder) for scene in sweep.scenes)
        return 1, parameters, _joined_table(tables), sweep.labels, scenes

    def _table(self, scene: Scene) -> dict[str, Any]:
        """Content of a scene file, with paths relative to `folder`; a description replaces each array."""
        table = dump(scene)
        for place, item in scene.inputs:
            arrays = {key: {"array": str(array)} for key, array in item.arrays().items()}
            files = {key: self._inside(path) for key, path in item.files().items()}
            table_at(table, place).update(arrays | files)
        return table

    def _inside(self, path: str) -> str:
        """The path relative to `folder`. Raises SceneError for a path outside of this folder."""
        whole = Path(os.path.normpath(self.folder / path))
        if not whole.is_relative_to(self.folder):
            raise SceneError(f"texture: files must lie in {self.folder}; got {path}")
        return whole.relative_to(self.folder).as_posix()


def _of_numpy(value: Any) -> Any:
    if (converted := as_python(value)) is value:
        raise TypeError(f"a value of type {type(value).__name__}")
    return converted


def _sweep_of(content: Any, noise_seed: int) -> Sweep:
    """The scenes that a function returned: as a scene, a list of scenes, or a scene file or its content.

    noise_seed: seed of the first scene if its sensor has none. If several variants have one seed, each further variant
    is another exposure.
    """
    if isinstance(content, list):
        sweep = Sweep(tuple(f"v{k:02d}" for k in range(len(content))), tuple(map(scene_of, content)))
    elif isinstance(content, Sweep):
        sweep = content
    elif isinstance(content, str | os.PathLike):
        sweep = load_sweep(content)
    else:
        sweep = parse_sweep(content) if isinstance(content, Mapping) else Sweep(("",), (scene_of(content),))
    if not 1 <= len(sweep.scenes) <= MAX_VARIANTS:
        raise SceneError(f"scene: must be 1 to {MAX_VARIANTS} variants; got {len(sweep.scenes)}")
    seeds = [scene.sensor.noise_seed for scene in sweep.scenes if scene.sensor is not None]
    first = sweep.scenes[0].sensor
    added = noise_seed if first is not None and "noise_seed" not in first.model_fields_set else 0
    step = int(len(set(seeds)) < len(seeds))
    scenes = [exposed_again(scene, added + step * k) for k, scene in enumerate(sweep.scenes)]
    return replace(sweep, scenes=tuple(scenes))


def _joined_table(tables: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Join the scene files of variants: sections that are equal in all stay, [[variant]] tables have the others."""
    first, *others = tables
    if not others:
        return first
    shared = {name: value for name, value in first.items() if all(table.get(name) == value for table in others)}
    own = [{name: value for name, value in table.items() if name not in shared} for table in tables]
    return {**shared, VARIANT: own}


def scripted(
    function: DrawScene, splits: SplitsLike = None, folder: Path | None = None, split_by: str = ""
) -> ScriptedDistribution:
    """The distribution whose samples a function draws; arguments as for `clsco.data.make`.

    Raises SceneError if other processes cannot import the function, or its source text is unknown.
    """
    name = getattr(function, "__qualname__", repr(function))
    try:
        if pickle.loads(pickle.dumps(function)) is not function:
            raise TypeError("another object")
        module = inspect.getmodule(function)
        source = inspect.getsource(module if module is not None and hasattr(module, "__file__") else function)
    except (pickle.PicklingError, AttributeError, TypeError, OSError) as error:
        rule = "a function must stand at the top of a module or script, from which other processes import it"
        raise SceneError(f"distribution: {rule}; got {name}: {error}") from None
    return ScriptedDistribution(name, (folder or Path()).resolve(), splits_of(splits), split_by, function, source)
