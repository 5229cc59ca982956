"""Example scenes shipped with the package."""

from __future__ import annotations

from importlib.resources import as_file

from clsco.resources import folder
from clsco.scene.file import load_scene
from clsco.scene.model import Scene

# Name of the example -> what its image shows. The first lines of each file give the same in numbers.
EXAMPLES = {
    "plane_tilted_both": "tilted plane, in focus along its diagonal",
    "sphere": "sphere, in focus at its nearest point",
    "saddle": "saddle, in focus along a hyperbola",
    "tube": "inside of a tube",
    "sphere_moving": "sphere moving to the right",
    "cylinder_turning": "cylinder coming nearer, turning",
    "card": "card with edges, turning",
    "road": "road from a moving car",
    "rolling_fan": "fan under a rolling shutter",
    "night": "ball at night, by a sensor",
    "occlusion_near_sphere": "near sphere before a far plane",
    "occlusion_three": "three objects, the column in focus",
    "depth_map": "image with a depth map",
    "stereo": "stereo pair, left view",
}


def example(name: str) -> Scene:
    """Load an example scene, a key of `EXAMPLES`. Raises SceneError for another name."""
    with as_file(folder("examples") / f"{name}.toml") as path:
        return load_scene(path)
