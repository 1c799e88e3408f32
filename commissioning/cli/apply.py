"""tworelay apply RUN."""

from __future__ import annotations

from typing import Any

import click

from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, at_desk, check_json, failure_in_json, write_json

__all__ = ["command", "write"]


@click.command("apply")
@click.argument("run")
@click.option("--link", help="Reach the drive by this LINK instead of the run's own.")
@click.option(
    "--gains",
    metavar="RULE",
    help="Write the gains of the drive's own loops by this rule, too (tworelay tune).",
)
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@click.option(
    "--json", "json_target", metavar="F", help="Result as JSON to F, '-' for standard output."
)
@verbose
def command(
    run: str, link: str | None, gains: str | None, yes: bool, json_target: str | None
) -> None:
    """Write what RUN proposed, read it back, and store it in the drive."""
    check_json(json_target)
    screen = Screen(json_target, yes=yes)
    result = write(run, link, screen, json_target, gains)
    write_json(result, json_target)
    screen.say(f"run {result['run']}: written. To take it back: tworelay restore {result['run']}")


def write(
    run: str,
    link: str | None,
    screen: Screen,
    json_target: str | None,
    gains: str | None = None,
) -> dict[str, Any]:
    """Apply with the proposal shown; on failure write the JSON too, then raise."""
    from commissioning.cli import show
    from commissioning.session.apply import apply

    with at_desk(screen) as desk, failure_in_json(desk, run, json_target):
        return apply(run, link, desk, lambda items: show.proposal(items, screen), gains)
