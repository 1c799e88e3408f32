"""Position and velocity loop of the virtual drive."""

from __future__ import annotations

from drivers.virtual.axes import VirtualAxis

__all__ = ["TICK", "Loops"]

TICK = 250_000  # ns: period of the drive's own loops
_TICK_SECONDS = TICK / 1e9


class Loops:
    """Cascade of the drive: position P, velocity PI; tuned from the axis' inertia."""

    def __init__(self, axis: VirtualAxis) -> None:
        bandwidth = min(250.0, 0.25 / axis.lag) if axis.lag else 250.0  # rad/s
        if axis.resonance:
            bandwidth = min(bandwidth, 0.5 * axis.resonance)  # well below it
        self.velocity_gain = axis.inertia * bandwidth
        self.integral_gain = self.velocity_gain * bandwidth / 4
        self.position_gain = bandwidth / 5
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
