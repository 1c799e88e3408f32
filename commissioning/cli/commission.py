"""tworelay commission TARGET."""

from __future__ import annotations

from typing import Any

import click

from commissioning.cli.terminal import Screen, check_json, job_options, write_json
from commissioning.report.words import host_law

__all__ = ["command"]


@click.command("commission")
@click.argument("target")
@job_options
def command(target: str, **arguments: Any) -> None:
    """Identify the axis at TARGET, apply the compensation, prove that it helps, write the report."""
    from commissioning.cli import show
    from commissioning.cli.apply import write
    from commissioning.cli.identify import measure
    from commissioning.cli.report import write_report
    from commissioning.cli.verify import prove

    check_json(arguments["json_target"])
    screen = Screen(arguments["json_target"], yes=arguments["yes"])
    result = measure(target, screen, arguments)
    if not arguments["dry_run"]:
        show.summary(result, screen)
        if result["compensation"]:
            write(result["run"], None, screen, arguments["json_target"])
            try:
                limits = {"without_watchdog": arguments["without_watchdog"]}
                result = prove(result["run"], None, screen, arguments["json_target"], limits)
            finally:
                screen.say(f"report {write_report(result['run'], None)}")
        else:
            screen.say(host_law(result["host_compensation"]))
            screen.say(f"report {write_report(result['run'], None)}")
        screen.say(f"run {result['run']}")
    write_json(result, arguments["json_target"])
