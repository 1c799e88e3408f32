"""tworelay compare RUN RUN, and of fleet runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.fleet.comparing import FleetComparison
    from commissioning.result.found import Quantity
    from commissioning.result.history import Compared, Comparison

__all__ = ["command"]


@click.command("compare", cls=Helpful)
@click.argument("first")
@click.argument("second")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def command(first: str, second: str, as_json: bool) -> None:
    """RUN FIRST and RUN SECOND side by side, or two fleet runs axis by axis.

    Each quantity with its change, and whether the intervals exclude each other; each parameter of
    the drive with what it was and became; and what else was not the same.
    """
    from commissioning.fleet.comparing import compare_fleets, fleet_runs
    from commissioning.history.comparing import compare
    from commissioning.journal import Journal
    from commissioning.result.codec import tree_of
    from commissioning.runs import resolve
    from drivers.home import home

    with Journal(home(), reading=True) as journal:
        pair = fleet_runs(first, second, journal)
        if pair is not None:
            fleets = compare_fleets(*pair)
            if as_json:
                document(json_text(tree_of(fleets)))
            else:
                _show_fleets(fleets)
            return
        results = []
        for run in (first, second):
            run_id, folder = resolve(journal, run)
            results.append(folder.result(folder.history(journal, run_id)))
    found = compare(*results)
    if as_json:
        document(json_text(tree_of(found)))
    else:
        _show(found)


def _show(found: Comparison) -> None:
    from commissioning.result.words import QUANTITY_LABELS

    screen = Screen(None, yes=True)
    labels = {**QUANTITY_LABELS, "low_speed": "friction just above rest"}
    rows = [
        [labels[one.quantity], _value(one.first), _value(one.second), *_verdict(one)]
        for one in found.quantities
    ]
    columns = ["quantity", found.first, found.second, "change", "intervals"]
    if rows:
        screen.table("what was measured", columns, rows)
    else:
        screen.say("neither run measured anything that can be trusted")
    rows = []
    for one in found.parameters:
        rows.append(
            [
                one.parameter, _change(one.first_old, one.first, one.first_state),
                _change(one.second_old, one.second, one.second_state),
                "differs" if one.differs else "same" if one.first == one.second else "",
                one.raw_unit,
            ]
        )  # fmt: skip
    if rows:
        columns = ["parameter", found.first, found.second, "they are", "in steps of"]
        screen.table("parameters of the drive, raw values", columns, rows, of_words=True)
    for remark in found.remarks:
        screen.say(remark)


def _value(found: Quantity | None) -> str:
    from commissioning.result.words import measured, unit

    if found is None:
        return "not measured"
    return f"{measured(found.value, found.low, found.high)} {unit(found.unit)}".strip()


def _verdict(one: Compared) -> list[str]:
    from commissioning.result.words import percent

    change = "" if one.change is None else percent(one.change)
    intervals = {True: "exclude each other", False: "overlap", None: ""}[one.excluded]
    return [change, intervals]


def _change(old: int | None, new: int | None, state: str) -> str:
    if new is None:
        return ""
    before = "" if old is None else f"{old} → "
    return f"{before}{new} ({state})" if state else f"{before}{new}"


def _show_fleets(found: FleetComparison) -> None:
    from commissioning.fleet.comparing import words

    screen = Screen(None, yes=True)
    rows = []
    for axis in found.axes:
        changes = [words(one) for one in axis.quantities]
        rows.append([axis.axis, axis.first, axis.second, "; ".join(changes), axis.parameters])
    columns = ["axis", found.first, found.second, "measured", "parameters"]
    screen.table("fleet runs side by side", columns, rows, of_words=True)
    for remark in found.remarks:
        screen.say(remark)
