"""The biharmonic equation on the device: against a direct solution."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import DOT_SEGMENT
from clsco.inpainting import biharmonic
from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.opencl.buffers import copied, download, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from tests.kernels.launches import filled

Array = NDArray[Any]
# The residual ends at 1e-4 of its beginning in the preconditioner's norm, which is the energy's up to a factor; a value
# far from all that is known has little energy, and errs most: 2e-3 where five pixels are all that is.
FIGURE = 5e-3


def picture(rows: int, columns: int, channels: int) -> Array:
    i, j = np.mgrid[0:rows, 0:columns]
    waves = [0.5 + 0.4 * np.sin(0.11 * i + 0.05 * k) * np.cos(0.09 * j - 0.2 * k) for k in range(channels)]
    return np.stack(waves, axis=-1).astype(np.float32)


def laplacian(u: Array) -> Array:
    """Five-point Laplacian (rows, columns, n); nothing flows over the border."""
    p = np.pad(u, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return np.asarray(p[:-2, 1:-1] + p[2:, 1:-1] + p[1:-1, :-2] + p[1:-1, 2:] - 4 * u)


def direct(image: Array, missing: Array) -> Array:
    """The solution by a dense matrix, kept within what is known, as scikit-image does."""
    rows, columns = missing.shape
    units = np.eye(missing.size).reshape(rows, columns, missing.size)
    matrix = laplacian(laplacian(units)).reshape(missing.size, missing.size)
    unknown = missing.ravel()
    values = image.reshape(missing.size, -1).astype(np.float64)
    right = -matrix[unknown][:, ~unknown] @ values[~unknown]
    values[unknown] = np.linalg.solve(matrix[unknown][:, unknown], right)
    known = values[~unknown]
    return np.clip(values, known.min(axis=0), known.max(axis=0)).reshape(image.shape)


def holes(shape: tuple[int, int]) -> dict[str, Array]:
    rows, columns = shape
    masks = {name: np.zeros(shape, bool) for name in ("random", "wide", "corner", "half", "all but a few")}
    masks["random"] = np.random.default_rng(3).random(shape) < 0.3
    masks["wide"][rows // 5 : -rows // 4, columns // 5 : -columns // 5] = True
    masks["corner"][: rows // 2, : columns // 2] = True
    masks["corner"][-1, -1] = True
    masks["half"][:, columns // 2 :] = True
    masks["all but a few"][...] = True
    masks["all but a few"][rows // 2 : rows // 2 + 2, ::7] = False
    return masks


@pytest.mark.parametrize("name", ["random", "wide", "corner", "half", "all but a few"])
@pytest.mark.parametrize(("rows", "columns", "channels"), [(30, 33, 1), (25, 40, 3)])
def test_it_is_the_direct_solution(session: Session, rows: int, columns: int, channels: int, name: str) -> None:
    image, missing = picture(rows, columns, channels), holes((rows, columns))[name]
    assert np.ptp(image[~missing]) > 0.1
    damaged = np.where(missing[..., None], np.float32(7), image)
    found = filled(session, fill_biharmonic, damaged, missing)
    assert found.dtype == np.float32
    assert np.array_equal(found[~missing], image[~missing])
    error = np.abs(found - direct(image, missing))
    worst = np.unravel_index(int(error.argmax()), error.shape)
    assert error.max() < FIGURE, f"{error.max():.1e} at {worst}"
    assert np.array_equal(filled(session, fill_biharmonic, damaged, missing), found)


@pytest.mark.parametrize("count", [2 * DOT_SEGMENT, 2 * DOT_SEGMENT + 1])
def test_products_are_added_in_whole_segments(session: Session, count: int) -> None:
    """The host adds up ceil(count / DOT_SEGMENT) sums: none may be left out, and none written beyond them."""
    a, b = np.random.default_rng(6).random((2, count, 3))
    expected = np.add.reduceat(a * b, np.arange(0, count, DOT_SEGMENT))
    partial = copied(session, np.full((len(expected) + 1, 3), 7.0))
    target = Target(session, ["inpainting/biharmonic.cl"], {"CHANNELS": 3}, "double")
    vectors = (upload(session, a), upload(session, b), np.int32(count), partial)
    launch(session, target["add_products"], (len(expected),), biharmonic.LOCAL, *vectors)
    found = download(session, partial, (len(expected) + 1, 3), np.float64)
    assert np.allclose(found[:-1], expected, rtol=1e-13)
    assert (found[-1] == 7).all()


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (2, 2), (1, 2), (3, 40)])
def test_narrow_images(session: Session, shape: tuple[int, int]) -> None:
    image = picture(*shape, 1)
    missing = np.zeros(shape, bool)
    missing.ravel()[1 : 1 + max(missing.size // 3, 1)] = True
    assert np.abs(filled(session, fill_biharmonic, image, missing) - direct(image, missing)).max() < FIGURE


def test_values_of_any_range_and_of_one(session: Session) -> None:
    image, missing = picture(30, 30, 3), holes((30, 30))["wide"]
    far = image * np.float32(1e6) - np.float32(3e5)
    found = filled(session, fill_biharmonic, far, missing)
    assert np.allclose(found, filled(session, fill_biharmonic, image, missing) * 1e6 - 3e5, atol=1e6 * FIGURE)
    flat = np.full((20, 20, 1), 0.25, np.float32)
    assert np.array_equal(filled(session, fill_biharmonic, flat, holes((20, 20))["corner"]), flat)
