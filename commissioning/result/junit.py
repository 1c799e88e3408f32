"""JUnit XML for CI: not done is a failure, not reached is skipped, the rest is an error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from commissioning.result.document import RunResult
from commissioning.result.found import QUANTITIES, Quantity
from commissioning.result.words import number
from profiles.plain import plain

__all__ = ["FAILURES", "Case", "Number", "case_of_exit", "junit_text", "numbers_of_run", "spread"]

Number = tuple[str, float, str]  # name, value, unit
FAILURES = 5, 6, 8  # exit codes that say something of the axis, and not of the way to it


@dataclass(frozen=True, slots=True)
class Case:
    """One axis and what was done to it.

    Attributes
    ----------
    where : machine.group
    kind : code or state of what is not passed
    lines : what else is to be read, on standard output
    """

    name: str
    where: str
    outcome: Literal["passed", "failure", "error", "skipped"]
    seconds: float = 0.0
    kind: str = ""
    message: str = ""
    numbers: Sequence[Number] = ()
    lines: Sequence[str] = ()


def case_of_exit(exit_code: int) -> Literal["passed", "failure", "error"]:
    """What an exit code is for CI."""
    if not exit_code:
        return "passed"
    return "failure" if exit_code in FAILURES else "error"


def spread(name: str, found: Quantity) -> Iterator[Number]:
    """A quantity and the ends of its interval."""
    yield name, found.value, found.unit
    for end in ("low", "high"):
        if (value := getattr(found, end)) is not None:
            yield f"{name}_{end}", value, found.unit


def numbers_of_run(result: RunResult) -> Iterator[Number]:
    """What a run measured, and by how much its proof says that it helps."""
    for name in QUANTITIES:
        if (found := result.friction.quantity(name)) is not None:
            yield from spread(name, found)
    if result.verification is not None and result.verification.percent is not None:
        yield "less_error", result.verification.percent, "%"


def junit_text(suite: str, cases: Sequence[Case]) -> str:
    """The cases as a suite."""
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

    made = TestSuite(plain(suite))
    for one in cases:
        case = TestCase(plain(one.name), plain(one.where), one.seconds)
        why = plain(one.message or one.kind)
        if one.outcome == "failure":
            case.result = [Failure(why, plain(one.kind))]
        elif one.outcome == "error":
            case.result = [Error(why, plain(one.kind))]
        elif one.outcome == "skipped":
            case.result = [Skipped(why)]
        if one.numbers:
            properties = Properties()
            for name, value, unit in one.numbers:
                properties.add_property(Property(f"{name} [{unit}]", f"{value:.6g}"))
            case.append(properties)
        lines = [f"{name} {number(value, unit)}" for name, value, unit in one.numbers]
        case.system_out = plain("; ".join([*one.lines[:1], *lines, *one.lines[1:]]))
        made.add_testcase(case)
    tree = JUnitXml("tworelay")
    tree.add_testsuite(made)
    tree.update_statistics()
    text: str = tree.tostring().decode()
    return f"<?xml version='1.0' encoding='utf-8'?>\n{text}\n"
