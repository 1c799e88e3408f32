"""Pages of a fleet run: one that goes along with it, and the acceptance record to be printed."""

from __future__ import annotations

import time

from commissioning.report.templates import template
from commissioning.result import words
from commissioning.result.fleet import FAILED, FleetResult, FleetState, JobState

__all__ = ["acceptance", "page"]

_REFRESH = 2  # s


def page(result: FleetResult) -> str:
    """The run as one page that needs nothing else, and reads itself again while it goes on."""
    going = result.state not in (FleetState.FINISHED, FleetState.STOPPED)
    counts = [(state, n) for state in JobState if (n := result.count(state))]
    return template("fleet.html.j2").render(
        r=result, going=going, refresh=_REFRESH, counts=counts, failed=FAILED, words=words,
        written=time.strftime("%Y-%m-%d %H:%M:%S"), stamp=round(time.time() * 1000),
    )  # fmt: skip


def acceptance(result: FleetResult) -> str:
    """The acceptance record: one printed page for the machine, and one for each axis."""
    return template("acceptance.html.j2").render(
        r=result, words=words, written=time.strftime("%Y-%m-%d %H:%M"), done=JobState.DONE,
    )  # fmt: skip
