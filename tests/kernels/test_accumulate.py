"""accumulate.cl: what it adds, and that it adds nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.frame.strips import Strip, grid_struct
from clsco.opencl.buffers import copied, download, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.records import structs
from tests.kernels.conftest import PLAIN


@pytest.mark.parametrize("local", [(64, 1), (7, 5)])
def test_the_frame_without_its_guard_band_is_added(session: Session, local: tuple[int, int]) -> None:
    """Work-groups that reach beyond it add nothing of the next channel's."""
    rows, columns, pad, channels, strip = 12, 17, 4, 3, Strip(top=3, rows=8, above=2, below=5)
    grid = grid_struct(rows, columns, 3, "double", strip)
    program = build(session, ["blur/accumulate.cl"], PLAIN | {"CHANNELS": channels}, structs("double"), "double")
    rng = np.random.default_rng(6)
    value = rng.random((channels, strip.height, columns + 6), np.float32)
    total = rng.random((channels + 1, strip.rows, columns + 2 * pad), np.float32)
    buffer = copied(session, total)
    sizes = (np.int32(total.shape[2]), np.int32(pad))
    args = (grid, upload(session, value), *sizes, buffer)
    launch(session, kernel(program, "accumulate"), (columns, strip.rows), local, *args)
    total[:channels, :, pad:-pad] += value[:, 2:10, 3:-3]
    np.testing.assert_array_equal(download(session, buffer, total.shape, np.float32), total)
