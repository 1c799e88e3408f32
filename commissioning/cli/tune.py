"""tworelay tune TARGET|RUN."""

from __future__ import annotations

from dataclasses import replace

import click

from commissioning.cli.acting import act_on, at_desk, check_json, write_json
from commissioning.cli.helping import Helpful
from commissioning.cli.job import Job, job_options
from commissioning.cli.junit import junit_option
from commissioning.cli.quantity import Measure
from commissioning.cli.targets import is_target
from commissioning.cli.terminal import Screen

__all__ = ["command"]


@click.command("tune", cls=Helpful)
@click.argument("target", metavar="TARGET|RUN")
@click.option(
    "--drive-dead-time", type=Measure("time", low=0, high=0.1), metavar="T",
    help="s, of the drive's own loops, from position sample to torque. Default: the profile's.",
)  # fmt: skip
@click.option(
    "--drive-period", type=Measure("time", low=1e-5, high=0.02), metavar="T",
    help="s, of the drive's own loops. Default: the profile's, else 0.00025.",
)  # fmt: skip
@job_options
@click.pass_context
@junit_option("tune")
def command(
    context: click.Context,
    /,
    target: str,
    drive_dead_time: float | None,
    drive_period: float | None,
    job: Job,
) -> None:
    """Propose gains by every tuning rule, from the distorted point and from the right one.

    RUN takes what was measured. TARGET is measured first, the points at -180 and -135 degrees
    included. Nothing is written: tworelay apply RUN --gains RULE does that.
    """
    from commissioning.cli import show
    from commissioning.cli.identify import measure
    from commissioning.session.tune import DriveLoop, tune_run

    json_target = job.json_target
    check_json(json_target)
    screen = Screen(json_target, yes=job.yes)
    run = target
    if is_target(target):
        with screen.watching("tune") as watcher:
            measured = measure(target, screen, replace(job, points=True), watcher)
        if job.dry_run:
            write_json(measured, json_target)
            return
        show.summary(measured, screen)
        run = str(measured.run)
    else:
        _only_for_targets(context)
    drive = DriveLoop(drive_dead_time, drive_period)
    with (
        at_desk(screen) as desk,
        act_on(run, desk, screen, json_target),
        screen.working("every rule on the identified axis"),
    ):
        result, notes = tune_run(run, drive, desk)
    write_json(result, json_target)
    show.tuning(result, screen)
    for note in notes:
        screen.say(note)
    for found in result.tuning:
        if found.best and found.parameters:
            screen.say(f"to write it: tworelay apply {result.run} --gains {found.rule}")
    show.ending(result, screen)


_OF_A_RUN = {"target", "drive_dead_time", "drive_period", "json_target", "junit", "yes", "verbose"}


def _only_for_targets(context: click.Context) -> None:
    """Raise UsageError for options of a measurement where a measured run is tuned."""
    from profiles.errors import UsageError

    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if name not in _OF_A_RUN and source is click.core.ParameterSource.COMMANDLINE:
            raise UsageError(
                f"{parameter.opts[0]} is for a TARGET that is measured first; a RUN was measured "
                "already"
            )
