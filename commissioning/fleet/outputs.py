"""A fleet run for other programs: JUnit for CI, and a line an axis for a spreadsheet."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from commissioning.result.fleet import FleetAxis, FleetResult, JobState, Outcome
from commissioning.result.words import number
from profiles.plain import plain

__all__ = ["csv_text", "junit_text", "numbers"]

_FAILURES = JobState.FAULT, JobState.REJECTED, JobState.NOT_HELPED
_ERRORS = (
    JobState.REFUSED, JobState.LINK, JobState.WRITE_INCOMPLETE, JobState.STOPPED, JobState.UNKNOWN,
)  # fmt: skip
_COLUMNS = (
    "fleet_run", "axis", "state", "attempt", "why", "link", "serial", "group", "zone", "run",
    "verdict", "began", "ended", "sha256",
)  # fmt: skip
_QUANTITIES = "coulomb", "offset", "viscous", "inertia"


def numbers(outcome: Outcome | None) -> Iterator[tuple[str, float, str]]:
    """What was measured: name, value, unit."""
    if outcome is None:
        return
    for name in _QUANTITIES:
        found = getattr(outcome, name)
        if found is None:
            continue
        yield name, found.value, found.unit
        for end in ("low", "high"):
            if (value := getattr(found, end)) is not None:
                yield f"{name}_{end}", value, found.unit
    if outcome.percent is not None:
        yield "less_error", outcome.percent, "%"


def junit_text(result: FleetResult) -> str:
    """JUnit XML; not done is a failure, not reached is skipped, the rest is an error."""
    from junitparser import (
        Error,
        Failure,
        JUnitXml,
        Properties,
        Property,
        Skipped,
        TestCase,
        TestSuite,
    )

    suite = TestSuite(plain(result.name))
    for one in result.axes:
        outcome = one.outcome
        where = plain(f"{result.name}.{one.group}" if one.group else result.name)
        seconds = outcome.seconds if outcome else 0.0
        case = TestCase(plain(f"{one.name}: {result.job}"), where, seconds)
        why = plain(one.why or str(one.state))
        if one.state in _FAILURES:
            case.result = [Failure(why, str(one.state))]
        elif one.state in _ERRORS:
            case.result = [Error(why, str(one.state))]
        elif one.state is not JobState.DONE:
            case.result = [Skipped(why)]
        found = list(numbers(outcome))
        if found:
            properties = Properties()
            for name, value, unit in found:
                properties.add_property(Property(f"{name} [{unit}]", f"{value:.6g}"))
            case.append(properties)
        lines = [f"{name} {number(value, unit)}" for name, value, unit in found]
        lines += [outcome.ending] if outcome and outcome.ending else []
        case.system_out = plain("; ".join([str(one.state), *lines]))
        suite.add_testcase(case)
    tree = JUnitXml("tworelay")
    tree.add_testsuite(suite)
    tree.update_statistics()
    text: str = tree.tostring().decode()
    return f"<?xml version='1.0' encoding='utf-8'?>\n{text}\n"


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
        writer.writerow([_harmless(cell) for cell in row])
    return stream.getvalue()


def _cell(result: FleetResult, one: FleetAxis, column: str) -> str:
    if column == "fleet_run":
        return result.fleet_run
    if column == "axis":
        return one.name
    source = one.outcome if column in ("run", "verdict", "sha256") else one
    value = getattr(source, column) if source is not None else None
    return "" if value is None else str(value)


def _harmless(cell: str) -> str:
    """A text that no spreadsheet takes for a formula."""
    text = plain(cell)
    is_formula = text[:1] in ("=", "+", "@") or (text[:1] == "-" and not text[1:2].isdigit())
    return f"'{text}" if is_formula else text
