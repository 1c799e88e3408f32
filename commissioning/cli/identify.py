"""tworelay identify TARGET."""

from __future__ import annotations

import contextlib
from typing import Any

import click

from commissioning.cli.terminal import (
    Screen,
    at_desk,
    axis_from,
    check_json,
    job_options,
    options_from,
    write_json,
)
from profiles.errors import UsageError

__all__ = ["command", "measure"]


@click.command("identify")
@click.argument("target")
@job_options
def command(target: str, **arguments: Any) -> None:
    """Measure the friction of the axis at TARGET; change nothing for good."""
    from commissioning.cli import show

    check_json(arguments["json_target"])
    screen = Screen(arguments["json_target"], yes=arguments["yes"])
    result = measure(target, screen, arguments)
    write_json(result, arguments["json_target"])
    if arguments["dry_run"]:
        return
    show.summary(result, screen)
    show.outcome(result, screen)


def measure(target: str, screen: Screen, arguments: dict[str, Any]) -> dict[str, Any]:
    """Run the experiments; on failure write the JSON too, then raise."""
    from commissioning.cli.tracing import tracer
    from commissioning.session.armed import Failure
    from commissioning.session.identify import identify

    axis = axis_from(target, arguments["profile"])
    if arguments["watchdog"] is not None:
        limits = axis.limits.model_copy(update={"watchdog": arguments["watchdog"]})
        axis = axis.model_copy(update={"limits": limits})
    options = options_from(arguments)
    with tracer(arguments["trace"], axis.link) as trace, at_desk(screen, trace) as desk:
        try:
            with screen.working(f"{axis.name}: measuring"):
                return identify(axis, options, desk)
        except Failure as failure:
            if failure.error.exit_code >= 3:
                with contextlib.suppress(UsageError):  # the first error is the one to be told
                    write_json(failure.result, arguments["json_target"])
                if failure.result["run"]:
                    screen.say(f"run {failure.result['run']}")
            raise failure.error from None
