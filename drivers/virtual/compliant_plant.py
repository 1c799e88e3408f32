"""Physics of an axis that is more than rigid with Coulomb friction: integrated in small steps.

    J1·v1' = u_m − B·v1 − F1 − cogging(x1) − spring    x1' = v1    (motor, where the encoder is)
    J2·v2' = spring − load − F2                        x2' = v2    (load side, where there is one)
    spring = k·gap(x1 − x2) + c·(v1 − v2), in contact only    lag·u_m' = u − u_m

Without a second mass `load` acts on the motor. Between velocity reversals of either side the
equations are smooth and a Runge-Kutta step of fourth order is taken; a reversal is found by a
secant search and the side then sticks, or turns. The rigid axis with Coulomb friction has its
closed form in `plant`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, log, pi, sqrt

from drivers.virtual.friction import Dry, LuGre, Soft

__all__ = ["CompliantParameters", "CompliantPlant"]

_LONGEST_STEP = 2e-4  # s
_STEPS_A_RADIAN = 25  # of the fastest oscillation
_SECANTS = 40
_HALVINGS = 12
_AFTER = 1e-3  # of the lag, after the instant of a breakaway: more than a step is wrong by
_STILL = 1e-12  # of a step: a reversal is found to this share


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
        position
    resonance : of motor against load, Hz; 0: one rigid mass
    ratio : inertia of the load over that of the motor
    damping : of the resonance, as a damping ratio
    backlash : play between motor and load, rad or m (needs a resonance)
    load_coulomb : Coulomb friction on the load side, N.m or N
    output_filter : corner of a first-order filter in the position signal, rad/s; 0: none
    """

    inertia: float
    viscous: float
    friction: Dry | Soft | LuGre
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


@dataclass(slots=True)
class _State:
    """x1, v1, x2, v2, bristle deflection, torque of the motor, position behind the filter."""

    x1: float = 0.0
    v1: float = 0.0
    x2: float = 0.0
    v2: float = 0.0
    z: float = 0.0
    torque: float = 0.0
    measured: float = 0.0


@dataclass(slots=True)
class _Way:
    """Which way each side moves: +1, −1, or 0 where it sticks."""

    motor: int = 0
    load: int = 0


