"""Reproducible matplotlib figures that write no files outside of clsco's folders."""

from __future__ import annotations

import os
from contextlib import chdir
from importlib import import_module
from pathlib import Path

from clsco.errors import ClscoError, require_extra
from clsco.resources import ExposedFolderError, private_folder, temporary_folder

VARIABLE = "MPLCONFIGDIR"


def require_matplotlib(what: str, extra: str) -> None:
    """Import matplotlib with its font cache in clsco's folder; call this before importing its modules.

    Otherwise matplotlib would read the user's settings, and a file `matplotlibrc` in the current folder, which may be
    untrusted and can run TeX. what: begins messages. extra: extra of clsco that installs it. Raises
    MissingDependencyError, or ClscoError if no folder for fonts can be made.
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
