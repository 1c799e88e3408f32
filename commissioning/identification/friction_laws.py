"""The ladder of friction laws that a record is fitted with, simplest first.

Each law is a sum of terms, linear in its coefficients, with at most one shape parameter:

    Coulomb        f·s                          s = sign(v)
    Stribeck       + b·s·e^(−(v/vs)²)           vs: Stribeck speed
    soft           f·tanh(v/w) + g/cosh²(v/w)   w: width; instead of the Coulomb term. g: a sigmoid
                                                whose middle is not at rest, f·tanh((v + v₃)/w) with
                                                g = f·v₃/w
    load           + c·s·|u − offset|           friction that grows with the transmitted torque
    position       + p·cos(2πy/λ) + q·sin(2πy/λ)  λ: pitch; cogging, a screw's wobble
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from commissioning.identification.motion import Cells

__all__ = ["Law", "Rung", "curve"]

Array = NDArray[np.float64]
Rung = Literal["stribeck", "soft", "load", "position"]


@dataclass(frozen=True, slots=True)
class Law:
    """A friction law: the rungs above Coulomb that it has, and their shape parameters.

    Attributes
    ----------
    stribeck : vs, rad/s or m/s; None: no such term
    soft : w, rad/s or m/s; None: the sign is hard
    load : whether friction grows with the torque
    position : pitch λ, rad or m; None: no such term
    """

    stribeck: float | None = None
    soft: float | None = None
    load: bool = False
    position: float | None = None

    @property
    def rungs(self) -> tuple[Rung, ...]:
        """Names of what is added to Coulomb friction."""
        found: list[Rung] = []
        if self.stribeck is not None:
            found.append("stribeck")
        if self.soft is not None:
            found.append("soft")
        if self.load:
            found.append("load")
        if self.position is not None:
            found.append("position")
        return tuple(found)

    @property
    def load_term(self) -> int:
        """Where the coefficient of the load term stands."""
        return 1 + (self.stribeck is not None) + (self.soft is not None)

    def terms(self, cells: Cells) -> Array:
        """Terms in the cells, (n, k), the Coulomb one first.

        Each times its coefficient is a torque.
        """
        speed = np.abs(cells.velocity)
        columns = [cells.sign]
        if self.soft is not None:
            level = np.tanh(cells.velocity / self.soft)
            columns = [level, 1 - level**2]
        if self.stribeck is not None:
            columns.append(cells.sign * np.exp(-((speed / self.stribeck) ** 2)))
        if self.load:
            columns.append(cells.sign * np.abs(cells.torque))
        if self.position is not None:
            angle = 2 * np.pi * cells.position / self.position
            columns += [np.cos(angle), np.sin(angle)]
        return np.column_stack(columns)


def curve(law: Law, coefficients: Array, viscous: float, speed: Array) -> Array:
    """Friction against speed at no load, mean of both directions, N.m or N."""
    friction = coefficients[0] * np.ones_like(speed)
    if law.soft is not None:
        friction = coefficients[0] * np.tanh(speed / law.soft)
    if law.stribeck is not None:
        friction = friction + coefficients[1] * np.exp(-((speed / law.stribeck) ** 2))
    result: Array = friction + viscous * speed
    return result
