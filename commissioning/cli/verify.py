"""tworelay verify RUN."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import act_on, at_desk, check_json, write_json
from commissioning.cli.job import CYCLE
from commissioning.cli.junit import junit_option
from commissioning.cli.options import verbose
from commissioning.cli.quantity import POSITION, SPEED
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.result.document import RunResult
    from commissioning.session.verify import Wishes

__all__ = ["command", "prove"]


@click.command("verify")
@click.argument("run")
@click.option("--link", help="Reach the drive by this LINK instead of the run's own.")
@click.option(
    "--travel",
    type=POSITION,
    metavar="±X",
    help="Room about the present position: '±180 deg', '20mm'; default: the run's.",
)
@click.option(
    "--max-speed", type=SPEED, metavar="X", help="'300 rpm', '20 mm/s'; default: the run's."
)
@click.option("--cycle", type=CYCLE, metavar="T", help="Of the exchange: '4ms'.")
@click.option("--without-watchdog", is_flag=True, help="As in identify.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@click.option(
    "--json", "json_target", metavar="F", help="Result as JSON to F, '-' for standard output."
)
@verbose
@junit_option("verify")
def command(
    run: str,
    link: str | None,
    travel: float | None,
    max_speed: float | None,
    cycle: float | None,
    without_watchdog: bool,
    yes: bool,
    json_target: str | None,
) -> None:
    """Prove that RUN's compensation helps: the axis follows a slow motion without and with it.

    The compensation is raised in steps; the last one without harm stays in the drive and is stored,
    or none.
    """
    from commissioning.cli import show
    from commissioning.session.verify import Wishes

    check_json(json_target)
    screen = Screen(json_target, yes=yes)
    wishes = Wishes(travel, max_speed, cycle, without_watchdog)
    result = prove(run, link, screen, json_target, wishes)
    write_json(result, json_target)
    show.in_the_drive(result, screen)
    show.ending(result, screen)


def prove(
    run: str, link: str | None, screen: Screen, json_target: str | None, wishes: Wishes
) -> RunResult:
    """Verify with the outcome shown; on failure write the JSON too, then raise."""
    from commissioning.cli import show
    from commissioning.session.verify import verify

    with (
        screen.watching("verify") as watcher,
        at_desk(screen, watcher=watcher) as desk,
        act_on(run, desk, screen, json_target),
    ):
        result = verify(run, link, desk, wishes)
    show.verification(result, screen)
    return result
