"""What an axis with friction does under commands: many axes at once, exact between events.

    J·v̇ = m − offset − k·x − B·v − c·v·|v| − (f·(1 + δ·t) + l·|m − offset|)·sign(v)
    lag·ṁ = u(t − τ + lag) − m

Between two events – a command that changes, a reversal – that is a linear equation (drag aside)
under a constant and an exponential: the exponential is split off in closed form, the rest is a
power series that ends far below rounding. Steps are as long as the events allow, each lane has its
own; positions between are those of the same series. A lane is one axis over one stretch of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PARAMETERS", "Lanes", "Torque", "positions"]

Array = NDArray[np.float64]

PARAMETERS = (
    "inertia", "viscous", "coulomb", "offset", "delay", "lag", "drag", "load", "drift", "spring",
)  # fmt: skip
_J, _B, _F, _OFFSET, _DELAY, _LAG, _DRAG, _LOAD, _DRIFT, _SPRING = range(len(PARAMETERS))

_LEAST_LAG = 1e-8  # s
_REMEMBERED = 40.0  # lags, after which an earlier torque is forgotten
# longest step times viscous rate, natural frequency, rate of the drag
_STEEP, _CURVED, _BENT = 0.5, 0.9, 0.1
_PRECISE = 1e-13  # of a step's motion: where its power series may end
_MOST_TERMS = 18
_NEWTONS = 7  # to a reversal; the error is squared with each
_MOST_EVENTS = 12  # a command that changes: more is an axis that chatters
_DEGENERATE = 0.1  # of the lag's rate, squared: an axis no slower than its torque


@dataclass(frozen=True, slots=True)
class Torque:
    """A command that holds until it changes.

    Attributes
    ----------
    time : (n,) s, when it changed, increasing
    value : (n,) N.m or N
    """

    time: Array
    value: Array

    @classmethod
    def of(cls, sent: Array, command: Array) -> Torque:
        """Of commands that repeat themselves."""
        changed = np.concatenate(([True], np.diff(command) != 0))
        return cls(sent[changed], command[changed])


@dataclass(frozen=True, slots=True)
class Lanes:
    """Axes over stretches of time.

    Attributes
    ----------
    parameters : (l, 10) in the order of PARAMETERS; SI units, drift in 1/s
    begin : (l,) s
    position, speed : (l,) there
    middle : where drift is none, s
    centre : where the spring is relaxed, rad or m
    """

    parameters: Array
    begin: Array
    position: Array
    speed: Array
    middle: float
    centre: float


@dataclass(slots=True)
class _Steps:
    """What was integrated: one row a step, one column a lane."""

    begin: list[Array]
    length: list[Array]
    series: list[Array]  # (terms, l) of the position in the step's own time, 0 … 1
    decaying: list[Array]  # (l,) share that goes with exp(−time/lag)


def positions(lanes: Lanes, torque: Torque, times: Array, longest: float) -> Array:
    """Positions of each lane at its own instants, (l, n) rad or m.

    Parameters
    ----------
    times : (l, n) s, increasing, none before the lane's begin
    longest : step, s
    """
    steps = _integrated(lanes, torque, times[:, -1], longest)
    begins = np.array(steps.begin)
    number = np.empty(times.shape, np.intp)
    for lane in range(len(times)):
        number[lane] = np.searchsorted(begins[:, lane], times[lane], side="right") - 1
    which = np.arange(len(times))[:, None]
    elapsed = times - begins[number, which]
    share = elapsed / np.array(steps.length)[number, which]
    series = np.zeros((len(steps.series), max(map(len, steps.series)), len(times)))
    for row, one in zip(series, steps.series, strict=True):
        row[: len(one)] = one
    found = series[number, -1, which]
    for term in range(series.shape[1] - 2, -1, -1):
        found = found * share + series[number, term, which]
    lag = np.maximum(lanes.parameters[:, _LAG], _LEAST_LAG)[:, None]
    decaying = np.array(steps.decaying)[number, which]
    result: Array = lanes.centre + found + decaying * np.exp(-elapsed / lag)
    return result


class _State:
    """All lanes at their own instants."""

    def __init__(self, lanes: Lanes, torque: Torque) -> None:
        p = lanes.parameters
        self.inertia, self.lag = p[:, _J], np.maximum(p[:, _LAG], _LEAST_LAG)
        self.friction, self.offset, self.load = p[:, _F], p[:, _OFFSET], p[:, _LOAD]
        self.rate, self.drag = p[:, _B] / p[:, _J], p[:, _DRAG] / p[:, _J]
        self.stiffness, self.drift = p[:, _SPRING] / p[:, _J], p[:, _DRIFT]
        self.later = p[:, _DELAY] - self.lag  # from a command to the first of its torque
        self.time = lanes.begin.copy()
        self.x, self.v = lanes.position - lanes.centre, lanes.speed.copy()
        self.torque, self.middle = torque, lanes.middle
        self.piece = np.maximum(
            np.searchsorted(torque.time, self.time - self.later, side="right") - 1, 0
        )
        self.m = self._reached()
        self.sign = np.where(self.v != 0, np.sign(self.v), self.away())

    def _reached(self) -> Array:
        """Torque at the beginning, by the commands before it."""
        torque, now = self.torque, self.time - self.later
        oldest = np.searchsorted(torque.time, (now - _REMEMBERED * self.lag).min())
        first, last = max(int(oldest) - 1, 0), int(self.piece.max()) + 1
        values = torque.value[first:last]
        if len(values) == 1:
            return np.full(len(now), values[0])
        since = (now[:, None] - torque.time[first + 1 : last]) / self.lag[:, None]
        left = np.where(since > 0, np.exp(-np.maximum(since, 0.0)), 1.0)  # of each change
        reached: Array = values[0] + (1 - left) @ np.diff(values)
        return reached

    @property
    def level(self) -> Array:
        """Friction without its share of the torque."""
        return self.friction * (1 + self.drift * (self.time - self.middle))

    def drive(self, torque: Array) -> Array:
        """What is left for friction and acceleration at rest."""
        result: Array = torque - self.offset - self.stiffness * self.inertia * self.x
        return result

    def away(self) -> Array:
        """Direction in which a lane at rest moves off; 0: it sticks."""
        drive = self.drive(self.m)
        held = self.level + self.load * np.abs(self.m - self.offset)
        return np.where(np.abs(drive) > held, np.sign(drive), 0.0)

    def moves_off(self, u: Array, most: Array) -> tuple[Array, Array]:
        """Of lanes at rest: how long they stay, at most `most`, s, and which way they go then."""
        towards = np.sign(self.drive(u))
        needed = self.level / np.maximum(1 - self.load, 0.05)
        at = self.offset + self.stiffness * self.inertia * self.x + towards * needed
        goes = (u - at) * towards > 0
        share = np.where(goes, (u - at) / np.where(u == self.m, np.inf, u - self.m), 1.0)
        stays = np.where(
            (self.m - at) * towards >= 0, 0.0, -self.lag * np.log(np.clip(share, 1e-300, 1.0))
        )
        leaves = goes & (stays < most)
        return np.where(leaves, stays, most), np.where(leaves, towards, 0.0)


def _integrated(lanes: Lanes, torque: Torque, end: Array, longest: float) -> _Steps:
    """Steps of all lanes from their begin to their end, s."""
    s = _State(lanes, torque)
    pieces = np.searchsorted(torque.time, end.max()) - np.searchsorted(torque.time, s.time.min())
    most = _MOST_EVENTS * (int(pieces) + int(np.max((end - s.time) / longest)) + 20)
    is_loaded, has_drag = bool(np.any(s.load != 0)), bool(np.any(s.drag != 0))
    cap = np.minimum(longest, _STEEP / np.maximum(np.abs(s.rate), 1e-300))
    cap = np.minimum(cap, _CURVED / np.sqrt(np.maximum(np.abs(s.stiffness), 1e-300)))
    steepness = np.abs(s.rate) + np.sqrt(np.abs(s.stiffness))
    steps = _Steps([], [], [], [])
    value, changes = torque.value, np.append(torque.time[1:], np.inf)
    for _ in range(most):
        left = end - s.time
        if not np.any(left > 0):
            break
        u = value[s.piece]
        until = changes[s.piece] + s.later - s.time
        h = np.minimum(np.minimum(until, cap), np.maximum(left, 0.0))
        if has_drag:
            h = np.minimum(h, _BENT / np.maximum(np.abs(s.drag * s.v), 1e-300))
        tilt = np.zeros(len(u))
        if is_loaded:  # up to where the torque changes its sign
            tilt, h = _tilted(s, u, h)
        stuck = s.sign == 0
        off = np.zeros(len(u))
        if np.any(stuck):
            stays, off = s.moves_off(u, h)
            h = np.where(stuck, stays, h)
        bent = np.abs(s.drag * s.v) * 4 if has_drag else 0.0
        terms = _terms(float(((steepness + bent) * h).max()))
        series, decaying = _series(s, u, h, tilt, terms, has_drag)
        share = _until_reversal(s, h, series, decaying)
        turned = share < 1
        _keep(steps, s, h, series, decaying)
        _advance(s, u, h, series, decaying, share)
        s.piece = s.piece + (~turned & (h >= until))
        s.v = np.where(turned, 0.0, s.v)
        if np.any(turned):
            away = s.away()
            s.sign = np.where(turned, np.where(away == s.sign, 0.0, away), s.sign)
        s.sign = np.where(stuck, off, s.sign)
    else:  # a lane that chatters has no motion
        steps.decaying[-1] = np.where(end - s.time > 0, np.nan, steps.decaying[-1])
    return steps


def _terms(steepness: float) -> int:
    """Of a series in which each term is `steepness`/n of the one before."""
    size, n = 1.0, 1
    while size > _PRECISE and n < _MOST_TERMS:
        n += 1
        size *= steepness / n
    return max(n + 1, 4)


def _tilted(s: _State, u: Array, h: Array) -> tuple[Array, Array]:
    """Friction's share of the torque as a factor on it, and the step in which its sign is one."""
    now, then = s.m - s.offset, u - s.offset
    side = np.where(now != 0, np.sign(now), np.sign(then))
    crosses = now * then < 0
    share = np.where(crosses, then / np.where(crosses, u - s.m, 1.0), 1.0)
    at = -s.lag * np.log(np.clip(share, 1e-300, 1.0))
    # beyond it by a rounding error, so that the next step begins on the other side
    at = at * (1 + 1e-12) + 1e-15
    return s.load * side, np.where(crosses & (at < h), at, h)


