"""Friction of the virtual axes, as its papers have it.

A dry law gives a level against the motion, F(v) for v > 0, and a level that holds the axis at rest:

    Coulomb    F = Fc                                                     (held by Fs)
    Stribeck   F = Fc + (Fs − Fc)·e^(−(v/vs)²)    Armstrong-Hélouvry, Dupont, Canudas de Wit 1994
    soft       F = Fc·tanh(v/w): no level holds it; the sigmoid of Gaz et al. 2019 has w = 2/φ2

LuGre (Canudas de Wit, Olsson, Åström, Lischinsky 1995) has a state, the bristle deflection z:

    dz/dt = v − σ0·|v|/g(v)·z          F = σ0·z + σ1·dz/dt          g = Fc + (Fs − Fc)·e^(−(v/vs)²)

Viscous friction is the plant's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf, tanh

__all__ = ["Dry", "LuGre", "Soft"]


@dataclass(frozen=True, slots=True)
class Dry:
    """Coulomb or Stribeck friction.

    Parameters
    ----------
    coulomb, breakaway : Fc and Fs, N.m or N
    stribeck : vs, rad/s or m/s; 0: Coulomb in motion, whatever the breakaway level
    """

    coulomb: float
    breakaway: float
    stribeck: float = 0.0

    def level(self, speed: float) -> float:
        """Friction in motion at |v| = `speed`, N.m or N."""
        if not self.stribeck:
            return self.coulomb
        x = speed / self.stribeck
        return (
            self.coulomb + (self.breakaway - self.coulomb) * exp(-x * x) if x < 6 else self.coulomb
        )

    @property
    def flat_from(self) -> float:
        """Speed above which the level no longer changes, rad/s or m/s."""
        return 3.5 * self.stribeck

    def time_scale(self, acceleration: float) -> float:
        """Time in which the level may change under an acceleration, s."""
        return self.stribeck / acceleration if self.stribeck and acceleration > 0 else inf


@dataclass(frozen=True, slots=True)
class Soft:
    """Friction that rises smoothly through zero speed: nothing sticks, everything creeps.

    Parameters
    ----------
    coulomb : level at high speed, N.m or N
    width : w, rad/s or m/s
    shift : v₃ of the sigmoid, rad/s or m/s: a bias of the speed; F(0) = 0 all the same
    """

    coulomb: float
    width: float
    shift: float = 0.0

    def torque(self, velocity: float) -> float:
        """Friction at a velocity, with its sign, N.m or N."""
        bias = tanh(self.shift / self.width) if self.shift else 0.0
        return self.coulomb * (tanh((velocity + self.shift) / self.width) - bias)

    @property
    def flat_from(self) -> float:
        """Speed above which the friction no longer changes, rad/s or m/s."""
        return 8 * self.width + abs(self.shift)

    def time_scale(self, acceleration: float) -> float:
        """Time in which the friction may change under an acceleration, s."""
        return self.width / acceleration if acceleration > 0 else inf


@dataclass(frozen=True, slots=True)
class LuGre:
    """Bristle friction.

    Parameters
    ----------
    coulomb, breakaway : Fc and Fs, N.m or N
    stribeck : vs, rad/s or m/s, > 0
    stiffness : σ0, N.m/rad or N/m
    damping : σ1, N.m.s/rad or N.s/m
    """

    coulomb: float
    breakaway: float
    stribeck: float
    stiffness: float
    damping: float

    def level(self, speed: float) -> float:
        """g(v): friction at a constant speed, N.m or N."""
        x = speed / self.stribeck
        return (
            self.coulomb + (self.breakaway - self.coulomb) * exp(-x * x) if x < 6 else self.coulomb
        )

    def rate(self, velocity: float, deflection: float) -> float:
        """dz/dt, rad/s or m/s."""
        return velocity - self.stiffness * abs(velocity) / self.level(abs(velocity)) * deflection

    def torque(self, deflection: float, rate: float) -> float:
        """Friction with its sign, N.m or N."""
        return self.stiffness * deflection + self.damping * rate
