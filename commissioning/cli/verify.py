"""tworelay verify RUN."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import act_on, at_desk, check_json, on_this_computer, write_json
from commissioning.cli.helping import Helpful
from commissioning.cli.job import CYCLE
from commissioning.cli.junit import junit_option
from commissioning.cli.options import verbose
from commissioning.cli.quantity import POSITION, SPEED
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.result.document import RunResult
    from commissioning.session.verify import Wishes

__all__ = ["command", "prove"]


@click.command("verify", cls=Helpful)
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
@click.option(
    "--check-only", is_flag=True,
    help="Follow the path with what is in the drive now; write nothing for good.",
)  # fmt: skip
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
    check_only: bool,
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
    on_this_computer(run, link)
    if check_only:
        _look_again(run, link, screen, json_target, wishes)
        return
    result = prove(run, link, screen, json_target, wishes)
    write_json(result, json_target)
    show.in_the_drive(result, screen)
    show.ending(result, screen)


def _look_again(
    run: str, link: str | None, screen: Screen, json_target: str | None, wishes: Wishes
) -> None:
    """How the axis follows now, and how it did when it was proved."""
    from commissioning.cli.output import document, json_text
    from commissioning.result.words import now_against_then
    from commissioning.session.verify import follow_as_it_is

    with screen.watching("verify") as watcher, at_desk(screen, watcher=watcher) as desk:
        found, result = follow_as_it_is(run, link, desk, wishes)
    for line in now_against_then(found, result):
        screen.say(line)
    if json_target is not None:
        tree = {
            "run": result.run, "unit": result.units.position,
            "reversal_error": found.reversal_error, "low_speed_error": found.low_speed_error,
            "rest_swing": found.rest_swing, "hunts": found.hunts,
        }  # fmt: skip
        if json_target == "-":
            document(json_text(tree))
        else:
            Path(json_target).write_text(json_text(tree), "utf-8")


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
