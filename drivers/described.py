"""One parameter of a drive on its axis: what the profile says of it, in SI."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import WriteFailed
from drivers.scaling import Scaling
from profiles.errors import UnknownName
from profiles.parameter import Parameter, Protection, Trust, Unit
from profiles.schema import Profile

__all__ = ["Described", "Parameters", "described"]


@dataclass(frozen=True, slots=True)
class Described:
    """A parameter by its name; values are raw, as the drive counts, or SI at the axis.

    Attributes
    ----------
    profile : name of the profile that says so
    parameter : what it says
    unit, raw_unit : of a value, ASCII; of one raw step, for people
    step : SI value of one raw step; negative where the drive counts against its motor
    doubtful_base : address of what it is scaled by, where nobody has verified that; ''
    lacks_gear : it counts at the output of the gear, whose ratio nobody has said
    """

    name: str
    profile: str
    parameter: Parameter
    unit: str
    raw_unit: str
    step: float
    doubtful_base: str = ""
    lacks_gear: bool = False

    @property
    def address(self) -> str:
        """Where it is, as the drive's manual has it."""
        return str(self.parameter.address)

    @property
    def protection(self) -> Protection:
        """What may be done with it."""
        return self.parameter.protection

    @property
    def trust(self) -> Trust:
        """How far the statement about it can be trusted."""
        return self.parameter.trust

    def si(self, raw: float) -> float:
        """SI value of `raw`."""
        return self.parameter.number(raw) * self.step

    def raw(self, value: float) -> int:
        """Nearest raw value to `value` (SI); not yet checked against the range."""
        return self.parameter.nearest_raw(value / self.step)

    def checked_raw(self, value: float) -> int:
        """Nearest raw value, checked against range and forbidden values; raises WriteFailed."""
        raw = self.raw(value)
        low, high = self.parameter.range
        if not low <= self.parameter.number(raw) <= high:
            raise WriteFailed(
                f"'{self.name}': {value:.6g} {self.unit} is outside {low * self.step:.6g}…"
                f"{high * self.step:.6g} {self.unit}",
                code="write.range",
                parameter=self.name,
            )
        if raw in self.parameter.forbidden:
            raise WriteFailed(
                f"'{self.name}': raw value {raw} must never be written to this drive",
                code="write.range",
                parameter=self.name,
            )
        return raw

    def share(self, raw: int, share: float) -> int:
        """Raw value of a share of what `raw` stands for."""
        return self.parameter.nearest_raw(share * self.parameter.number(raw))


class Parameters(dict[str, Described]):
    """Every parameter of a drive by its name.

    A name that is not there raises UnknownName, with those that are.

    Attributes
    ----------
    motor_speed : speed of the axis at 1 rad/s of the motor, rad/s or m/s
    """

    def __init__(self, profile: str, found: dict[str, Described], motor_speed: float) -> None:
        super().__init__(found)
        self._profile = profile
        self.motor_speed = motor_speed

    def __missing__(self, name: str) -> Described:
        raise UnknownName(f"parameter in profile '{self._profile}'", name, list(self))


def described(profile: Profile, scaling: Scaling, *, constant_known: bool) -> Parameters:
    """The parameters of `profile` on an axis with that scaling.

    `constant_known` : the axis file says the motor's torque constant, N.m/A
    """
    rated = profile.parameters.get("rated_current")
    doubted = not constant_known and rated is not None and rated.trust is Trust.UNVERIFIED
    base = str(rated.address) if rated is not None and doubted else ""
    found = {
        name: Described(
            name, profile.name, one, scaling.unit_text(one), scaling.raw_unit(one),
            scaling.step(one), base if one.unit is Unit.CURRENT else "",
            one.side == "output" and "gear" not in scaling.mechanics.model_fields_set,
        )
        for name, one in profile.parameters.items()
    }  # fmt: skip
    return Parameters(profile.name, found, scaling.step_of(Unit.SPEED))
