"""What the virtual drive can be asked and told: its objects, their ranges and defaults."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from drivers.virtual.axes import VirtualAxis
from drivers.virtual.loops import as_delivered

__all__ = [
    "MODES",
    "MODE_CYCLIC_POSITION",
    "MODE_CYCLIC_TORQUE",
    "MODE_PROFILE_TORQUE",
    "Object",
    "objects",
]

MODE_PROFILE_TORQUE = 4
MODE_PROFILE_VELOCITY = 3
MODE_CYCLIC_POSITION = 8
MODE_CYCLIC_VELOCITY = 9
MODE_CYCLIC_TORQUE = 10
MODES = (3, 4, 8, 9, 10)


_MOST = 4_000_000_000


@dataclass(frozen=True, slots=True)
class Object:
    """One object: raw default, smallest and largest value.

    `nonvolatile` ones are kept by a store.
    """

    default: int
    low: int = -(1 << 31)
    high: int = (1 << 32) - 1
    writable: bool = True
    nonvolatile: bool = False


def objects(axis: VirtualAxis) -> dict[str, Object]:
    """The objects of the drive of `axis`, by key; units stand in docs/virtual-drive.md."""
    revolution = 2 * pi / axis.resolution
    gain, integral, position = as_delivered(axis)
    per_mille = round(1000 * axis.peak / axis.rated)

    def setting(default: int, low: int, high: int) -> Object:
        return Object(default, low, high, nonvolatile=True)

    def fixed(value: int) -> Object:
        return Object(value, writable=False)

    return {
        "controlword": Object(0, 0, 0xFFFF),
        "mode": Object(0, -128, 127),
        "torque_target": Object(0, -32768, 32767),
        "position_target": Object(0),
        "velocity_target": Object(0),
        "rated_torque": fixed(round(axis.rated * 1e6)),  # uN.m
        "encoder_increments": fixed(round(revolution)),
        "encoder_revolutions": fixed(1),
        "supported_modes": fixed(sum(1 << (mode - 1) for mode in MODES)),
        "serial": fixed(axis.serial),
        "torque_lag": fixed(round(axis.lag * 1e6)),  # us
        "motor_temperature": fixed(round(10 * axis.temperature)),  # 0.1 degC
        "max_torque": setting(per_mille, 0, per_mille),
        "max_speed": setting(round(axis.speed * 600 / (2 * pi)), 0, 10_000_000),  # 0.1 rpm
        "torque_slope": setting(0xFFFFFFFF, 1, 0xFFFFFFFF),  # per mille of rated a second
        "quick_stop_option": setting(2, 0, 8),
        "abort_connection_option": setting(1, 0, 3),
        "watchdog_time": setting(round(axis.watchdog * 1000), 0, 65535),  # ms
        "following_window": setting(round(revolution / 4), 0, (1 << 31) - 1),
        "torque_offset": setting(0, -1000, 1000),  # per mille of rated
        "coulomb_positive": setting(0, 0, 1000),
        "coulomb_negative": setting(0, 0, 1000),
        "coulomb_speed": setting(0, 0, 10_000_000),  # 0.1 rpm: linear up to there; 0: at once
        "viscous_gain": setting(0, 0, 65535),  # 1e-5 of rated a rad/s
        "velocity_gain": setting(round(1e6 * gain / axis.rated), 0, _MOST),  # 1e-6 of rated a rad/s
        "integral_time": setting(round(1e6 * integral), 0, _MOST),  # us; 0: no integral part
        "position_gain": setting(round(100 * position), 0, 1_000_000),  # 0.01/s
    }
