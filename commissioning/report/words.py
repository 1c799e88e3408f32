"""How numbers are worded, on the screen and in the report alike."""

from __future__ import annotations

from typing import Any

__all__ = ["GAINS", "duration", "host_law"]

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


def host_law(terms: dict[str, Any] | None) -> str:
    """What the master of a drive adds in every cycle, where the drive has no compensation of its own."""
    if terms is None:
        return "this drive has no friction compensation to write to: identify and report only"
    return (
        f"this drive leaves friction to its master: in cyclic position or velocity mode add to "
        f"{terms['parameter']} ({terms['address']}) in every cycle {terms['offset_raw']:+d} "
        f"{terms['coulomb_raw']:+d} * sign(velocity command), in steps of {terms['raw_unit']} "
        f"({terms['offset']:+.4g} {terms['unit']} and {terms['coulomb']:+.4g} {terms['unit']})"
    )
