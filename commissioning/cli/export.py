"""tworelay export RUN DIR."""

from __future__ import annotations

from pathlib import Path

import click

from commissioning.cli.options import verbose
from commissioning.cli.output import say

__all__ = ["command"]


@click.command("export")
@click.argument("run")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@verbose
def command(run: str, folder: Path) -> None:
    """Copy RUN to FOLDER: result, samples (also as CSV), profile, journal.

    What was written to a CANopen drive is in changes.dcf, for the maker's own tool.

    The folder can be read as a RUN anywhere; 'tworelay adopt' takes it in, to be applied or
    restored.
    """
    from commissioning.journal import Journal
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home(), reading=True) as journal:
        run_id, source = resolve(journal, run)
        for path in source.export(journal, run_id, folder):
            say(str(path))