class CompliantPlant:
    """State of the mechanics and its advance in time; the interface of `Plant`."""

    def __init__(self, parameters: CompliantParameters, position: float = 0.0) -> None:
        p = self.parameters = parameters
        self.locked = False
        self._two = p.resonance > 0
        self._j2 = p.inertia * p.ratio / (1 + p.ratio) if self._two else 0.0
        self._j1 = p.inertia - self._j2
        fastest = 0.0
        self._k = self._c = 0.0
        if self._two:
            w = 2 * pi * p.resonance
            reduced = self._j1 * self._j2 / p.inertia
            self._k, self._c = reduced * w * w, 2 * p.damping * reduced * w
            fastest = w
        self._dry = p.friction if isinstance(p.friction, Dry) else None
        self._soft = p.friction if isinstance(p.friction, Soft) else None
        self._lugre = p.friction if isinstance(p.friction, LuGre) else None
        if self._lugre is not None:
            fastest = max(fastest, sqrt(self._lugre.stiffness / self._j1))
        self._step = min(_LONGEST_STEP, 1 / (_STEPS_A_RADIAN * fastest) if fastest else inf)
        if p.lag:
            self._step = min(self._step, p.lag / 4)
        if p.output_filter:
            self._step = min(self._step, 0.25 / p.output_filter)
        self._way = _Way()
        self._state = _State()
        self.place(position)

    def place(self, position: float) -> None:
        """Put the axis at rest at `position` of the motor; the load hangs on the spring."""
        p = self.parameters
        self._way = _Way()
        self._state = _State(x1=position, measured=position)
        if self._two:  # on the side to which it pulls
            twist = p.load / self._k + 0.5 * p.backlash * ((p.load > 0) - (p.load < 0))
            self._state.x2 = position - twist

    @property
    def position(self) -> float:
        """Position of the motor as it is measured, rad or m."""
        return self._state.measured if self.parameters.output_filter else self._state.x1

    @property
    def velocity(self) -> float:
        """Velocity of the motor, rad/s or m/s."""
        return self._state.v1

    @property
    def torque(self) -> float:
        """Torque that acts on the motor, behind the lag, N.m or N."""
        return self._state.torque

    @property
    def deflection(self) -> float:
        """Motor against load, rad or m."""
        return self._state.x1 - self._state.x2 if self._two else 0.0

    def advance(self, duration: float, command: float) -> None:
        """Let `duration` s pass under the constant torque command `command` (N.m or N)."""
        s = self._state
        if self.locked:
            s.v1 = s.v2 = 0.0
            s.torque = command
            return
        if not self.parameters.lag:
            s.torque = command
        left = duration
        while left > 1e-13:
            left -= self._advance_once(min(left, self._longest(command)), command)

    # -- one step ----------------------------------------------------------------------------------

    def _longest(self, command: float) -> float:
        """Step that the friction law allows here, s."""
        step, s = self._step, self._state
        if self._dry is not None and self._way.motor == 0 and self.parameters.lag:
            step = min(step, self._until_breakaway(command))
        law = self.parameters.friction
        if isinstance(law, LuGre):
            rate = law.stiffness * abs(s.v1) / law.coulomb
            return min(step, 0.5 / rate) if rate else step
        if isinstance(law, Dry) and not law.stribeck:
            return step
        acceleration = abs(command - self.parameters.load) / self._j1
        fine = max(0.25 * law.time_scale(acceleration), 0.02 * step)
        above = abs(s.v1) - law.flat_from
        if above > 0 and acceleration > 0:  # up to where the law bends
            fine = max(fine, above / acceleration)
        return min(step, fine)

    def _until_breakaway(self, command: float) -> float:
        """Time until the lagging torque reaches the level that holds a resting motor, s."""
        s, lag = self._state, self.parameters.lag
        up, down = self._holding(s)
        beside = s.torque - self._pull(s)
        threshold = beside + (up if command > s.torque else -down)
        if (threshold - s.torque) * (command - threshold) <= 0:
            return inf
        return lag * log((command - s.torque) / (command - threshold)) + _AFTER * lag

    def _holding(self, s: _State) -> tuple[float, float]:
        """Torques up and down that a resting motor withstands."""
        p = self.parameters
        assert self._dry is not None
        level, extra = self._dry.breakaway, p.load_friction * abs(s.torque - p.load)
        return (1 + p.asymmetry) * level + extra, (1 - p.asymmetry) * level + extra

    def _advance_once(self, step: float, command: float) -> float:
        """Take one step, or the part of it up to a reversal; return the time."""
        way = self._way
        self._unstick(command)
        begin = self._state
        end = self._runge_kutta(begin, step, command)
        crossed = self._crossed(begin, end)
        if not crossed:
            self._state = end
            return step
        if self._speeds(begin, end, crossed)[0] == 0.0:
            return self._barely(begin, step, command, crossed)
        low, high, at_low, at_high = 0.0, step, *self._speeds(begin, end, crossed)
        time, side = step, 0
        for _ in range(_SECANTS):  # Illinois: a secant that keeps its bracket
            time = high - at_high * (high - low) / (at_high - at_low)
            end = self._runge_kutta(begin, time, command)
            speed = end.v1 if crossed == "motor" else end.v2
            if speed * at_low > 0:
                low, at_low = time, speed
                at_high = at_high / 2 if side < 0 else at_high
                side = -1
            else:
                high, at_high = time, speed
                at_low = at_low / 2 if side > 0 else at_low
                side = 1
            if high - low < _STILL * step or speed == 0.0:
                break
        if crossed == "motor":
            end.v1, way.motor = 0.0, 0
        else:
            end.v2, way.load = 0.0, 0
        self._state = end
        return time

    def _barely(self, begin: _State, step: float, command: float, side: str) -> float:
        """A side that broke away and is turned back within the step.

        As far as it goes, or not at all.
        """
        for _ in range(_HALVINGS):
            step *= 0.5
            end = self._runge_kutta(begin, step, command)
            if not self._crossed(begin, end):
                self._state = end
                return step
        setattr(self._way, side, 0)
        self._state = self._runge_kutta(begin, step, command)
        return step

    def _crossed(self, begin: _State, end: _State) -> str:
        """Which side has turned within the step, '' for none; the motor first."""
        way = self._way
        if way.motor and end.v1 * way.motor < 0:
            return "motor"
        if way.load and self.parameters.load_coulomb and end.v2 * way.load < 0:
            return "load"
        return ""

    @staticmethod
    def _speeds(begin: _State, end: _State, crossed: str) -> tuple[float, float]:
        if crossed == "motor":
            return begin.v1, end.v1
        return begin.v2, end.v2

    def _unstick(self, command: float) -> None:
        """Let a side that rests go where its torque is beyond the breakaway level."""
        p, s, way = self.parameters, self._state, self._way
        if self._dry is not None and way.motor == 0:
            pull = self._pull(s)
            up, down = self._holding(s)
            way.motor = 1 if pull > up else -1 if pull < -down else 0
        if self._two and way.load == 0:
            pull, level = self._spring(s) - p.load, p.load_coulomb
            way.load = 1 if pull > level or not level else -1 if pull < -level else 0

    def _pull(self, s: _State) -> float:
        """Torque on the motor beside friction, at rest."""
        p = self.parameters
        pull = s.torque - self._cogging(s.x1)
        return pull - self._spring(s) if self._two else pull - p.load

    def _cogging(self, x: float) -> float:
        p = self.parameters
        return p.cogging * cos(2 * pi * x / p.pitch) if p.cogging else 0.0

    def _spring(self, s: _State) -> float:
        """Torque from the motor into the load; across a play it can only push."""
        twist, rate, half = s.x1 - s.x2, s.v1 - s.v2, 0.5 * self.parameters.backlash
        if not half:
            return self._k * twist + self._c * rate
        if twist > half:
            return max(self._k * (twist - half) + self._c * rate, 0.0)
        if twist < -half:
            return min(self._k * (twist + half) + self._c * rate, 0.0)
        return 0.0

    def _rates(self, s: _State, command: float) -> tuple[float, ...]:
        """Time derivatives of the state."""
        p, way = self.parameters, self._way
        spring = self._spring(s) if self._two else p.load
        z_rate = 0.0
        if self._dry is not None:
            if way.motor == 0:
                a1 = 0.0
            else:
                level = self._dry.level(abs(s.v1)) * (1 + way.motor * p.asymmetry)
                if p.load_friction:
                    level += p.load_friction * abs(s.torque - p.load)
                a1 = (
                    s.torque - p.viscous * s.v1 - way.motor * level - self._cogging(s.x1) - spring
                ) / self._j1
        else:
            if self._lugre is not None:
                z_rate = self._lugre.rate(s.v1, s.z)
                friction = self._lugre.torque(s.z, z_rate)
            else:
                assert self._soft is not None
                friction = self._soft.torque(s.v1)
            a1 = (s.torque - p.viscous * s.v1 - friction - self._cogging(s.x1) - spring) / self._j1
        a2 = 0.0
        if self._two and way.load:
            a2 = (spring - p.load - way.load * p.load_coulomb) / self._j2
        torque_rate = (command - s.torque) / p.lag if p.lag else 0.0
        filtered = p.output_filter * (s.x1 - s.measured)
        return s.v1, a1, s.v2, a2, z_rate, torque_rate, filtered

    def _runge_kutta(self, s: _State, h: float, command: float) -> _State:
        def moved(k: tuple[float, ...], by: float) -> _State:
            return _State(
                s.x1 + by * k[0], s.v1 + by * k[1], s.x2 + by * k[2], s.v2 + by * k[3],
                s.z + by * k[4], s.torque + by * k[5], s.measured + by * k[6],
            )  # fmt: skip

        k1 = self._rates(s, command)
        k2 = self._rates(moved(k1, h / 2), command)
        k3 = self._rates(moved(k2, h / 2), command)
        k4 = self._rates(moved(k3, h), command)
        mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        return moved(mean, h)
