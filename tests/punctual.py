"""Tests in real time.

A failure counts only where this computer kept its promise to wake them in time.

Where it did not, the test is repeated, at most three times in all, then skipped with the lateness.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Protocol

import pytest
from _pytest.runner import runtestprotocol

from tests.witness import Lateness, witnesses

__all__ = ["Punctual", "real_time"]

real_time = pytest.mark.real_time
TRIES, FOLDER = 3, "tests/job/"


class Witness(Protocol):
    """What is asked after each try."""

    def lateness(self) -> Lateness:
        """Since this was asked before."""


Try = Callable[[], list[pytest.TestReport]]


def judged(attempt: Try, witness: Witness) -> list[pytest.TestReport]:
    """Reports of the first try that counts; of the last one, as skipped, where none does."""
    for _ in range(TRIES):
        witness.lateness()
        reports = attempt()
        if not any(report.failed for report in reports):
            return reports
        late = witness.lateness()
        if not late.too_late:
            return reports
    for report in reports:
        if report.failed:
            report.outcome = "skipped"
            report.longrepr = (
                str(report.fspath),
                report.location[1] or 0,
                f"{TRIES} times: {late}",
            )
    return reports


class Punctual:
    """The plugin: it runs the tests marked `real_time`."""

    def __init__(self) -> None:
        self._witness: Witness | None = None
        self._processes = contextlib.ExitStack()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """They are looked for in one folder, so that the others need not be collected for them."""
        astray = [
            i.nodeid for i in items if i.get_closest_marker("real_time") and FOLDER not in i.nodeid
        ]
        if astray:
            raise pytest.UsageError(f"tests in real time belong into {FOLDER}: {', '.join(astray)}")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> bool | None:
        """Run one test in real time."""
        if item.get_closest_marker("real_time") is None:
            return None
        log = item.ihook
        log.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        attempt = lambda: runtestprotocol(item, log=False, nextitem=nextitem)  # noqa: E731
        for report in judged(attempt, self._started()):
            log.pytest_runtest_logreport(report=report)
        log.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _started(self) -> Witness:
        if self._witness is None:
            self._witness = self._processes.enter_context(witnesses())
        return self._witness

    def pytest_unconfigure(self) -> None:
        """The witnesses are no longer needed."""
        self._processes.close()
