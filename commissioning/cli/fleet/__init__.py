"""tworelay fleet: each command in a module of its own, imported when it is called."""

from __future__ import annotations

from importlib import import_module

import click

from commissioning.cli.helping import HelpfulGroup

__all__ = ["command"]

_COMMANDS = {
    "check": "Look at all axes of a fleet file; write and move nothing.",
    "run": "Do the job of a fleet file on all its axes.",
    "rehearse": "The same run against virtual twins of all its axes.",
    "status": "Where a fleet run is.",
    "stop": "End a fleet run: what moves is stopped.",
    "restore": "Finish what was cut off; put back what was written.",
    "gateway": "Serve the axes of this computer to a fleet run on another.",
    "keys": "Make the certificates of gateways and of those who may command them.",
    "report": "Write the pages and the acceptance record of a fleet run.",
}


class _Lazy(HelpfulGroup):
    """Commands by name; the module is imported when the command is needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        found: click.Command = import_module(f"commissioning.cli.fleet.{cmd_name}").command
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


@click.group("fleet", cls=_Lazy)
def command() -> None:
    """Many axes: a fleet file, its ledger, and what became of each.

    FLEET is a file as in docs/forty-axes.md; ID a fleet run as printed, default: the last.
    """
