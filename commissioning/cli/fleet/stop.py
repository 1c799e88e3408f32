"""tworelay fleet stop [ID]."""

from __future__ import annotations

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen

__all__ = ["command"]


@click.command("stop", cls=Helpful)
@click.argument("run", required=False, metavar="[ID]")
@click.option("--drain", is_flag=True, help="What moves is finished; nothing more starts.")
@verbose
def command(run: str | None, drain: bool) -> None:
    """End fleet run ID (default: all under way): what moves is stopped, nothing more starts.

    Where its runner is gone, the processes that still move its axes are told, and its gateways.
    """
    from commissioning.fleet.afar import reach
    from commissioning.fleet.stopping import stop_runs
    from drivers.home import home

    screen = Screen(None, yes=True)
    for line in stop_runs(home(), run, reach, drain=drain):
        screen.say(line)
