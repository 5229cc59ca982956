"""Former names of commands, for one release: each does what the command does, and says what it is called now."""

from __future__ import annotations

import click

from clsco.cli.output import echo


def report_former(former: str, name: str) -> None:
    """Say on stderr what a former name or form is called now."""
    echo(f"{former}: is called {name} now; the former name goes in the next version", err=True)


class _Former(click.Group):
    """A hidden command that hands its words on to one of another group.

    Parameters
    ----------
    name : str
        Former name.
    group : Group
        Group of the commands that are meant; its name is said.
    usual : str
        The command that is meant where the words name none.
    others : tuple of str
        Commands that may be named, as a word or, as they were options once, with two dashes.
    """

    def __init__(self, name: str, group: click.Group, usual: str, others: tuple[str, ...] = ()) -> None:
        commands = {each: group.commands[each] for each in (usual, *others)}
        super().__init__(name, commands=commands, hidden=True, help=f"Former name of clsco {group.name} {usual}.")
        self.present, self.usual = group.name, usual

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Find the command that is meant, and say its present name."""
        options = [word for word in args if word.removeprefix("--") in self.commands and word.startswith("--")]
        if options:
            args = [options[0].removeprefix("--"), *(word for word in args if word not in options)]
        elif not args or args[0] not in self.commands:
            args = [self.usual, *args]
        report_former(f"clsco {self.name}", f"clsco {self.present} {args[0]}")
        return super().parse_args(ctx, args)


def former_command(name: str, group: click.Group) -> click.Command:
    """Command of a former name, which is in another group now."""
    others = {"batch": ("status", "verify", "show"), "bench": ("stability",)}
    return _Former(name, group, "make" if name == "batch" else name, others.get(name, ()))
