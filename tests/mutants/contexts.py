"""A plugin: which test runs which line, children included, and how long each test takes.

With coverage under way, the context is the test's id, here and in the processes that it starts.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections import defaultdict
from copy import copy
from pathlib import Path

import pytest

DURATIONS = "TWORELAY_DURATIONS"
_CHILDREN = "COVERAGE_PROCESS_CONFIG"
_spent: defaultdict[str, float] = defaultdict(float)


def _name(nodeid: str) -> str:
    """A test's id without the group that xdist appends."""
    return re.sub(r"@\w+$", "", nodeid)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    coverage = sys.modules.get("coverage")
    under_way = coverage.Coverage.current() if coverage else None
    if under_way is None:
        return
    under_way.switch_context(_name(item.nodeid))
    if _CHILDREN in os.environ:
        described = copy(under_way.config)
        described.context = _name(item.nodeid)
        os.environ[_CHILDREN] = described.serialize()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _spent[_name(report.nodeid)] += report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    if DURATIONS in os.environ and not hasattr(session.config, "workerinput"):
        Path(os.environ[DURATIONS]).write_text(json.dumps(_spent), "utf-8")
