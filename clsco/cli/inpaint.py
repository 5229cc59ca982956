"""Implementation of `clsco inpaint`: reads an image and its mask, and writes the filled image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.cli.inputs import prepare_file
from clsco.cli.output import echo
from clsco.errors import ArgumentError, SceneError
from clsco.files import images
from clsco.files.atomic import raise_file_error
from clsco.files.images import WRITERS, ImageWriter, Picture, read_image
from clsco.files.ranges import first_of
from clsco.inpainting.rules import MeanMedian


def read_pair(
    image: Path, mask: Path, threshold: float | None = None, layer: str | None = None
) -> tuple[Picture, NDArray[np.bool_]]:  # fmt: skip
    """Read an image as stored, and its mask (rows, columns), True for missing pixels. Raises FileError, ArgumentError.

    Without a threshold, a pixel is missing where the mask is white (255, 65535, or 1.0 in floats) and known where it is
    0; with one, it is missing where the mask is at least the threshold. Missing pixels of the image may be NaN. layer:
    as for `clsco.files.images.read_image`.
    """
    if threshold is not None and not math.isfinite(threshold):
        raise ArgumentError(f"--threshold: must be a finite number; got {threshold}")
    images.check_same_size(str(image), str(mask), images.image_size(mask))
    if note := images.upright_note(str(image), str(mask)):
        echo(note, err=True)
    missing = _missing(mask, threshold)
    if missing.all():
        raise_file_error(mask, "some pixel must be known, and be 0", "only missing ones")
    return read_image(image, missing, layer), missing


def _missing(mask: Path, threshold: float | None) -> NDArray[np.bool_]:
    picture = read_image(mask)
    values = picture.data
    if values.ndim == 3:
        if (values != values[..., :1]).any():
            raise_file_error(mask, "a mask must be gray", "colors")
        values = values[..., 0]
    if threshold is not None:
        return values >= threshold
    white = 1 if picture.is_float else np.iinfo(values.dtype).max
    other = (values != 0) & (values != white)
    if other.any():
        rule = f"values must be 0 (known) or {white} (missing), or give --threshold"
        raise_file_error(mask, rule, first_of(values, other))
    return values == white


def prepare_out(out: Path, image: Path, mask: Path, is_float: bool | None = None) -> ImageWriter:
    """Writer for OUT, after checks of it and its folder; is_float: None if not known yet. Raises FileError."""
    suffix = out.suffix.lower()
    if suffix not in WRITERS or out.is_dir():
        raise_file_error(out, f"must be a file that ends in one of {' '.join(WRITERS)}", repr(out.suffix))
    writer = prepare_file(out, (image, mask), "the image or the mask")
    if is_float is not None:
        kind, other = ("floats", "codes") if is_float else ("codes", "floats")
        *first, last = (name for name, each in WRITERS.items() if (each.floats if is_float else each.code_bits))
        if suffix not in (*first, last):
            rule = f"{writer.label} holds {other}; for {kind} it must end in {', '.join(first)} or {last}"
            raise_file_error(out, rule, f"the {kind} of {image}")
    return writer


def mean_median_options(method: str, options: Mapping[str, Any]) -> MeanMedian | None:
    """Constants of the method mean-median, or None if no option sets one. Raises SceneError, which names the option."""
    from clsco.inpainting.methods import THESIS

    constants = {name: value for name, value in options.items() if value is not None}
    if not constants:
        return None
    if method != THESIS:
        option = f"--{next(iter(constants)).replace('_', '-')}"
        raise SceneError(f"{option}: belongs to --method {THESIS}; got {method}")
    try:
        return MeanMedian(**constants)
    except SceneError as error:
        name, _, rest = str(error).partition(":")
        raise SceneError(f"--{name.replace('_', '-')}:{rest}") from None
