"""Equations of motion of an axis that is more than rigid, integrated: plain numbers only.

    J1·v1' = um − B·v1 − drag·v1·|v1| − F1 − cogging(x1) − joint      x1' = v1   (motor)
    J2·v2' = joint − outer(x2) − F2                                   x2' = v2   (load side)
    joint  = k·gap(x1 − x2) + c·(v1 − v2), in contact only; outer(x1) where there is no second mass
    outer  = load + spring·x + gravity·cos(x + angle)
    um     = gain·(1 + ripple·sin(waves·x1))·m,   lag·m' = u − m

Friction F1 has the level g(v) = (Fc + (Fs − Fc)·e^(−(|v|/vs)^e))·(1 ± asymmetry)·(1 + drift·t)·(1 +
slope·x1 + wave·sin(2π·x1/λ)) + c·|um − load| and one of five kinds:

    dry         g(v)·sign(v), held at rest by g with Fs
    soft        Fc·(tanh((v + v₃)/w) − tanh(v₃/w))
    bristles    z' = v − σ0·|v|/g·z, F = σ0·z + σ1·z'     LuGre 1995; Dahl 1968 with g = Fc, σ1 = 0
    Maxwell     Σ of elements that stick as springs and slip at their share of g (Iwan 1966)
    GMS         the same, slipping as F_i' = C·(share·sign(v) − F_i/g)  (Al-Bender et al. 2005)

Between reversals the equations are smooth and Runge-Kutta steps of fourth order are taken; a
reversal is found by a secant search. Everything is a float, in lists or arrays, and a function of
`math`: so Python runs it, and numba compiles it as it stands.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from math import cos, exp, log, pi, sin, tanh

__all__ = ["ELEMENTS", "PARAMETERS", "STATES", "advance", "outer_torque", "torque_on_shaft"]

ELEMENTS = 6  # of Maxwell and GMS friction

# the kinds of friction
DRY, SOFT, BRISTLES, MAXWELL, GMS = range(5)

# places in the state
X1, V1, X2, V2, Z, MOTOR, SEEN, TIME, WAY, WAY_LOAD = range(10)
FORCES = 10  # of the elements
SLIPS = FORCES + ELEMENTS  # whether each slips, 0 or 1
STATES = SLIPS + ELEMENTS

# places in the parameters
(
    J1, J2, VISCOUS, DRAG, KIND, COULOMB, BREAKAWAY, STRIBECK, EXPONENT, ASYMMETRY, DRIFT, SLOPE,
    WAVE, WAVE_LENGTH, LOAD_FRICTION, WIDTH, SHIFT, STIFFNESS, DAMPING, ATTRACTION, LOAD, SPRING,
    GRAVITY, GRAVITY_ANGLE, COGGING, PITCH, COGGING_2, PITCH_2, ANGLE_2, JOINT_K, JOINT_C, PLAY,
    LOAD_COULOMB, LAG, GAIN, RIPPLE, RIPPLE_WAVES, CORNER, LONGEST, SLIDING,
) = range(40)  # fmt: skip
SHARES = 40  # of the level, of each element
REACHES = SHARES + ELEMENTS  # deflection at which each slips, rad or m
PARAMETERS = REACHES + ELEMENTS

_SECANTS = 40
_HALVINGS = 12
_STILL = 1e-12  # of a step: a reversal is found to this share
_AFTER = 1e-3  # of the lag, after the instant of a breakaway: more than a step is wrong by
_NEVER = 1e300
_FOLLOWED = 0.2  # a step of fourth order is wrong by (h/lag)^5
_STIFF = 20.0  # bristles that follow the speed so many times within a step …
_BENT, _BENT_WITH_THE_SPEED = 1e-9, 2e-3  # … and are bent as far as they go, as a share of it
_FASTEST = 0.25  # of the time in which a friction law may change: the longest step

Numbers = Sequence[float]


def outer_torque(p: Numbers, x: float) -> float:
    """What pulls the axis from outside, N.m or N."""
    outer = p[LOAD]
    if p[SPRING] != 0.0:
        outer += p[SPRING] * x
    if p[GRAVITY] != 0.0:
        outer += p[GRAVITY] * cos(x + p[GRAVITY_ANGLE])
    return outer


def _cogging(p: Numbers, x: float) -> float:
    torque = 0.0
    if p[COGGING] != 0.0:
        torque = p[COGGING] * cos(2 * pi * x / p[PITCH])
    if p[COGGING_2] != 0.0:
        torque += p[COGGING_2] * cos(2 * pi * x / p[PITCH_2] + p[ANGLE_2])
    return torque


def _joint(p: Numbers, twist: float, rate: float) -> float:
    """Torque from the motor into the load; across a play it can only push."""
    half = 0.5 * p[PLAY]
    if half == 0.0:
        return p[JOINT_K] * twist + p[JOINT_C] * rate
    if twist > half:
        return max(p[JOINT_K] * (twist - half) + p[JOINT_C] * rate, 0.0)
    if twist < -half:
        return min(p[JOINT_K] * (twist + half) + p[JOINT_C] * rate, 0.0)
    return 0.0


def torque_on_shaft(p: Numbers, motor: float, x: float) -> float:
    """Torque on the shaft."""
    torque = motor * p[GAIN]
    if p[RIPPLE] != 0.0:
        torque *= 1 + p[RIPPLE] * sin(p[RIPPLE_WAVES] * x)
    return torque


def _scaled(
    p: Numbers, level: float, direction: float, x: float, torque: float, time: float
) -> float:
    """A level of friction in a direction, at a position, under a torque."""
    level *= 1 + direction * p[ASYMMETRY]
    if p[DRIFT] != 0.0:
        level *= 1 + p[DRIFT] * time
    if p[SLOPE] != 0.0:
        level *= 1 + p[SLOPE] * x
    if p[WAVE] != 0.0:
        level *= 1 + p[WAVE] * sin(2 * pi * x / p[WAVE_LENGTH])
    level = max(level, 0.0)
    if p[LOAD_FRICTION] != 0.0:
        level += p[LOAD_FRICTION] * abs(torque - p[LOAD])
    return level


def _level(
    p: Numbers, speed: float, direction: float, x: float, torque: float, time: float
) -> float:
    """g(v), N.m or N."""
    level = p[COULOMB]
    if p[STRIBECK] != 0.0:
        ratio = speed / p[STRIBECK]
        power = ratio * ratio if p[EXPONENT] == 2.0 else ratio ** p[EXPONENT]
        if power < 36.0:
            level += (p[BREAKAWAY] - level) * exp(-power)
    return _scaled(p, level, direction, x, torque, time)


def _elements(p: Numbers, s: Numbers, moved: float, level: float) -> float:
    """Torque of the elements that stick, after a motion one way, N.m or N."""
    torque = 0.0
    for i in range(ELEMENTS):
        if s[SLIPS + i] == 0.0:
            most = p[SHARES + i] * level
            stiffness = p[SHARES + i] * p[COULOMB] / p[REACHES + i]
            torque += min(max(s[FORCES + i] + stiffness * moved, -most), most)
    return torque


def _rates(
    p: Numbers,
    s: Numbers,
    x1: float,
    v1: float,
    x2: float,
    v2: float,
    z: float,
    motor: float,
    seen: float,
    time: float,
    share: float,
) -> tuple[float, float, float, float, float, float]:
    """Time derivatives of x1, v1, x2, v2, z, seen in a step that begins at `s`.

    z of GMS friction: torque of the elements that slip, which have `share` of the level.
    """  # fmt: skip
    torque = torque_on_shaft(p, motor, x1)
    two = p[J2] > 0.0
    joint = _joint(p, x1 - x2, v1 - v2) if two else outer_torque(p, x1)
    kind, way = p[KIND], s[WAY]
    z_rate = 0.0
    a1 = 0.0
    if kind != DRY or way != 0.0:
        speed = abs(v1)
        if kind == DRY:
            friction = way * _level(p, speed, way, x1, torque, time)
        elif kind == SOFT:
            bias = tanh(p[SHIFT] / p[WIDTH]) if p[SHIFT] != 0.0 else 0.0
            friction = p[COULOMB] * (tanh((v1 + p[SHIFT]) / p[WIDTH]) - bias)
        elif kind == BRISTLES:
            level = _level(p, speed, 1.0 if v1 > 0.0 else -1.0, x1, torque, time)
            if way != 0.0:
                friction = way * level
            else:
                z_rate = v1 - p[STIFFNESS] * speed / level * z
                friction = p[STIFFNESS] * z + p[DAMPING] * z_rate
        else:
            level = _level(p, speed, way, x1, torque, time)
            friction = _elements(p, s, x1 - s[X1], level)
            if share != 0.0:
                if kind == GMS:
                    z_rate = p[ATTRACTION] * (share * way - z / level)
                friction += z
        a1 = torque - p[VISCOUS] * v1 - friction - joint
        if p[DRAG] != 0.0:
            a1 -= p[DRAG] * v1 * speed
        if p[COGGING] != 0.0 or p[COGGING_2] != 0.0:
            a1 -= _cogging(p, x1)
        a1 /= p[J1]
    a2 = 0.0
    if two and s[WAY_LOAD] != 0.0:
        a2 = (joint - outer_torque(p, x2) - s[WAY_LOAD] * p[LOAD_COULOMB]) / p[J2]
    seen_rate = p[CORNER] * (x1 - seen) if p[CORNER] != 0.0 else 0.0
    return v1, a1, v2, a2, z_rate, seen_rate


def _step(
    p: Numbers, s: Numbers, h: float, command: float, share: float
) -> tuple[float, float, float, float, float, float, float]:
    """x1, v1, x2, v2, z, motor, seen after `h` s; the torque loop in closed form."""
    x1, v1, x2, v2, z, y, t = s[X1], s[V1], s[X2], s[V2], s[Z], s[SEEN], s[TIME]
    g = h / 2
    first = middle = last = s[MOTOR]
    if p[LAG] != 0.0 and first != command:
        fade = exp(-g / p[LAG])
        middle = command + (first - command) * fade
        last = command + (middle - command) * fade
    a1, a2, a3, a4, a5, a6 = _rates(p, s, x1, v1, x2, v2, z, first, y, t, share)
    b1, b2, b3, b4, b5, b6 = _rates(
        p, s, x1 + g * a1, v1 + g * a2, x2 + g * a3, v2 + g * a4, z + g * a5, middle, y + g * a6,
        t + g, share,
    )  # fmt: skip
    c1, c2, c3, c4, c5, c6 = _rates(
        p, s, x1 + g * b1, v1 + g * b2, x2 + g * b3, v2 + g * b4, z + g * b5, middle, y + g * b6,
        t + g, share,
    )  # fmt: skip
    d1, d2, d3, d4, d5, d6 = _rates(
        p, s, x1 + h * c1, v1 + h * c2, x2 + h * c3, v2 + h * c4, z + h * c5, last, y + h * c6,
        t + h, share,
    )  # fmt: skip
    w = h / 6
    return (
        x1 + w * (a1 + 2 * b1 + 2 * c1 + d1), v1 + w * (a2 + 2 * b2 + 2 * c2 + d2),
        x2 + w * (a3 + 2 * b3 + 2 * c3 + d3), v2 + w * (a4 + 2 * b4 + 2 * c4 + d4),
        z + w * (a5 + 2 * b5 + 2 * c5 + d5), last, y + w * (a6 + 2 * b6 + 2 * c6 + d6),
    )  # fmt: skip


def _longest(p: Numbers, s: MutableSequence[float], command: float) -> float:
    """Step that the friction law allows here, s."""
    step, follows, kind, speed = p[LONGEST], _NEVER, p[KIND], abs(s[V1])
    if p[LAG] != 0.0:  # a transient is followed the less closely the smaller it has become
        apart = abs(command - s[MOTOR])
        if apart > 1e-12 * abs(command):
            share = max(abs(command), apart) / apart
            follows = p[LAG] / 4 * share**_FOLLOWED
    if kind == DRY and s[WAY] == 0.0 and p[LAG] != 0.0:
        step = min(step, _until_breakaway(p, s, command))
    if kind == BRISTLES:
        step = _bristles_step(p, s, command)
        if s[WAY] == 0.0:
            return min(step, follows)
    step = min(step, follows)
    if kind == SOFT:
        scale, flat = p[WIDTH], 8 * p[WIDTH] + abs(p[SHIFT])
    elif p[STRIBECK] != 0.0:
        scale, flat = p[STRIBECK], p[STRIBECK] * 12.25 ** (1 / p[EXPONENT])
    else:
        return step
    acceleration = abs(command - p[LOAD]) / p[J1]
    if acceleration == 0.0:
        return step
    fine = max(_FASTEST * scale / acceleration, 0.02 * step)
    above = speed - flat
    if above > 0.0:  # up to where the law bends
        fine = max(fine, above / acceleration)
    return min(step, fine)


def _bristles_step(p: Numbers, s: MutableSequence[float], command: float) -> float:
    """Bristles that are bent as far as they go slide like dry friction, until the axis turns.

    So where they would follow the speed within a small part of a step; WAY says it.
    """
    speed = abs(s[V1])
    rate = p[STIFFNESS] * speed / p[COULOMB]
    if rate * p[SLIDING] > _STIFF:
        if s[WAY] == 0.0:
            way = 1.0 if s[V1] > 0.0 else -1.0
            torque = torque_on_shaft(p, s[MOTOR], s[X1])
            level = _level(p, speed, way, s[X1], torque, s[TIME])
            near = _BENT if p[STRIBECK] == 0.0 else _BENT_WITH_THE_SPEED
            if abs(p[STIFFNESS] * s[Z] * way / level - 1) < near:
                s[WAY] = way
        if s[WAY] != 0.0:
            acceleration = abs(command - p[LOAD]) / p[J1]
            above = speed - _STIFF * p[COULOMB] / (p[STIFFNESS] * p[SLIDING])
            if acceleration == 0.0:
                return p[SLIDING]
            return min(p[SLIDING], max(above / acceleration, 0.02 * p[SLIDING]))
    else:
        _release(p, s)
    return min(p[LONGEST], 0.5 / rate) if rate > 0.0 else p[LONGEST]


def _release(p: Numbers, s: MutableSequence[float]) -> None:
    """Bristles that slid bend again: by what they were bent."""
    if s[WAY] != 0.0:
        torque = torque_on_shaft(p, s[MOTOR], s[X1])
        level = _level(p, abs(s[V1]), s[WAY], s[X1], torque, s[TIME])
        s[Z], s[WAY] = s[WAY] * level / p[STIFFNESS], 0.0


def _until_breakaway(p: Numbers, s: Numbers, command: float) -> float:
    """Time until the lagging torque reaches the level that holds a resting motor, s."""
    up, down, pull = _held_at(p, s)
    gain = torque_on_shaft(p, 1.0, s[X1])
    beside = s[MOTOR] * gain - pull
    threshold = (beside + (up if command > s[MOTOR] else -down)) / gain
    if (threshold - s[MOTOR]) * (command - threshold) <= 0.0:
        return _NEVER
    return p[LAG] * log((command - s[MOTOR]) / (command - threshold)) + _AFTER * p[LAG]


def _held_at(p: Numbers, s: Numbers) -> tuple[float, float, float]:
    """Torques up and down that a resting motor withstands, and what pulls at it."""
    torque = torque_on_shaft(p, s[MOTOR], s[X1])
    up = _scaled(p, p[BREAKAWAY], 1.0, s[X1], torque, s[TIME])
    down = _scaled(p, p[BREAKAWAY], -1.0, s[X1], torque, s[TIME])
    two = p[J2] > 0.0
    joint = _joint(p, s[X1] - s[X2], s[V1] - s[V2]) if two else outer_torque(p, s[X1])
    return up, down, torque - _cogging(p, s[X1]) - joint


def _unstick(p: Numbers, s: MutableSequence[float]) -> None:
    """Let a side that rests go where its torque is beyond the level that holds it."""
    if s[WAY] == 0.0 and p[KIND] == DRY:
        up, down, pull = _held_at(p, s)
        s[WAY] = 1.0 if pull > up else -1.0 if pull < -down else 0.0
    if p[J2] > 0.0 and s[WAY_LOAD] == 0.0:
        joint = _joint(p, s[X1] - s[X2], s[V1] - s[V2])
        pull, level = joint - outer_torque(p, s[X2]), p[LOAD_COULOMB]
        s[WAY_LOAD] = 1.0 if pull > level or level == 0.0 else -1.0 if pull < -level else 0.0


def _set_out(p: Numbers, s: MutableSequence[float]) -> float:
    """Elements that slip stick again where the motion turns; the share of those that slip."""
    if s[WAY] == 0.0:
        sprung = 0.0
        for i in range(ELEMENTS):
            s[SLIPS + i] = 0.0
            sprung += s[FORCES + i]
        _, _, pull = _held_at(p, s)
        s[WAY] = s[V1] if s[V1] != 0.0 else pull - sprung
        s[WAY] = 1.0 if s[WAY] >= 0.0 else -1.0
    share, slipping = 0.0, 0.0
    for i in range(ELEMENTS):
        if s[SLIPS + i] != 0.0:
            share += p[SHARES + i]
            slipping += s[FORCES + i]
    s[Z] = slipping
    return share


def _moved(
    p: Numbers, s: MutableSequence[float], x: float, v: float, z: float, h: float, share: float
) -> None:
    """The elements after a step from `s` to x, v; z: what those that slip have then."""
    way, time = s[WAY], s[TIME] + h
    level = _level(p, abs(v), way, x, torque_on_shaft(p, s[MOTOR], x), time)
    fade = exp(-p[ATTRACTION] * h / max(level, 1e-300))
    for i in range(ELEMENTS):
        part, force = p[SHARES + i], s[FORCES + i]
        if s[SLIPS + i] != 0.0:
            if p[KIND] == MAXWELL:
                s[FORCES + i] = way * part * level
            else:  # each towards the mean of them
                apart = force - part * s[Z] / share
                s[FORCES + i] = part * z / share + apart * fade
        else:
            force += part * p[COULOMB] / p[REACHES + i] * (x - s[X1])
            if abs(force) >= part * level:
                force = part * level * (1.0 if force > 0.0 else -1.0)
                if force * way > 0.0:
                    s[SLIPS + i] = 1.0
            s[FORCES + i] = force


def _turned(p: Numbers, s: Numbers, v1: float, v2: float) -> int:
    """Which side has turned on the way to these speeds: 1 the motor, 2 the load, 0 none."""
    if s[WAY] != 0.0 and v1 * s[WAY] < 0.0:
        return 1
    if s[WAY_LOAD] != 0.0 and p[LOAD_COULOMB] != 0.0 and v2 * s[WAY_LOAD] < 0.0:
        return 2
    return 0


def _reversal(
    p: Numbers, s: Numbers, step: float, command: float, share: float, side: int, after: float
) -> float:
    """When a side turns whose speed is `after` at the end of the step, s."""
    low, high, at_low, at_high = 0.0, step, s[V1] if side == 1 else s[V2], after
    last, time = 0, step
    for _ in range(_SECANTS):  # Illinois: a secant that keeps its bracket
        time = high - at_high * (high - low) / (at_high - at_low)
        _, v1, _, v2, _, _, _ = _step(p, s, time, command, share)
        speed = v1 if side == 1 else v2
        if speed * at_low > 0.0:
            low, at_low = time, speed
            at_high = at_high / 2 if last < 0 else at_high
            last = -1
        else:
            high, at_high = time, speed
            at_low = at_low / 2 if last > 0 else at_low
            last = 1
        if high - low < _STILL * step or speed == 0.0:
            break
    return time


def _barely(
    p: Numbers, s: MutableSequence[float], step: float, command: float, share: float, side: int
) -> float:
    """A side that broke away and is turned back within the step: as far as it goes, or not at all.

    Return the time, s.
    """
    for _ in range(_HALVINGS):
        step *= 0.5
        _, v1, _, v2, _, _, _ = _step(p, s, step, command, share)
        if _turned(p, s, v1, v2) == 0:
            return step
    if side == 2:
        s[WAY_LOAD] = 0.0
    else:  # nothing holds elements: they go the other way
        s[WAY] = -s[WAY] if p[KIND] >= MAXWELL else 0.0
    return step


def _advance_once(p: Numbers, s: MutableSequence[float], step: float, command: float) -> float:
    """Take one step, or the part of it up to a reversal; return its time, s."""
    _unstick(p, s)
    share = _set_out(p, s) if p[KIND] >= MAXWELL else 0.0
    x1, v1, x2, v2, z, motor, seen = _step(p, s, step, command, share)
    side = _turned(p, s, v1, v2)
    if side != 0:
        if (s[V1] if side == 1 else s[V2]) == 0.0:
            step = _barely(p, s, step, command, share, side)
            side = 0
        else:
            step = _reversal(p, s, step, command, share, side, v1 if side == 1 else v2)
        x1, v1, x2, v2, z, motor, seen = _step(p, s, step, command, share)
    if p[KIND] >= MAXWELL:
        _moved(p, s, x1, v1, z, step, share)
    s[X1], s[V1], s[X2], s[V2], s[Z], s[MOTOR], s[SEEN] = x1, v1, x2, v2, z, motor, seen
    s[TIME] += step
    if side == 1:
        s[V1] = 0.0
        if p[KIND] == BRISTLES:
            _release(p, s)
        s[WAY] = 0.0
    elif side == 2:
        s[V2], s[WAY_LOAD] = 0.0, 0.0
    return step


def advance(p: Numbers, s: MutableSequence[float], duration: float, command: float) -> None:
    """Let `duration` s pass under the constant torque command `command` (N.m or N).

    Parameters
    ----------
    p : (PARAMETERS,)
    s : (STATES,), moved on
    """
    if p[LAG] == 0.0:
        s[MOTOR] = command
    left = duration
    while left > 1e-13:
        left -= _advance_once(p, s, min(left, _longest(p, s, command)), command)
