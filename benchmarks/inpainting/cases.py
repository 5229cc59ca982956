"""Images of scikit-image and masks for them: what benchmarks/inpainting fills."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

IMAGES = ("astronaut", "camera", "coffee", "brick")
MASKS = ("scratches", "text", "blocks", "random", "wide")
# Of five wide holes: first row and column, height and width, as parts of the image.
WIDE = (
    (0.15, 0.20, 0.09, 0.10),
    (0.20, 0.62, 0.08, 0.16),
    (0.55, 0.35, 0.12, 0.10),
    (0.68, 0.72, 0.10, 0.10),
    (0.80, 0.12, 0.10, 0.13),
)


class Case(NamedTuple):
    """An 8-bit image, (rows, columns[, 3]), and what is missing of it, (rows, columns)."""

    image_name: str
    mask_name: str
    image: NDArray[np.uint8]
    missing: NDArray[np.bool_]


def cases(images: Iterable[str] = IMAGES, masks: Iterable[str] = MASKS, size: int | None = None) -> Iterator[Case]:
    """Every image with every mask; the masks of an image depend on its place in the list only.

    size: take the middle of the images only, so many px wide and high.
    """
    for seed, name in enumerate(images):
        image = np.asarray(getattr(data, name)())
        if size is not None:
            top, left = (max(length - size, 0) // 2 for length in image.shape[:2])
            image = np.ascontiguousarray(image[top : top + size, left : left + size])
        for mask in masks:
            yield Case(name, mask, image, make_mask(mask, (image.shape[0], image.shape[1]), seed))


def make_mask(name: str, shape: tuple[int, int], seed: int) -> NDArray[np.bool_]:
    """A mask of a kind of MASKS, (rows, columns); the same for the same arguments."""
    rng = np.random.default_rng([seed, MASKS.index(name)])
    rows, columns = shape
    drawn: NDArray[Any] = np.zeros(shape, np.uint8)
    if name == "scratches":
        for _ in range(max(rows * columns // 9000, 1)):  # 29 on 512 x 512
            _scratch(drawn, rng)
    elif name == "text":
        for line in range(rows // 44 + 1):
            text = "The quick brown fox jumps over the lazy dog 0123456789"
            at = (5 - 37 * line % 50, 30 + 44 * line)
            cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 255, 4)
    elif name == "blocks":
        places = np.argwhere(np.ones((rows // 16, columns // 16))) * 16
        for i, j in rng.permutation(places)[: len(places) // 12]:
            drawn[i : i + 16, j : j + 16] = 255
    elif name == "random":
        drawn = rng.random(shape) < 0.1
    else:
        for top, left, height, width in WIDE:
            i, j = int(top * rows), int(left * columns)
            drawn[i : i + int(height * rows), j : j + int(width * columns)] = 255
    return np.asarray(drawn > 0)


def _scratch(drawn: NDArray[Any], rng: np.random.Generator) -> None:
    """A bent line, 2 to 5 px wide."""
    points = [rng.uniform([0.0, 0.0], drawn.shape[::-1])]
    angle = rng.uniform(0, np.pi)
    for bend in rng.normal(0, 0.25, int(rng.integers(8, 20))):
        angle += bend
        points.append(points[-1] + 14 * np.array([np.cos(angle), np.sin(angle)]))
    cv2.polylines(drawn, [np.round(points).astype(np.int32)], False, 255, int(rng.integers(2, 6)))
