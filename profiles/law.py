"""The drive's own compensation and loops: which parameters are which terms."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from profiles.procedures import Mode
from profiles.strict import Strict

__all__ = ["Amount", "Compensation", "CompensationLaw", "LoopGains", "TablePoint"]


class Amount(NamedTuple):
    """What is to be compensated, SI at the axis; None: not known well enough to be written.

    Attributes
    ----------
    coulomb, viscous : the share of the friction that is compensated
    offset : whole
    share : for people
    motor_speed : speed of the axis at 1 rad/s of the motor
    """

    coulomb: float
    offset: float | None
    viscous: float | None
    share: str
    motor_speed: float


class TermValue(NamedTuple):
    """A value for a parameter of the compensation, SI at the axis, and why."""

    value: float
    why: str


class _Term(NamedTuple):
    """One term of a law.

    What it is given, and whether it is friction, of which a share can be tried.
    """

    value: Callable[[Amount], float | None]
    why: str
    is_friction: bool


_TERMS = {
    "offset": _Term(
        lambda a: a.offset, "the whole offset (load, and friction's asymmetry)", is_friction=False
    ),
    "positive": _Term(lambda a: a.coulomb, "{} of the Coulomb friction", is_friction=True),
    "negative": _Term(lambda a: a.coulomb, "{} of the Coulomb friction", is_friction=True),
    "gain": _Term(lambda a: a.coulomb, "{} of the Coulomb friction", is_friction=True),
    "speed": _Term(lambda a: None, "", is_friction=False),  # the drive's own: left as it is
    "viscous": _Term(lambda a: a.viscous, "{} of the viscous friction", is_friction=True),
    "points": _Term(lambda a: None, "points of the table", is_friction=False),
}


class CompensationLaw(StrEnum):
    """Shape of the friction compensation that the drive has (reference: compensation laws).

    Attributes
    ----------
    must, may : terms that it has, and that it can have
    """

    must: frozenset[str]
    may: frozenset[str]

    # nothing to write: identify and report only
    NONE = "none", "", ""
    # T = offset + F+ or F- by direction
    OFFSET_ASYMMETRIC = "offset+asymmetric", "positive negative", "offset"
    # T = F * sign(v)
    SINGLE_GAIN = "single-gain", "gain", "offset"
    # T = F * clip(v / v0, -1, 1)
    SATURATED_LINEAR = "saturated-linear", "gain speed", "offset"
    # T = offset + F+ or F- by direction + B * v
    COULOMB_VISCOUS = "coulomb+viscous", "positive negative viscous", "offset"
    # T = offset + torque over speed, interpolated between points, odd in v
    TABLE = "table", "points", "offset"
    # nothing in the drive: the master adds T = offset + F * sign(v) in every cycle
    HOST = "host", "", ""

    def __new__(cls, name: str, must: str, may: str) -> Self:
        """A law by its name and terms."""
        one = str.__new__(cls, name)
        one._value_ = name
        one.must, one.may = frozenset(must.split()), frozenset(may.split())
        return one


class TablePoint(Strict):
    """One point of a friction table.

    The parameters that hold it, and the speed to give it (rad/s, motor).
    """

    speed: str
    torque: str
    at: Annotated[float, Field(gt=0)]


class Compensation(Strict):
    """Where the friction compensation of the drive is written.

    The terms name parameters. `negative_sign` is the sign with which the drive stores the
    compensation of the negative direction. `acts_in` lists the modes in which it has an effect.
    `host` names the torque offset that a master writes in every cycle (60B2h); tworelay never
    leaves one behind. `acts_stored`: a value has no effect until it is stored, so that it cannot be
    proved before.
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
        found = {name: value for name in _TERMS if (value := getattr(self, name)) is not None}
        for n, point in enumerate(self.table, 1):
            found |= {f"speed_{n}": point.speed, f"torque_{n}": point.torque}
        return found

    def values(self, amount: Amount) -> dict[str, TermValue]:
        """What compensates `amount`, by parameter.

        What stays as it is in the drive is not in it.
        """
        found = {}
        for name, term in _TERMS.items():
            parameter, value = getattr(self, name), term.value(amount)
            if parameter is not None and value is not None:
                sign = self.negative_sign if name == "negative" else 1
                found[parameter] = TermValue(sign * value, term.why.format(amount.share))
        for point in self.table:
            speed = point.at * amount.motor_speed
            torque = amount.coulomb + (amount.viscous or 0.0) * speed
            found[point.speed] = TermValue(speed, "speed of a point of the table")
            found[point.torque] = TermValue(torque, f"{amount.share} of the friction at that speed")
        if self.points is not None:
            found[self.points] = TermValue(float(len(self.table)), "points of the table")
        return found

    @property
    def friction(self) -> frozenset[str]:
        """Parameters that hold friction: of these a share can be tried, the others stay whole."""
        named = {getattr(self, name) for name, term in _TERMS.items() if term.is_friction}
        return frozenset((named - {None}) | {point.torque for point in self.table})

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.law is CompensationLaw.TABLE) != bool(self.table):
            raise ValueError("law 'table' has its points in table, and no other law does")
        speeds = [point.at for point in self.table]
        if speeds != sorted(set(speeds)):
            raise ValueError("the speeds of table must rise from point to point")
        must, may = self.law.must, self.law.may
        there = {name for name in self.terms if not name[-1].isdigit()}
        if missing := must - there:
            raise ValueError(f"law '{self.law}' needs {', '.join(sorted(missing))}")
        if extra := there - must - may:
            takes = ", ".join(sorted(must | may)) or "no parameters"
            raise ValueError(
                f"law '{self.law}' takes {takes}, and the profile names "
                f"{', '.join(sorted(extra))}, too: leave that out, or name the law that it belongs "
                "to"
            )
        if (self.law is CompensationLaw.HOST) != (self.host is not None):
            raise ValueError("law 'host' names the torque offset as host, and no other law does")
        return self


class LoopGains(Strict):
    """The drive's own loops: how late they are, and where their gains are written.

    P of the position over PI of the velocity; all three gains are mapped, or none. `dead_time` is
    from the sample of the position to the torque, the hold of the loop's own period left out; `lag`
    names a parameter with the time constant of the torque loop, which comes on top.
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
