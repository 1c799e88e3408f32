"""tworelay apply RUN."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import act_on, at_desk, check_json, on_this_computer, write_json
from commissioning.cli.helping import Helpful
from commissioning.cli.junit import junit_option
from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.result.changes import Change
    from commissioning.result.document import RunResult

__all__ = ["command", "write"]


@click.command("apply", cls=Helpful)
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
@junit_option("apply")
def command(
    run: str, link: str | None, gains: str | None, yes: bool, json_target: str | None
) -> None:
    """Write what RUN proposed, read it back, and store it in the drive."""
    from commissioning.cli import show

    check_json(json_target)
    screen = Screen(json_target, yes=yes)
    on_this_computer(run, link)
    result = write(run, link, screen, json_target, gains)
    write_json(result, json_target)
    show.in_the_drive(result, screen)
    show.ending(result, screen)


def write(
    run: str,
    link: str | None,
    screen: Screen,
    json_target: str | None,
    gains: str | None = None,
) -> RunResult:
    """Apply with the proposal shown; on failure write the JSON too, then raise."""
    from commissioning.cli import show
    from commissioning.ending import of_run
    from commissioning.runs import resolve
    from commissioning.session.apply import apply

    with at_desk(screen) as desk, act_on(run, desk, screen, json_target):

        def to_write(changes: Sequence[Change]) -> None:
            show.found(of_run(desk, resolve(desk.journal, run)[0]), screen)
            show.proposal(changes, screen)

        return apply(run, link, desk, to_write, gains)
