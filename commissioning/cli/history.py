"""tworelay history [AXIS], and history prune."""

from __future__ import annotations

import re
import time
from datetime import datetime
from typing import TYPE_CHECKING

import click

from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text
from commissioning.cli.terminal import Screen, at_desk
from profiles.errors import UsageError

if TYPE_CHECKING:
    from commissioning.session.listed import Listed

__all__ = ["command"]

_DAY = 86400.0  # s


class _RunsOf(click.Group):
    """A group whose own act takes an AXIS.

    A word that is no command of it is the axis of a list.
    """

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.commands:
            return list_runs.name, list_runs, args
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args or (args[0].startswith("-") and args[0] != "--help"):
            args = ["list", *args]
        return super().parse_args(ctx, args)


@click.group("history", cls=_RunsOf)
def command() -> None:
    """The runs of this computer: 'tworelay history [AXIS]' lists them, newest last."""


@command.command("list")
@click.argument("axis", required=False)
@click.option(
    "--most", type=click.IntRange(1), default=30, show_default=True, metavar="N",
    help="Only the last N runs.",
)  # fmt: skip
@click.option("--all", "everything", is_flag=True, help="All of them.")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def list_runs(axis: str | None, most: int, everything: bool, as_json: bool) -> None:
    """The runs (of AXIS) in the order in which they came.

    Verdict, friction, what is in the drive.
    """
    from commissioning.journal import Journal
    from commissioning.result.words import number
    from commissioning.session.listed import runs
    from drivers.home import home

    with Journal(home(), reading=True) as journal:
        found, before = runs(journal, axis, None if everything else most)
        axes = [] if found or axis is None else sorted({one.axis for one in journal.runs()})
    if as_json:
        document(json_text([_tree(one) for one in found]))
        return
    screen = Screen(None, yes=True)
    if not found:
        there = f"; there are: {', '.join(axes)}" if axes else ""
        screen.say("no runs" if axis is None else f"no runs of axis '{axis}'{there}")
        return
    if before:
        screen.say(f"{before} older runs are not shown: --all")
    rows = []
    for one in found:
        f = one.coulomb
        friction = f"{number(f.value, f.unit)} ± {100 * f.half_width:.2g} %" if f else ""
        axis_text = f"{one.axis} (adopted)" if one.adopted else one.axis
        rows.append([one.run, axis_text, one.verdict, friction, one.drive])
    columns = ["run", "axis", "verdict", "friction", "in the drive"]
    screen.table("runs, newest last", columns, rows)


def _tree(one: Listed) -> dict[str, object]:
    """A row for JSON."""
    f = one.coulomb
    began = datetime.fromtimestamp(one.began).astimezone().isoformat(timespec="seconds")
    return {
        "run": one.run, "axis": one.axis, "began": began, "verdict": one.verdict,
        "coulomb": f and {"value": f.value, "low": f.low, "high": f.high, "unit": f.unit},
        "drive": one.drive, "adopted": one.adopted,
    }  # fmt: skip


@command.command("prune")
@click.option(
    "--before", required=True, metavar="DATE|AGE", help="2026-01-31, or an age in days: 90d."
)
@click.option("--dry-run", is_flag=True, help="Say what would be deleted; delete nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def prune(before: str, dry_run: bool, yes: bool) -> None:
    """Delete the files of old runs: samples, results, reports.

    What was written to which drive stays in the journal; a run with anything to restore keeps its
    files.
    """
    from commissioning.session.prune import prune as delete

    instant = _instant(before)
    screen = Screen(None, yes=yes)
    with at_desk(screen) as desk:
        found = delete(instant, desk, dry_run=dry_run)
    verb = "would be deleted" if dry_run else "deleted"
    screen.say(f"files of {len(found.runs)} run(s) {verb}, {found.size / 1e6:.1f} MB")
    for run in found.kept:
        screen.say(
            f"  kept: {run}, which has something to restore, is in progress, or lies elsewhere"
        )


def _instant(text: str) -> float:
    """A date or an age as s since 1970; raises UsageError."""
    age = re.fullmatch(r"([0-9]{1,5})d", text)
    if age is not None:
        return time.time() - int(age[1]) * _DAY
    try:
        return time.mktime(time.strptime(text, "%Y-%m-%d"))
    except (ValueError, OverflowError):
        raise UsageError(
            f"--before {text}: must be a date as 2026-01-31, or an age in days as 90d"
        ) from None
