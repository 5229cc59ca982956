"""The command as tests call it."""

from __future__ import annotations

from click.testing import CliRunner, Result

from clsco.cli.main import main


def clsco_(*words: object) -> Result:
    """Run the command with these words."""
    return CliRunner().invoke(main, [str(word) for word in words])


def done(*words: object) -> Result:
    """Run the command with these words, with which it succeeds."""
    result = clsco_(*words)
    assert result.exit_code == 0, result.output
    return result
