"""Channel names of EXR files with several layers or parts, from which the image or the depth is selected.

A channel's name is its layer, a dot, and its own name: "ViewLayer.Combined.R". In a file of several parts, the name of
the part precedes it. If no layer is given, the usual names of renderers decide. Nuke's "red" is R, and so is "r".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

MAIN_LAYERS = ("beauty", "color", "combined", "rgb", "rgba")  # names that renderers give to the image itself
DEPTHS = ("pz", "hitpz", "z")  # names, besides those with "depth", that renderers give to a channel or layer of depths
WORDS = {"red": "R", "green": "G", "blue": "B", "alpha": "A"}
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


def list_layers(names: Sequence[str]) -> str:
    """Channels for a message; if there are many, their layers."""
    many = len(names) > SHOWN
    return list_names({name.rpartition(".")[0] or name for name in names} if many else names) or "none"


def image_channels(names: Sequence[str], layer: str | None = None) -> list[str]:
    """The channels of an image: R G B or Y, and A if it exists. Raises LookupError(rule, the file's layers).

    layer: name of the layer, its last words, or a layer that holds it. By default, it is the only layer, the layer
    without a name, or one of `MAIN_LAYERS`.
    """
    layers = _layers(names)
    images = [name for name, own in layers.items() if own.keys() & {*"RGBY", "RY"} in ({*"RGB"}, {*"RGBY"}, {"Y"})]
    if layer is not None:
        images = _matching(images, layer)
    elif "" in images:
        images = [""]
    if len(images) > 1:
        images = [name for name in images if not _is_depth(_last(name))] or images
    if len(images) > 1:
        images = [name for name in images if _last(name).lower() in MAIN_LAYERS] or images
    if not images:
        rule = "an EXR must hold the channels R G B or Y"
        raise LookupError(rule if layer is None else f"{rule} in a layer {list_names([layer])}", list_layers(names))
    if len(images) > 1:
        raise LookupError("an EXR must hold one image, or its layer must be named", f"layers {list_names(images)}")
    own = layers[images[0]]
    return [own[name] for name in ("RGBA" if "R" in own else "YA") if name in own]


def depth_channels(names: Sequence[str], layer: str | None = None, image: Sequence[str] = ()) -> list[str]:
    """The channels that may be the depth: all channels of the most likely kind that exists.

    The kinds, most likely first: Z; a channel called depth, or Z or V in a layer called depth; one of `DEPTHS` or with
    "depth" in its name, or R G B or Y of such a layer; Z or V in any other layer but Blender's Mist; R G B; Y; the only
    channel. A Z beside X and Y, or a V beside U, is a component of a vector, and does not count. layer: name of a
    layer, its last words, a layer that holds it, or a channel. By default all layers are searched, but R G B and Y only
    in the layer without a name. image: channels of the image if the file also holds it; they are no depth, and without
    `layer` a channel of another name is none either.
    """
    if layer is not None:
        if layer in names:
            return [layer]
        layers = _matching(list(_layers(names)), layer)
        names = [name for name in names if name.rpartition(".")[0] in layers]
    names, layers_own = [name for name in names if name not in image], _layers(names)

    def is_value(name: str) -> bool:
        prefix, _, last = name.rpartition(".")
        is_mist = layer is None and _last(prefix).lower() == "mist"
        vector = {"Z": {"X", "Y"}, "V": {"U"}}.get(_own(last))
        return vector is not None and not vector <= layers_own[prefix].keys() and not is_mist

    def is_depth(name: str) -> bool:
        prefix, _, last = name.rpartition(".")
        return last.lower() == "depth" or (is_value(name) and "depth" in prefix.lower().split("."))

    def is_like_depth(name: str) -> bool:
        prefix, _, last = name.rpartition(".")
        return (_is_depth(last) and len(last) > 1) or (_is_depth(_last(prefix)) and _own(last) in ("R", "G", "B", "Y"))

    own = {name: name if layer is None else _last(name) for name in names}  # in the layer, or the file
    kinds = (
        [name for name in names if name in ("Z", "z") and is_value(name)],
        [name for name in names if is_depth(name)],
        [name for name in names if is_like_depth(name)],
        [name for name in names if is_value(name)],
        [name for name in names if own[name] in ("R", "G", "B")],
        [name for name in names if own[name] == "Y"],
        names if len(names) == 1 and (layer is not None or not image) else [],
    )
    return next((kind for kind in kinds if kind), [])


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _own(name: str) -> str:
    """A channel's own name as most programs write it."""
    return WORDS.get(name.lower(), name.upper() if len(name) == 1 else name)


def _is_depth(name: str) -> bool:
    return name.lower() in DEPTHS or "depth" in name.lower()


def _layers(names: Iterable[str]) -> Mapping[str, dict[str, str]]:
    """By layer, its channels by their own names; "" is the layer without a name."""
    layers: dict[str, dict[str, str]] = {}
    for name in names:
        layer, _, own = name.rpartition(".")
        layers.setdefault(layer, {})[_own(own)] = name
    return layers


def _matching(layers: Sequence[str], layer: str) -> list[str]:
    """The layers that match a name: exactly, else without regard to case, else by its last words, else those in it."""
    low = layer.lower()
    kinds = (
        [name for name in layers if name == layer],
        [name for name in layers if name.lower() == low],
        [name for name in layers if name.lower().endswith(f".{low}")],
        [name for name in layers if f".{low}." in f".{name.lower()}."],
    )
    return next((kind for kind in kinds if kind), [])
