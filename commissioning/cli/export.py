"""tworelay export RUN DIR."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import say
from profiles.errors import UsageError

if TYPE_CHECKING:
    from commissioning.journal import Journal

__all__ = ["command"]


@click.command("export", cls=Helpful)
@click.argument("words", nargs=-1, required=True, metavar="RUN DIR")
@click.option("--all", "everything", is_flag=True, help="All runs, each to a folder in DIR.")
@verbose
def command(words: tuple[str, ...], everything: bool) -> None:
    """Copy RUN to DIR: result, samples (also as CSV), profile, journal, notes on its axis.

    What was written to a CANopen drive is in changes.dcf, for the maker's own tool.

    The folder can be read as a RUN anywhere; 'tworelay adopt' takes it in, to be applied or
    restored. 'tworelay export --all DIR' is for a home that moves, or is joined to another.
    """
    from commissioning.journal import Journal
    from commissioning.runs import resolve
    from drivers.home import home

    if len(words) != (1 if everything else 2):
        raise click.UsageError("give RUN and DIR, or --all and DIR", click.get_current_context())
    with Journal(home(), reading=True) as journal:
        if everything:
            _all_to(journal, Path(words[0]))
            return
        run_id, source = resolve(journal, words[0])
        for path in source.export(journal, run_id, Path(words[1])):
            say(str(path))


def _all_to(journal: Journal, folder: Path) -> None:
    """Every run that has files; those that have none are told."""
    from commissioning.cli.terminal import Screen
    from commissioning.runs import resolve

    runs, _ = journal.last_runs(None)
    left: list[str] = []
    broken: list[UsageError] = []
    with Screen(None, yes=True).counting("exporting", len(runs)) as told:
        for run in runs:
            told(1)
            try:
                _, source = resolve(journal, run)
            except UsageError:
                left.append(run)
                continue
            try:
                source.export(journal, run, folder / run)
            except UsageError as error:
                broken.append(error)
    say(f"{len(runs) - len(left) - len(broken)} run(s) exported to {folder}")
    if left:
        some = ", ".join(left[:3]) + (" …" if left[3:] else "")
        say(f"{len(left)} have no files any more, and were not: {some}")
    say("fleet runs are no part of it: 'tworelay fleet report' writes theirs")
    for one in broken:
        say(f"not exported: {one}", err=True)
    if broken:
        raise broken[0]
