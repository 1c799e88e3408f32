"""tworelay identify TARGET."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from commissioning.cli.junit import junit_option
from commissioning.cli.terminal import (
    Job,
    Screen,
    at_desk,
    check_json,
    job_options,
    write_json,
)
from profiles.errors import UsageError

if TYPE_CHECKING:
    from commissioning.result.document import RunResult

__all__ = ["command", "measure"]


@click.command("identify")
@click.argument("target")
@job_options
@junit_option("identify")
def command(target: str, job: Job) -> None:
    """Measure the friction of the axis at TARGET; change nothing for good."""
    from commissioning.cli import show

    check_json(job.json_target)
    screen = Screen(job.json_target, yes=job.yes)
    result = measure(target, screen, job)
    write_json(result, job.json_target)
    if job.dry_run:
        return
    show.summary(result, screen)
    show.outcome(result, screen)
    show.ending(result, screen)


def measure(target: str, screen: Screen, job: Job, *, writes: bool = False) -> RunResult:
    """Run the experiments; on failure write the JSON too, then raise.

    `writes` : what is found will be written at once
    """
    from commissioning.cli import show
    from commissioning.cli.tracing import tracer
    from commissioning.rig.armed import Failure
    from commissioning.session.identify import identify

    axis, options = job.axis(target), replace(job.options(), writes=writes)
    with tracer(job.trace, axis.link) as trace, at_desk(screen, trace) as desk:
        try:
            with screen.working(f"{axis.name}: measuring"):
                return identify(axis, options, desk)
        except Failure as failure:
            if failure.error.exit_code >= 3:
                with contextlib.suppress(UsageError):  # the first error is the one to be told
                    write_json(failure.result, job.json_target)
                show.ending(failure.result, screen)
            raise failure.error from None
