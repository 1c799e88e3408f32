"""How fast and how regular a link is, and how late a torque acts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil
from time import perf_counter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from commissioning.desk import Desk, Options, connect
from commissioning.errors import MeasurementRejected
from commissioning.experiments.design import SHORT
from commissioning.identification.errors import words_of
from commissioning.identification.modulating import estimate
from commissioning.identification.reasons import Reason, Weight
from commissioning.result.document import Quality, RunResult
from commissioning.result.found import Found
from commissioning.rig.armed import in_a_run
from commissioning.rig.preflight import CYCLES_A_WATCHDOG
from commissioning.rig.results import quantity
from commissioning.rig.rig import Rig
from drivers.bus import GUARDS
from drivers.errors import LinkError
from profiles.axis import Axis
from profiles.errors import UsageError
from profiles.library import as_written

__all__ = ["Latency", "dead_time", "latency"]

Array = NDArray[np.float64]

_FLAT_OUT = 2e-4  # s: a cycle that no link holds, so that its own time is left
_SPARE_TIME = 1.3  # of the 99th percentile
_GRID = 5e-4  # s: cycles are rounded up to these
_LATE_SHARE = 0.5  # of a cycle: late
_PATIENCE = 2.0  # s for one answer
_LONGEST, _FEWEST = 10.0, 30  # s of one kind of measurement; values
_WATCHDOG_GRID = 0.01  # s

T = TypeVar("T")


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
    bears : s of silence that the drive's watchdog bears now
    """

    service: Array
    exchange: Array
    cycle: float
    lateness: Array
    missed: int
    bears: float

    @property
    def watchdog(self) -> float:
        """Silence that the drive's watchdog has to bear on this link, s."""
        slowest = float(np.max(self.exchange, initial=0.0))
        needed = max(GUARDS * _SPARE_TIME * slowest, CYCLES_A_WATCHDOG * self.cycle)
        return ceil(needed / _WATCHDOG_GRID) * _WATCHDOG_GRID

    @property
    def late_share(self) -> float:
        """Share of the cycles that came late by half a cycle or more."""
        return float(np.mean(self.lateness > _LATE_SHARE * self.cycle))

    @property
    def shortest_period(self) -> float:
        """Shortest oscillation that an experiment runs at that cycle, s."""
        return SHORT.cycles * self.cycle


def dead_time(axis: Axis, options: Options, desk: Desk) -> RunResult:
    """A run with the dead time by small torque steps, which move the axis; raises Failure."""

    def work(rig: Rig, result: RunResult) -> RunResult:
        record = rig.torque_steps()
        try:
            found = estimate(record, any_motion=True)
        except (ValueError, ArithmeticError) as error:
            raise MeasurementRejected(
                f"the torque steps show no dead time: {words_of(error)}", code="measurement.method"
            ) from None
        number = quantity(found.dead_time, result.units.dead_time)
        only = Reason("dead-time.only", Weight.NOTE, "torque steps: the dead time only")
        return replace(
            result,
            friction=Found("modulating", dead_time=number),
            quality=Quality("usable", (only,)),
        )

    return in_a_run(axis, options, desk, work)


def latency(axis: Axis, count: int, desk: Desk) -> Latency:
    """Measure with the drive de-energised; raises LinkError, PreflightRefused, UsageError.

    What answers within 2 s is measured, whatever the drive's watchdog bears: it is to be chosen by
    this. A link that is lost on the way leaves what has been measured.
    """
    if axis.link is None or axis.link.startswith("virtual://"):
        raise UsageError("latency: virtual:// has no link to be late; serve the axis")
    if "clock=step" in axis.link:
        raise UsageError("latency: a drive with clock=step has no time; serve it with --clock wall")
    patient = _patient(axis)
    with connect(patient, _FLAT_OUT, desk, "latency") as drive:
        status = drive.rehearsal.status
        drive.rehearsal.check()

        def read() -> Iterator[float]:
            while True:
                begin = perf_counter()
                drive.read(status)
                yield perf_counter() - begin

        desk.tell("reads of one parameter")
        service = _taken(read(), count, desk)
        count = min(count, max(_FEWEST, round(_LONGEST / float(np.median(service)))))
        desk.tell(f"{count} cycles, as fast as they go; the drive stays de-energised")
        times = _taken((e.time for e in drive.rehearsal.cycles(count + 1)), count + 1, desk)
    exchange = np.diff(np.array(times))
    cycle = ceil(_SPARE_TIME * float(np.quantile(exchange, 0.99)) / _GRID) * _GRID
    with connect(patient, cycle, desk, "latency") as drive:
        desk.tell(f"{count} cycles of {cycle * 1000:g} ms")
        kept = _taken(drive.rehearsal.cycles(count), count, desk)
        own = as_written(axis, drive.profile).watchdog.timeout
    bears = axis.limits.watchdog or own
    return Latency(
        np.array(service), exchange, cycle, np.array([e.lateness for e in kept]),
        sum(e.missed for e in kept), bears,
    )  # fmt: skip


def _patient(axis: Axis) -> Axis:
    """The axis with a link that waits for 2 s, in and out of the cycle."""
    link = axis.link or ""
    if "timeout=" not in link:
        link += f"{'&' if '?' in link else '?'}timeout={_PATIENCE:g}"
    limits = axis.limits.model_copy(update={"watchdog": GUARDS * _PATIENCE})
    return axis.model_copy(update={"link": link, "limits": limits})


def _taken(values: Iterator[T], count: int, desk: Desk) -> list[T]:
    """As many of them as come within some time, and before the link is lost.

    Raises LinkError for too few.
    """
    found: list[T] = []
    begun = perf_counter()
    try:
        for value in values:
            found.append(value)
            late = perf_counter() - begun > _LONGEST and len(found) > _FEWEST
            if len(found) >= count or late:
                break
    except LinkError as error:
        if len(found) <= _FEWEST:
            raise
        desk.tell(f"{error}; what follows is of the {len(found)} before")
    return found
