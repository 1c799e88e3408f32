"""What stands between a drive's firmware and its mechanics, and is not ideal.

On the way to the motor: a torque that is clipped without a word, torque noise, the drive's own tick
at which a command takes effect. On the way back: an encoder that is not centred or noisy, latched
at the tick.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from math import pi, sin

from drivers.virtual.compliant_plant import CompliantPlant
from drivers.virtual.plant import Plant

__all__ = ["Electronics", "Imperfections"]

_NOISE_HELD = 250_000  # ns
_NEVER = 2**62  # ns
_SECOND = 1_000_000_000  # ns


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Each 0 where there is none.

    Parameters
    ----------
    clip : largest torque that the drive makes, N.m or N
    torque_noise : rms of a white torque that is held for 250 µs, N.m or N
    tick : of the drive's own clock, s; its phase is drawn
    noise : rms of a white error of each position, rad or m
    eccentricity, turn : e of y = x + e·sin(2π·x/turn), rad or m
    shows_shaft : the torque that the drive tells is the one on the shaft, not the one it demands
    seed : of what is drawn
    """

    clip: float = 0.0
    torque_noise: float = 0.0
    tick: float = 0.0
    noise: float = 0.0
    eccentricity: float = 0.0
    turn: float = 2 * pi
    shows_shaft: bool = False
    seed: int = 0

    @property
    def is_none(self) -> bool:
        """Whether the drive is as it should be."""
        return not (
            self.clip or self.torque_noise or self.tick or self.noise or self.eccentricity
            or self.shows_shaft
        )  # fmt: skip


class Electronics:
    """A plant behind imperfect electronics; the interface of `Plant`."""

    def __init__(self, plant: Plant | CompliantPlant, imperfections: Imperfections) -> None:
        self.plant = plant
        self._i = imperfections
        self._random = random.Random(imperfections.seed)  # noqa: S311
        self._demand = self._noise = 0.0  # N.m or N
        self._tick = round(imperfections.tick * _SECOND) or _NEVER
        self._to_tick = self._random.randrange(self._tick) if imperfections.tick else _NEVER
        self._to_noise = 0 if imperfections.torque_noise else _NEVER
        self.position = 0.0
        self._latch()

    @property
    def locked(self) -> bool:
        """Holding brake closed."""
        return self.plant.locked

    @locked.setter
    def locked(self, locked: bool) -> None:
        self.plant.locked = locked

    @property
    def velocity(self) -> float:
        """True velocity of the motor, rad/s or m/s."""
        return self.plant.velocity

    @property
    def torque(self) -> float:
        """Torque as the drive tells it, N.m or N."""
        if self._i.shows_shaft:
            plant = self.plant
            return plant.torque if isinstance(plant, Plant) else plant.shaft_torque
        return self._demand if self._i.clip else self.plant.torque

    def advance(self, duration: float, command: float) -> None:
        """Let `duration` s pass under the constant torque command `command` (N.m or N)."""
        i, left = self._i, round(duration * _SECOND)
        if not i.tick:
            self._demand = command
        while left > 0:
            if self._to_tick <= 0:
                self._demand, self._to_tick = command, self._tick
                self._latch()
            if self._to_noise <= 0:
                self._noise, self._to_noise = self._random.gauss(0.0, i.torque_noise), _NOISE_HELD
            step = min(left, self._to_tick, self._to_noise)
            torque = min(max(self._demand, -i.clip), i.clip) if i.clip else self._demand
            self.plant.advance(step / _SECOND, torque + self._noise)
            left -= step
            self._to_tick -= step
            self._to_noise -= step
        if not i.tick:
            self._latch()

    def _latch(self) -> None:
        i, x = self._i, self.plant.position
        if i.eccentricity:
            x += i.eccentricity * sin(2 * pi * x / i.turn)
        if i.noise:
            x += self._random.gauss(0.0, i.noise)
        self.position = x
