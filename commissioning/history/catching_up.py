"""The index is made of what it lacks: runs of older versions, and rows that are damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from commissioning.errors import JournalError
from commissioning.journal import Journal
from commissioning.result.document import RunResult
from commissioning.result.history import IndexedRun, conditions_of, numbers_of
from commissioning.runs import RunFolder
from drivers.home import home
from profiles.errors import UsageError

__all__ = ["catch_up", "said_by_run"]


def catch_up(runs: Iterable[str], told: Callable[[int], None] = lambda step: None) -> int | None:
    """Index these runs; returns how many of them have a file that says something.

    None where the index cannot be written. What it has of a run without a file stays. `told`: each
    run, 1
    """
    read = 0
    try:
        with Journal(home()) as journal:
            for run in runs:
                result = _result(journal, run)
                journal.index(run, result)
                read += result is not None
                told(1)
    except JournalError:
        return None
    return read


def said_by_run(journal: Journal, entry: IndexedRun) -> IndexedRun:
    """A run as its own file says, where the index cannot be written."""
    result = _result(journal, entry.run)
    if result is None:
        return entry
    return replace(
        entry,
        host=result.host,
        version=result.tool.version if result.tool else None,
        method=result.friction.method,
        verdict=result.quality.verdict,
        quantities=numbers_of(result),
        conditions=conditions_of(result),
    )


def _result(journal: Journal, run: str) -> RunResult | None:
    """What the run's file says; None where it is no more, or no result."""
    try:
        return RunFolder.of(journal, run).result()
    except UsageError:
        return None
