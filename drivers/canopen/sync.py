"""SYNC that another node produces: how often it comes."""

from __future__ import annotations

from itertools import combinations
from statistics import median
from time import perf_counter

from drivers.canopen.wire import CanWire
from drivers.errors import PreflightRefused

__all__ = ["check_sync", "sync_period"]

_SYNCS_LOOKED_AT = 20
_SYNC_PATIENCE = 1.0  # s
_SYNC_TOLERANCE = 0.1  # of the cycle


def check_sync(wire: CanWire, cycle: float) -> None:
    """See that SYNC comes as often as the cycle says; raises PreflightRefused."""
    arrivals: list[float] = []
    wire.drain()
    for _ in range(_SYNCS_LOOKED_AT):
        wire.syncs = 0
        if not wire.await_sync(max(_SYNC_PATIENCE, 3 * cycle)):
            raise PreflightRefused(
                f"no SYNC on the bus within {_SYNC_PATIENCE:g} s: is its producer on? Without "
                "sync=bus in the link, tworelay produces it",
                code="sync.none",
            )
        arrivals.append(perf_counter())
    period = sync_period(arrivals)
    if abs(period - cycle) > _SYNC_TOLERANCE * cycle:
        raise PreflightRefused(
            f"SYNC comes every {period * 1000:g} ms and the cycle is {cycle * 1000:g} ms: give "
            f"--cycle {period:g}",
            code="sync.period",
        )


def sync_period(arrivals: list[float]) -> float:
    """Period of messages, s, to 0.1 ms; late arrivals count little (slope of Theil and Sen)."""
    pairs = combinations(enumerate(arrivals), 2)
    return round(median((after - before) / (n - m) for (m, before), (n, after) in pairs), 4)
