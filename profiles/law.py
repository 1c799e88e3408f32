"""The drive's own compensation and loops: which parameters are which terms."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from profiles.procedures import Mode
from profiles.strict import Strict

__all__ = ["LAW_TERMS", "Compensation", "CompensationLaw", "LoopGains", "TablePoint"]


class CompensationLaw(StrEnum):
    """Shape of the friction compensation that the drive has (reference: compensation laws).

    NONE                  nothing to write: identify and report only
    OFFSET_ASYMMETRIC     T = offset + F+ or F- by direction
    SINGLE_GAIN           T = F * sign(v)
    SATURATED_LINEAR      T = F * clip(v / v0, -1, 1)
    COULOMB_VISCOUS       T = offset + F+ or F- by direction + B * v
    TABLE                 T = offset + torque over speed, interpolated between points, odd in v
    HOST                  nothing in the drive: the master adds T = offset + F * sign(v) in every cycle
    """

    NONE = "none"
    OFFSET_ASYMMETRIC = "offset+asymmetric"
    SINGLE_GAIN = "single-gain"
    SATURATED_LINEAR = "saturated-linear"
    COULOMB_VISCOUS = "coulomb+viscous"
    TABLE = "table"
    HOST = "host"


LAW_TERMS: dict[CompensationLaw, tuple[frozenset[str], frozenset[str]]] = {
    # law: (terms it must have, terms it may have)
    CompensationLaw.NONE: (frozenset(), frozenset()),
    CompensationLaw.HOST: (frozenset(), frozenset()),
    CompensationLaw.TABLE: (frozenset({"points"}), frozenset({"offset"})),
    CompensationLaw.OFFSET_ASYMMETRIC: (frozenset({"positive", "negative"}), frozenset({"offset"})),
    CompensationLaw.SINGLE_GAIN: (frozenset({"gain"}), frozenset({"offset"})),
    CompensationLaw.SATURATED_LINEAR: (frozenset({"gain", "speed"}), frozenset({"offset"})),
    CompensationLaw.COULOMB_VISCOUS: (
        frozenset({"positive", "negative", "viscous"}),
        frozenset({"offset"}),
    ),
}


class TablePoint(Strict):
    """One point of a friction table: the parameters that hold it, and the speed to give it (rad/s, motor)."""

    speed: str
    torque: str
    at: Annotated[float, Field(gt=0)]


class Compensation(Strict):
    """Where the friction compensation of the drive is written.

    The terms name parameters. `negative_sign` is the sign with which the drive stores the
    compensation of the negative direction. `acts_in` lists the modes in which it has an effect. `host`
    names the torque offset that a master writes in every cycle (60B2h); tworelay never leaves one behind.
    `acts_stored`: a value has no effect until it is stored, so that it cannot be proved before.
    """

    law: CompensationLaw
    offset: str | None = None
    positive: str | None = None
    negative: str | None = None
    gain: str | None = None
    speed: str | None = None
    viscous: str | None = None
    points: str | None = None  # how many points the table has
    table: tuple[TablePoint, ...] = ()
    host: str | None = None
    negative_sign: Literal[-1, 1] = 1
    acts_in: tuple[Mode, ...] = (Mode.POSITION,)
    acts_stored: bool = False
    note: str = ""  # what a technician has to know before it is written

    @property
    def terms(self) -> dict[str, str]:
        """Parameter name of each term of the law that the drive has."""
        names = ("offset", "positive", "negative", "gain", "speed", "viscous", "points")
        found = {name: value for name in names if (value := getattr(self, name)) is not None}
        for n, point in enumerate(self.table, 1):
            found |= {f"speed_{n}": point.speed, f"torque_{n}": point.torque}
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.law is CompensationLaw.TABLE) != bool(self.table):
            raise ValueError("law 'table' has its points in table, and no other law does")
        speeds = [point.at for point in self.table]
        if speeds != sorted(set(speeds)):
            raise ValueError("the speeds of table must rise from point to point")
        must, may = LAW_TERMS[self.law]
        there = {name for name in self.terms if not name[-1].isdigit()}
        if missing := must - there:
            raise ValueError(f"law '{self.law}' needs {', '.join(sorted(missing))}")
        if extra := there - must - may:
            takes = ", ".join(sorted(must | may)) or "no parameters"
            raise ValueError(
                f"law '{self.law}' takes {takes}, and the profile names "
                f"{', '.join(sorted(extra))}, too: leave that out, or name the law that it belongs to"
            )
        if (self.law is CompensationLaw.HOST) != (self.host is not None):
            raise ValueError("law 'host' names the torque offset as host, and no other law does")
        return self


class LoopGains(Strict):
    """The drive's own loops: how late they are, and where their gains are written.

    P of the position over PI of the velocity; all three gains are mapped, or none. `dead_time` is from the
    sample of the position to the torque, the hold of the loop's own period left out; `lag` names a
    parameter with the time constant of the torque loop, which comes on top.
    """

    period: Annotated[float, Field(gt=0)]  # s
    dead_time: Annotated[float, Field(ge=0)]  # s
    lag: str | None = None
    velocity_gain: str | None = None
    integral_time: str | None = None
    position_gain: str | None = None

    @property
    def terms(self) -> dict[str, str]:
        """Parameter name of each gain that the profile maps."""
        names = ("velocity_gain", "integral_time", "position_gain")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.terms) not in (0, 3):
            raise ValueError("velocity_gain, integral_time and position_gain go together")
        return self
