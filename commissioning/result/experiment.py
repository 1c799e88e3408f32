"""How it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from commissioning.result.kinds import Count, Finite, Pair, Positive, Text

__all__ = [
    "Allowed",
    "Bases",
    "Conditions",
    "Experiment",
    "FirstLookReading",
    "Oscillated",
    "Setup",
]


@dataclass(frozen=True, slots=True)
class Oscillated:
    """One oscillation: of a relay, or of an oscillator, which has no hysteresis.

    Attributes
    ----------
    relay_amplitude : half of the torque's swing, N.m or N
    hysteresis : half-width, rad or m
    half_swing, fundamental : rad or m
    begin, end : s since the record's begin
    """

    name: Text
    period: Positive
    begin: Finite
    end: Finite
    relay_amplitude: Finite | None = None
    hysteresis: Finite | None = None
    bias: Finite | None = None
    half_swing: Finite | None = None
    fundamental: Finite | None = None
    duty: Finite | None = None
    periods: Finite | None = None
    settled: bool | None = None


@dataclass(frozen=True, slots=True)
class Allowed:
    """What the run was allowed: ± about its start, rad or m; N.m or N; rad/s or m/s."""

    travel: Positive
    torque: Positive
    speed: Positive


@dataclass(frozen=True, slots=True)
class FirstLookReading:
    """What short pushes told before the oscillations."""

    breakaway: Finite
    coulomb: Finite
    offset: Finite
    viscous: Finite
    inertia: Finite
    dead_time: Finite


@dataclass(frozen=True, slots=True)
class Bases:
    """What scales the drive's numbers: N.m, increments a revolution, N.m/A."""

    rated_torque: Finite
    increments_per_revolution: Finite
    torque_constant: Finite = 0.0


@dataclass(frozen=True, slots=True)
class Setup:
    """What the drive and the link were, where it takes a measurement to know it.

    Attributes
    ----------
    turnaround : s, from a sample to the command that answers it
    loop_lag : s, that the drive itself says of its torque
    resolution : of the position, rad or m
    """

    turnaround: Finite
    resolution: Finite
    bases: Bases
    first_look: FirstLookReading
    loop_lag: Finite = 0.0


@dataclass(frozen=True, slots=True)
class Conditions:
    """What friction depends on beside wear; None: not known.

    Attributes
    ----------
    motor_temperature, drive_temperature : °C
    minutes_on : since the drive was switched on, min
    position : where the axis stood when it began, rad or m
    third : which third of the travel that is, 0 to 2, where the axis file says its ends
    cycle : of the exchange, s
    """

    motor_temperature: Finite | None = None
    drive_temperature: Finite | None = None
    minutes_on: Finite | None = None
    position: Finite | None = None
    third: Literal[0, 1, 2] | None = None
    cycle: Positive | None = None


@dataclass(frozen=True, slots=True)
class Experiment:
    """How long and how regularly the axis was watched.

    Attributes
    ----------
    periods : of all oscillations
    duration : s
    cycle : s
    late_share, lost_share : of the cycles
    travel : from end to end, rad or m
    limits : None for a recording
    cycles : one oscillation at each amplitude; empty where the run did not get there
    complex_coulomb : that puts the relay's locus on the plant, N.m or N
    tests : relay tests that the thesis' method took
    repeats : Coulomb friction of each repeat, N.m or N
    spread : standard deviation of the repeats, about their drift where they drift, N.m or N
    drift : of the repeats, N.m/s or N/s, and the ends of its interval; None of fewer than three
    analysed : begin and end of each stretch that the numbers are of, s; of repeats the last
    """

    periods: Finite
    duration: Finite
    cycle: Positive
    late_share: Finite
    lost_share: Finite
    travel: Finite
    limits: Allowed | None = None
    cycles: tuple[Oscillated, ...] = ()
    complex_coulomb: Pair | None = None
    tests: Count = 0
    repeats: tuple[Finite, ...] = ()
    spread: Finite | None = None
    drift: tuple[Finite, Finite, Finite] | None = None
    setup: Setup | None = None
    analysed: tuple[Pair, ...] = ()
