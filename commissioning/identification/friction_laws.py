"""The ladder of friction laws that a record is fitted with, simplest first.

Each law is a sum of terms, linear in its coefficients, with at most one shape parameter:

    Coulomb        f·s                          s = sign(v)
    Stribeck       + b·s·e^(−(|v|/vs)^e)        vs: Stribeck speed; e 2, 1 or ½
    soft           f·tanh(v/w) + g/cosh²(v/w)   w: width; instead of the Coulomb term. g: a sigmoid
                                                whose middle is not at rest, f·tanh((v + v₃)/w) with
                                                g = f·v₃/w
    load           + c·s·|u − offset|           friction that grows with the transmitted torque
    drag           + c·v·|v|                    of air, oil or a fan
    drift          + r·s·(t − t₀)               t₀: middle of the record, so that f is the mean
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
Rung = Literal["stribeck", "soft", "load", "drag", "drift", "position"]


@dataclass(frozen=True, slots=True)
class Law:
    """A friction law: the rungs above Coulomb that it has, and their shape parameters.

    Attributes
    ----------
    stribeck, exponent : vs, rad/s or m/s, and e; None: no such term
    soft : w, rad/s or m/s; None: the sign is hard
    load : whether friction grows with the torque
    drag : whether there is a torque that grows with the square of the speed
    drift : whether friction changes with time
    position : pitch λ, rad or m; None: no such term
    """

    stribeck: float | None = None
    exponent: float = 2.0
    soft: float | None = None
    load: bool = False
    drag: bool = False
    drift: bool = False
    position: float | None = None

    @property
    def rungs(self) -> tuple[Rung, ...]:
        """Names of what is added to Coulomb friction."""
        there: dict[Rung, bool] = {
            "stribeck": self.stribeck is not None, "soft": self.soft is not None,
            "load": self.load, "drag": self.drag, "drift": self.drift,
            "position": self.position is not None,
        }  # fmt: skip
        return tuple(rung for rung, is_there in there.items() if is_there)

    def place(self, rung: Rung) -> int:
        """Where the first coefficient of a term stands."""
        before = ("soft", "stribeck", "load", "drag", "drift", "position")
        return 1 + sum(one in self.rungs for one in before[: before.index(rung)])

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
            columns.append(cells.sign * np.exp(-((speed / self.stribeck) ** self.exponent)))
        if self.load:
            columns.append(cells.sign * np.abs(cells.torque))
        if self.drag:
            columns.append(cells.velocity * speed)
        if self.drift:
            middle = 0.5 * (cells.edges[1:] + cells.edges[:-1])
            columns.append(cells.sign * (middle - 0.5 * (cells.edges[0] + cells.edges[-1])))
        if self.position is not None:
            angle = 2 * np.pi * cells.position / self.position
            columns += [np.cos(angle), np.sin(angle)]
        return np.column_stack(columns)


def curve(law: Law, coefficients: Array, viscous: float, speed: Array) -> Array:
    """Friction against speed at no load and in the middle of the record.

    Mean of both directions, N.m or N.
    """
    friction = coefficients[0] * np.ones_like(speed)
    if law.soft is not None:
        friction = coefficients[0] * np.tanh(speed / law.soft)
    if law.stribeck is not None:
        friction = friction + coefficients[1] * np.exp(-((speed / law.stribeck) ** law.exponent))
    if law.drag:
        friction = friction + coefficients[law.place("drag")] * speed**2
    result: Array = friction + viscous * speed
    return result
