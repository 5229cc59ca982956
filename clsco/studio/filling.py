"""Methods of inpainting in a process of their own, which says how far it is, and may be ended."""

from __future__ import annotations

from multiprocessing.connection import Connection
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.engine.child import Child
from clsco.errors import ClscoError, ImageError


class FillingProcess:
    """Fills images one after the other; its process is begun with the first, and stays.

    Parameters
    ----------
    device : str, optional
        As for `clsco.inpaint`.

    Attributes
    ----------
    share : float
        Share of the image that is filled, from 0 to 1.
    """

    def __init__(self, device: str | None = None) -> None:
        self.device = device
        self.share = 0.0
        self._child: Child | None = None
        self._working, self._is_canceled = Lock(), False

    def fill(
        self, image: NDArray[Any], mask: NDArray[np.bool_], method: str
    ) -> tuple[NDArray[Any], dict[str, Any]] | None:
        """Fill an image; returns it with the figures of its report, or None where `cancel` ended it.

        Raises ClscoError: as `clsco.inpaint`; the process ended by itself; another image is being filled.
        """
        if not self._working.acquire(blocking=False):
            raise ImageError(f"{method}: must wait for what is being filled")
        try:
            self.share, self._is_canceled = 0.0, False
            if self._child is None:
                self._child = Child(_work)
            self._child.send((image, mask, method, self.device))
            while True:
                what, *content = self._child.pipe.recv()
                if what == "share":
                    (self.share,) = content
                elif what == "refused":
                    raise content[0]
                else:
                    image, figures = content
                    return image, figures
        except (EOFError, OSError):
            if self._child is not None:
                self._child.end()
            self._child = None
            if self._is_canceled:
                return None
            raise ImageError(f"{method}: its process ended; it is begun again with the next try") from None
        finally:
            self._working.release()

    def cancel(self) -> None:
        """Cancel the filling that runs, if any."""
        if self._working.locked():
            self._is_canceled = True
            self.close()

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.kill()


def _work(pipe: Connection) -> None:
    """Fill images that the studio sends, in a process, until the studio is gone."""
    from clsco.engine.inpaint import inpaint

    while True:
        image, mask, method, device = pipe.recv()
        try:
            filled, report = inpaint(
                image, mask, method=method, device=device, return_report=True,
                progress=lambda share: pipe.send(("share", share)),
            )  # fmt: skip
        except ClscoError as error:
            pipe.send(("refused", error))
        else:
            pipe.send(("filled", filled, report.figures()))
