"""The judge of tests in real time: a failure counts unless this computer was late, thrice."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import pytest

from tests.punctual import TRIES, judged
from tests.witness import Lateness, witnesses

PUNCTUAL, LATE = Lateness(0.0001, 0.001), Lateness(0.02, 0.001)


class Scripted:
    """A witness that says what it is told to, alternately before and after a try."""

    def __init__(self, *said: Lateness) -> None:
        self._said: Iterator[Lateness] = iter(said)
        self._before = True

    def lateness(self) -> Lateness:
        self._before, before = not self._before, self._before
        return PUNCTUAL if before else next(self._said)


class Tries:
    """A test that fails and passes as it is told to."""

    def __init__(self, *outcomes: str) -> None:
        self.count, self._outcomes = 0, outcomes

    def __call__(self) -> list[pytest.TestReport]:
        outcome = cast("Any", self._outcomes[self.count])
        self.count += 1
        where = ("tests/x.py", 3, "test_x")
        return [pytest.TestReport("tests/x.py::test_x", where, {}, outcome, None, "call")]


def test_a_failure_on_a_punctual_computer_counts_at_once() -> None:
    tries = Tries("failed", "passed")
    (report,) = judged(tries, Scripted(PUNCTUAL))
    assert report.failed
    assert tries.count == 1


def test_a_failure_on_a_late_computer_is_tried_again() -> None:
    tries = Tries("failed", "passed")
    (report,) = judged(tries, Scripted(LATE, LATE))
    assert report.passed
    assert tries.count == 2


def test_what_fails_thrice_on_a_late_computer_is_skipped_with_the_lateness() -> None:
    tries = Tries(*["failed"] * 5)
    (report,) = judged(tries, Scripted(LATE, LATE, LATE))
    assert tries.count == TRIES == 3
    assert report.skipped
    assert isinstance(report.longrepr, tuple)
    assert "late by 20 ms at real-time priority" in report.longrepr[2]


def test_the_last_try_counts_where_the_computer_was_punctual_then() -> None:
    (report,) = judged(Tries(*["failed"] * 3), Scripted(LATE, LATE, PUNCTUAL))
    assert report.failed


def test_the_witnesses_tell_the_lateness_since_they_were_asked() -> None:
    with witnesses() as found:
        first, second = found.lateness(), found.lateness()
    for late in (first, second):
        assert 0 <= late.urgent < 60
        assert 0 <= late.ordinary < 60
    assert Lateness(0.0, 1.0).too_late
    assert not Lateness(0.001, 0.02).too_late
