"""Writer of scene files and of the arrays that a scene has in memory."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from clsco.errors import SceneError
from clsco.files.atomic import atomic_folder, atomic_write
from clsco.scene.changes import given_keys, table_at
from clsco.scene.file import absolute
from clsco.scene.model import Scene
from clsco.scene.text import key_name
from clsco.scene.toml import toml_text


def dump_scene(scene: Scene, path: str | os.PathLike[str] | None = None) -> str:
    """Write a scene as the text of a scene file, from which an equal scene can be read.

    Parameters
    ----------
    scene : Scene
    path : str or os.PathLike, optional
        A .toml file to write. Arrays are written beside it, as ball_object_0_texture.npy for ball.toml, and relative
        paths of other files become absolute.

    Returns
    -------
    str
        TOML with the keys that were set explicitly. `clsco.parse_scene` makes an equal scene of it. With `path`, the
        content of the file.

    Raises
    ------
    SceneError
        The scene has arrays in memory, and `path` is missing or does not end in .toml.
    FileError
        A file cannot be written; in this case none is written.

    Notes
    -----
    `clsco.load_scene` returns a scene with file names in place of arrays; its frames are bit-identical.

    Examples
    --------
    >>> import clsco
    >>> scene = clsco.Scene(camera=clsco.Camera(f_number=4), objects=(clsco.Plane(),))
    >>> print(clsco.dump_scene(scene), end="")
    [camera]
    f_number = 4.0
    <BLANKLINE>
    [[object]]
    shape = "plane"
    >>> clsco.parse_scene(clsco.dump_scene(scene)) == scene
    True
    """
    if path is None:
        arrays = [(place, *each) for place, item in scene.inputs for each in item.arrays().items()]
        rule = "must be a name or a path to be written as text; give dump_scene a path for arrays"
        if arrays:
            raise SceneError([f"scene: {key_name((*place, key))}: {rule}; got {array}" for place, key, array in arrays])
        return toml_text(given_keys(scene))
    target = Path(path)
    if target.suffix.lower() != ".toml":
        raise SceneError(f"{target}: a scene is written to a file that ends in .toml; got {target.suffix!r}")
    data: dict[str, Any] = given_keys(absolute(scene, Path.cwd()))
    with atomic_folder(target.parent, target.name) as temporary:
        for place, item in scene.inputs:
            for key, array in item.arrays().items():
                name = "_".join(map(str, (target.stem, *place, key))) + ".npy"
                with atomic_write(temporary / name) as file:
                    np.lib.format.write_array(file, array.array, allow_pickle=False)
                table_at(data, place)[key] = name
        text = toml_text(data)
        with atomic_write(temporary / target.name) as file:
            file.write(text.encode())
    return text
