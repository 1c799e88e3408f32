"""Raw values of a drive against SI at the axis.

The drive counts in shares of its rated torque, increments and motor revolutions; the axis adds gear
and feed. SI at the axis is rad or m, N.m or N, and their derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

from profiles.address import Address
from profiles.axis import Mechanics
from profiles.parameter import Parameter, Unit

__all__ = ["Scaling"]


@dataclass(frozen=True, slots=True)
class Scaling:
    """Conversion for one drive on one axis.

    Parameters
    ----------
    rated_torque : N.m of the motor
    increments_per_revolution : of the motor
    mechanics : gear and feed
    torque_constant : N.m/A; 0 where no parameter is a current
    turned : addresses of what the drive counts against its motor
    """

    rated_torque: float
    increments_per_revolution: float
    mechanics: Mechanics
    torque_constant: float = 0.0
    turned: frozenset[Address] = frozenset()

    def step(self, parameter: Parameter) -> float:
        """Value of one raw step in SI at the axis.

        Negative where the drive counts against its motor.
        """
        of = self
        if parameter.side == "output":
            of = replace(self, mechanics=self.mechanics.model_copy(update={"gear": 1.0}))
        step = parameter.scale * of.step_of(parameter.unit)
        return -step if parameter.address in self.turned else step

    def unit_text(self, parameter: Parameter) -> str:
        """ASCII unit of the SI value at the axis."""
        rotary = self.mechanics.motion == "rotary"
        position, effort = ("rad", "N.m") if rotary else ("m", "N")
        return {
            Unit.NONE: "1",
            Unit.SECOND: "s",
            Unit.PER_SECOND: "1/s",
            Unit.MINUTE: "min",
            Unit.DEGREE_CELSIUS: "degC",
            Unit.TORQUE: effort,
            Unit.CURRENT: effort,
            Unit.RATED_TORQUE: effort,
            Unit.RATED_TORQUE_PER_SECOND: f"{effort}/s",
            Unit.RATED_TORQUE_PER_SPEED: f"{effort}.s/{position}",
            Unit.TORQUE_PER_SPEED: f"{effort}.s/{position}",
            Unit.STIFFNESS: f"{effort}/{position}",
            Unit.REVOLUTION: position,
            Unit.INCREMENT: position,
            Unit.INCREMENT_PER_SECOND: f"{position}/s",
            Unit.SPEED: f"{position}/s",
            Unit.RPM: f"{position}/s",
        }[parameter.unit]

    def raw_unit(self, parameter: Parameter) -> str:
        """What the drive counts in, for people: '0.001 rated', 'increment'."""
        if parameter.is_float:
            return "bits of an f32"
        return (
            parameter.unit.value
            if parameter.scale == 1
            else (f"{parameter.scale:g} {parameter.unit.value}")
        )

    def step_of(self, unit: Unit) -> float:
        """What one of `unit` is in SI at the axis."""
        travel = self.mechanics.travel_per_revolution  # rad or m a motor revolution
        effort = self.mechanics.effort_per_torque
        return {
            Unit.NONE: 1.0,
            Unit.SECOND: 1.0,
            Unit.PER_SECOND: 1.0,
            Unit.MINUTE: 1.0,
            Unit.DEGREE_CELSIUS: 1.0,
            Unit.TORQUE: effort,
            Unit.CURRENT: self.torque_constant * effort,
            Unit.RATED_TORQUE: self.rated_torque * effort,
            Unit.RATED_TORQUE_PER_SECOND: self.rated_torque * effort,
            Unit.RATED_TORQUE_PER_SPEED: self.rated_torque * effort * 2 * pi / travel,
            Unit.TORQUE_PER_SPEED: effort * 2 * pi / travel,
            Unit.STIFFNESS: effort * 2 * pi / travel,
            Unit.REVOLUTION: travel,
            Unit.INCREMENT: travel / self.increments_per_revolution,
            Unit.INCREMENT_PER_SECOND: travel / self.increments_per_revolution,
            Unit.SPEED: travel / (2 * pi),
            Unit.RPM: travel / 60,
        }[unit]
