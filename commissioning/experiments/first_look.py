"""First look at an unknown axis: direction, breakaway, offset, and a first guess of f and J.

A torque ramp from rest to first motion, both ways; then a short push with more than the breakaway
torque and a coast, both ways. The speeds stay low: nothing is known yet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.ma  # which np.median would import, in a cycle

from commissioning.errors import MeasurementRejected
from commissioning.experiments.plan import Context, Plan, come_to_rest
from drivers.sample import Sample

__all__ = ["FirstLook", "first_look", "push"]

RAMP_TIME = 4.0  # s from zero to the torque limit
_WOUND_UP, _AWAY = 1.8, 6.0  # displacements that count as motion: still at its place, and off
_PUSHES = (1.5, 2.2)  # torque of the pushes, in breakaway torques
_HARDER = 1.05  # the second pair of pushes over the first, at least
_PUSH_TRAVEL = 0.05  # share of the travel that a push may take
_PUSH_SPEED = 0.3  # share of the speed limit
_PUSH_TIME = 0.8  # s
_GOES_ON = 0.25  # s of constant torque in which an axis that broke away goes on …
_KEEPS_ON = 1.0  # … by so much, of its mean way in their first half; 2 at a constant speed
_FAR, _FAST = 0.01, 0.15  # of travel and speed, where it need not be awaited
_FASTER = 3.0  # times the speed at first: it runs away
_PLAUSIBLE = 0.4, 4.0  # of 2·s/t²: accelerations by a parabola that are believed
_AT_ONCE = 4  # steps of the ramp in which an axis that jumps is away
_WINDING = 0.15  # more torque at which it is away than at which it began to move: it wound up
_LASTS = 2.0  # times the duration of an even braking: the axis springs back
_LEAST_SHARE = 0.7  # of the breakaway torque: friction in motion that impulses are believed
_TIMES = 1.6  # by which the inertia by momentum and by work may differ
_SPEED = 1e-9  # rad/s or m/s
_FEWEST = 5  # samples for a parabola
STEPS = 10  # pushes that show a dead time; each turns the axis around once
_STEP = 2.0  # torque of them, in breakaway torques


@dataclass(frozen=True, slots=True)
class FirstLook:
    """What the first motions tell; good to a third or so.

    Attributes
    ----------
    breakaway : mean of both directions, N.m or N
    offset : torque that leaves the axis balanced, N.m or N
    coulomb : friction in motion, N.m or N
    viscous : N.m.s/rad or N.s/m
    inertia : kg.m2 or kg
    dead_time : s, from command to motion
    """

    breakaway: float
    offset: float
    coulomb: float
    viscous: float
    inertia: float
    dead_time: float


@dataclass(frozen=True, slots=True)
class Push:
    """One push and coast, all along the direction of the push.

    Attributes
    ----------
    torque : N.m or N, above the offset
    impulse : N.m.s or N.s, given to the axis
    duration : s, from the first motion to rest
    distance : rad or m, from rest to rest
    reach : rad or m, farthest from where it began
    speed : rad/s or m/s, at the end of the push
    coast_duration, coast_distance : s, rad or m, from there to rest
    dead_time : s
    """

    torque: float
    impulse: float
    duration: float
    distance: float
    reach: float
    speed: float
    coast_duration: float
    coast_distance: float
    dead_time: float

    @property
    def springs(self) -> bool:
        """Whether the coast lasts much longer than even braking over its distance would."""
        return self.coast_duration * self.speed > _LASTS * 2 * self.coast_distance > 0


def first_look(context: Context) -> Plan[FirstLook]:
    """Ramp and push, both ways; raises MeasurementRejected."""
    context.tell("torque ramp to first motion, both ways")
    upper = yield from _ramp(context, +1)
    yield from come_to_rest(context.rest, context)
    lower = yield from _ramp(context, -1)
    at = yield from come_to_rest(context.rest, context)
    inwards = -1 if at.position > context.start else +1  # with stiction the ramps take it far
    offset, breakaway = (upper + lower) / 2, (upper - lower) / 2
    most = context.torque - abs(offset)
    if most < 1.2 * breakaway:
        raise MeasurementRejected(
            f"breakaway {breakaway:.4g} {context.effort_unit} and offset {offset:.4g} "
            f"{context.effort_unit} leave no torque to move the axis within the limit of "
            f"{context.torque:.4g} {context.effort_unit}",
            code="measurement.torque",
            hint="raise --max-torque",
        )
    context.tell("short pushes and coasts, both ways")
    pushes = []
    gentle, hard = _PUSHES
    for direction in (inwards, -inwards):
        torque = direction * min(gentle * breakaway, most)
        pushes.append((yield from push(context, offset, torque)))
    # a slow cycle needs as many samples, and meets a higher speed
    fastest = max(push.speed for push in pushes)
    hard = min(hard, 1 + (gentle - 1) * _PUSH_SPEED * context.speed / fastest)
    for direction in (inwards, -inwards):
        torque = direction * min(max(hard, _HARDER * gentle) * breakaway, most)
        pushes.append((yield from push(context, offset, torque)))
    return _evaluate(context, breakaway, offset, pushes)


def torque_steps(context: Context, known: FirstLook) -> Plan[None]:
    """Pushes both ways, as many as modulating functions want reversals."""
    torque = min(_STEP * known.breakaway, context.torque - abs(known.offset))
    for n in range(STEPS):
        yield from push(context, known.offset, torque if n % 2 == 0 else -torque)


def _evaluate(context: Context, breakaway: float, offset: float, pushes: list[Push]) -> FirstLook:
    """From rest to rest the momentum is zero: impulse = f·duration + B·distance, without J."""
    if all(p.speed <= _SPEED for p in pushes):
        raise _load_stays(max(p.torque for p in pushes), max(p.reach for p in pushes), context)
    # one that only wound the axis up says nothing
    pushes = [p for p in pushes if p.speed > _SPEED and p.coast_distance > 0] or pushes
    rows = np.array([(p.duration, p.distance) for p in pushes])
    impulses = np.array([p.impulse for p in pushes])
    scale = np.abs(rows).max(axis=0)
    solution, *_ = np.linalg.lstsq(rows / scale, impulses, rcond=None)
    coulomb, viscous = (float(value) for value in solution / scale)
    if viscous < 0:
        coulomb, viscous = float(impulses.sum() / rows[:, 0].sum()), 0.0
    springy = [_by_work(p) for p in pushes if p.springs]
    if springy and not _LEAST_SHARE * breakaway < coulomb <= 1.3 * breakaway:
        # such an axis is not at rest for long: by work, which does not ask when
        coulomb, viscous = min(*springy, 1.3 * breakaway), 0.0
    if not 0 < coulomb <= 1.3 * breakaway:
        coulomb = breakaway  # the friction in motion cannot be told from these pushes
    inertia = float(np.median([_inertia(p, coulomb, viscous) for p in pushes]))
    if not inertia > 0:
        raise MeasurementRejected(
            f"the pushes contradict each other (inertia {inertia:.3g}): is there a torque that "
            f"depends on the position (cogging), is the travel of ±{context.travel:.3g} "
            f"{context.position_unit} too small, or the position signal noisy?",
            code="measurement.contradiction",
        )
    dead_time = float(np.median([p.dead_time for p in pushes]))
    return FirstLook(breakaway, offset, coulomb, viscous, inertia, dead_time)


def _load_stays(torque: float, reach: float, context: Context) -> MeasurementRejected:
    """Something winds up and nothing behind it moves; `reach`: by how far, rad or m."""
    return MeasurementRejected(
        f"torques of up to {torque:.4g} {context.effort_unit} move the axis by no more than "
        f"{reach:.3g} {context.position_unit}, where it stands under the torque: the motor winds "
        "something up, and its load never moves",
        code="measurement.load-stays",
        hint="is it blocked, or at an end stop? Else raise --max-torque if the machine allows it",
    )


def _by_work(push: Push) -> float:
    """Friction that takes from rest to rest what the torque gave while it pushed, N.m or N."""
    return push.torque * (push.distance - push.coast_distance) / max(push.distance, 1e-300)


def _inertia(push: Push, coulomb: float, viscous: float) -> float:
    """Momentum at the end of the push = what friction takes while coasting, less the torque's tail.

    J·v = f·t + B·y − u·dead_time; or, where the axis springs back and so seems to coast for longer,
    by the work: J·v²/2 = f·y − u·v·dead_time.
    """
    braking = coulomb * push.coast_duration + viscous * push.coast_distance
    found = (braking - push.torque * push.dead_time) / push.speed
    taken, tail = coulomb * push.coast_distance, push.torque * push.speed * push.dead_time
    by_work = 2 * (taken - tail) / push.speed**2
    return by_work if push.springs and taken > 2 * tail and found > _TIMES * by_work else found


def _ramp(context: Context, direction: int) -> Plan[float]:
    """Raise the torque until the axis moves away; return the torque at which that began.

    An axis that winds up – bristles, a spring, a load behind one – moves, too, before it breaks
    away: the first counts of motion do not count, nor does motion that ends while the torque stays.
    From there it must go as far again.
    """
    sample = yield context.rest
    begin, torque = sample.position, context.rest
    limit = context.torque
    step = direction * limit / RAMP_TIME * context.cycle
    began, base, away = context.rest, begin, _AWAY * context.motion
    since = sample.time
    while abs(torque) <= limit or torque * direction < 0:
        sample = yield torque
        moved = (sample.position - begin) * direction
        further = (sample.position - base) * direction
        if further < _WOUND_UP / _AWAY * away:
            began, since = sample.command, sample.time
        elif further > away:
            raised = abs(torque - began)
            if raised <= _AT_ONCE * abs(step):
                return began
            took = max(sample.time - since, context.cycle)
            if (yield from _goes_on(context, torque, direction, further, took, sample)):
                return torque if raised > _WINDING * abs(began - context.rest) else began
            sample = yield torque
            base, away = sample.position, max(away, (sample.position - begin) * direction)
            since = sample.time
        if moved < -context.motion:
            raise MeasurementRejected(
                f"the axis moved {abs(moved):.3g} {context.position_unit} against a torque of "
                f"{sample.command:.4g} {context.effort_unit}: the sign of torque or encoder is "
                "inverted, or the load drives the axis",
                code="measurement.against",
                hint="check the wiring and direction settings",
            )
        torque += step
    if base != begin:
        raise _load_stays(limit, abs(sample.position - begin), context)
    raise MeasurementRejected(
        f"no motion up to {limit:.4g} {context.effort_unit}: friction and load are above the "
        "torque limit, or the axis is blocked, or the brake is closed",
        code="measurement.no-motion",
        hint="raise --max-torque if the machine allows it",
    )


def _goes_on(
    context: Context, torque: float, direction: int, way: float, took: float, first: Sample
) -> Plan[bool]:
    """Whether motion goes on while the torque stays, or was the axis winding up.

    Ends as soon as the axis runs away from its torque: what winds up, by `way` in `took` s so far,
    does not become much faster.
    """

    def speed(before: Sample, after: Sample) -> float:
        elapsed = after.time - before.time
        return (after.position - before.position) * direction / elapsed if elapsed > 0 else 0.0

    time = max(_GOES_ON, 2 * _FEWEST * context.cycle)
    halves: tuple[list[float], list[float]] = ([], [])
    at_first, sample = max(way / took, context.resolution / context.cycle), first
    while sample.time - first.time < time:
        before, sample = sample, (yield torque)
        moved = (sample.position - first.position) * direction
        fast = min(_FASTER * at_first, _FAST * context.speed)
        if moved > _FAR * context.travel or speed(before, sample) > fast:
            return True
        halves[sample.time - first.time > time / 2].append(moved)
    early, late = (float(np.mean(half)) if half else 0.0 for half in halves)
    # what rings has its mean, and creeps by little
    return late - early > max(_KEEPS_ON * abs(early), _KEEPS_ON / 2 * way)


def push(context: Context, offset: float, torque: float) -> Plan[Push]:
    """Push with `torque` about `offset` for a short way, then coast to rest."""
    direction = 1 if torque > 0 else -1
    far, fast = _PUSH_TRAVEL * context.travel, _PUSH_SPEED * context.speed
    samples: list[Sample] = []
    sample = yield offset
    begin = sample
    while True:
        sample = yield offset + torque
        samples.append(sample)
        moved = (sample.position - begin.position) * direction
        speed = abs(sample.position - begin.position) / max(sample.time - samples[0].time, 1e-9)
        enough = len(samples) >= _FEWEST + 2
        if (enough or moved >= 2 * far) and (moved >= far or 2 * speed >= fast):
            break
        if sample.time - samples[0].sent > _PUSH_TIME:
            break
    switched = len(samples)
    last = yield from _coast(context, offset, samples)
    up = [
        s for s in samples[:switched] if (s.position - begin.position) * direction > context.motion
    ]
    if len(up) < _FEWEST:
        up = samples[max(0, switched - _FEWEST) : switched]
    acceleration, start = _parabola(up, direction)
    mean, began = _mean_acceleration(begin, samples[0].sent, samples[switched - 1], direction)
    if not _PLAUSIBLE[0] * mean < acceleration < _PLAUSIBLE[1] * mean:
        acceleration, start = mean, began
    if not acceleration > 0:
        raise MeasurementRejected(
            f"a push of {torque:.4g} {context.effort_unit} gave no acceleration along it "
            f"({acceleration:.3g} {context.position_unit}/s2): does the axis rest in a detent "
            "(cogging, a gear, elastic pre-sliding) that such a push does not leave? More "
            "--max-torque or --travel does; else the cycle is too slow for this travel, or the "
            "position signal noisy",
            code="measurement.no-acceleration",
        )
    still = next(s for s in samples[switched:] if abs(s.position - last.position) <= context.still)
    began, end = samples[0].sent, samples[switched - 1]
    dead_time = min(max(start - began, 0.0), 0.5 * (still.time - began))
    return Push(
        abs(torque),
        abs(torque) * (samples[switched].sent - began),
        still.time - began - dead_time,
        (last.position - begin.position) * direction,
        max(abs(s.position - begin.position) for s in samples),
        max(_end_speed(up[-_FEWEST:], direction), 1e-12),
        still.time - end.time,
        (last.position - end.position) * direction,
        dead_time,
    )


def _coast(context: Context, torque: float, samples: list[Sample]) -> Plan[Sample]:
    """Come to rest, keeping the samples."""
    plan = come_to_rest(torque, context)
    set_point = next(plan)
    while True:
        sample = yield set_point
        samples.append(sample)
        try:
            set_point = plan.send(sample)
        except StopIteration as end:
            last: Sample = end.value
            return last


def _parabola(samples: list[Sample], direction: int) -> tuple[float, float]:
    """Acceleration along `direction`, and the instant at which the parabola has its vertex."""
    t = np.array([s.time for s in samples])
    y = np.array([s.position for s in samples]) * direction
    if len(t) < 3:
        return 0.0, float(t[0]) if len(t) else 0.0
    centre, width = t.mean(), max(np.ptp(t), 1e-9)
    c2, c1, _ = np.polyfit((t - centre) / width, y, 2)
    vertex = centre - c1 / (2 * c2) * width if c2 else centre
    return float(2 * c2 / width**2), float(vertex)


def _mean_acceleration(
    begin: Sample, sent: float, end: Sample, direction: int
) -> tuple[float, float]:
    """Acceleration by 2·s/t² alone, and when it began: with the command."""
    time = max(end.time - sent, 1e-9)
    return 2 * (end.position - begin.position) * direction / time**2, sent


def _end_speed(samples: list[Sample], direction: int) -> float:
    """Speed at the last sample, from a parabola through all of them."""
    t = np.array([s.time for s in samples])
    y = np.array([s.position for s in samples]) * direction
    return float(np.polyfit(t - t[-1], y, 2)[1])
