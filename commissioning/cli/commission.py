"""tworelay commission TARGET."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import act_on, at_desk, check_json, write_json
from commissioning.cli.helping import Helpful
from commissioning.cli.job import Job, job_options
from commissioning.cli.junit import junit_option
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.result.changes import Change
    from commissioning.result.document import RunResult
    from commissioning.watching import Watcher

__all__ = ["command"]


@click.command("commission", cls=Helpful)
@click.argument("target")
@job_options
@click.option("--ask-each", is_flag=True, help="Ask before each act, not once.")
@junit_option("commission")
def command(target: str, job: Job) -> None:
    """Identify the axis at TARGET, apply the compensation, prove that it helps, write the report.

    One confirmation covers all of it, and names each act. The compensation is stored once it is
    proved; else the drive is left as it was found.
    """
    from commissioning.cli import show
    from commissioning.cli.identify import measure
    from commissioning.cli.report import say_report
    from commissioning.ownership import owned
    from commissioning.result.words import nothing_proposed

    check_json(job.json_target)
    screen = Screen(job.json_target, yes=job.yes)
    axis = job.axis(target)
    with owned(axis.link or "virtual://", "commission"):  # from the first step to the last
        with screen.watching("commission") as watcher:
            result = measure(target, screen, job, watcher, writes=True)
            if not job.dry_run and result.compensation:
                screen.agreed = None if job.ask_each else axis.name
                result = _prove(result, screen, job, watcher)
        write_json(result, job.json_target)
        if job.dry_run:
            return
        show.summary(result, screen)
        if result.compensation:
            show.verification(result, screen)
            show.in_the_drive(result, screen)
        else:
            screen.say(nothing_proposed(result))
        say_report(str(result.run), screen)
        show.ending(result, screen)


def _prove(measured: RunResult, screen: Screen, job: Job, watcher: Watcher) -> RunResult:
    """Write, prove, store; on failure say what was found and write the JSON, then raise."""
    from commissioning.cli import show
    from commissioning.cli.report import say_report
    from commissioning.session.commission import prove_and_store

    run = str(measured.run)

    def proposed(changes: Sequence[Change]) -> None:
        if job.ask_each or screen.verbose:
            show.summary(measured, screen)
            show.proposal(changes, screen)

    try:
        with (
            at_desk(screen, watcher=watcher) as desk,
            act_on(run, desk, screen, job.json_target),
        ):
            return prove_and_store(run, desk, proposed, without_watchdog=job.without_watchdog)
    except BaseException:
        screen.show_held()
        if not (job.ask_each or screen.verbose):
            show.summary(measured, screen)
        say_report(run, screen)
        raise
