"""How far an axis still goes when it is told to stop (safety: envelope)."""

from __future__ import annotations

from dataclasses import dataclass

from commissioning.errors import MeasurementRejected
from commissioning.experiments.approach import approach
from commissioning.experiments.first_look import FirstLook
from commissioning.experiments.plan import Context, Plan

__all__ = ["Stopping", "run_up"]

_PROOF_SPEED = 0.3  # of the speed limit
_PROOF_TRAVEL = 0.12  # of the travel, for the run-up
_OVERSHOOT = 0.7  # of that speed, gained until the axis feels that it is to stop
_RUN_UP_TIME = 3.0  # s
_COAST_TRAVEL = 0.5  # of the travel, that coasting on friction alone may take


@dataclass(frozen=True, slots=True)
class Stopping:
    """What is certain about stopping.

    For `reaction` the old torque may still act; then `braking` acts until rest:

        v' = |v| + (d − f)/J·t,   distance = (|v| + v')/2·t + v'²·J/(2·b)

    Attributes
    ----------
    inertia : J, kg.m2 or kg
    friction : f, N.m or N; the offset is cancelled by the bias as long as the old torque acts
    braking : b, torque that is certain to brake, N.m or N, > 0
    reaction : t, s: until the loss is noticed, dead time, and the drive's own reaction
    delay : the part of t that no setting changes, s
    watchdog : s until the drive's watchdog notices it; 0: this computer does, by its cycles
    """

    inertia: float
    friction: float
    braking: float
    reaction: float
    delay: float = 0.0
    watchdog: float = 0.0

    def coefficients(self, torque: float) -> tuple[float, float, float]:
        """c0, c1, c2 of distance = c0 + c1·|v| + c2·v² under a relay torque d = `torque`."""
        a, t = max(torque - self.friction, 0.0) / self.inertia, self.reaction
        per_square = self.inertia / (2 * self.braking)
        return (
            a * t * t / 2 + per_square * (a * t) ** 2,
            t + 2 * per_square * a * t,
            per_square,
        )

    def distance(self, speed: float, torque: float) -> float:
        """Stopping distance, rad or m."""
        c0, c1, c2 = self.coefficients(torque)
        return c0 + (c1 + c2 * speed) * speed


def run_up(context: Context, known: FirstLook) -> Plan[tuple[float, float]]:
    """Set the axis in motion and return while it moves, for the stop path to be proved.

    From the start position, and the way in which the load moves the axis: there it stops worst.

    Returns
    -------
    position and speed of the last sample (rad or m, rad/s or m/s; speed >= 0)
    """
    yield from approach(context, context.start, known)
    context.tell("proof of the stop path: a short run, then stop")
    direction = -1 if known.offset > 0 else +1
    coasting = (2 * known.coulomb * _COAST_TRAVEL * context.travel / known.inertia) ** 0.5
    goal = min(_PROOF_SPEED * context.speed, coasting)
    # the stop comes a dead time and two cycles after the speed that asks for it
    late = known.dead_time + 2 * context.cycle
    strongest = min(2.0 * max(known.coulomb, known.breakaway), context.torque - abs(known.offset))
    torque = known.coulomb + known.inertia * _OVERSHOOT * goal / late
    torque = min(max(torque, 1.2 * known.breakaway), strongest)
    goal = max(goal - (torque - known.coulomb) / known.inertia * late, 0.3 * goal)
    before = yield known.offset
    begin, begun = before.position, before.time
    while True:
        sample = yield known.offset + direction * torque
        elapsed = sample.time - before.time
        speed = direction * (sample.position - before.position) / elapsed if elapsed > 0 else 0.0
        far = direction * (sample.position - begin) >= _PROOF_TRAVEL * context.travel
        if speed >= goal or (far and speed > 0):
            return sample.position, max(speed, 0.0)
        if sample.time > begun + _RUN_UP_TIME:
            raise MeasurementRejected(
                f"the axis does not come up to speed with {torque:.4g} {context.effort_unit} "
                f"within {_RUN_UP_TIME:g} s ({speed:.3g} of {goal:.3g} {context.position_unit}/s)",
                code="measurement.no-speed",
                hint="does something block it?",
            )
        before = sample
