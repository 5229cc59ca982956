"""SHA-256 of every array of every example scene, to compare two versions of clsco bit by bit on one machine.

Run it with the Python of each version, on the same scenes, then compare:
    OLD/.venv/bin/python benchmarks/same_bits.py --examples OLD/examples -o before.json
    .venv/bin/python benchmarks/same_bits.py --examples OLD/examples --against before.json
It uses public functions only, and those of their arguments that every version has.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import clsco

SAMPLES = "sequence.samples=5"  # where a scene does not say: the default has changed once
METHODS = ("auto", "gather", "scatter", "tiles")  # of the blur; "auto" is `convolve` or `gather` on a processor
STRIPS = "1MiB"  # less than any frame needs: the message says how much the smallest strips take


def main() -> None:
    """Hash all examples; exit status 1 where some differ from the file given by --against."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--examples", type=Path, required=True, help="folder of scene files, searched with its folders")
    parser.add_argument("--only", default="", help="part of the names of the scenes")
    parser.add_argument("--methods", default=",".join(METHODS), help="methods of the blur, separated by commas")
    parser.add_argument("--against", type=Path, help="JSON of another version")
    parser.add_argument("-o", dest="out", type=Path, help="JSON to write")
    chosen = parser.parse_args()
    before = {} if chosen.against is None else json.loads(chosen.against.read_text("utf-8"))
    found: dict[str, str] = {}
    differ: list[str] = []
    began = time.perf_counter()
    for name, digest in hashes(chosen.examples, chosen.only, chosen.methods.split(",")):
        found[name] = digest
        if chosen.against is not None and before.get(name, digest) != digest:
            differ.append(name)
            print(f"differs: {name}", flush=True)
    absent = sorted(found.keys() - before.keys()) if chosen.against is not None else []
    for name in absent:
        print(f"not in {chosen.against}: {name}")
    if chosen.out is not None:
        chosen.out.write_text(json.dumps(found, indent=0), "utf-8")
    print(f"{len(found)} arrays in {time.perf_counter() - began:.0f} s, {len(differ)} differ")
    sys.exit(bool(differ or absent))


def hashes(examples: Path, only: str, methods: list[str]) -> Iterator[tuple[str, str]]:
    """Name and digest of each array: of frames, then of the blur and the filling of images alone."""
    for path in sorted(path for path in examples.rglob("*.toml") if path.parent.name != "sets"):
        name = path.relative_to(examples).with_suffix("").as_posix()
        if only not in name:
            continue
        samples = tomllib.loads(path.read_text("utf-8")).get("sequence", {}).get("samples")
        for k, scene in enumerate(clsco.load_sweep(path, [] if samples else [SAMPLES]).scenes):
            for precision, method, memory in product(("double", "single"), methods, (None, STRIPS)):
                options = {"precision": precision, "method": method, "frames": [0]}
                try:
                    frames = rendered(scene, options, memory)
                except clsco_errors() as error:
                    yield f"{name} {k} {precision} {method} {memory or 'whole'}", f"refused: {type(error).__name__}"
                    continue
                for frame in frames:
                    for array, values in arrays(frame).items():
                        where = f"{name} {k} {precision} {method} {memory or 'whole'} {frame.eye} {array}"
                        yield where, digest(values)
            yield from of_coverage(name, k, scene)
    if not only:
        yield from of_images(examples)


def clsco_errors() -> tuple[type[Exception], ...]:
    """Errors of a version where a scene and a method, or an output, do not go together."""
    from clsco.errors import ClscoError

    return (ClscoError,)


def rendered(scene: Any, options: dict[str, Any], memory: str | None) -> list[Any]:
    """The first frame, in the smallest strips where memory is given."""
    try:
        return list(clsco.render(scene, **options, memory=memory))
    except clsco_errors() as error:
        least = re.search(r"must be at least (\d+) MiB", str(error))
        if least is None:
            raise
    return list(clsco.render(scene, **options, memory=f"{least[1]}MiB"))


def arrays(frame: Any) -> dict[str, Any]:
    """All arrays of a frame by the names that their files use."""
    names = ("color", "sharp", "depth", "mask", "filled", "object_id", "normal", "flow", "hidden", "disparity")
    more = ("occluded", "uv", "flow_backward", "flow_occluded", "missing")  # of which older versions lack some
    found = {name: getattr(frame, name, None) for name in (*names, *more)}
    found["coc"] = frame.blur_radius if hasattr(frame, "blur_radius") else frame.coc
    return {name: values for name, values in found.items() if values is not None}


def of_coverage(name: str, k: int, scene: Any) -> Iterator[tuple[str, str]]:
    """Coverage, which is rendered by name only; nothing of a version that has none."""
    with suppress(*clsco_errors()):
        for frame in clsco.render(scene, truth=["alpha"], precision="double", frames=[0]):
            yield f"{name} {k} double auto whole {frame.eye} alpha", digest(frame.alpha)


def as_before() -> dict[str, str]:
    """Options of `clsco.defocus` that old versions have without being asked."""
    options: Any
    options, nothing = {"outside": "black", "soft_edges": "keep"}, np.zeros((2, 2), np.float32)
    try:
        clsco.defocus(nothing, nothing, **options)
    except TypeError:
        return {}
    return options


def of_images(examples: Path) -> Iterator[tuple[str, str]]:
    """Blur of an image by its map of radii, and filling of one, by each method."""
    import imageio.v3 as iio

    image = iio.imread(examples / "depth_map_image.png").astype(np.float32) / 255
    depth = iio.imread(examples / "depth_map_depth.png").astype(np.float64)
    options: Any = as_before()
    radii = np.where(depth > 0, 12.0 - 250000.0 / np.maximum(depth, 1.0), 0.0).clip(-9.0, 9.0)
    edges, occlusions = ("integrated", "area", "sampled"), ("none", "layered")
    for model, edge, tilt, occlusion in product(("pillbox", "gaussian"), edges, (True, False), occlusions):
        psf = {"model": model, "edge": edge, "tilt": tilt, "occlusion": occlusion}
        for method in ("gather", "scatter", "tiles"):
            blurred = clsco.defocus(image, radii, psf, method=method, **options)
            yield f"defocus {model} {edge} {tilt} {occlusion} {method}", digest(blurred)
        same = clsco.defocus(image, np.full(radii.shape, 5.3), psf | {"occlusion": "none"}, **options)
        yield f"defocus {model} {edge} {tilt} {occlusion} convolve", digest(same)
    photo, holes = iio.imread(examples / "damaged.png"), iio.imread(examples / "damaged_mask.png") > 127
    for method, kind in product(("mean-median", "biharmonic", "texture", "auto"), (np.uint8, np.float32)):
        filled = clsco.inpaint(photo.astype(kind), holes, method=method)
        values = filled[0] if isinstance(filled, tuple) else filled
        yield f"inpaint {method} {np.dtype(kind)}", digest(values)


def digest(values: Any) -> str:
    """Digest of an array's shape, type and bytes."""
    array = np.ascontiguousarray(values)
    return hashlib.sha256(f"{array.shape} {array.dtype}".encode() + array.tobytes()).hexdigest()


if __name__ == "__main__":
    main()
