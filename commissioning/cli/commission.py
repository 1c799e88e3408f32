"""tworelay commission TARGET."""

from __future__ import annotations

from typing import Any

import click

from commissioning.cli.terminal import (
    Screen,
    at_desk,
    axis_from,
    check_json,
    failure_in_json,
    job_options,
    write_json,
)
from commissioning.report.words import host_law

__all__ = ["command"]


@click.command("commission")
@click.argument("target")
@job_options
def command(target: str, **arguments: Any) -> None:
    """Identify the axis at TARGET, apply the compensation, prove that it helps, write the report.

    The compensation is stored once it is proved; else the drive is left as it was found.
    """
    from commissioning.cli import show
    from commissioning.cli.identify import measure
    from commissioning.cli.report import say_report
    from commissioning.ownership import owned

    check_json(arguments["json_target"])
    screen = Screen(arguments["json_target"], yes=arguments["yes"])
    axis = axis_from(target, arguments["profile"])
    with owned(axis.link or "virtual://", "commission"):  # from the first step to the last
        result = measure(target, screen, arguments)
        if arguments["dry_run"]:
            write_json(result, arguments["json_target"])
            return
        show.summary(result, screen)
        try:
            if result["compensation"]:
                result = _prove(result["run"], screen, arguments)
            else:
                screen.say(host_law(result["host_compensation"]))
        finally:
            say_report(result["run"], screen)
    screen.say(f"run {result['run']}")
    write_json(result, arguments["json_target"])


def _prove(run: str, screen: Screen, arguments: dict[str, Any]) -> dict[str, Any]:
    """Write, prove, store; on failure write the JSON too, then raise."""
    from commissioning.cli import show
    from commissioning.session.commission import prove_and_store

    limits = {"without_watchdog": arguments["without_watchdog"]}
    with (
        at_desk(screen) as desk,
        failure_in_json(desk, run, arguments["json_target"]),
        screen.working("proving"),
    ):
        result = prove_and_store(run, desk, lambda items: show.proposal(items, screen), limits)
    show.verification(result, screen)
    return result
