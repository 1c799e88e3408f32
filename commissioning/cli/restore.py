"""tworelay restore [RUN]."""

from __future__ import annotations

import click

from commissioning.cli.acting import act_on, at_desk, on_this_computer
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen

__all__ = ["command"]


@click.command("restore", cls=Helpful)
@click.argument("run", required=False)
@click.option("--link", help="Reach the drive by this LINK instead of the run's own.")
@click.option("--force", is_flag=True, help="Overwrite values that somebody changed since.")
@click.option("--dry-run", is_flag=True, help="Show every write; write nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def command(run: str | None, link: str | None, force: bool, dry_run: bool, yes: bool) -> None:
    """Put back every parameter that RUN changed (default: the latest run that changed any).

    Names the axis and the values, and asks.
    """
    from commissioning.cli import show
    from commissioning.ending import of_run
    from commissioning.session.restore import restore, to_restore

    screen = Screen(None, yes=yes)
    with at_desk(screen) as desk:
        run_id = to_restore(run, desk)
        if run_id is None:
            screen.say("nothing to restore")
            return
        on_this_computer(run_id, link)
        with act_on(run_id, desk, screen, None):
            outcome = restore(
                run_id, link, desk, force=force, dry_run=dry_run,
                show=lambda rows, drive: show.going_back(rows, drive, screen),
            )  # fmt: skip
        screen.say("dry run: nothing was written" if outcome is None else str(outcome))
        if outcome is not None:
            show.ending(of_run(desk, run_id), screen)
