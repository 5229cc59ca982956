"""Settings of packages that others could leave: in the current folder, the home, the temporary folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
FIGURE = """
from clsco.files.plots import require_matplotlib
require_matplotlib("plots", "report")
import matplotlib
print(matplotlib.rcParams["text.usetex"], matplotlib.get_cachedir())
"""


@pytest.mark.parametrize("where", ["here", pytest.param("home", marks=pytest.mark.slow)])
def test_settings_of_others_do_not_count(tmp_path: Path, where: str) -> None:
    folder = tmp_path / ("" if where == "here" else "config/matplotlib")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "matplotlibrc").write_text("text.usetex: True\n")
    inherited = {name: value for name, value in os.environ.items() if name != "MPLCONFIGDIR"}  # of tests before
    environ = inherited | {"XDG_CACHE_HOME": f"{tmp_path}/cache", "XDG_CONFIG_HOME": f"{tmp_path}/config"}
    printed = subprocess.run(
        [sys.executable, "-c", FIGURE], check=True, capture_output=True, text=True, cwd=tmp_path, env=environ
    )
    assert (printed.stdout, printed.stderr) == (f"False {tmp_path}/cache/clsco/matplotlib\n", "")


def test_settings_of_gnutls_are_not_read_from_the_temporary_folder() -> None:
    """Its constructor opens them, and would wait for a pipe; GnuTLS takes them from this variable if it is set."""
    code = "import os; from pathlib import Path; from clsco.files.video import require_video; "
    code += "require_video(Path('clip')); "
    code += "print(os.environ['GNUTLS_SYSTEM_PRIORITY_FILE'])"
    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert printed.stdout == f"{os.devnull}\n"
