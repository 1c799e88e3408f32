"""Slow motion in position mode: reversals, low speed, rest. Set-points are positions, rad or m."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, pi

from commissioning.errors import MeasurementRejected
from commissioning.experiments.plan import Context, Plan
from drivers.sample import Sample

__all__ = ["SWING", "TURNS", "TrackingPath", "TrackingSamples", "path_for", "track"]

SWING = 0.4  # of the travel: from one reversal to the other
_SPEED = 0.1  # of the speed limit, at most
_PERIOD = 2.0  # s, at least
_INERTIAL = 0.3  # torque that accelerates the axis, in shares of the friction, at most
TURNS = 2  # that are looked at
_CREEP = 0.05  # of the amplitude: distance of the low-speed part
_CREEP_TIME = 2.0  # s, one way
_REST_TIME = 2.0  # s


@dataclass(frozen=True, slots=True)
class TrackingPath:
    """What is followed, from and back to the start.

    Attributes
    ----------
    amplitude : half-swing of the reversals, rad or m; the axis moves by twice that to one side
    period : s
    creep : distance of the low-speed part, rad or m
    """

    amplitude: float
    period: float
    creep: float

    @property
    def seconds(self) -> float:
        """Time of the whole path."""
        return (1 + TURNS) * self.period + 2 * _CREEP_TIME + _REST_TIME


@dataclass(frozen=True, slots=True)
class TrackingSamples:
    """Samples of each part."""

    reversals: list[Sample]
    creep: list[Sample]
    rest: list[Sample]


def path_for(context: Context, coulomb: float, inertia: float | None) -> TrackingPath:
    """A path so slow that friction and not inertia makes the error."""
    amplitude = max(SWING / 2 * context.travel, 50 * context.resolution)
    slow = pi * 2 * amplitude / (_SPEED * context.speed)  # s: peak speed 2 pi A / T
    light = 2 * pi * (amplitude * (inertia or 0.0) / (_INERTIAL * coulomb)) ** 0.5
    creep = max(_CREEP * amplitude, 20 * context.resolution)
    return TrackingPath(amplitude, max(_PERIOD, slow, light), creep)


def track(context: Context, path: TrackingPath, here: float) -> Plan[TrackingSamples]:
    """Follow the path; the position command begins and ends at the start with no speed.

    `here` : where the axis is, rad or m: friction may have held it a little off
    """
    start, count, way = (
        context.start,
        *(round(seconds / context.cycle) for seconds in (path.period, _CREEP_TIME)),
    )
    turn = [start + path.amplitude * (1 - cos(2 * pi * n / count)) for n in range(1, count + 1)]
    out = [start + path.creep * n / way for n in range(1, way + 1)]
    back = [start + path.creep * (1 - n / way) for n in range(1, way + 1)]

    def follow(positions: list[float]) -> Plan[list[Sample]]:
        return _follow(context, positions, path.amplitude)

    slowly = path.amplitude / count  # a cycle, as is usual on the path
    steps = ceil(abs(start - here) / slowly)
    yield from follow([here + (start - here) * n / steps for n in range(1, steps + 1)])
    yield from follow(turn)  # the first turn is not looked at
    return TrackingSamples(
        reversals=(yield from follow(TURNS * turn)),
        creep=(yield from follow(out + back)),
        rest=(yield from follow(round(_REST_TIME / context.cycle) * [start])),
    )


def _follow(context: Context, positions: list[float], most: float) -> Plan[list[Sample]]:
    """Command one position a cycle; raises MeasurementRejected where the axis is `most` off."""
    samples = []
    for position in positions:
        sample = yield position
        samples.append(sample)
        if abs(sample.position - position) > most:
            raise MeasurementRejected(
                f"the axis does not follow: it is {sample.position - position:+.3g} "
                f"{context.position_unit} from where it should be",
                code="measurement.not-following",
                hint="is it blocked, or its encoder?",
            )
    return samples
