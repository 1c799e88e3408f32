"""Friction of the virtual axes, as its papers have it; `mechanics` has the equations.

    Coulomb    F = Fc                                                     (held by Fs)
    Stribeck   F = Fc + (Fs − Fc)·e^(−(|v|/vs)^e)   Armstrong-Hélouvry, Dupont, Canudas de Wit 1994
    soft       F = Fc·tanh(v/w): no level holds it; the sigmoid of Gaz et al. 2019 has w = 2/φ2
    LuGre      bristles that bend               Canudas de Wit, Olsson, Åström, Lischinsky 1995
    Dahl       the same with g = Fc and no damping                                     Dahl 1968
    Maxwell    elements that stick as springs and slip one after the other             Iwan 1966
    GMS        the same with a level that falls with the speed            Al-Bender et al. 2005

Viscous friction is the plant's own.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.virtual.mechanics import ELEMENTS

__all__ = ["Dry", "Elements", "Friction", "LuGre", "Soft"]


@dataclass(frozen=True, slots=True)
class Dry:
    """Coulomb or Stribeck friction.

    Parameters
    ----------
    coulomb, breakaway : Fc and Fs, N.m or N
    stribeck : vs, rad/s or m/s; 0: Coulomb in motion, whatever the breakaway level
    exponent : e of the Stribeck curve
    """

    coulomb: float
    breakaway: float
    stribeck: float = 0.0
    exponent: float = 2.0


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


@dataclass(frozen=True, slots=True)
class LuGre:
    """Bristle friction; Dahl's with breakaway = coulomb and no damping.

    Parameters
    ----------
    coulomb, breakaway : Fc and Fs, N.m or N
    stribeck : vs, rad/s or m/s; 0: Fc at any speed
    stiffness : σ0, N.m/rad or N/m
    damping : σ1, N.m.s/rad or N.s/m
    exponent : e of the Stribeck curve
    """

    coulomb: float
    breakaway: float
    stribeck: float
    stiffness: float
    damping: float
    exponent: float = 2.0


@dataclass(frozen=True, slots=True)
class Elements:
    """Equal elements that stick as springs and slip at their share of the level.

    Element i of n slips after a deflection of reach·(i/n)^1.5 from rest.

    Parameters
    ----------
    coulomb, breakaway : Fc and Fs, N.m or N
    reach : of the last one, rad or m
    attraction : rate C of GMS friction, N.m/s or N/s: how soon an element that slips comes to its
        share; 0: at once, Maxwell's
    stribeck : vs, rad/s or m/s; 0: Fc at any speed
    exponent : e of the Stribeck curve
    """

    coulomb: float
    breakaway: float
    reach: float
    attraction: float = 0.0
    stribeck: float = 0.0
    exponent: float = 2.0

    @property
    def reaches(self) -> tuple[float, ...]:
        """Deflection at which each slips, rad or m."""
        return tuple(self.reach * ((i + 1) / ELEMENTS) ** 1.5 for i in range(ELEMENTS))

    @property
    def stiffness(self) -> float:
        """Of all of them together, N.m/rad or N/m."""
        return sum(self.coulomb / ELEMENTS / reach for reach in self.reaches)


Friction = Dry | Soft | LuGre | Elements
