"""Go to a position by proportional control: the thesis' own first stage.

The position error asks for a speed, the speed error for a torque, and the friction found so far is
fed forward, so that the axis does not stick short of its goal.
"""

from __future__ import annotations

from commissioning.errors import MeasurementRejected
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context, Plan, come_to_rest
from drivers.sample import Sample

__all__ = ["approach"]

_TOLERANCE = 0.02  # of the travel
_SPEED = 0.2  # of the speed limit
_TIME = 20.0  # s
_CREEPS = 0.1  # of the speed that is wanted
_STILL = 2.0  # s without any motion


def approach(context: Context, goal: float, known: FirstLook) -> Plan[Sample]:
    """Move to `goal` (rad or m) and come to rest there; raises MeasurementRejected."""
    context.tell("approach to the start position")
    bandwidth = 0.25 / (known.dead_time + 2 * context.cycle)  # rad/s, of the speed loop
    gain = known.inertia * bandwidth
    tolerance = max(_TOLERANCE * context.travel, 4 * context.resolution)
    fastest = min(_SPEED * context.speed, 0.5 * known.coulomb / gain + context.travel)
    authority = min(2.5 * known.breakaway, context.torque - abs(known.offset))
    sample = yield known.offset
    began = moved = sample.time
    previous = sample
    torque = known.offset
    while True:
        error = goal - sample.position
        if abs(error) < tolerance:
            return (yield from come_to_rest(known.offset, context))
        if sample.time - began > _TIME:
            raise MeasurementRejected(
                f"the axis is still {error:.3g} {context.position_unit} from its start position "
                f"after {_TIME:g} s",
                code="measurement.approach",
                hint="does something block it?",
            )
        elapsed = sample.time - previous.time
        speed = (sample.position - previous.position) / elapsed if elapsed > 0 else 0.0
        wanted = max(-fastest, min(fastest, bandwidth / 4 * error))
        at_rest = abs(sample.position - previous.position) <= context.resolution
        if not at_rest:
            moved = sample.time
        elif sample.time - moved > _STILL:
            raise MeasurementRejected(
                f"the axis stands still, {error:.3g} {context.position_unit} from its start "
                f"position, with a torque of {torque:.4g} {context.effort_unit} that moved it "
                "before: does something block it?",
                code="measurement.approach",
            )
        creeps = at_rest or abs(speed) < _CREEPS * abs(wanted)  # winds up before it breaks away
        friction = 1.1 * known.breakaway if creeps else 0.9 * known.coulomb
        push = gain * (wanted - speed) + (friction if error > 0 else -friction)
        torque = known.offset + max(-authority, min(authority, push))
        previous = sample
        sample = yield torque
