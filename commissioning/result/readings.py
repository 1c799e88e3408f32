"""What each method read."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Self

from commissioning.result.kinds import Count, Finite, Pair, Text

__all__ = [
    "BalanceReading",
    "LawReading",
    "MethodName",
    "Methods",
    "ModulatingReading",
    "OutputErrorReading",
    "ProgressReading",
    "Speed",
    "SteadyReading",
    "TwoRelayReading",
]


class MethodName(StrEnum):
    """The methods of an experiment; of those that read friction, the finest first.

    Attributes
    ----------
    about : what it does, for help
    """

    about: str

    AUTO = "auto", "four periods, and more where they are needed"
    OUTPUT_ERROR = "output-error", "the positions fitted, four to twelve periods"
    MODULATING = "modulating", "a dozen periods"
    LOCK_IN = "lock-in", "exact harmonic balance, no model"
    TWO_RELAY = "two-relay", "the thesis, with hysteresis"
    TWO_RELAY_DELAY = "two-relay-delay", "the thesis, with a delay"
    PHASE_LOCKED = "phase-locked", "the thesis, with a sine"
    ALL = "all", "each"

    def __new__(cls, name: str, about: str) -> Self:
        """A name that says what it stands for."""
        one = str.__new__(cls, name)
        one._value_ = name
        one.about = about
        return one


@dataclass(frozen=True, slots=True)
class TwoRelayReading:
    """The thesis' balance: its complex friction, N.m or N, and both relay tests."""

    coulomb: Finite
    real: Finite
    imaginary: Finite
    modulus: Finite
    half_swing: Pair
    fundamental: Pair
    period: Pair
    periods: tuple[Count, Count]
    relay_amplitude: Pair
    hysteresis: Pair
    bias: Pair
    duty: Pair
    settled: tuple[bool, bool]


@dataclass(frozen=True, slots=True)
class BalanceReading:
    """A balance on measured phasors.

    Attributes
    ----------
    harmonics : friction at the harmonics 1, 3, 5, N.m or N
    rejected : harmonics that were too small to be read
    plant : real and imaginary part
    phase_deg : of both oscillations, by the phase-locked method
    """

    coulomb: Finite
    real: Finite
    imaginary: Finite
    modulus: Finite
    half_swing: tuple[Finite, ...]
    fundamental: tuple[Finite, ...]
    period: Finite
    periods: tuple[Finite, ...]
    offset: Finite | None = None
    viscous: Finite | None = None
    inertia: Finite | None = None
    dead_time: Finite | None = None
    hysteresis: Finite | None = None
    harmonics: dict[str, Finite] | None = None
    rejected: tuple[Finite, ...] = ()
    plant: Pair | None = None
    phase_deg: tuple[Finite, ...] | None = None


@dataclass(frozen=True, slots=True)
class LawReading:
    """The friction law that the record asks for."""

    terms: tuple[Text, ...]
    stribeck_speed: Finite | None = None
    soft_speed: Finite | None = None
    pitch: Finite | None = None
    coefficients: tuple[Finite, ...] = ()
    stribeck_exponent: Finite | None = None


@dataclass(frozen=True, slots=True)
class ModulatingReading:
    """Modulating functions: numbers, law, and what says how far to trust them.

    Shares of the torque.
    """

    coulomb: Finite
    offset: Finite
    viscous: Finite
    inertia: Finite
    dead_time: Finite
    law: LawReading
    residual: Finite | None = None
    held_out: Finite | None = None
    rigid_residual: Finite | None = None
    condition: Finite | None = None
    halves: Finite | None = None
    widths: Finite | None = None
    noise: Finite | None = None
    periods: Finite | None = None
    windows: Finite | None = None
    reversals: Finite | None = None
    low_speed: Finite | None = None
    peak_speed: Finite | None = None


@dataclass(frozen=True, slots=True)
class ProgressReading:
    """Coulomb friction as fewer periods would have given it, N.m or N."""

    periods: Finite
    coulomb: Finite
    low: Finite
    high: Finite


@dataclass(frozen=True, slots=True)
class OutputErrorReading:
    """Positions fitted with a free state a segment: numbers, law, and what is left.

    Attributes
    ----------
    lag, lag_low, lag_high : of the torque behind its command, first order, s
    terms : of the law beside Coulomb and viscous friction, and the size of each
    left, noise : rms of what is left of the position, and of the position itself, rad or m
    colour : 1: what is left is white
    misfit : what is left beyond the noise, as a torque, of the friction
    explained : whether the numbers are of a law that explains the record
    samples, periods : that were used
    progress : what fewer periods would have given
    """

    coulomb: Finite
    offset: Finite
    viscous: Finite
    inertia: Finite
    dead_time: Finite
    lag: Finite
    lag_low: Finite
    lag_high: Finite
    terms: dict[str, Finite]
    left: Finite
    noise: Finite
    colour: Finite
    misfit: Finite
    explained: bool
    samples: Count
    periods: Finite
    low_speed: Finite
    peak_speed: Finite
    progress: tuple[ProgressReading, ...] = ()


@dataclass(frozen=True, slots=True)
class Speed:
    """Torque at one constant speed, and its error."""

    speed: Finite
    torque: Finite
    error: Finite


@dataclass(frozen=True, slots=True)
class SteadyReading:
    """The friction curve from constant speeds."""

    coulomb: Finite
    offset: Finite
    viscous: Finite
    stribeck_level: Finite | None = None
    stribeck_speed: Finite | None = None
    rms: Finite | None = None
    held_out: Finite | None = None
    points: tuple[Speed, ...] = ()


Reading = TwoRelayReading | BalanceReading | ModulatingReading | OutputErrorReading | SteadyReading


@dataclass(frozen=True, slots=True)
class Methods:
    """What was run, each with its own reading.

    Of a measurement that was repeated, of the last repeat.
    """

    two_relay: TwoRelayReading | None = None
    two_relay_delay: TwoRelayReading | None = None
    phase_locked: BalanceReading | None = None
    lock_in: BalanceReading | None = None
    modulating: ModulatingReading | None = None
    output_error: OutputErrorReading | None = None
    steady: SteadyReading | None = None

    def readings(self) -> list[tuple[str, Reading]]:
        """Name and reading of each method that was run."""
        pairs = [(one.name.replace("_", "-"), getattr(self, one.name)) for one in fields(self)]
        return [(name, reading) for name, reading in pairs if reading is not None]
