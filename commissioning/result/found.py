"""What was found: numbers with their intervals, and the plant's points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from commissioning.result.kinds import Finite, Positive, Text

__all__ = [
    "POINTS",
    "QUANTITIES",
    "CriticalPoints",
    "Curve",
    "DriveTrain",
    "Found",
    "Point",
    "Quantity",
    "Units",
]

QUANTITIES = ("coulomb", "offset", "viscous", "inertia", "dead_time")
POINTS = ("naive", "hysteresis", "corrected", "measured", "at_180", "at_135")


@dataclass(frozen=True, slots=True)
class Units:
    """ASCII units of this axis' quantities."""

    position: Literal["rad", "m"] = "rad"
    effort: Text = "N.m"
    coulomb: Text = "N.m"
    offset: Text = "N.m"
    viscous: Text = "N.m.s/rad"
    inertia: Text = "kg.m2"
    dead_time: Text = "s"
    gain: Text = "rad/(N.m)"
    stiffness: Text = "N.m/rad"

    @classmethod
    def of(cls, position: Literal["rad", "m"]) -> Units:
        """Units of a rotary (rad, N.m) or a linear axis (m, N)."""
        if position == "rad":
            return cls()
        return cls("m", "N", "N", "N", "N.s/m", "kg", "s", "m/N", "N/m")

    def of_quantity(self, name: str) -> str:
        """Unit of one of QUANTITIES."""
        return str(getattr(self, name))


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its interval, which holds the truth in 19 of 20 cases.

    Attributes
    ----------
    value, low, high : in `unit`; an end is None where it is not known
    raw : the value as the drive counts, in `raw_unit`; None where the drive has no such number
    """

    value: Finite
    low: Finite | None
    high: Finite | None
    unit: Text
    raw: Finite | None = None
    raw_unit: Text | None = None

    @property
    def half_width(self) -> float:
        """Half of the interval as a share of the value; infinite where it is not known."""
        if self.low is None or self.high is None or not self.value:
            return float("inf")
        return (self.high - self.low) / (2 * abs(self.value))


@dataclass(frozen=True, slots=True)
class Curve:
    """Friction against speed, the mean of both directions: columns of one length.

    Attributes
    ----------
    speed : rad/s or m/s
    friction : N.m or N
    low, high : its interval; empty where it is not known
    """

    speed: tuple[Finite, ...]
    friction: tuple[Finite, ...]
    low: tuple[Finite, ...] = ()
    high: tuple[Finite, ...] = ()

    def __post_init__(self) -> None:
        if len({len(self.speed), len(self.friction)}) != 1:
            raise ValueError("columns of one length")


@dataclass(frozen=True, slots=True)
class Found:
    """The numbers of a run, by the chosen method: what report, proposal, tuning and history go by.

    Attributes
    ----------
    method : name of the method; None where nothing was measured
    coulomb, offset : N.m or N
    viscous : N.m.s/rad or N.s/m
    inertia : kg.m2 or kg
    dead_time : s, at the period of the oscillations
    lag : what of it is a lag of the torque, first order, s
    low_speed : friction just above rest, N.m or N
    """

    method: Text | None = None
    coulomb: Quantity | None = None
    offset: Quantity | None = None
    viscous: Quantity | None = None
    inertia: Quantity | None = None
    dead_time: Quantity | None = None
    lag: Quantity | None = None
    low_speed: Quantity | None = None
    curve: Curve | None = None

    def quantity(self, name: str) -> Quantity | None:
        """One of QUANTITIES."""
        found: Quantity | None = getattr(self, name)
        return found


@dataclass(frozen=True, slots=True)
class DriveTrain:
    """What the axis shows beside a rigid body: two masses, play.

    Attributes
    ----------
    motor_inertia, load_inertia : kg.m2 or kg
    stiffness : N.m/rad or N/m
    damping : N.m.s/rad or N.s/m
    resonance, antiresonance : Hz
    play : rad or m
    """

    verdict: Text
    reasons: tuple[Text, ...] = ()
    motor_inertia: Quantity | None = None
    load_inertia: Quantity | None = None
    stiffness: Quantity | None = None
    damping: Quantity | None = None
    resonance: Quantity | None = None
    antiresonance: Quantity | None = None
    play: Quantity | None = None


@dataclass(frozen=True, slots=True)
class Point:
    """A point of the plant's frequency response, with its interval.

    Attributes
    ----------
    gain : |position/torque|
    phase_deg : in (−360, 0]
    period : s, of the oscillation that it was read at
    ku, ku_low, ku_high : 1/gain where the phase is −180° within half a degree
    travel_needed : rad or m on either side of the start, to measure it
    """

    gain: Positive
    phase_deg: Finite
    period: Positive
    ku: Finite | None
    how: Literal["measured", "computed"]
    gain_low: Finite | None = None
    gain_high: Finite | None = None
    phase_low_deg: Finite | None = None
    phase_high_deg: Finite | None = None
    travel_needed: Finite | None = None
    ku_low: Finite | None = None
    ku_high: Finite | None = None


@dataclass(frozen=True, slots=True)
class CriticalPoints:
    """The plant at the relay's frequency, read in several ways, and where rules want it."""

    naive: Point | None = None
    hysteresis: Point | None = None
    corrected: Point | None = None
    measured: Point | None = None
    at_180: Point | None = None
    at_135: Point | None = None

    def point(self, name: str) -> Point | None:
        """One of POINTS."""
        found: Point | None = getattr(self, name)
        return found
