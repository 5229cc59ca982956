"""matplotlib for figures: the same everywhere, and with nothing of its own outside of clsco's folders."""

from __future__ import annotations

import os
from contextlib import chdir
from importlib import import_module
from pathlib import Path

from clsco.errors import ClscoError, require_extra
from clsco.resources import ExposedFolderError, private_folder, temporary_folder

VARIABLE = "MPLCONFIGDIR"


def require_matplotlib(what: str, extra: str) -> None:
    """Import matplotlib, which keeps its list of fonts in clsco's folder; call it before importing modules of it.

    By itself it would take settings from a file `matplotlibrc` of the current folder, which may be a stranger's and can
    have TeX run, and from the user's. what: begins messages. extra: of clsco that brings it. Raises
    MissingDependencyError, or ClscoError where there is no folder for its fonts.
    """
    require_extra(what, "matplotlib", extra)
    try:
        if not os.environ.get(VARIABLE):
            os.environ[VARIABLE] = str(_folder())
        with chdir(os.environ[VARIABLE]):
            import_module("matplotlib")
    except OSError as error:
        raise ClscoError(f"{what}: matplotlib must have a folder for its fonts; got {error}") from error


def _folder() -> Path:
    try:
        return private_folder("clsco", "matplotlib")
    except (ExposedFolderError, OSError, RuntimeError):
        return temporary_folder("matplotlib")