def _series(
    s: _State, u: Array, h: Array, tilt: Array, terms: int, has_drag: bool
) -> tuple[Array, Array]:
    """Position over one step: a power series in its own time, and what decays with the torque."""
    moving = s.sign != 0
    gain = np.where(moving, (1 - s.sign * tilt) / s.inertia, 0.0)
    level, growing = s.level * s.sign, s.friction * s.drift * s.sign
    constant = np.where(moving, (u - s.offset) * gain - level / s.inertia, 0.0)
    slope = -growing / s.inertia
    fast = 1 / s.lag
    bent = s.sign * s.drag
    damping = s.rate + 2 * bent * np.abs(s.v) * s.sign if has_drag else s.rate
    below = fast**2 - damping * fast + s.stiffness
    below = np.where(np.abs(below) < _DEGENERATE * fast**2, _DEGENERATE * fast**2, below)
    decaying = gain * (s.m - u) / below
    x = np.empty((terms, len(u)))
    v = np.empty((terms, len(u)))
    x[0] = s.x - decaying
    v[0] = np.where(moving, (s.v + fast * decaying) * h, 0.0)
    damped, stiff, bend = s.rate * h, s.stiffness * h * h, bent
    h2 = h * h
    for n in range(terms - 1):
        x[n + 1] = v[n] / (n + 1)
        more = damped * v[n] + stiff * x[n]
        if has_drag:
            more = more + bend * np.einsum("nl,nl->l", v[: n + 1], v[n::-1])
        if n == 0:
            more = more - constant * h2
        elif n == 1:
            more = more - slope * h2 * h
        v[n + 1] = np.where(moving, -more / (n + 1), 0.0)
    return x, decaying


