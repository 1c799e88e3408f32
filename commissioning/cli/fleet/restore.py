"""tworelay fleet restore [ID]."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import act_on, at_desk
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import say
from commissioning.cli.terminal import Screen
from profiles.errors import TwoRelayError, UsageError

if TYPE_CHECKING:
    from commissioning.fleet.rows import FleetRecord

__all__ = ["command"]

_SOME = 9


@click.command("restore", cls=Helpful)
@click.argument("run", required=False, default="last", metavar="[ID]")
@click.option("--axis", "axes", multiple=True, metavar="A", help="All that was written to A.")
@click.option("--all", "everything", is_flag=True, help="All that was written to any axis.")
@click.option("--force", is_flag=True, help="Overwrite values that somebody changed since.")
@click.option("--dry-run", is_flag=True, help="Show every write; write nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def command(
    run: str, axes: tuple[str, ...], everything: bool, force: bool, dry_run: bool, yes: bool
) -> None:
    """Finish what was cut off in fleet run ID (default: the last): old values back, axis by axis.

    With --axis or --all also what was written for good. Names the values, and asks.
    """
    from commissioning.cli import show
    from commissioning.ending import of_run
    from commissioning.fleet.afar import on_gateways
    from commissioning.fleet.ledger import Ledger
    from commissioning.fleet.restoring import left_by
    from commissioning.session.restore import restore
    from drivers.home import home

    if axes and everything:
        raise UsageError("--axis and --all exclude each other")
    screen = Screen(None, yes=yes)
    failed = []
    with Ledger(home(), reading=True) as ledger, at_desk(screen) as desk:
        found = left_by(ledger, desk.journal, run, axes, everything=everything)
        record = ledger.record(run)
        elsewhere = on_gateways(record, ledger, axes)
        if not found and not elsewhere:
            screen.say("nothing to restore")
            return
        try:
            failed += _on_gateways(
                record, elsewhere, bool(axes) or everything, screen, force=force, dry_run=dry_run
            )
        except TwoRelayError as error:
            say(f"tworelay: {error}", err=True)
            failed += [name for names in elsewhere.values() for name in names]
        for left in found:
            screen.say(f"{left.axis}:")
            try:
                with act_on(left.run, desk, screen, None):
                    outcome = restore(
                        left.run, None, desk, force=force, dry_run=dry_run,
                        show=lambda rows, drive: show.going_back(rows, drive, screen),
                    )  # fmt: skip
            except TwoRelayError as error:
                if error.exit_code >= 128 or (len(found) == 1 and not elsewhere):
                    raise
                say(f"tworelay: {left.axis}: {error}", err=True)
                failed.append(left.axis)
                continue
            screen.say("dry run: nothing was written" if outcome is None else str(outcome))
            if outcome is not None:
                show.ending(of_run(desk, left.run), screen)
    if failed:
        say(f"tworelay: not restored: {', '.join(dict.fromkeys(failed))}", err=True)
        sys.exit(_SOME)


def _on_gateways(
    record: FleetRecord, axes: dict[str, list[str]], everything: bool, screen: Screen, *,
    force: bool, dry_run: bool,
) -> list[str]:  # fmt: skip
    """What is on other computers is shown, agreed to, and put back there; returns what was not."""
    from commissioning.fleet.afar import note_put_back, put_back_on, reach
    from commissioning.fleet.gateway.messages import Restore

    if not axes:
        return []
    failed = []
    with reach(record) as gateways:
        gateways.meet()
        for gateway, names in axes.items():
            asked = Restore(record.key, tuple(names), "show", everything, force)
            screen.say(f"on gateway '{gateway}':")
            shown = put_back_on(gateways, gateway, asked)
            for line in shown.lines:
                if line != "dry run: nothing was written" or dry_run:
                    screen.say(f"  {line}")
            if shown.lines == ("nothing to restore",) or dry_run:
                continue
            question = f"The values above will be WRITTEN on gateway '{gateway}'."
            if shown.exit_code or not screen.confirm(question, gateway):
                failed += names
                continue
            done = put_back_on(gateways, gateway, replace(asked, act="do"))
            for line in done.lines:
                screen.say(f"  {line}")
            failed += names if done.exit_code else []
            note_put_back(gateways, record, names)
    return failed
