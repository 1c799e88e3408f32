"""tworelay stop TARGET."""

from __future__ import annotations

import contextlib
import os

import click

from commissioning.cli.acting import at_desk
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.targets import axis_from
from commissioning.cli.terminal import Screen

__all__ = ["command"]


@click.command("stop", cls=Helpful)
@click.argument("target")
@click.option("--profile", metavar="P", help="Drive profile: a built-in name or a file.")
@verbose
def command(target: str, profile: str | None) -> None:
    """Stop and de-energise the axis at TARGET, whoever enabled it."""
    from commissioning.journal import Journal
    from commissioning.processes import is_alive
    from commissioning.result.endings import AxisState
    from commissioning.result.words import axis_words
    from commissioning.session.stop import stop
    from drivers.home import home
    from drivers.places import same_place
    from profiles.errors import TwoRelayError

    screen = Screen(None, yes=True)
    axis = axis_from(target, profile)
    with at_desk(screen, to_stop=True) as desk:
        try:
            screen.say(str(stop(axis, desk)))
        except TwoRelayError:
            screen.say(axis_words(AxisState.NOT_VERIFIED))
            raise
    with contextlib.suppress(TwoRelayError), Journal(home(), reading=True) as journal:
        for run in journal.unfinished_on(lambda link: same_place(link, axis.link or "")):
            context = journal.run(run).context
            if context.pid != os.getpid() and is_alive(context.pid, context.started):
                continue  # it puts them back itself
            screen.say(
                f"run {run} left settings changed in a drive on this link; 'tworelay restore "
                f"{run}' puts them back"
            )
