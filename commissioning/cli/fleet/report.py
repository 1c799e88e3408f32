"""tworelay fleet report [ID]."""

from __future__ import annotations

import click

from commissioning.cli.fleet.run import check_outputs, write_outputs
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import say
from profiles.errors import UsageError

__all__ = ["command"]


@click.command("report", cls=Helpful)
@click.argument("run", required=False, default="last", metavar="[ID]")
@click.option("--junit", metavar="F", help="JUnit XML to F.")
@click.option("--json", "json_target", metavar="F", help="tworelay.fleet/1 to F.")
@click.option("--csv", "csv_target", metavar="F", help="A line an axis to F.")
@verbose
def command(run: str, junit: str | None, json_target: str | None, csv_target: str | None) -> None:
    """Write the page and the acceptance record of fleet run ID (default: the last); name them."""
    from commissioning.ending import tool
    from commissioning.fleet.ledger import Ledger
    from commissioning.fleet.pages import Pages, folder_of
    from commissioning.fleet.view import by_the_ledger
    from commissioning.journal import Journal
    from drivers.home import home

    check_outputs(junit, json_target, csv_target)
    with Ledger(home(), reading=True) as ledger, Journal(home(), reading=True) as journal:
        result = by_the_ledger(ledger, run, tool(), journal)
    written = Pages().write(result)
    if not written:
        raise UsageError(f"{folder_of(result.fleet_run)}: cannot be written to")
    write_outputs(result, junit, json_target, csv_target)
    if json_target != "-":
        for path in written:
            say(str(path))
