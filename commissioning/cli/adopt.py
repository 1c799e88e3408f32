"""tworelay adopt DIR."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, at_desk

__all__ = ["command"]


@click.command("adopt")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--profile", metavar="P", help="Profile of its drive as you know it; default: the built-in one."
)
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def command(folder: Path, profile: str | None, yes: bool) -> None:
    """Take in a run that was exported on another computer, to apply or restore it here.

    Shows link, axis, profile and what it wrote, and asks. Nothing is written to a drive.
    """
    from commissioning.cli import show
    from commissioning.session.adopt import adopt

    screen = Screen(None, yes=yes)
    with at_desk(screen) as desk:
        run = adopt(folder, profile, desk, lambda found: show.adopted(found, screen))
    screen.say(
        f"to write what it proposed: tworelay apply {run}; to take it back: tworelay restore {run}"
    )
    screen.say(f"run {run}")
