"""tworelay fleet status [ID]."""

from __future__ import annotations

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document
from commissioning.cli.terminal import Screen
from profiles.errors import TwoRelayError

__all__ = ["command"]


@click.command("status", cls=Helpful)
@click.argument("run", required=False, default="last", metavar="[ID]")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def command(run: str, as_json: bool) -> None:
    """Where the fleet run ID is, by its ledger (default: the last)."""
    from commissioning.cli.fleet.screen import final_table
    from commissioning.ending import tool
    from commissioning.fleet.afar import bring_up_to_date
    from commissioning.fleet.ledger import Ledger
    from commissioning.fleet.view import by_the_ledger
    from commissioning.journal import Journal
    from commissioning.result.fleet_codec import fleet_text
    from drivers.home import home

    moving: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    try:
        moving = bring_up_to_date(run)
    except TwoRelayError as error:
        left = (f"its gateways could not be asked: {error}",)
    with Ledger(home(), reading=True) as ledger, Journal(home(), reading=True) as journal:
        result = by_the_ledger(ledger, run, tool(), journal, moving)
    if as_json:
        document(fleet_text(result))
        return
    screen = Screen(None, yes=True)
    final_table(result, screen)
    screen.say(f"fleet run {result.fleet_run} of {result.file}")
    for note in (*left, *result.notes):
        screen.say(note)
