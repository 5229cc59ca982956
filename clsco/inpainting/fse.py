"""Inpainting with texture and structure on the device, by frequency-selective extrapolation, coarse to fine.

The image around a block of pixels is decomposed into a few waves, which are extrapolated into the block: the strongest
wave of the weighted residual is subtracted repeatedly (Seiler and Kaup 2010, doi:10.1109/LSP.2010.2052560; number of
waves and preference of low frequencies: Genser et al. 2017 and 2018; FSR in OpenCV's xphoto). Here all channels use the
same waves, blocks are 2 x 2 px, and blocks at the same distance from known pixels are computed at once. Holes wider
than a block are first filled by the same method in the image at half the size. This coarse result gets a small weight
in every window, so that wide holes are neither flat nor dominated by chance.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import FSE_BLOCK
from clsco.inpainting.fse_tables import FEWEST_WAVES, GUESS, MOST_WAVES, STEP, TRUST, WAVES_PER_CONTRAST, tables
from clsco.inpainting.hole_shapes import block_turns, doubled, halved
from clsco.inpainting.tiles import Progress, fill_in_tiles, no_progress
from clsco.opencl.buffers import copied, download, empty, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session

LOCAL = (1,)  # local size; a work-item takes long, and has large arrays


def fill_texture(
    session: Session, image: NDArray[Any], missing: NDArray[np.bool_], progress: Progress = no_progress
) -> NDArray[np.float32]:
    """Values (N, channels) of the N missing pixels of an image, row by row.

    image: (rows, columns, channels), codes or floats, finite where known; missing: (rows, columns); progress: called
    with the fraction done, 0 to 1, after each tile. Filled values are limited to the range of nearby known ones. Every
    run on a device gives the same bits. Memory besides the image: a byte per pixel; for each missing pixel 8 bytes and
    the result; and about 28 channels + 12 bytes per pixel of one tile (`clsco.inpainting.tiles`). Raises ArgumentError
    if no pixel is known, and DeviceError.
    """
    features = {"CHANNELS": image.shape[2]}
    target = Target(session, ["inpainting/fse.cl"], features, "float")
    constants = [upload(session, table) for table in tables()]
    result = fill_in_tiles(image, missing, partial(_fill, session, target, constants), progress)
    session.queue.finish()
    return result


def _fill(
    session: Session, target: Target, constants: list[cl.Buffer], image: NDArray[np.float32],
    missing: NDArray[np.bool_],
) -> NDArray[np.float32]:  # fmt: skip
    if not missing.any():
        return image
    turns = block_turns(missing, FSE_BLOCK)
    start = np.where(missing[..., None], np.float32(0), image)
    weights = np.where(missing, np.float32(0), np.float32(1))
    if turns.max() > 1:  # a block has no known pixel
        start[missing] = doubled(_fill(session, target, constants, *halved(start, missing)), missing)
        weights[missing] = GUESS
    value, weight = (copied(session, array) for array in (start, weights))
    size = (np.int32(missing.shape[0]), np.int32(missing.shape[1]))
    order = np.argsort(turns, axis=None, kind="stable")
    blocks = (np.stack(np.unravel_index(order, turns.shape), axis=1) * FSE_BLOCK).astype(np.int32)
    ends = np.searchsorted(turns.ravel()[order], np.arange(turns.max() + 2))
    settings = (np.float32(STEP), np.float32(WAVES_PER_CONTRAST), np.int32(FEWEST_WAVES), np.int32(MOST_WAVES))
    held = []  # buffers to keep until the queue has finished
    for first, end in pairwise(ends):
        count = int(end - first)
        if not count:
            continue
        listed, filled = upload(session, blocks[first:end]), empty(session, 4 * FSE_BLOCK**2 * image.shape[2] * count)
        todo: tuple[Any, ...] = (*size, value, weight, *constants, listed, np.int32(count), *settings, filled)
        launch(session, target["extrapolate_blocks"], (count,), LOCAL, *todo)
        settled = (*size, filled, listed, np.int32(count), np.float32(TRUST), value, weight)
        launch(session, target["settle_blocks"], (count,), LOCAL, *settled)
        held += [listed, filled]
    return download(session, value, image.shape, np.float32)
