"""tworelay history prune."""

from __future__ import annotations

import re
import time

import click

from commissioning.cli.options import verbose
from commissioning.cli.terminal import Screen, at_desk
from profiles.errors import UsageError

__all__ = ["command"]

_DAY = 86400.0  # s


@click.group("history")
def command() -> None:
    """The runs of this computer."""


@command.command("prune")
@click.option(
    "--before", required=True, metavar="DATE|AGE", help="2026-01-31, or an age in days: 90d."
)
@click.option("--dry-run", is_flag=True, help="Say what would be deleted; delete nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def prune(before: str, dry_run: bool, yes: bool) -> None:
    """Delete the files of old runs: samples, results, reports.

    What was written to which drive stays in the journal; a run with anything to restore keeps its files.
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
