"""tworelay commission TARGET."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from commissioning.cli.junit import junit_option
from commissioning.cli.terminal import (
    Job,
    Screen,
    act_on,
    at_desk,
    check_json,
    job_options,
    write_json,
)

if TYPE_CHECKING:
    from commissioning.result.document import RunResult

__all__ = ["command"]


@click.command("commission")
@click.argument("target")
@job_options
@junit_option("commission")
def command(target: str, job: Job) -> None:
    """Identify the axis at TARGET, apply the compensation, prove that it helps, write the report.

    The compensation is stored once it is proved; else the drive is left as it was found.
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
        result = measure(target, screen, job, writes=True)
        if job.dry_run:
            write_json(result, job.json_target)
            return
        show.summary(result, screen)
        run = str(result.run)
        try:
            if result.compensation:
                result = _prove(run, screen, job)
            else:
                screen.say(nothing_proposed(result))
            write_json(result, job.json_target)
            show.ending(result, screen)
        finally:
            say_report(run, screen)


def _prove(run: str, screen: Screen, job: Job) -> RunResult:
    """Write, prove, store; on failure write the JSON too, then raise."""
    from commissioning.cli import show
    from commissioning.session.commission import prove_and_store

    with (
        at_desk(screen) as desk,
        act_on(run, desk, screen, job.json_target),
        screen.working("proving"),
    ):
        result = prove_and_store(
            run,
            desk,
            lambda changes: show.proposal(changes, screen),
            without_watchdog=job.without_watchdog,
        )
    show.verification(result, screen)
    return result
