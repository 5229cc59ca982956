"""Channel names of EXR files with several layers or parts, from which the image or the depth is selected.

A channel's name is its layer, a dot, and its own name: "ViewLayer.Combined.R". In a file of several parts, the name of
the part precedes it. If no layer is given, the usual names of renderers decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

MAIN_LAYERS = ("beauty", "color", "combined", "rgb", "rgba")  # names that renderers give to the image itself
SHOWN = 20


def full_names(parts: Sequence[tuple[str, Iterable[str]]]) -> list[dict[str, str]]:
    """For each part (name, channels), the full names of its channels by their names within the part.

    With a single part, both names are the same.
    """
    if len(parts) == 1:
        return [{name: name for name in parts[0][1]}]
    known = [part for part, _ in parts]
    labels = [name if name and known.count(name) == 1 else f"part{n}" for n, name in enumerate(known)]
    return [
        {name: name if name.startswith(f"{label}.") else f"{label}.{name}" for name in names}
        for label, (_, names) in zip(labels, parts, strict=True)
    ]


def list_names(names: Iterable[str]) -> str:
    """Sorted names for a message: unprintable ones are escaped, and after the first SHOWN only the number of the others
    is given.
    """
    ordered = sorted(names)
    shown = [name if name.isprintable() else ascii(name) for name in ordered[:SHOWN]]
    return " ".join(shown) + (f" and {len(ordered) - SHOWN} more" if len(ordered) > SHOWN else "")


def image_channels(names: Sequence[str], layer: str | None = None) -> list[str]:
    """The channels of an image: R G B or Y, and A if it exists. Raises LookupError(rule, the file's layers).

    layer: name of the layer, or its last words. By default, it is the only layer, the layer without a name, or one of
    `MAIN_LAYERS`.
    """
    layers = _layers(names)
    images = [name for name, own in layers.items() if {"R", "G", "B"} <= own or ("Y" in own and not own & {"RY", "R"})]
    if layer is not None:
        images = _matching(images, layer)
    elif "" in images:
        images = [""]
    elif len(images) > 1:
        images = [name for name in images if name.rpartition(".")[2].lower() in MAIN_LAYERS] or images
    if not images:
        rule = "an EXR must hold the channels R G B or Y"
        raise LookupError(
            rule if layer is None else f"{rule} in a layer {list_names([layer])}", list_names(names) or "none"
        )
    if len(images) > 1:
        raise LookupError("an EXR must hold one image, or its layer must be named", f"layers {list_names(images)}")
    (image,) = images
    own, prefix = layers[image], f"{image}." if image else ""
    return [prefix + name for name in (*("RGB" if "R" in own else "Y"), *("A" if "A" in own else ""))]


def depth_channels(names: Sequence[str], layer: str | None = None) -> list[str]:
    """The channels that may be the depth: all channels of the most likely kind that exists.

    The kinds, most likely first: Z; a channel called depth, or Z or V in a layer called depth; Z or V in any other
    layer; R G B; Y; the only channel. A Z or V beside X and Y is a component of a vector, and does not count. layer:
    name of a layer, its last words, or a channel. By default all layers are searched, but R G B and Y only in the layer
    without a name.
    """
    if layer is not None:
        if layer in names:
            return [layer]
        layers = _matching(list(_layers(names)), layer)
        names = [name for name in names if name.rpartition(".")[0] in layers]

    def is_value(name: str) -> bool:
        prefix, dot, last = name.rpartition(".")
        return last in ("Z", "V") and not {f"{prefix}{dot}X", f"{prefix}{dot}Y"} <= set(names)

    def is_depth(name: str) -> bool:
        prefix, _, last = name.rpartition(".")
        return last.lower() == "depth" or (is_value(name) and "depth" in prefix.lower().split("."))

    own = {name: name if layer is None else name.rpartition(".")[2] for name in names}  # in the layer, or the file
    kinds = (
        [name for name in names if name == "Z" and is_value(name)],
        [name for name in names if is_depth(name)],
        [name for name in names if is_value(name)],
        [name for name in names if own[name] in ("R", "G", "B")],
        [name for name in names if own[name] == "Y"],
        list(names) if len(names) == 1 else [],
    )
    return next((kind for kind in kinds if kind), [])


def _layers(names: Iterable[str]) -> Mapping[str, set[str]]:
    """By layer, the names of its channels without the layer's name; "" is the layer without a name."""
    layers: dict[str, set[str]] = {}
    for name in names:
        layer, _, own = name.rpartition(".")
        layers.setdefault(layer, set()).add(own)
    return layers


def _matching(layers: Sequence[str], layer: str) -> list[str]:
    """The layers that match a name: exactly, else without regard to case, else by its last words."""
    low = layer.lower()
    kinds = (
        [name for name in layers if name == layer],
        [name for name in layers if name.lower() == low],
        [name for name in layers if name.lower().endswith(f".{low}")],
    )
    return next((kind for kind in kinds if kind), [])
