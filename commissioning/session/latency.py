"""How fast and how regular a link is, what that means for an experiment, and how late a torque acts."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.experiments.design import SHORT
from commissioning.identification.modulating import estimate
from commissioning.session.armed import in_a_run
from commissioning.session.desk import Desk, Options, connect
from commissioning.session.measurement import Measurement
from commissioning.session.result import estimate_json
from profiles.axis import Axis
from profiles.errors import MeasurementRejected, UsageError

__all__ = ["Latency", "dead_time", "latency"]

Array = NDArray[np.float64]

_FLAT_OUT = 2e-4  # s: a cycle that no link holds, so that its own time is left
_SPARE = 1.3  # of the 99th percentile
_GRID = 5e-4  # s: cycles are rounded up to these
_LATE = 0.5  # of a cycle: late


@dataclass(frozen=True, slots=True)
class Latency:
    """What was measured.

    Attributes
    ----------
    service : (n,) s, one read of a parameter
    exchange : (n,) s, one cyclic exchange, as fast as it goes
    cycle : s, the fastest that the link holds with some spare time
    lateness : (n,) s, against the deadlines of that cycle
    missed : cycles without a sample, of the last
    """

    service: Array
    exchange: Array
    cycle: float
    lateness: Array
    missed: int

    @property
    def late_share(self) -> float:
        """Share of the cycles that came late by half a cycle or more."""
        return float(np.mean(self.lateness > _LATE * self.cycle))

    @property
    def shortest_period(self) -> float:
        """Shortest oscillation that an experiment runs at that cycle, s."""
        return SHORT.cycles * self.cycle


def dead_time(axis: Axis, options: Options, desk: Desk) -> dict[str, Any]:
    """Result JSON with the dead time by small torque steps, which move the axis; raises Failure."""

    def work(job: Measurement, result: dict[str, Any]) -> None:
        record = job.torque_steps()
        try:
            found = estimate(record, any_motion=True)
        except (ValueError, ArithmeticError) as error:
            raise MeasurementRejected(f"the torque steps show no dead time: {error}") from None
        result["friction"]["method"] = "modulating"
        result["friction"]["dead_time"] = estimate_json(found.dead_time, "s")
        result["quality"] = {"verdict": "usable", "reasons": ["torque steps: the dead time only"]}

    return in_a_run(axis, options, desk, work)


def latency(axis: Axis, count: int, desk: Desk) -> Latency:
    """Measure with the drive de-energised; raises LinkError, PreflightRefused, UsageError."""
    if axis.link is not None and axis.link.startswith("virtual://"):
        raise UsageError("latency: virtual:// has no link to be late; serve the axis")
    if axis.link is not None and "clock=step" in axis.link:
        raise UsageError("latency: a drive with clock=step has no time; serve it with --clock wall")
    with connect(axis, _FLAT_OUT, desk, "latency") as drive:
        power = drive.profile.power
        status = "statusword" if power is None else power.enabled.parameter
        drive.refuse_rehearsal()
        desk.tell(f"{count} reads of one parameter")
        service = []
        for _ in range(count):
            begin = perf_counter()
            drive.read_raw(status)
            service.append(perf_counter() - begin)
        desk.tell(f"{count} cycles, as fast as they go; the drive stays de-energised")
        times = np.array([e.time for e in drive.rehearse(count + 1)])
    exchange = np.asarray(np.diff(times), np.float64)
    cycle = ceil(_SPARE * float(np.quantile(exchange, 0.99)) / _GRID) * _GRID
    with connect(axis, cycle, desk, "latency") as drive:
        desk.tell(f"{count} cycles of {cycle * 1000:g} ms")
        kept = drive.rehearse(count)
    return Latency(
        np.array(service), exchange, cycle, np.array([e.lateness for e in kept]),
        sum(e.missed for e in kept),
    )  # fmt: skip
