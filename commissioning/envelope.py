"""What may never be exceeded in an experiment, checked on the host in every cycle."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from commissioning.experiments.stopping import Stopping
from drivers.sample import Sample
from profiles.errors import EnvelopeTripped

__all__ = ["Envelope", "Watch"]

_MEASURED_TORQUE_SHARE = 1.5  # of the limit; sustained, so that a spike of noise does not trip
_MEASURED_TORQUE_CYCLES = 10
_FIRST_TRAVEL, _FIRST_SPEED = 0.6, 0.35  # of the limits, while nothing is known
_STAYS = 0.05  # of the travel, while the drive takes over


@dataclass(frozen=True, slots=True)
class Envelope:
    """Limits of one experiment.

    Attributes
    ----------
    centre, travel : rad or m; the axis, its stopping distance included, stays in centre ± travel
    speed : rad/s or m/s
    torque : N.m or N, of the command
    duration : s, of all experiments together; `spent` of it by those before
    thermal : (N.m)²·s or N²·s above the rated torque, the i²t budget; `rated` the torque it counts from,
        `heat` what the experiments before have left of it
    stopping : what is certain about stopping; None while nothing is known and speeds are low
    relay_torque : torque about the offset that may act until the axis is told to stop, N.m or N
    cautious : the first motions, of which nothing is known: a share of travel and speed
    position_unit, effort_unit : for messages
    """

    centre: float
    travel: float
    speed: float
    torque: float
    duration: float
    spent: float = 0.0
    rated: float = inf
    thermal: float = inf
    heat: float = 0.0
    stopping: Stopping | None = None
    relay_torque: float = 0.0
    cautious: bool = False
    position_unit: str = "rad"
    effort_unit: str = "N.m"

    def watch(self, position: float) -> Watch:
        """A fresh watch over one run, which begins at `position`, rad or m."""
        return Watch(self, position)


class Watch:
    """Follows one run; each method raises EnvelopeTripped with numbers and units."""

    __slots__ = (
        "_began", "_c0", "_c1", "_c2", "_centre", "_duration", "_envelope", "_heat", "_over",
        "_position", "_rated2", "_speed", "_time", "_torque", "_travel",
    )  # fmt: skip

    def __init__(self, envelope: Envelope, position: float) -> None:
        self._envelope = envelope
        self._centre = envelope.centre
        self._travel = envelope.travel * (_FIRST_TRAVEL if envelope.cautious else 1.0)
        self._speed = envelope.speed * (_FIRST_SPEED if envelope.cautious else 1.0)
        self._torque = envelope.torque * (1 + 1e-9)
        self._duration = max(envelope.duration - envelope.spent, 0.0)
        self._rated2 = envelope.rated**2
        if envelope.stopping is None:
            self._c0 = self._c1 = self._c2 = 0.0
        else:
            self._c0, self._c1, self._c2 = envelope.stopping.coefficients(envelope.relay_torque)
        self._began = inf
        self._time = inf
        self._position = position
        self._heat = envelope.heat
        self._over = 0

    def admit(self, set_point: float) -> None:
        """Check a torque command before it is sent."""
        if not -self._torque <= set_point <= self._torque:
            e = self._envelope
            raise EnvelopeTripped(
                f"torque command {set_point:.4g} {e.effort_unit} is above the limit of "
                f"{e.torque:.4g} {e.effort_unit}; the axis was stopped"
            )

    def check(self, sample: Sample) -> None:
        """Check a sample."""
        time, position = sample.time, sample.position
        elapsed = time - self._time
        offset = position - self._centre
        if elapsed > 0:
            velocity = (position - self._position) / elapsed
            speed = abs(velocity)
            ahead = self._c0 + (self._c1 + self._c2 * speed) * speed
            far = abs(offset)
            # at rest it may begin to move either way
            outwards = offset if velocity > 0 else -offset if velocity < 0 else far
            reach = max(ahead + outwards, far)
            excess = sample.command * sample.command - self._rated2
            self._heat = max(self._heat + excess * elapsed, 0.0)
            if (
                speed > self._speed
                or reach > self._travel
                or self._heat > self._envelope.thermal
                or time - self._began > self._duration
            ):
                self._trip(sample, speed, reach)
        elif self._began == inf:
            self._began = time
            self._check_start(position)
        torque = sample.torque
        if abs(torque) > self._torque * _MEASURED_TORQUE_SHARE:  # never, where it is not measured
            self._over += 1
            if self._over >= _MEASURED_TORQUE_CYCLES:
                e = self._envelope
                raise EnvelopeTripped(
                    f"the drive measures a torque of {torque:.4g} {e.effort_unit} against a limit "
                    f"of {e.torque:.4g} {e.effort_unit}; the axis was stopped"
                )
        else:
            self._over = 0
        self._time = time
        self._position = position

    def _check_start(self, position: float) -> None:
        """The axis is still where it was before the drive took over."""
        e, moved = self._envelope, position - self._position
        if abs(moved) > _STAYS * e.travel:
            raise EnvelopeTripped(
                f"the axis, or its encoder, moved by {moved:+.3g} {e.position_unit} while the drive "
                "was enabled; the axis was stopped. Find out why first"
            )

    def _trip(self, sample: Sample, speed: float, reach: float) -> None:
        e = self._envelope
        pu, tu = e.position_unit, e.effort_unit
        first = " for the first motions ({:.0f} % of {:.4g})" if e.cautious else ""
        if reach > self._travel:
            first = first.format(100 * _FIRST_TRAVEL, e.travel)
            at = sample.position - e.centre
            raise EnvelopeTripped(
                f"travel: the axis is {at:+.4g} {pu} from its start at {speed:.3g} {pu}/s and would "
                f"stop within {reach:.4g} {pu}, beyond ±{self._travel:.4g} {pu}{first}; the axis was "
                "stopped. Give more --travel or less --max-torque"
            )
        if speed > self._speed:
            first = first.format(100 * _FIRST_SPEED, e.speed)
            raise EnvelopeTripped(
                f"speed: {speed:.4g} {pu}/s is above the limit of {self._speed:.4g} {pu}/s{first}; the "
                "axis was stopped. Raise --max-speed if the machine allows it"
            )
        if self._heat > e.thermal:
            raise EnvelopeTripped(
                f"the torque of the last seconds is too much for the motor (i2t budget of "
                f"{e.thermal:.3g} ({tu})2.s above {e.rated:.3g} {tu}); the axis was stopped"
            )
        raise EnvelopeTripped(
            f"duration: the experiments take longer than {e.duration:.4g} s; the axis was stopped. "
            "Raise --duration"
        )
