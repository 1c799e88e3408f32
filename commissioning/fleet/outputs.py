"""A fleet run for other programs: JUnit for CI, and a line an axis for a spreadsheet."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from typing import Literal

from commissioning.result.fleet import FleetAxis, FleetResult, JobState, Outcome
from commissioning.result.junit import Case, Number, junit_text, spread
from profiles.plain import harmless_cell

__all__ = ["csv_text", "junit_of", "numbers"]

_FAILURES = JobState.FAULT, JobState.REJECTED, JobState.NOT_HELPED
_ERRORS = (
    JobState.REFUSED, JobState.LINK, JobState.WRITE_INCOMPLETE, JobState.STOPPED, JobState.UNKNOWN,
)  # fmt: skip
_COLUMNS = (
    "fleet_run", "axis", "state", "attempt", "why", "gateway", "link", "serial", "group", "zone",
    "run", "verdict", "began", "ended", "sha256",
)  # fmt: skip
_QUANTITIES = "coulomb", "offset", "viscous", "inertia"


def numbers(outcome: Outcome | None) -> Iterator[Number]:
    """What was measured: name, value, unit."""
    if outcome is None:
        return
    for name in _QUANTITIES:
        if (found := getattr(outcome, name)) is not None:
            yield from spread(name, found)
    if outcome.percent is not None:
        yield "less_error", outcome.percent, "%"


def junit_of(result: FleetResult) -> str:
    """JUnit XML of a fleet run, a case an axis."""
    return junit_text(result.name, [_case(result, one) for one in result.axes])


def _case(result: FleetResult, one: FleetAxis) -> Case:
    outcome = one.outcome
    kind: Literal["passed", "failure", "error", "skipped"] = "skipped"
    if one.state is JobState.DONE:
        kind = "passed"
    elif one.state in (*_FAILURES, *_ERRORS):
        kind = "failure" if one.state in _FAILURES else "error"
    ending = [outcome.ending] if outcome and outcome.ending else []
    return Case(
        f"{one.name}: {result.job}",
        f"{result.name}.{one.group}" if one.group else result.name,
        kind,
        outcome.seconds if outcome else 0.0,
        str(one.state),
        one.why or str(one.state),
        tuple(numbers(outcome)),
        (str(one.state), *ending),
    )


def csv_text(result: FleetResult) -> str:
    """One line an axis, with a head; SI units, which the head names."""
    names = list(dict.fromkeys(name for one in result.axes for name, _, _ in numbers(one.outcome)))
    stream = io.StringIO()
    writer = csv.writer(stream)
    writer.writerow([*_COLUMNS, *(part for name in names for part in (name, f"{name}_unit"))])
    for one in result.axes:
        found = {name: (f"{value:.9g}", unit) for name, value, unit in numbers(one.outcome)}
        row = [_cell(result, one, column) for column in _COLUMNS]
        row += [part for name in names for part in found.get(name, ("", ""))]
        writer.writerow([harmless_cell(cell) for cell in row])
    return stream.getvalue()


def _cell(result: FleetResult, one: FleetAxis, column: str) -> str:
    if column == "fleet_run":
        return result.fleet_run
    if column == "axis":
        return one.name
    source = one.outcome if column in ("run", "verdict", "sha256") else one
    value = getattr(source, column) if source is not None else None
    return "" if value is None else str(value)
