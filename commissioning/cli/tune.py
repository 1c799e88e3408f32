"""tworelay tune TARGET|RUN."""

from __future__ import annotations

from typing import Any

import click

from commissioning.cli.terminal import (
    Finite,
    Screen,
    at_desk,
    check_json,
    job_options,
    write_json,
)

__all__ = ["command"]


@click.command("tune")
@click.argument("target", metavar="TARGET|RUN")
@click.option(
    "--drive-dead-time", type=Finite(0), metavar="S",
    help="s, of the drive's own loops, from position sample to torque. Default: the profile's.",
)  # fmt: skip
@click.option(
    "--drive-period", type=Finite(0, min_open=True), metavar="S",
    help="s, of the drive's own loops. Default: the profile's, else 0.00025.",
)  # fmt: skip
@job_options
def command(
    target: str, drive_dead_time: float | None, drive_period: float | None, **arguments: Any
) -> None:
    """Propose gains by every tuning rule, from the distorted point and from the right one.

    RUN takes what was measured. TARGET is measured first, the points at -180 and -135 degrees
    included. Nothing is written: tworelay apply RUN --gains RULE does that.
    """
    from commissioning.cli import show
    from commissioning.cli.identify import measure
    from commissioning.session.tune import DriveLoop, tune_run

    json_target = arguments["json_target"]
    check_json(json_target)
    screen = Screen(json_target, yes=arguments["yes"])
    run = target
    if "://" in target or target.endswith(".toml"):
        measured = measure(target, screen, {**arguments, "points": True})
        if arguments["dry_run"]:
            write_json(measured, json_target)
            return
        show.summary(measured, screen)
        run = measured["run"]
    with at_desk(screen) as desk, screen.working("every rule on the identified axis"):
        result, notes = tune_run(run, DriveLoop(drive_dead_time, drive_period), desk)
    write_json(result, json_target)
    show.tuning(result, screen)
    for note in notes:
        screen.say(note)
    for found in result["tuning"]:
        if found["best"] and found["parameters"]:
            screen.say(f"to write it: tworelay apply {result['run']} --gains {found['rule']}")
    screen.say(f"run {result['run']}")
