"""tworelay fleet restore [ID]."""

from __future__ import annotations

import sys

import click

from commissioning.cli.acting import act_on, at_desk
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import say
from commissioning.cli.terminal import Screen
from profiles.errors import TwoRelayError, UsageError

__all__ = ["command"]

_SOME = 9


@click.command("restore", cls=Helpful)
@click.argument("run", required=False, default="last", metavar="[ID]")
@click.option("--axis", "axes", multiple=True, metavar="A", help="All that was written to A.")
@click.option("--all", "everything", is_flag=True, help="All that was written to any axis.")
@click.option("--force", is_flag=True, help="Overwrite values that somebody changed since.")
@click.option("--dry-run", is_flag=True, help="Show every write; write nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def command(
    run: str, axes: tuple[str, ...], everything: bool, force: bool, dry_run: bool, yes: bool
) -> None:
    """Finish what was cut off in fleet run ID (default: the last): old values back, axis by axis.

    With --axis or --all also what was written for good. Names the values, and asks.
    """
    from commissioning.cli import show
    from commissioning.ending import of_run
    from commissioning.fleet.ledger import Ledger
    from commissioning.fleet.restoring import left_by
    from commissioning.session.restore import restore
    from drivers.home import home

    if axes and everything:
        raise UsageError("--axis and --all exclude each other")
    screen = Screen(None, yes=yes)
    failed = []
    with Ledger(home(), reading=True) as ledger, at_desk(screen) as desk:
        found = left_by(ledger, desk.journal, run, axes, everything=everything)
        if not found:
            screen.say("nothing to restore")
            return
        for left in found:
            screen.say(f"{left.axis}:")
            try:
                with act_on(left.run, desk, screen, None):
                    outcome = restore(
                        left.run, None, desk, force=force, dry_run=dry_run,
                        show=lambda rows, drive: show.going_back(rows, drive, screen),
                    )  # fmt: skip
            except TwoRelayError as error:
                if error.exit_code >= 128 or len(found) == 1:
                    raise
                say(f"tworelay: {left.axis}: {error}", err=True)
                failed.append(left.axis)
                continue
            screen.say("dry run: nothing was written" if outcome is None else str(outcome))
            if outcome is not None:
                show.ending(of_run(desk, left.run), screen)
    if failed:
        say(f"tworelay: not restored: {', '.join(dict.fromkeys(failed))}", err=True)
        sys.exit(_SOME)
