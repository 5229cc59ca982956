"""Choices for jobs: formats of ground truth, clips and data sets, and distributions to draw from; with the name of each
extra of clsco that is needed and not installed."""

from __future__ import annotations

import tomllib
from importlib.util import find_spec
from pathlib import Path

from clsco.data.containers import CONTAINERS, DEFAULT
from clsco.files.video import PRESETS
from clsco.frame.files import TRUTH_FORMATS
from clsco.resources import folder, read_regular
from clsco.studio.folder import listed

_LARGEST = 2**20  # bytes of a file that may be a distribution
_VIDEO = ("av", "video")
_SETS = "sets"  # folder of the distributions that are shipped, and of their copies


def truth_formats() -> dict[str, str]:
    """Formats of `clsco render --format`, each with the extra that it lacks; "" for none."""
    return {name: _missing(form.needs) for name, form in TRUTH_FORMATS.items()}


def clip_presets() -> dict[str, str]:
    """Presets of `clsco video`, likewise."""
    return dict.fromkeys(PRESETS, _missing(_VIDEO))


def clip_name(preset: str) -> str:
    """Name of a clip that is made by a preset."""
    return f"clip{PRESETS[preset].suffix}"


def set_formats() -> dict[str, str]:
    """Formats of `clsco dataset make --format`, likewise."""
    return {name: _missing(container.needs) for name, container in CONTAINERS.items()}


def first_format() -> str:
    """The format that a form shows at first: the default, or where its extra is not installed the first that is."""
    forms = set_formats()
    return next(name for name in (DEFAULT, *forms) if not forms[name])


def distributions(root: Path) -> list[str]:
    """Distribution files below a folder, and those that are shipped, by the names that their copies would have."""
    found = [name for name in listed(root, (".toml",)) if _is_distribution(root / name)]
    return found + [name for name in shipped_distributions() if name not in found]


def shipped_distributions() -> dict[str, Path]:
    """Distribution files of the package, by the names of their copies in a studio's folder."""
    paths = Path(str(folder("examples"))) / _SETS
    return {f"{_SETS}/{path.name}": path for path in sorted(paths.glob("*.toml"))}


def _is_distribution(path: Path) -> bool:
    try:
        content = tomllib.loads(read_regular(path, _LARGEST, follow=True).decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return bool({"vary", "derive", "accept"} & content.keys())


def _missing(needs: tuple[str, str] | None) -> str:
    if needs is None or find_spec(needs[0]) is not None:
        return ""
    return f"needs {needs[0]}: pip install 'clsco[{needs[1]}]'"
