"""An axis that is more than rigid with Coulomb friction: the plant that `mechanics` integrates.

The rigid axis with Coulomb friction has its closed form in `plant`.
"""

from __future__ import annotations

import inspect
import sys
import types
from collections.abc import Callable, MutableSequence
from dataclasses import dataclass
from math import inf, pi, sqrt
from typing import Any

from drivers.virtual import mechanics as m
from drivers.virtual.friction import Elements, Friction, LuGre, Soft

__all__ = ["CompliantParameters", "CompliantPlant", "accelerate"]

_LONGEST_STEP = 2e-4  # s
_STEPS_A_RADIAN = 25  # of the fastest oscillation

Advance = Callable[[Any, Any, float, float], None]


@dataclass(frozen=True, slots=True)
class CompliantParameters:
    """What the mechanics are; a rotary axis in rad, N.m, kg.m2, a linear one in m, N, kg.

    Parameters
    ----------
    inertia : whole, motor and load, > 0
    viscous : B, on the motor
    friction : law on the motor
    load : torque that holds the axis
    asymmetry : share by which friction is larger in the positive and smaller in the negative
        direction
    load_friction : share of the transmitted torque |u_m − load| that is friction too
    lag : of the torque loop, s
    cogging, pitch : amplitude, N.m or N, and period, rad or m, of a torque that goes with the
        position; the cosine of it
    cogging_2, pitch_2, angle_2 : a second one, with the angle at 0, rad
    resonance : of motor against load, Hz; 0: one rigid mass
    ratio : inertia of the load over that of the motor
    damping : of the resonance, as a damping ratio
    backlash : play between motor and load, rad or m (needs a resonance)
    load_coulomb : Coulomb friction on the load side, N.m or N
    output_filter : corner of a first-order filter in the position signal, rad/s; 0: none
    drag : c of a torque c·v·|v|, N.m.s2/rad2 or N.s2/m2
    drift : share by which friction grows a second, 1/s
    slope : share by which it grows with the position, 1/rad or 1/m
    wave, wave_length : share by which it goes with a sine of the position, and its period
    spring : torque towards position 0, N.m/rad or N/m
    gravity, gravity_angle : G·cos(x + angle), N.m or N, rad
    gain : torque on the shaft over torque commanded
    ripple, ripple_waves : share of it that goes with sin(waves·x), waves a radian or metre
    """

    inertia: float
    viscous: float
    friction: Friction
    load: float = 0.0
    asymmetry: float = 0.0
    load_friction: float = 0.0
    lag: float = 0.0
    cogging: float = 0.0
    pitch: float = 2 * pi
    resonance: float = 0.0
    ratio: float = 1.0
    damping: float = 0.02
    backlash: float = 0.0
    load_coulomb: float = 0.0
    output_filter: float = 0.0
    cogging_2: float = 0.0
    pitch_2: float = 2 * pi
    angle_2: float = 0.0
    drag: float = 0.0
    drift: float = 0.0
    slope: float = 0.0
    wave: float = 0.0
    wave_length: float = 2 * pi
    spring: float = 0.0
    gravity: float = 0.0
    gravity_angle: float = 0.0
    gain: float = 1.0
    ripple: float = 0.0
    ripple_waves: float = 1.0


class CompliantPlant:
    """State of the mechanics and its advance in time; the interface of `Plant`."""

    def __init__(self, parameters: CompliantParameters, position: float = 0.0) -> None:
        self.parameters = parameters
        self.locked = False
        self._p = _numbers(parameters)
        self._two = self._p[m.J2] > 0
        self._advance: Advance = m.advance
        self._s: MutableSequence[float] = [0.0] * m.STATES
        self.place(position)
        if _COMPILED:
            self._compile(_COMPILED[0])

    def _compile(self, advance: Advance) -> None:
        import numpy as np

        self._advance = advance
        self._p, self._s = np.array(self._p), np.array(self._s)  # type: ignore[assignment]

    def place(self, position: float) -> None:
        """Put the axis at rest at `position` of the motor; the load hangs on the spring."""
        p, s = self._p, self._s
        time = s[m.TIME]
        for place in range(m.STATES):
            s[place] = 0.0
        s[m.X1] = s[m.SEEN] = s[m.X2] = position
        s[m.TIME] = time
        if self._two:  # on the side to which it pulls
            pull = m.outer_torque(p, position)
            twist = pull / p[m.JOINT_K] + 0.5 * p[m.PLAY] * ((pull > 0) - (pull < 0))
            s[m.X2] = position - twist

    @property
    def position(self) -> float:
        """Position of the motor as it is measured, rad or m."""
        return float(self._s[m.SEEN if self._p[m.CORNER] else m.X1])

    @property
    def velocity(self) -> float:
        """Velocity of the motor, rad/s or m/s."""
        return float(self._s[m.V1])

    @property
    def torque(self) -> float:
        """Torque that the motor makes by its current, behind the lag, N.m or N."""
        return float(self._s[m.MOTOR])

    @property
    def shaft_torque(self) -> float:
        """Torque that acts on the motor, gain and ripple in it, N.m or N."""
        return m.torque_on_shaft(self._p, self.torque, float(self._s[m.X1]))

    @property
    def deflection(self) -> float:
        """Motor against load, rad or m."""
        return float(self._s[m.X1] - self._s[m.X2]) if self._two else 0.0

    def advance(self, duration: float, command: float) -> None:
        """Let `duration` s pass under the constant torque command `command` (N.m or N)."""
        if self.locked:
            s = self._s
            s[m.V1] = s[m.V2] = s[m.WAY] = s[m.WAY_LOAD] = 0.0
            s[m.MOTOR] = command
            s[m.TIME] += duration
            return
        self._advance(self._p, self._s, duration, command)


