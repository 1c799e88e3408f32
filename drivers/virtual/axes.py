"""The virtual axes: published machines and a bench, with every figure an option.

Sources: `emps` is Janot, Gautier, Brunot 2019 (nonlinearbenchmark.org); `thesis-motor` is section
4.10 of Blaha's thesis with k_DT read as 8e-3 and a Coulomb friction of ours, without its output
filter; `bench` and `vertical` are made up.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields, replace
from typing import Literal

from drivers.virtual.plant import PlantParameters
from profiles.errors import UnknownName, UsageError

__all__ = ["AXES", "VirtualAxis", "configured"]


@dataclass(frozen=True, slots=True)
class VirtualAxis:
    """One virtual drive with its axis.

    Rotary axes are in rad, N.m, kg.m2; for a linear one read m, N, kg: its drive counts a
    revolution as 2 pi m.

    Parameters
    ----------
    inertia, viscous, coulomb, breakaway, load, asymmetry, lag : see PlantParameters
    delay : s, from a torque command to its torque
    encoder : counts per turn, or per metre
    cycle : s, of the link, where the link has no other
    rated, peak : torque or force of the motor, N.m or N
    speed : rad/s or m/s, as delivered limit of the drive
    travel : room on either side, rad or m
    watchdog : s, as delivered
    brake : holding brake fitted
    """

    name: str
    title: str
    motion: Literal["rotary", "linear"]
    inertia: float
    viscous: float
    coulomb: float
    rated: float
    peak: float
    speed: float
    travel: float
    breakaway: float | None = None
    load: float = 0.0
    asymmetry: float = 0.0
    lag: float = 0.0
    delay: float = 0.002
    encoder: float = 131072.0
    cycle: float = 0.001
    watchdog: float = 0.05
    brake: bool = False
    seed: int = 0

    @property
    def plant(self) -> PlantParameters:
        """Mechanics of this axis."""
        return PlantParameters(
            self.inertia,
            self.viscous,
            self.coulomb,
            self.coulomb if self.breakaway is None else self.breakaway,
            self.load,
            self.asymmetry,
            self.lag,
        )

    @property
    def resolution(self) -> float:
        """Position of one encoder count, rad or m."""
        if self.motion == "rotary":
            return 6.283185307179586 / self.encoder
        return 1 / self.encoder

    @property
    def serial(self) -> int:
        """Serial number: the same axis with the same options is the same drive."""
        return zlib.crc32(repr(self).encode())


AXES: dict[str, VirtualAxis] = {
    axis.name: axis
    for axis in (
        VirtualAxis(
            name="bench", title="Bench axis: servo motor with a flywheel", motion="rotary",
            inertia=1e-3, viscous=2e-3, coulomb=0.1,
            rated=1.0, peak=3.0, speed=300.0, travel=3.141592653589793,
        ),
        VirtualAxis(
            name="thesis-motor", title="DC motor of the thesis, 1 V as 1 N.m and as 1 rad",
            motion="rotary", inertia=7.035e-3, viscous=0.2513, coulomb=0.3,
            rated=3.0, peak=10.0, speed=40.0, travel=10.0,
        ),
        VirtualAxis(
            name="vertical", title="Vertical axis with a holding brake", motion="rotary",
            inertia=1e-4, viscous=2e-4, coulomb=0.08, load=0.15,
            rated=1.3, peak=3.9, speed=300.0, travel=12.566370614359172, brake=True,
        ),
        VirtualAxis(
            name="emps", title="EMPS ball-screw slide", motion="linear",
            inertia=95.1089, viscous=203.5034, coulomb=20.3935, load=-3.1648,
            rated=117.2, peak=351.5, speed=1.0, travel=0.12, encoder=2e7,
        ),
    )
}  # fmt: skip

# what the drive's registers can hold, and what its firmware can step
_RANGES = {
    "encoder": (16, 2**30), "cycle": (1e-5, 1.0), "rated": (1e-3, 4000.0),
    "speed": (1e-3, 1e4), "delay": (0, 1.0), "watchdog": (0, 60.0), "lag": (0, 10.0),
}  # fmt: skip

_OPTIONS = {
    field.name: field
    for field in fields(VirtualAxis)
    if field.name not in {"name", "title", "motion", "brake", "seed"}
}


def configured(name: str, options: dict[str, str]) -> VirtualAxis:
    """The axis `name` with `options` (text, as in a LINK) put in; raises UsageError, UnknownName."""
    if name not in AXES:
        raise UnknownName("virtual axis", name, list(AXES))
    changes: dict[str, float | int] = {}
    for key, text in options.items():
        if key == "seed":
            changes[key] = _number(key, text, int)
        elif key in _OPTIONS:
            changes[key] = _number(key, text, float)
        else:
            raise UnknownName("option of a virtual axis", key, [*_OPTIONS, "seed", "state"])
    axis = replace(AXES[name], **changes)  # type: ignore[arg-type]
    try:
        _ = axis.plant
    except ValueError as error:
        raise UsageError(f"virtual axis '{name}': {error}") from None
    for key in ("encoder", "cycle", "rated", "peak", "speed", "travel"):
        if not getattr(axis, key) > 0:
            raise UsageError(f"virtual axis '{name}': {key} is {getattr(axis, key):g}: must be > 0")
    for key, (low, high) in _RANGES.items():
        if not low <= getattr(axis, key) <= high:
            raise UsageError(
                f"virtual axis '{name}': {key} is {getattr(axis, key):g}: must be {low:g}…{high:g}"
            )
    if not axis.rated <= axis.peak <= 30 * axis.rated:
        raise UsageError(
            f"virtual axis '{name}': peak is {axis.peak:g}: must be {axis.rated:g}…"
            f"{30 * axis.rated:g} (1 to 30 times rated)"
        )
    return axis


def _number(key: str, text: str, kind: type[int] | type[float]) -> float | int:
    try:
        value = kind(text)
    except ValueError:
        raise UsageError(f"option {key}={text!r}: must be a number") from None
    if not abs(value) < 1e300:
        raise UsageError(f"option {key}={text!r}: must be finite")
    return value
