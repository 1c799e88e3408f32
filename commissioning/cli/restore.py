"""tworelay restore [RUN]."""

from __future__ import annotations

import click

from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, at_desk

__all__ = ["command"]


@click.command("restore")
@click.argument("run", required=False)
@click.option("--link", help="Reach the drive by this LINK instead of the run's own.")
@click.option("--force", is_flag=True, help="Overwrite values that somebody changed since.")
@verbose
def command(run: str | None, link: str | None, force: bool) -> None:
    """Put back every parameter that RUN changed (default: the latest run that changed any)."""
    from commissioning.session.apply import restore

    screen = Screen(None, yes=True)
    with at_desk(screen) as desk:
        screen.say(str(restore(run, link, desk, force=force)))