def _numbers(p: CompliantParameters) -> list[float]:
    """Parameters as `mechanics` has them."""
    n = [0.0] * m.PARAMETERS
    n[m.J2] = p.inertia * p.ratio / (1 + p.ratio) if p.resonance > 0 else 0.0
    n[m.J1] = p.inertia - n[m.J2]
    fastest, longest = 0.0, _LONGEST_STEP
    if p.resonance > 0:
        fastest = 2 * pi * p.resonance
        reduced = n[m.J1] * n[m.J2] / p.inertia
        n[m.JOINT_K] = reduced * fastest**2
        n[m.JOINT_C] = 2 * p.damping * reduced * fastest
    law = p.friction
    n[m.COULOMB] = law.coulomb
    if isinstance(law, Soft):
        n[m.KIND], n[m.WIDTH], n[m.SHIFT] = m.SOFT, law.width, law.shift
    else:
        n[m.BREAKAWAY], n[m.STRIBECK], n[m.EXPONENT] = law.breakaway, law.stribeck, law.exponent
    stiffness = 0.0
    if isinstance(law, LuGre):
        n[m.KIND], n[m.DAMPING] = m.BRISTLES, law.damping
        n[m.STIFFNESS] = stiffness = law.stiffness
    if isinstance(law, Elements):
        n[m.KIND] = m.GMS if law.attraction else m.MAXWELL
        n[m.ATTRACTION], stiffness = law.attraction, law.stiffness
        n[m.SHARES : m.SHARES + m.ELEMENTS] = [1 / m.ELEMENTS] * m.ELEMENTS
        n[m.REACHES : m.REACHES + m.ELEMENTS] = law.reaches
        if law.attraction:
            longest = min(longest, 0.25 * law.coulomb / law.attraction)
    fastest = max(fastest, sqrt(abs(p.spring) / n[m.J1]))
    n[m.SLIDING] = min(longest, 1 / (_STEPS_A_RADIAN * fastest) if fastest else inf)
    fastest = max(fastest, sqrt((stiffness + abs(p.spring)) / n[m.J1]))
    longest = min(longest, 1 / (_STEPS_A_RADIAN * fastest) if fastest else inf)
    n[m.LONGEST] = longest
    if p.output_filter:
        for place in (m.LONGEST, m.SLIDING):
            n[place] = min(n[place], 0.25 / p.output_filter)
    for place, value in (
        (m.VISCOUS, p.viscous), (m.DRAG, p.drag), (m.ASYMMETRY, p.asymmetry), (m.DRIFT, p.drift),
        (m.SLOPE, p.slope), (m.WAVE, p.wave), (m.WAVE_LENGTH, p.wave_length),
        (m.LOAD_FRICTION, p.load_friction), (m.LOAD, p.load), (m.SPRING, p.spring),
        (m.GRAVITY, p.gravity), (m.GRAVITY_ANGLE, p.gravity_angle), (m.COGGING, p.cogging),
        (m.PITCH, p.pitch), (m.COGGING_2, p.cogging_2), (m.PITCH_2, p.pitch_2),
        (m.ANGLE_2, p.angle_2), (m.PLAY, p.backlash), (m.LOAD_COULOMB, p.load_coulomb),
        (m.LAG, p.lag), (m.GAIN, p.gain), (m.RIPPLE, p.ripple), (m.RIPPLE_WAVES, p.ripple_waves),
        (m.CORNER, p.output_filter),
    ):  # fmt: skip
        n[place] = value
    return n


_COMPILED: list[Advance] = []  # the one compiled integration, once there is one


def accelerate() -> bool:
    """Compile the integration of the plants that are built from now on; False without numba.

    The first time on a computer takes half a minute, later ones are read from numba's cache. The
    motion is the same to 1e-9.
    """
    try:
        import numba
    except ImportError:
        return False
    if not _COMPILED:
        own = types.ModuleType(m.__name__ + "_compiled")  # a second one, in which all is compiled
        sys.modules[own.__name__] = own
        exec(compile(inspect.getsource(m), m.__file__, "exec"), own.__dict__)  # noqa: S102
        for name, value in list(vars(own).items()):
            if inspect.isfunction(value) and value.__module__ == own.__name__:
                setattr(own, name, numba.njit(cache=True)(value))
        _COMPILED.append(own.advance)
    return True
