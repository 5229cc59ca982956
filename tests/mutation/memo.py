"""Memo of the reference: the same arguments are computed once, as mutants of the kernels leave it as it is."""

from __future__ import annotations

import functools
import importlib
import os
import pickle
import pkgutil
import sys
import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any

WORTH = 0.003  # seconds, from which a result is kept
_inside: list[str] = []  # the function of these that runs


def remember(folder: Path) -> None:
    """Have all functions of the reference, and tables of point spread functions, keep their results in a folder."""
    import clsco.optics.psf_tables
    import clsco.reference

    names = [f"clsco.reference.{module.name}" for module in pkgutil.walk_packages(clsco.reference.__path__)]
    public: list[Callable[..., Any]] = [
        function
        for module in map(importlib.import_module, names)
        for name, function in vars(module).items()
        if isinstance(function, FunctionType) and function.__module__ == module.__name__ and not name.startswith("_")
    ]
    public.append(clsco.optics.psf_tables.psf_table)
    kept = {id(function): _keeping(folder, function) for function in public}
    for module in [module for name, module in sys.modules.items() if name.split(".")[0] == "clsco"]:
        for name, value in list(vars(module).items()):
            if id(value) in kept:
                setattr(module, name, kept[id(value)])


def _keeping(folder: Path, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that keeps its results, unless it changes its arguments, or another one calls it that does so, too."""
    of = f"{function.__module__}.{function.__qualname__}"

    @functools.wraps(function)
    def kept(*args: Any, **options: Any) -> Any:
        given = _pickled((of, _constants(), args, options)) if not _inside else None
        if given is None:
            return function(*args, **options)
        path = folder / sha256(given).hexdigest()
        if path.exists():
            return pickle.loads(path.read_bytes())
        begun = time.monotonic()
        _inside.append(of)
        try:
            found = function(*args, **options)
        finally:
            _inside.pop()
        if time.monotonic() - begun > WORTH and _pickled((of, _constants(), args, options)) == given:
            result = _pickled(found)
            if result is not None:
                partial = path.with_suffix(f".{os.getpid()}")
                partial.write_bytes(result)
                partial.replace(path)
        return found

    return kept


def _constants() -> list[tuple[str, str, object]]:
    """Constants of all modules: tests change some."""
    return [
        (module.__name__, name, value)
        for module in [module for name, module in sorted(sys.modules.items()) if name.split(".")[0] == "clsco"]
        for name, value in sorted(vars(module).items())
        if name.isupper() and isinstance(value, (int, float, str))
    ]


def _pickled(value: object) -> bytes | None:
    try:
        return pickle.dumps(value)
    except (TypeError, AttributeError, pickle.PicklingError):
        return None
