"""tworelay identify TARGET."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import at_desk, check_json, write_json
from commissioning.cli.helping import Helpful
from commissioning.cli.job import Job, job_options
from commissioning.cli.junit import junit_option
from commissioning.cli.terminal import Screen
from profiles.errors import UsageError

if TYPE_CHECKING:
    from commissioning.result.document import RunResult
    from commissioning.watching import Watcher

__all__ = ["command", "measure"]


@click.command("identify", cls=Helpful)
@click.argument("target")
@job_options
@junit_option("identify")
def command(target: str, job: Job) -> None:
    """Measure the friction of the axis at TARGET; change nothing for good."""
    from commissioning.cli import show

    check_json(job.json_target)
    screen = Screen(job.json_target, yes=job.yes)
    with screen.watching("identify") as watcher:
        result = measure(target, screen, job, watcher)
    write_json(result, job.json_target)
    if job.dry_run:
        return
    show.summary(result, screen)
    show.outcome(result, screen)
    show.ending(result, screen)


def measure(
    target: str, screen: Screen, job: Job, watcher: Watcher, *, writes: bool = False
) -> RunResult:
    """Run the experiments; on failure write the JSON too, then raise.

    `writes` : what is found will be written at once
    """
    from commissioning.cli import show
    from commissioning.cli.tracing import tracer
    from commissioning.rig.armed import Failure
    from commissioning.session.identify import identify

    axis, options = job.axis(target), replace(job.options(), writes=writes)
    with tracer(job.trace, axis.link) as trace, at_desk(screen, trace, watcher=watcher) as desk:
        try:
            return identify(axis, options, desk)
        except Failure as failure:
            if failure.error.exit_code >= 3:
                with contextlib.suppress(UsageError):  # the first error is the one to be told
                    write_json(failure.result, job.json_target)
                show.ending(failure.result, screen)
            raise failure.error from None
