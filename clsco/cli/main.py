"""The command `clsco`.

Exit status: 0 done; 1 a user's error, in one line on stderr; 2 wrong usage; 3 no device; 130 interrupted; 143 ended.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import click

from clsco import __version__
from clsco.cli.group import Commands

COMMANDS = {
    "check": ("scenes", "Compare frames with the NumPy reference."),
    "dataset": ("dataset", "Make data sets of many scenes drawn from distributions."),
    "defocus": ("images", "Defocus IMAGE by its depth map DEPTH."),
    "demo": ("scenes", "Render some of the example scenes."),
    "devices": ("devices", "List OpenCL devices, what each can do, and which one is used."),
    "examples": ("examples", "List the example files, or copy some."),
    "inpaint": ("images", "Fill the missing pixels of IMAGE."),
    "plan": ("scenes", "Report what rendering a scene takes, and how long."),
    "psf": ("psf", "Write the point spread functions of a scene's lens."),
    "render": ("render", "Render the frames of scenes to files."),
    "schema": ("scenes", "Print the JSON Schema of a scene file."),
    "studio": ("studio", "Edit a scene in the browser while it is rendered."),
    "validate": ("scenes", "Check scene files and their textures without rendering."),
    "video": ("video", "Make a clip of the frames in DIR, which clsco render wrote."),
}
"""Module of each command, imported when the command is called, and the command's line in the list of commands."""


class _LazyCommands(Commands):
    """The commands of `COMMANDS`."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, without importing their modules."""
        stubs: dict[str, click.Command] = {name: click.Command(name, help=text) for name, (_, text) in COMMANDS.items()}
        click.Group(commands=stubs).format_commands(ctx, formatter)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands."""
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> Any:
        """The command of this name; None if there is none."""
        del ctx
        if name not in COMMANDS:
            return None
        return getattr(import_module(f"clsco.cli.{COMMANDS[name][0]}"), name)


@click.group(cls=_LazyCommands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clsco")
@click.option("-v", "--verbose", count=True, help="Say on stderr what is done; -vv: with all details.")
def main(verbose: int) -> None:
    """Images of moving objects out of focus, with their ground truth."""
    if verbose:
        from clsco.cli.output import show_log

        show_log(verbose)