def _until_reversal(s: _State, h: Array, series: Array, decaying: Array) -> Array:
    """Share of the step after which the speed has changed its sign; 1: it does not."""
    count = len(series)
    numbers = np.arange(1, count)[:, None]
    v = series[1:] * numbers
    fade = h / s.lag
    lost = -decaying * fade  # all speeds a step's length

    def speed(at: Array) -> Array:
        found = v[-1]
        for n in range(count - 3, -1, -1):
            found = found * at + v[n]
        result: Array = found + lost * np.exp(-fade * at)
        return result

    share = np.ones(len(h))
    last = speed(share)
    turned = (last * s.sign < 0) & (h > 0)
    if not np.any(turned):
        return share
    which = np.flatnonzero(turned)
    v, fade, lost, sign = v[:, which], fade[which], lost[which], s.sign[which]
    low, high = np.zeros(len(which)), np.ones(len(which))
    first, last = s.v[which] * h[which], last[which]
    scale = np.maximum(np.abs(first), np.abs(last))
    at = np.clip(first / np.where(first == last, 1.0, first - last), 0.05, 0.95)
    numbers = np.arange(1, count - 1)[:, None]
    slopes = v[1:] * numbers
    for _ in range(_NEWTONS):
        now = speed(at)
        if np.all(np.abs(now) <= _PRECISE * scale):
            break
        before = now * sign > 0
        low, high = np.where(before, at, low), np.where(before, high, at)
        slope = slopes[-1]
        for n in range(count - 4, -1, -1):
            slope = slope * at + slopes[n]
        slope = slope - lost * fade * np.exp(-fade * at)
        follows = at - now / np.where(slope == 0, 1e-300, slope)
        inside = (follows >= low) & (follows <= high)
        at = np.where(inside, follows, 0.5 * (low + high))
    share[which] = at
    return share


def _keep(steps: _Steps, s: _State, h: Array, series: Array, decaying: Array) -> None:
    steps.begin.append(s.time)
    steps.length.append(np.where(h > 0, h, 1.0))
    steps.series.append(series)
    steps.decaying.append(decaying)


def _advance(s: _State, u: Array, h: Array, series: Array, decaying: Array, share: Array) -> None:
    """To the end of the step, or to the reversal in it."""
    count = len(series)
    x, v = series[-1], (count - 1) * series[-1]
    for n in range(count - 2, -1, -1):
        x = x * share + series[n]
        if n:
            v = v * share + n * series[n]
    elapsed = h * share
    fading = np.exp(-elapsed / s.lag)
    s.x = x + decaying * fading
    speed = v / np.where(h > 0, h, 1.0) - decaying * fading / s.lag
    s.v = np.where(h > 0, speed, s.v)
    s.m = u + (s.m - u) * fading
    s.time = s.time + elapsed
