"""How numbers are worded, on the screen and in the report alike."""

from __future__ import annotations

__all__ = ["GAINS", "duration"]

# gain: (symbol, name of its unit in the result's `units`, or the unit itself)
GAINS = {
    "gain": ("K", "stiffness"), "integral_time": ("Ti", "s"), "derivative_time": ("Td", "s"),
    "velocity_gain": ("Kv", "viscous"), "position_gain": ("Kp", "1/s"),
}  # fmt: skip


def duration(value: float | None) -> str:
    """A time in ms below a second, else in s; None: never."""
    if value is None:
        return "never"
    return f"{value:.2f} s" if value >= 1 else f"{1000 * value:.0f} ms"
