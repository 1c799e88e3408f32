"""The friction compensation that the virtual drive has.

Of every law of a profile, what it makes of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

__all__ = ["TENTH_RPM", "compensation"]

TENTH_RPM = 2 * pi / 600  # rad/s
_VISCOUS = 1e-5  # of the rated torque, per rad/s


def compensation(values: Mapping[str, int], velocity: float, rated: float) -> float:
    """Torque, N.m or N, by the direction of the velocity command (rad/s or m/s).

    `values` : raw, as the firmware keeps them; `rated` : torque of the motor, N.m or N
    """
    unit = rated / 1000
    torque = values["torque_offset"] * unit
    threshold = values["coulomb_speed"] * TENTH_RPM
    share = min(abs(velocity) / threshold, 1.0) if threshold else 1.0
    if velocity > 0:
        torque += share * values["coulomb_positive"] * unit
    elif velocity < 0:
        torque -= share * values["coulomb_negative"] * unit
    return torque + values["viscous_gain"] * _VISCOUS * rated * velocity
