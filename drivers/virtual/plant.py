"""Physics of a rigid axis with dry friction, solved exactly between events.

    J * dv/dt = u_m - load - B * v - F(v)          dx/dt = v
    lag * du_m/dt = u - u_m                        (torque loop; lag = 0: u_m = u)

F(v) is Coulomb friction, `coulomb * (1 +/- asymmetry)` against the motion, and a breakaway level
that holds the axis at rest. Between a velocity reversal, a stop and a breakaway the equation is
linear, so its closed form is used; the events themselves are found to rounding error.

A rotary axis is in rad, N.m, kg.m2; a linear one in m, N, kg.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, expm1, log, log1p

__all__ = ["Plant", "PlantParameters"]

_ROOT_STEPS = 80
_TIME_RESOLUTION = 1e-15  # s: far below the nanosecond that the firmware counts in
_MAX_SEGMENTS = 1000  # a step of some milliseconds has a handful of events; more is a bug


@dataclass(frozen=True, slots=True)
class PlantParameters:
    """What the mechanics are.

    Parameters
    ----------
    inertia : J, kg.m2 or kg, > 0
    viscous : B, N.m.s/rad or N.s/m
    coulomb : mean Coulomb friction of both directions, N.m or N
    breakaway : torque that the axis withstands at rest, N.m or N; at least `coulomb`
    load : torque needed to hold the axis, N.m or N (> 0 needs a positive torque)
    asymmetry : share by which friction is larger in the positive and smaller in the negative
        direction
    lag : time constant of the torque loop, s
    """

    inertia: float
    viscous: float
    coulomb: float
    breakaway: float
    load: float = 0.0
    asymmetry: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        if not self.inertia > 0:
            raise ValueError(f"inertia is {self.inertia:g}: must be > 0")
        for name in ("viscous", "coulomb", "lag"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name):g}: must not be negative")
        if self.breakaway < self.coulomb:
            raise ValueError(
                f"breakaway is {self.breakaway:g}: must be at least coulomb, {self.coulomb:g}"
            )
        if not -1 < self.asymmetry < 1:
            raise ValueError(f"asymmetry is {self.asymmetry:g}: must lie between -1 and 1")


@dataclass(frozen=True, slots=True)
class _Propagator:
    """Coefficients of the closed form over one time step (all in s and s2)."""

    decay: float  # e^(-b t)
    a1: float  # integral of the decay
    a2: float  # integral of a1
    lag_decay: float  # e^(-t/lag)
    k1: float  # velocity from a unit torque transient
    k2: float  # position from it


class Plant:
    """State of the mechanics and its exact advance in time.

    Attributes
    ----------
    position, velocity : rad, rad/s or m, m/s
    torque : torque that acts on the axis (after the lag), N.m or N
    locked : holding brake closed; the axis stands
    """

    __slots__ = (
        "_b", "_cache", "_lag", "_per_inertia", "_resist_down", "_resist_up", "locked",
        "parameters", "position", "torque", "velocity",
    )  # fmt: skip

    def __init__(self, parameters: PlantParameters, position: float = 0.0) -> None:
        self.parameters = parameters
        self.position = position
        self.velocity = 0.0
        self.torque = 0.0
        self.locked = False
        self._b = parameters.viscous / parameters.inertia
        self._per_inertia = 1 / parameters.inertia
        self._resist_up = parameters.load + self.kinetic_friction(+1)
        self._resist_down = parameters.load - self.kinetic_friction(-1)
        self._lag = parameters.lag
        if self._lag and abs(self._b * self._lag - 1) < 1e-6:
            self._lag *= (
                1 + 2e-6
            )  # the two time constants coincide: the partial fractions need them apart
        self._cache: dict[float, _Propagator] = {}

    def advance(self, duration: float, command: float) -> None:
        """Let `duration` s pass under the constant torque command `command` (N.m or N)."""
        velocity = self.velocity
        if velocity and not self._lag and not self.locked:
            # nearly every step: moving, and still moving the same way at its end
            resisting = self._resist_up if velocity > 0 else self._resist_down
            acceleration = (command - resisting) * self._per_inertia
            step = self._cache.get(duration) or self._propagator(duration)
            end = velocity * step.decay + acceleration * step.a1
            if end * velocity > 0:
                self.position += velocity * step.a1 + acceleration * step.a2
                self.velocity = end
                self.torque = command
                return
        if self.locked:
            self.velocity = 0.0
            self._settle_torque(duration, command)
            return
        remaining = duration
        for _ in range(_MAX_SEGMENTS):
            if self.velocity == 0.0:
                remaining -= self._stand(remaining, command)
            if remaining <= _TIME_RESOLUTION:
                return
            remaining -= self._move(remaining, command)
            if remaining <= _TIME_RESOLUTION:
                return
        raise ArithmeticError("the axis changes between rest and motion without end")

    def kinetic_friction(self, direction: int) -> float:
        """Friction torque against motion in `direction` (+1 or -1), a magnitude in N.m or N."""
        p = self.parameters
        return p.coulomb * (1 + direction * p.asymmetry)

    # -- at rest ---------------------------------------------------------------------------------

    def _stand(self, limit: float, command: float) -> float:
        """Stay at rest until the torque breaks the axis away, at most `limit` s.

        Return the time.
        """
        p = self.parameters
        upper = p.load + p.breakaway * (1 + p.asymmetry)
        lower = p.load - p.breakaway * (1 - p.asymmetry)
        if self.torque > upper or self.torque < lower:
            return 0.0
        if self._lag == 0.0:
            self.torque = command
            return limit if lower <= command <= upper else 0.0
        if lower <= command <= upper:
            self._settle_torque(limit, command)
            return limit
        threshold = upper if command > upper else lower
        if self.torque == threshold:
            return 0.0
        time = self._lag * log((command - self.torque) / (command - threshold))
        if time >= limit:
            self._settle_torque(limit, command)
            return limit
        self.torque = threshold
        return time

    def _settle_torque(self, duration: float, command: float) -> None:
        if self._lag == 0.0:
            self.torque = command
        else:
            self.torque = command + (self.torque - command) * exp(-duration / self._lag)

    # -- in motion -------------------------------------------------------------------------------

    def _move(self, limit: float, command: float) -> float:
        """Move in one direction until the velocity is zero, at most `limit` s; return the time."""
        p = self.parameters
        if self._lag == 0.0:
            self.torque = command
        velocity = self.velocity
        if velocity == 0.0:
            # leaving rest, or passing through zero with a torque beyond the breakaway level
            pull = self.torque - p.load if self.torque != p.load else command - p.load
            direction = 1 if pull > 0 else -1
        else:
            direction = 1 if velocity > 0 else -1
        acceleration = (command - p.load - direction * self.kinetic_friction(direction)) / p.inertia
        transient = (self.torque - command) / p.inertia
        step = self._propagator(limit)
        end = velocity * step.decay + acceleration * step.a1 + transient * step.k1
        if end * direction > 0 and not self._dips(
            limit, velocity, acceleration, transient, direction
        ):
            self.position += velocity * step.a1 + acceleration * step.a2 + transient * step.k2
            self.velocity = end
            if self._lag:
                self.torque = command + (self.torque - command) * step.lag_decay
            return limit
        time = self._reversal(limit, velocity, acceleration, transient, direction)
        step = self._compute(time)
        self.position += velocity * step.a1 + acceleration * step.a2 + transient * step.k2
        self.velocity = 0.0
        if self._lag:
            self.torque = command + (self.torque - command) * step.lag_decay
        return time

    def _acceleration_at(
        self, time: float, velocity: float, acceleration: float, transient: float
    ) -> float:
        """dv/dt after `time` s."""
        step = self._compute(time)
        v = velocity * step.decay + acceleration * step.a1 + transient * step.k1
        return acceleration - self._b * v + transient * step.lag_decay

    def _velocity_at(
        self, time: float, velocity: float, acceleration: float, transient: float
    ) -> float:
        step = self._compute(time)
        return velocity * step.decay + acceleration * step.a1 + transient * step.k1

    def _dips(
        self,
        limit: float,
        velocity: float,
        acceleration: float,
        transient: float,
        direction: int,
    ) -> bool:
        """Whether the velocity passes zero and comes back within `limit` s (a lag can do that)."""
        if transient == 0.0 or velocity == 0.0:
            return False
        extremum = self._extremum(limit, velocity, acceleration, transient)
        return extremum is not None and (
            self._velocity_at(extremum, velocity, acceleration, transient) * direction <= 0
        )

    def _extremum(
        self, limit: float, velocity: float, acceleration: float, transient: float
    ) -> float | None:
        """Time within `limit` s at which dv/dt is zero, or None."""
        low, high = 0.0, limit
        at_low = self._acceleration_at(low, velocity, acceleration, transient)
        at_high = self._acceleration_at(high, velocity, acceleration, transient)
        if at_low * at_high >= 0:
            return None
        for _ in range(_ROOT_STEPS):
            middle = 0.5 * (low + high)
            if self._acceleration_at(middle, velocity, acceleration, transient) * at_low > 0:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def _reversal(
        self,
        limit: float,
        velocity: float,
        acceleration: float,
        transient: float,
        direction: int,
    ) -> float:
        """First time within `limit` s at which the velocity is zero."""
        if transient == 0.0:
            if acceleration == 0.0:  # at rest, and exactly balanced
                return limit
            time = -velocity / acceleration
            x = self._b * time
            # log(1 + x)/x, by its series where the quotient would lose its digits
            return min(time * (log1p(x) / x if x > 1e-9 else 1 - x / 2), limit)
        low, high = 0.0, limit
        extremum = self._extremum(limit, velocity, acceleration, transient)
        if velocity == 0.0:
            low = extremum or 0.0  # it leaves rest, turns, and comes to rest again
        elif self._velocity_at(limit, velocity, acceleration, transient) * direction > 0:
            high = extremum or limit  # it dips below zero and comes back
        for _ in range(_ROOT_STEPS):
            middle = 0.5 * (low + high)
            if self._velocity_at(middle, velocity, acceleration, transient) * direction > 0:
                low = middle
            else:
                high = middle
            if high - low <= _TIME_RESOLUTION:
                break
        return high

    # -- closed form -----------------------------------------------------------------------------

    def _propagator(self, time: float) -> _Propagator:
        step = self._cache.get(time)
        if step is None:
            step = self._compute(time)
            if len(self._cache) < 256:
                self._cache[time] = step
        return step

    def _compute(self, time: float) -> _Propagator:
        b = self._b
        z = b * time
        if z < 1e-4:
            # the series loses nothing where the closed form would cancel: z^4/120 < 1e-18
            a1 = time * (1 - z / 2 * (1 - z / 3 * (1 - z / 4)))
            a2 = time * time / 2 * (1 - z / 3 * (1 - z / 4 * (1 - z / 5)))
            decay = exp(-z)
        else:
            decay = exp(-z)
            a1 = -expm1(-z) / b
            a2 = (time - a1) / b
        lag = self._lag
        if lag == 0.0:
            return _Propagator(decay, a1, a2, 0.0, 0.0, 0.0)
        lag_decay = exp(-time / lag)
        slope = b - 1 / lag
        k1 = (lag_decay - decay) / slope
        k2 = (-lag * expm1(-time / lag) - a1) / slope
        return _Propagator(decay, a1, a2, lag_decay, k1, k2)
