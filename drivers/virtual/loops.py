"""Position and velocity loop of the virtual drive."""

from __future__ import annotations

from drivers.virtual.axes import VirtualAxis

__all__ = ["TICK", "Loops", "as_delivered"]

TICK = 250_000  # ns: period of the drive's own loops
_TICK_SECONDS = TICK / 1e9


def as_delivered(axis: VirtualAxis) -> tuple[float, float, float]:
    """Velocity gain, its integral time in s, position gain in 1/s; tuned from the axis' inertia."""
    bandwidth = min(250.0, 0.25 / axis.lag) if axis.lag else 250.0  # rad/s
    if axis.resonance:
        bandwidth = min(bandwidth, 0.5 * axis.resonance)  # well below it
    return axis.inertia * bandwidth, 4 / bandwidth, bandwidth / 5


class Loops:
    """Cascade of the drive: position P, velocity PI."""

    def __init__(self, velocity_gain: float, integral_time: float, position_gain: float) -> None:
        self.velocity_gain = velocity_gain
        self.integral_gain = velocity_gain / integral_time if integral_time else 0.0
        self.position_gain = position_gain
        self.integral = 0.0
        self.clamped = False

    def reset(self, torque: float) -> None:
        """Start from this torque of the integrator, N.m or N."""
        self.integral = torque
        self.clamped = False

    def velocity_control(self, wanted: float, actual: float) -> float:
        """PI control of velocity with the integrator held at the torque limit; returns torque."""
        error = wanted - actual
        if not self.clamped or self.integral * error < 0:
            self.integral += self.integral_gain * error * _TICK_SECONDS
        return self.velocity_gain * error + self.integral
