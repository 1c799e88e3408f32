"""Two fleet runs side by side, axis by axis."""

from __future__ import annotations

from dataclasses import dataclass

from commissioning.ending import tool
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.view import by_the_ledger
from commissioning.history.comparing import compared
from commissioning.journal import Journal
from commissioning.result.fleet import FleetAxis, FleetResult
from commissioning.result.found import Quantity
from commissioning.result.history import Compared
from commissioning.result.words import percent
from profiles.errors import UnknownName, UsageError

__all__ = ["AxisCompared", "FleetComparison", "compare_fleets", "fleet_runs", "words"]

_QUANTITIES = "coulomb", "offset", "viscous", "inertia"


@dataclass(frozen=True, slots=True)
class AxisCompared:
    """One axis in two fleet runs.

    Attributes
    ----------
    first, second : its state; '' where the run does not have it
    parameters : what is proposed otherwise, in words
    """

    axis: str
    first: str
    second: str
    quantities: tuple[Compared, ...]
    parameters: str


@dataclass(frozen=True, slots=True)
class FleetComparison:
    """Two fleet runs."""

    first: str
    second: str
    axes: tuple[AxisCompared, ...]
    remarks: tuple[str, ...] = ()


def fleet_runs(first: str, second: str, journal: Journal) -> tuple[FleetResult, FleetResult] | None:
    """Both fleet runs of these ids; None where neither is one. Raises UsageError."""
    with Ledger(journal.folder, reading=True) as ledger:
        found = []
        for run in (first, second):
            try:
                known = run != "last" and ledger.record(run).id == run
            except UnknownName:
                known = False
            found.append(by_the_ledger(ledger, run, tool(), journal) if known else None)
    one, other = found
    if one is None and other is None:
        return None
    if one is None or other is None:
        fleet, single = (second, first) if one is None else (first, second)
        raise UsageError(
            f"{fleet} is a fleet run and {single} is none: compare two runs of one kind "
            "('tworelay fleet status' and 'tworelay history' name them)"
        )
    return one, other


def compare_fleets(first: FleetResult, second: FleetResult) -> FleetComparison:
    """The second fleet run against the first."""
    ones = {one.name: one for one in first.axes}
    others = {one.name: one for one in second.axes}
    axes = tuple(_axis(name, ones.get(name), others.get(name)) for name in {**ones, **others})
    remarks = []
    if first.name != second.name:
        remarks.append(f"of two fleets: {first.name} and {second.name}")
    if first.job != second.job:
        remarks.append(f"of two jobs: {first.job} and {second.job}")
    exchanged = [
        name
        for name, one in ones.items()
        if name in others and one.serial and others[name].serial not in (None, one.serial)
    ]
    if exchanged:
        remarks.append(f"another drive: {', '.join(exchanged)}")
    return FleetComparison(first.fleet_run, second.fleet_run, axes, tuple(remarks))


def _axis(name: str, first: FleetAxis | None, second: FleetAxis | None) -> AxisCompared:
    pairs = (compared(name, _of(first, name), _of(second, name)) for name in _QUANTITIES)
    return AxisCompared(
        name,
        str(first.state) if first else "",
        str(second.state) if second else "",
        tuple(one for one in pairs if one is not None),
        _parameters(first, second),
    )


def _of(axis: FleetAxis | None, quantity: str) -> Quantity | None:
    outcome = axis.outcome if axis else None
    found: Quantity | None = getattr(outcome, quantity) if outcome else None
    return found


def _parameters(first: FleetAxis | None, second: FleetAxis | None) -> str:
    """What is proposed otherwise."""
    if not (first and first.outcome and second and second.outcome):
        return ""
    ones = {c.parameter: c.new_raw for c in first.outcome.changes}
    others = {c.parameter: c.new_raw for c in second.outcome.changes}
    differ = [
        f"{name} {ones.get(name, '–')} → {others.get(name, '–')}"
        for name in {**ones, **others}
        if ones.get(name) != others.get(name)
    ]
    return ", ".join(differ) if differ else ("same" if ones else "")


def words(one: Compared) -> str:
    """A quantity of two runs in a few words."""
    if one.change is None:
        return f"{one.quantity} not in both"
    apart = {True: ": outside both intervals", False: "", None: ""}[one.excluded]
    return f"{one.quantity} {percent(one.change)}{apart}"
