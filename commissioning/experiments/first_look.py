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
    speed : rad/s or m/s, at the end of the push
    coast_duration, coast_distance : s, rad or m, from there to rest
    dead_time : s
    """

    torque: float
    impulse: float
    duration: float
    distance: float
    speed: float
    coast_duration: float
    coast_distance: float
    dead_time: float


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
    rows = np.array([(p.duration, p.distance) for p in pushes])
    impulses = np.array([p.impulse for p in pushes])
    scale = np.abs(rows).max(axis=0)
    solution, *_ = np.linalg.lstsq(rows / scale, impulses, rcond=None)
    coulomb, viscous = (float(value) for value in solution / scale)
    if viscous < 0:
        coulomb, viscous = float(impulses.sum() / rows[:, 0].sum()), 0.0
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


def _inertia(push: Push, coulomb: float, viscous: float) -> float:
    """Momentum at the end of the push = what friction takes while coasting, less the torque's tail.

    J·v = f·t + B·y − u·dead_time
    """
    braking = coulomb * push.coast_duration + viscous * push.coast_distance
    return (braking - push.torque * push.dead_time) / push.speed


def _ramp(context: Context, direction: int) -> Plan[float]:
    """Raise the torque until the axis moves away; return the torque at which that began.

    An elastic axis winds up before it breaks away, so the first counts of motion do not count.
    """
    sample = yield context.rest
    begin, torque = sample.position, context.rest
    limit = context.torque
    step = direction * limit / RAMP_TIME * context.cycle
    began = context.rest
    while abs(torque) <= limit or torque * direction < 0:
        sample = yield torque
        moved = (sample.position - begin) * direction
        if moved < _WOUND_UP * context.motion:
            began = sample.command
        elif moved > _AWAY * context.motion:
            return began
        if moved < -context.motion:
            raise MeasurementRejected(
                f"the axis moved {abs(moved):.3g} {context.position_unit} against a torque of "
                f"{sample.command:.4g} {context.effort_unit}: the sign of torque or encoder is "
                "inverted, or the load drives the axis",
                code="measurement.against",
                hint="check the wiring and direction settings",
            )
        torque += step
    raise MeasurementRejected(
        f"no motion up to {limit:.4g} {context.effort_unit}: friction and load are above the "
        "torque limit, or the axis is blocked, or the brake is closed",
        code="measurement.no-motion",
        hint="raise --max-torque if the machine allows it",
    )


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
    if not acceleration > 0:
        raise MeasurementRejected(
            f"a push of {torque:.4g} {context.effort_unit} gave no acceleration along it "
            f"({acceleration:.3g} {context.position_unit}/s2): does the axis rest in a detent "
            "(cogging, a gear, elastic pre-sliding) that such a push does not leave? More "
            "--max-torque or --travel does; else the cycle is too slow for this travel, or the "
            "position signal noisy",
            code="measurement.no-acceleration",
        )
    still = next(
        s for s in samples[switched:] if abs(s.position - last.position) <= 2.5 * context.resolution
    )
    began, end = samples[0].sent, samples[switched - 1]
    dead_time = min(max(start - began, 0.0), 0.5 * (still.time - began))
    return Push(
        abs(torque),
        abs(torque) * (samples[switched].sent - began),
        still.time - began - dead_time,
        (last.position - begin.position) * direction,
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


def _end_speed(samples: list[Sample], direction: int) -> float:
    """Speed at the last sample, from a parabola through all of them."""
    t = np.array([s.time for s in samples])
    y = np.array([s.position for s in samples]) * direction
    return float(np.polyfit(t - t[-1], y, 2)[1])
