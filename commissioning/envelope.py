"""What may never be exceeded in an experiment, checked on the host in every cycle."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

from commissioning.errors import EnvelopeTripped, FeedbackReversed
from commissioning.experiments.stopping import Stopping
from drivers.sample import Sample

__all__ = ["Envelope", "Watch"]

_MEASURED_TORQUE_SHARE = 1.5  # of the limit; sustained, so that a spike of noise does not trip
_MEASURED_TORQUE_CYCLES = 10
_FIRST_TRAVEL, _FIRST_SPEED = 0.6, 0.35  # of the limits, while nothing is known
_LARGEST_JUMP = 0.05  # of the travel, while the drive takes over
# A change of speed within one sample that is so many times what the torque can do, and as many
# counts, is the encoder's direction that changed. It is believed when the next sample has the new
# speed, too.
_IMPOSSIBLE, _COUNTS, _STAYS_REVERSED = 6.0, 4.0, 0.5
_LONGEST_AGAINST_TORQUE = (
    0.03  # s: an axis that gains speed for so long against its torque contradicts it
)


@dataclass(frozen=True, slots=True)
class Envelope:
    """Limits of one experiment.

    Attributes
    ----------
    centre, travel : rad or m; the axis, its stopping distance included, stays in centre ± travel
    speed : rad/s or m/s
    torque : N.m or N, of the command
    duration : s, of all experiments together; `spent` of it by those before
    thermal : (N.m)²·s or N²·s above the rated torque, the i²t budget; `rated` the torque it counts
        from, `heat` what the experiments before have left of it
    stopping : what is certain about stopping; None while nothing is known and speeds are low
    relay_torque : torque about the offset that may act until the axis is told to stop, N.m or N
    bias : torque that balances the axis, N.m or N; nan: not known, or positions are commanded
    cycle, resolution : s, rad or m: the largest step of a position command is the speed's in one
        cycle
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
    bias: float = nan
    cycle: float = inf
    resolution: float = 0.0
    cautious: bool = False
    position_unit: str = "rad"
    effort_unit: str = "N.m"

    def watch(self, position: float) -> Watch:
        """A fresh watch over one run, which begins at `position`, rad or m."""
        return Watch(self, position)


