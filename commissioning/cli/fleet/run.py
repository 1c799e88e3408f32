"""tworelay fleet run FLEET."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import click

from commissioning.cli.acting import check_json
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, say
from commissioning.cli.terminal import Screen
from profiles.errors import TwoRelayError, UsageError

if TYPE_CHECKING:
    from commissioning.fleet.plan import Fleet
    from commissioning.fleet.running import FleetWishes
    from commissioning.result.fleet import FleetJob, FleetResult

__all__ = ["Outputs", "check_outputs", "command", "conduct", "run_options", "write_outputs"]

_NOTHING_STARTED = 3

_OPTIONS = [
    click.option("--job", type=click.Choice(["identify", "commission", "verify"]),
                 help="Instead of the file's."),
    click.option("--only", metavar="EXPR",
                 help="Names and globs, group=G, zone=Z, gateway=W, with commas; !X leaves X out."),
    click.option("--at-once", type=click.IntRange(1, 64), metavar="N",
                 help="Axes at once, at most."),
    click.option("--junit", metavar="F", help="JUnit XML to F."),
    click.option("--json", "json_target", metavar="F",
                 help="tworelay.fleet/1 to F, '-' for standard output."),
    click.option("--csv", "csv_target", metavar="F", help="A line an axis to F."),
]  # fmt: skip


def run_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options of a run and of its rehearsal."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@click.command("run", cls=Helpful)
@click.argument("fleet", type=click.Path(path_type=Path))
@run_options
@click.option("--resume", is_flag=False, flag_value="last", metavar="[ID]",
              help="Go on with a run that was left: what was not started.")  # fmt: skip
@click.option("--again", multiple=True, metavar="failed|AXIS", help="A new attempt at these.")
@click.option("--dry-run", is_flag=True, help="Show every write; write and move nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def command(
    fleet: Path,
    job: FleetJob | None,
    only: str | None,
    at_once: int | None,
    resume: str | None,
    again: tuple[str, ...],
    dry_run: bool,
    yes: bool,
    junit: str | None,
    json_target: str | None,
    csv_target: str | None,
) -> None:
    """Do the job of FLEET: look at all its axes, ask, move each once, say how it went.

    What moves is asked for as the file says. Ctrl-C: what runs is finished, nothing more starts;
    once more stops it.
    """
    from commissioning.cli.fleet.check import looked_at
    from commissioning.fleet.loading import load_fleet
    from commissioning.fleet.running import FleetWishes

    check_outputs(junit, json_target, csv_target)
    if resume is not None and again:
        raise UsageError("--resume and --again exclude each other: first the one, then the other")
    if dry_run and (resume is not None or again):
        raise UsageError("--dry-run looks at what a new run would do: without --resume and --again")
    screen = Screen("-" if "-" in (junit, json_target, csv_target) else None, yes=False)
    plan = load_fleet(fleet, job)
    terminal = sys.stdin is not None and sys.stdin.isatty()
    wishes = FleetWishes(only, at_once, resume, again, yes, terminal, job)
    if dry_run:
        sys.exit(looked_at(plan, wishes, screen, json_target, with_writes=True))
    conduct(plan, wishes, screen, Outputs(junit, json_target, csv_target))


class Outputs(NamedTuple):
    """Where other programs read."""

    junit: str | None
    json: str | None
    csv: str | None


def check_outputs(junit: str | None, json_target: str | None, csv_target: str | None) -> None:
    """See before anything is done that all can be written; raises UsageError."""
    for target, option in ((junit, "--junit"), (json_target, "--json"), (csv_target, "--csv")):
        check_json(target, option)
    if [junit, json_target, csv_target].count("-") > 1:
        raise UsageError("standard output takes one of --junit, --json and --csv")


def conduct(plan: Fleet, wishes: FleetWishes, screen: Screen, outputs: Outputs) -> NoReturn:
    """Run it, write its files, show its table, exit; what ended it early is raised then."""
    from commissioning.cli.fleet.screen import FleetScreen, final_table
    from commissioning.ending import tool
    from commissioning.fleet.pages import Pages
    from commissioning.fleet.running import run
    from commissioning.fleet.view import not_begun, ways_on
    from commissioning.interruption import Interruption

    pages = Pages()
    people = FleetScreen(screen, pages.show)

    def opened(run_id: str) -> None:
        pages.open(run_id)
        people.tell(f"fleet run {run_id}: {pages.going}")

    with Interruption() as interruption, interruption.deferred():
        try:
            with people.living():
                result, error = run(plan, wishes, people, interruption, opened)
        except TwoRelayError as refused:
            if refused.exit_code >= _NOTHING_STARTED:
                write_outputs(not_begun(plan, str(refused), tool()), *outputs)
                refused.__dict__["in_junit"] = True
            raise
        final_table(result, screen)
        for path in pages.write(result):
            screen.say(str(path))
        for line in ways_on(result):
            screen.say(line)
        write_outputs(result, *outputs)
        if error is not None:
            error.__dict__["in_junit"] = True
            raise error
    if not any(axis.began for axis in result.axes):
        sys.exit(_NOTHING_STARTED)
    sys.exit(result.exit_code)


def write_outputs(
    result: FleetResult, junit: str | None, json_target: str | None, csv_target: str | None
) -> None:
    """What other programs read; a file that cannot be written is told, and ends nothing."""
    from commissioning.fleet.outputs import csv_text, junit_of
    from commissioning.result.fleet_codec import fleet_text

    for option, target, text in (
        ("--json", json_target, fleet_text),
        ("--junit", junit, junit_of),
        ("--csv", csv_target, csv_text),
    ):
        if target == "-":
            document(text(result))
        if target is None or target == "-":
            continue
        try:
            Path(target).write_text(text(result), "utf-8")
        except OSError as error:
            say(
                f"tworelay: {option} {target}: cannot be written: {error.strerror}; 'tworelay "
                f"fleet report {result.fleet_run}' keeps the result",
                err=True,
            )
