"""Distributions that are a function in Python: it draws the scene of each sample."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.distribution import Sample, sample_numbers
from clsco.data.splits import Splits, SplitsLike, of_samples, splits_of
from clsco.errors import ClscoError, SceneError
from clsco.scene.changes import dump, table_at
from clsco.scene.faults import at_most
from clsco.scene.file import SceneLike, absolute, scene_of
from clsco.scene.model import Scene

DrawScene = Callable[[np.random.Generator, int], SceneLike]
"""Takes a generator and the number of the sample, and gives its scene."""


@dataclass(frozen=True)
class ScriptedDistribution:
    """All samples that a function draws, as a function of seed and number. It is pickled by the function's name.

    Attributes
    ----------
    function : callable
        `draw(rng, sample)`, defined in a module or a script, which other processes import.
    where : str
        Name of the function, for messages.
    folder : Path
        Start of the paths of textures.
    source : str
        Text of the module, from which the digest is made.
    splits : tuple of (str, float)
    """

    function: DrawScene
    where: str
    folder: Path
    source: str
    splits: Splits

    @property
    def digest(self) -> str:
        """SHA-256 of what is known to decide samples: source, splits, and NumPy, whose generators may change."""
        content = [self.function.__qualname__, self.source, np.__version__, self.splits]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    @property
    def about(self) -> dict[str, Any]:
        """Entries of the card of a set: the source, and the name of the function in it."""
        return {"recipe": self.source, "function": self.function.__qualname__}

    def draw(self, seed: int, number: int) -> Sample:
        """Draw a sample; arguments and errors as of `Distribution.draw`.

        Notes
        -----
        The generator is NumPy's Philox with the key (seed, number): its bits depend on nothing else.
        """
        numbers = sample_numbers(seed, number)
        position = int(of_samples(self.splits, seed, numbers)[0])
        rng = np.random.Generator(np.random.Philox(key=[seed, number]))
        try:
            drawn = self.function(rng, number)
            scene = scene_of(drawn)
            table = self._table(scene)
        except ClscoError as error:
            messages = [f"{message} (sample {number}, seed {seed})" for message in str(error).splitlines()]
            raise SceneError(at_most(self.where, messages)) from error
        except Exception as error:
            text = f"{self.where}: must give a scene; got {error!r} (sample {number}, seed {seed})"
            raise SceneError(text) from error
        split = self.splits[position][0] if self.splits else ""
        return Sample(number, split, 1, {}, table, ("",), (absolute(scene, self.folder),))

    def _table(self, scene: Scene) -> dict[str, Any]:
        """Content of a scene file in the folder; a description stands in place of an array."""
        table = dump(scene)
        for place, item in scene.inputs:
            arrays = {key: {"array": str(array)} for key, array in item.arrays().items()}
            files = {key: self._inside(path) for key, path in item.files().items()}
            table_at(table, place).update(arrays | files)
        return table

    def _inside(self, path: str) -> str:
        """A path as it is written in the folder. Raises SceneError where it leaves it."""
        found = Path(os.path.normpath(self.folder / path))
        if not found.is_relative_to(self.folder):
            raise SceneError(f"texture: files must lie in {self.folder}; got {path}")
        return found.relative_to(self.folder).as_posix()


def scripted(function: DrawScene, splits: SplitsLike = None, folder: Path | None = None) -> ScriptedDistribution:
    """The distribution of a function.

    Parameters
    ----------
    function : callable
        `draw(rng, sample)`: takes a `numpy.random.Generator` and the number of the sample, and gives a scene, as
        `clsco.render` takes it. It should take random numbers from `rng` alone.
    splits : str, mapping, sequence of (str, float) or None
        Shares of the splits, such as "train=0.9,val=0.05,test=0.05".
    folder : Path, optional
        Start of the paths of textures; by default the current folder.

    Raises
    ------
    SceneError
        Other processes cannot import the function, or its source is not known.
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
    return ScriptedDistribution(function, name, (folder or Path()).resolve(), source, splits_of(splits))