class Watch:
    """Follows one run; each method raises EnvelopeTripped with numbers and units."""

    __slots__ = (
        "_against", "_began", "_bias", "_c0", "_c1", "_c2", "_centre", "_commanded", "_counts",
        "_duration", "_envelope", "_heat", "_most_change", "_over", "_position", "_rated2",
        "_reversed",
        "_speed", "_step", "_time", "_torque", "_travel", "_velocity",
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
            self._most_change = inf
        else:
            stopping = envelope.stopping
            self._c0, self._c1, self._c2 = stopping.coefficients(envelope.relay_torque)
            most = envelope.relay_torque + stopping.friction
            self._most_change = _IMPOSSIBLE * most / stopping.inertia
        self._counts = _COUNTS * envelope.resolution
        self._step = self._speed * envelope.cycle + envelope.resolution
        self._bias = envelope.bias
        self._began = inf
        self._time = inf
        self._position = self._commanded = position
        self._velocity = 0.0
        self._reversed = 0.0  # velocity after a change that no torque makes, rad/s or m/s
        self._against = (
            inf,
            0.0,
        )  # since when and from which speed the axis moves against its torque
        self._heat = envelope.heat
        self._over = 0

    def admit(self, set_point: float) -> None:
        """Check a torque command before it is sent."""
        if not -self._torque <= set_point <= self._torque:
            e = self._envelope
            raise EnvelopeTripped(
                f"torque command {set_point:.4g} {e.effort_unit} is above the limit of "
                f"{e.torque:.4g} {e.effort_unit}; the axis was stopped",
                code="limit.torque-command",
                value=set_point,
                limit=e.torque,
                unit=e.effort_unit,
            )

    def admit_position(self, set_point: float) -> None:
        """Check a position command before it is sent: within the travel, and no step."""
        if not abs(set_point - self._centre) <= self._travel + self._envelope.resolution:
            e = self._envelope
            raise EnvelopeTripped(
                f"position command: {set_point - self._centre:+.4g} {e.position_unit} from the "
                f"start is beyond ±{self._travel:.4g} {e.position_unit}; the axis was stopped",
                code="limit.position-command",
                value=set_point - self._centre,
                limit=self._travel,
                unit=e.position_unit,
            )
        if not abs(set_point - self._commanded) <= self._step:
            e = self._envelope
            raise EnvelopeTripped(
                f"position command: a step of {set_point - self._commanded:+.4g} {e.position_unit} "
                f"is more than {self._speed:.4g} {e.position_unit}/s go in one cycle; the axis was "
                "stopped",
                code="limit.position-step",
                value=set_point - self._commanded,
                limit=self._step,
                unit=e.position_unit,
            )
        self._commanded = set_point

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
            before, self._velocity = self._velocity, velocity
            if velocity * (sample.command - self._bias) < 0:
                if self._against[0] == inf:
                    self._against = time, speed
            else:
                self._against = inf, 0.0
            if self._reversed:
                self._check_direction(velocity, before)
            elif (
                velocity * before < 0
                and abs(velocity - before) > self._most_change * elapsed + self._counts / elapsed
            ):
                self._reversed = velocity
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
                    f"of {e.torque:.4g} {e.effort_unit}; the axis was stopped",
                    code="limit.torque",
                    value=torque,
                    limit=e.torque,
                    unit=e.effort_unit,
                )
        else:
            self._over = 0
        self._time = time
        self._position = position

    def _check_start(self, position: float) -> None:
        """The axis is still where it was before the drive took over."""
        e, moved = self._envelope, position - self._position
        if abs(moved) > _LARGEST_JUMP * e.travel:
            raise EnvelopeTripped(
                f"the axis, or its encoder, moved by {moved:+.3g} {e.position_unit} while the "
                "drive was enabled; the axis was stopped",
                code="limit.jump",
                value=moved,
                limit=_LARGEST_JUMP * e.travel,
                unit=e.position_unit,
                hint="find out why first",
            )

    def _check_direction(self, velocity: float, before: float) -> None:
        """The sample after a change of speed that no torque makes.

        A disturbed one, or the new direction.
        """
        was, self._reversed = self._reversed, 0.0
        if abs(velocity - was) < _STAYS_REVERSED * abs(was):
            e = self._envelope
            raise FeedbackReversed(
                f"feedback: the speed turned to {before:+.3g} {e.position_unit}/s within one "
                "cycle, which no torque does; the encoder's direction has changed, or the axis hit "
                "something. The energy was taken away at once, for a quick stop would accelerate",
                hint="check the encoder and its cable",
            )

    def _trip(self, sample: Sample, speed: float, reach: float) -> None:
        e = self._envelope
        pu, tu = e.position_unit, e.effort_unit
        since, slower = self._against
        against = sample.time - since
        if against > _LONGEST_AGAINST_TORQUE and speed > slower:
            raise FeedbackReversed(
                f"feedback: the axis gained speed against its torque for {1000 * against:.0f} ms, "
                f"from {slower:.3g} to {speed:.3g} {pu}/s; the direction of encoder or motor has "
                "changed. The energy was taken away at once, for a quick stop would accelerate",
                hint="check encoder, motor cable and both directions",
            )
        first = " for the first motions ({:.0f} % of {:.4g})" if e.cautious else ""
        if reach > self._travel:
            first = first.format(100 * _FIRST_TRAVEL, e.travel)
            at = sample.position - e.centre
            raise EnvelopeTripped(
                f"travel: the axis is {at:+.4g} {pu} from its start at {speed:.3g} {pu}/s and "
                f"would stop within {reach:.4g} {pu}, beyond ±{self._travel:.4g} {pu}{first}; the "
                "axis was stopped",
                code="limit.travel",
                value=reach,
                limit=self._travel,
                unit=pu,
                hint="give more --travel or less --max-torque",
            )
        if speed > self._speed:
            first = first.format(100 * _FIRST_SPEED, e.speed)
            raise EnvelopeTripped(
                f"speed: {speed:.4g} {pu}/s is above the limit of {self._speed:.4g} {pu}/s{first}; "
                "the axis was stopped",
                code="limit.speed",
                value=speed,
                limit=self._speed,
                unit=f"{pu}/s",
                hint="raise --max-speed if the machine allows it",
            )
        if self._heat > e.thermal:
            raise EnvelopeTripped(
                f"the torque of the last seconds is too much for the motor (i2t budget of "
                f"{e.thermal:.3g} ({tu})2.s above {e.rated:.3g} {tu}); the axis was stopped",
                code="limit.heat",
                value=self._heat,
                limit=e.thermal,
                unit=f"({tu})2.s",
            )
        raise EnvelopeTripped(
            f"duration: the experiments take longer than {e.duration:.4g} s; the axis was stopped",
            code="limit.duration",
            value=sample.time - self._began,
            limit=e.duration,
            unit="s",
            hint="raise --duration",
        )
