"""The biharmonic equation on the device: against a direct solution and the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import DOT_SEGMENT
from clsco.inpainting import biharmonic
from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.opencl.buffers import copied, download, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.records import structs
from clsco.reference.inpainting import biharmonic as reference

Array = NDArray[Any]
# The residual ends at 1e-4 of its beginning in the preconditioner's norm, which is the energy's up to a factor; a value
# far from all that is known has little energy, and errs most: 2e-3 where five pixels are all that is.
FIGURE = 5e-3


def filled(session: Session, fill: Any, image: Array, missing: Array) -> Array:
    """The image with the values that a method finds."""
    result = image.copy()
    result[missing] = fill(session, image, missing)
    return result


def picture(rows: int, columns: int, channels: int) -> Array:
    i, j = np.mgrid[0:rows, 0:columns]
    waves = [0.5 + 0.4 * np.sin(0.11 * i + 0.05 * k) * np.cos(0.09 * j - 0.2 * k) for k in range(channels)]
    return np.stack(waves, axis=-1).astype(np.float32)


def direct(image: Array, missing: Array) -> Array:
    """The solution by a dense matrix, kept within what is known, as scikit-image does."""
    rows, columns = missing.shape
    units = np.eye(missing.size).reshape(rows, columns, missing.size)
    matrix = reference.laplacian(reference.laplacian(units)).reshape(missing.size, missing.size)
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


@pytest.mark.parametrize("name", ["random", "wide", "corner"])
def test_the_reference_takes_the_same_steps(session: Session, name: str) -> None:
    image, missing = picture(61, 50, 2), holes((61, 50))[name]
    low, high = image[~missing].min(axis=0), image[~missing].max(axis=0)
    scaled = (image.astype(np.float64) - low) / (high - low)
    expected = np.clip(reference.fill_biharmonic(scaled, missing), 0, 1) * (high - low) + low
    # The device looks at the residual at every tenth step only.
    assert np.abs(filled(session, fill_biharmonic, image, missing) - expected).max() < FIGURE


@pytest.mark.parametrize(("rows", "columns"), [(31, 40), (22, 27)])
@pytest.mark.parametrize("steps", [1, 3])
def test_each_step_is_the_reference(
    session: Session, monkeypatch: pytest.MonkeyPatch, steps: int, rows: int, columns: int
) -> None:
    """Whatever a preconditioner leaves out, the solution is the same in the end, only later."""
    monkeypatch.setattr(biharmonic, "MOST_STEPS", steps)
    monkeypatch.setattr(reference, "MOST_STEPS", steps)
    image = 1e-3 * picture(rows, columns, 2).astype(np.float32)  # all sums are less than 1
    missing = holes((rows, columns))["random"]
    missing[: rows // 2, : columns // 2] = True
    missing[rows // 2 :, columns // 2 :] = True
    missing[rows // 3, columns // 3] = False
    program = build(session, ["inpainting/biharmonic.cl"], {"CHANNELS": 2, "SAMPLED": 0}, structs("double"), "double")
    solver = biharmonic._Solver(session, program, "double", 2, missing)
    assert len(solver.levels) > 2
    exact = reference.fill_biharmonic(image.astype(np.float64), missing)[missing]
    assert np.abs(solver.solve(image) - exact).max() < 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("count", [2 * DOT_SEGMENT, 2 * DOT_SEGMENT + 1])
def test_products_are_added_in_whole_segments(session: Session, count: int) -> None:
    """The host adds up ceil(count / DOT_SEGMENT) sums: none may be left out, and none written beyond them."""
    a, b = np.random.default_rng(6).random((2, count, 2))
    expected = np.add.reduceat(a * b, np.arange(0, count, DOT_SEGMENT))
    partial = copied(session, np.full((len(expected) + 1, 2), 7.0))
    program = build(session, ["inpainting/biharmonic.cl"], {"CHANNELS": 2, "SAMPLED": 0}, structs("double"), "double")
    vectors = (upload(session, a), upload(session, b), np.int32(count), partial)
    launch(session, kernel(program, "add_products"), (len(expected),), biharmonic.LOCAL, *vectors)
    found = download(session, partial, (len(expected) + 1, 2), np.float64)
    assert np.allclose(found[:-1], expected, rtol=1e-13)
    assert (found[-1] == 7).all()


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (2, 2), (1, 2), (3, 40)])
def test_narrow_images(session: Session, shape: tuple[int, int]) -> None:
    image = picture(*shape, 1)
    missing = np.zeros(shape, bool)
    missing.ravel()[1 : 1 + max(missing.size // 3, 1)] = True
    assert np.abs(filled(session, fill_biharmonic, image, missing) - direct(image, missing)).max() < FIGURE


def test_values_of_any_range_and_of_one(session: Session) -> None:
    image, missing = picture(30, 30, 2), holes((30, 30))["wide"]
    far = image * np.float32(1e6) - np.float32(3e5)
    found = filled(session, fill_biharmonic, far, missing)
    assert np.allclose(found, filled(session, fill_biharmonic, image, missing) * 1e6 - 3e5, atol=1e6 * FIGURE)
    flat = np.full((20, 20, 1), 0.25, np.float32)
    assert np.array_equal(filled(session, fill_biharmonic, flat, holes((20, 20))["corner"]), flat)


def test_splines_are_refined_and_gathered_by_the_same_weights() -> None:
    """coarser is the transpose of finer, without which the preconditioner were not symmetric."""
    rng = np.random.default_rng(5)
    for shape in ((7, 10), (8, 9)):
        missing = np.ones(shape, bool)
        half = ((shape[0] + 1) // 2, (shape[1] + 1) // 2)
        fine, coarse = rng.random((*shape, 1)), rng.random((*half, 1))
        nothing = np.zeros((*shape, 1))
        one = (reference.finer(nothing, coarse, missing) * fine).sum()
        other = (reference.coarser(fine, np.ones(half, bool), 1.0) * coarse).sum()
        assert np.isclose(one, other)
