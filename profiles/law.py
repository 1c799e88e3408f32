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
    "static": _Term(lambda a: a.coulomb, "{} of the Coulomb friction", is_friction=True),
    "spring": _Term(lambda a: None, "", is_friction=False),  # stiffness before it slips: likewise
    "dynamic": _Term(lambda a: a.viscous, "{} of the viscous friction", is_friction=True),
    "points": _Term(lambda a: None, "points of the table", is_friction=False),
}


class CompensationLaw(StrEnum):
    """Shape of the friction compensation that the drive has (reference: compensation laws).

    Attributes
    ----------
    must : terms that it has, one set of them
    may : terms that it can have
    """

    must: tuple[frozenset[str], ...]
    may: frozenset[str]

    # nothing to write: identify and report only
    NONE = "none", "", ""
    # T = offset + F+ or F- by direction
    OFFSET_ASYMMETRIC = "offset+asymmetric", "positive negative", "offset"
    # T = offset + F * sign(v)
    SINGLE_GAIN = "single-gain", "gain", "offset"
    # T = offset + F * clip(v / v0, -1, 1), where F is one for both directions or F+ or F-
    SATURATED_LINEAR = "saturated-linear", "gain speed|positive negative speed", "offset viscous"
    # T = offset + F+ or F- by direction + B * v
    COULOMB_VISCOUS = "coulomb+viscous", "positive negative viscous", "offset"
    # T = offset + clip(k * x, -F, F) + B * v, where x is the way since the reversal
    SPRING_STATIC_DYNAMIC = "spring+static+dynamic", "static spring dynamic", "offset"
    # T = offset + torque over speed, interpolated between points, odd in v
    TABLE = "table", "points", "offset"
    # T = offset + torque of the first level whose speed is not passed, odd in v
    LEVELS = "levels", "", "offset points"
    # nothing in the drive: the master adds T = offset + F * sign(v) in every cycle
    HOST = "host", "", ""

    def __new__(cls, name: str, must: str, may: str) -> Self:
        """A law by its name and terms."""
        one = str.__new__(cls, name)
        one._value_ = name
        one.must = tuple(frozenset(terms.split()) for terms in must.split("|"))
        one.may = frozenset(may.split())
        return one

    @property
    def has_table(self) -> bool:
        """Whether torques stand over speeds in it."""
        return self in (CompensationLaw.TABLE, CompensationLaw.LEVELS)

    def takes(self, terms: frozenset[str]) -> bool:
        """Whether these are its terms."""
        return any(must <= terms <= must | self.may for must in self.must)


class TablePoint(Strict):
    """One point of a friction table, or one level.

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
    static: str | None = None
    spring: str | None = None
    dynamic: str | None = None
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
        below = 0.0
        for point in self.table:
            speed = point.at * amount.motor_speed
            # a level is for all speeds up to its own: what friction is in their middle
            here = (below + speed) / 2 if self.law is CompensationLaw.LEVELS else speed
            below = speed
            torque = amount.coulomb + (amount.viscous or 0.0) * here
            found[point.speed] = TermValue(speed, "speed of a point of the table")
            found[point.torque] = TermValue(torque, f"{amount.share} of the friction at that speed")
        if self.points is not None:
            found[self.points] = TermValue(float(len(self.table)), "points of the table")
        return found

    @property
    def written(self) -> tuple[str, ...]:
        """Parameters that `apply` writes; the others stay as they are in the drive."""
        return tuple(self.values(Amount(1.0, 1.0, 1.0, "", 1.0)))

    @property
    def friction(self) -> frozenset[str]:
        """Parameters that hold friction: of these a share can be tried, the others stay whole."""
        named = {getattr(self, name) for name, term in _TERMS.items() if term.is_friction}
        return frozenset((named - {None}) | {point.torque for point in self.table})

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.law.has_table != bool(self.table):
            raise ValueError(
                "laws 'table' and 'levels' have their points in table, and no other law does"
            )
        speeds = [point.at for point in self.table]
        if speeds != sorted(set(speeds)):
            raise ValueError("the speeds of table must rise from point to point")
        there = frozenset(name for name in _TERMS if getattr(self, name) is not None)
        if not self.law.takes(there):
            raise ValueError(_other_terms(self.law, there))
        if (self.law is CompensationLaw.HOST) != (self.host is not None):
            raise ValueError("law 'host' names the torque offset as host, and no other law does")
        return self


def _other_terms(law: CompensationLaw, there: frozenset[str]) -> str:
    """Why these terms are not that law's, and which law they belong to."""
    sets = [_listed(must) for must in law.must if must]
    takes = " or ".join(sets) or "no parameters"
    may = f", and can have {_listed(law.may)}" if law.may else ""
    others = [one for one in CompensationLaw if not one.has_table and one.takes(there)]
    way = f"; those are the terms of '{others[0]}'" if others and there else ""
    nearest = min(law.must, key=lambda must: len(must ^ there))
    missing = nearest - there
    if missing:
        return f"law '{law}' needs {_listed(missing)}: it takes {takes}{may}{way}"
    extra = _listed(there - nearest - law.may)
    return f"law '{law}' takes {takes}{may}, and the profile names {extra}, too{way}"


def _listed(terms: frozenset[str]) -> str:
    return ", ".join(name for name in _TERMS if name in terms)


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
