"""`clsco devices --warm`: kernels compiled ahead."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from clsco.cli import warm
from clsco.cli.main import main


@pytest.mark.slow
def test_usual_kernels_are_compiled_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm, "EXAMPLES", {"sphere": "sphere"})
    result = CliRunner().invoke(main, ["devices", "--warm"])
    assert result.exit_code == 0, result.output
    words = result.output.splitlines()[-1].split()
    assert words[0] == "warm:"
    assert int(words[1]) > 10
    assert int(words[-2]) >= 2 * (8 + 3) + 1
