"""Example scenes shipped with the package."""

from __future__ import annotations

from importlib.resources import as_file

from clsco.resources import folder
from clsco.scene.file import load_scene
from clsco.scene.model import Scene

# Name of the example -> what its image shows. The first lines of each file give the same in numbers.
EXAMPLES = {
    "evening": "balls before the lights of an evening",
    "portrait": "doll before strings of lights",
    "macro": "ladybird, close up",
    "street": "tram passing",
    "shutter": "propeller under a rolling shutter",
    "night": "house at night, by a sensor",
    "hearts": "lights through a heart",
    "swirl": "cat's eyes of an old lens",
    "coded": "lights through a coded aperture",
    "cylinder_turning": "cylinder coming nearer, turning",
    "card": "card with edges, turning",
    "road": "road from a moving car",
    "depth_map": "image with a depth map",
    "stereo": "stereo pair, left view",
}


def example(name: str) -> Scene:
    """Load an example scene, a key of `EXAMPLES`. Raises SceneError for another name."""
    with as_file(folder("examples") / f"{name}.toml") as path:
        return load_scene(path)
