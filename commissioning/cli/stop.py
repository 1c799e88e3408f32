"""tworelay stop TARGET."""

from __future__ import annotations

import click

from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, at_desk, axis_from

__all__ = ["command"]


@click.command("stop")
@click.argument("target")
@click.option("--profile", metavar="P", help="Drive profile: a built-in name or a file.")
@verbose
def command(target: str, profile: str | None) -> None:
    """Stop and de-energise the axis at TARGET, whoever enabled it."""
    from commissioning.session.apply import stop, unfinished

    screen = Screen(None, yes=True)
    axis = axis_from(target, profile)
    with at_desk(screen, to_stop=True) as desk:
        screen.say(str(stop(axis, desk)))
        for run in unfinished(axis, desk):
            screen.say(
                f"run {run} left settings changed in a drive on this link; 'tworelay restore {run}' puts "
                "them back"
            )
