"""The experiments of one measurement, in their order: each learns what the next one needs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from math import inf, nan
from typing import TypeVar

import numpy as np

from commissioning.desk import Desk, Options
from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped, FeedbackReversed, MeasurementRejected
from commissioning.experiments.creep import balancing_torque
from commissioning.experiments.design import LONG, SHORT, RelayDesign, design
from commissioning.experiments.first_look import STEPS, FirstLook, first_look, torque_steps
from commissioning.experiments.plan import Context, Plan, stand
from commissioning.experiments.stopping import Stopping, run_up
from commissioning.experiments.tracking import TrackingPath, TrackingSamples, track
from commissioning.experiments.two_relay import Solver
from commissioning.guardian import Guardian
from commissioning.identification.modulating import ModulatingEstimate
from commissioning.identification.record import Record, unfiltered
from commissioning.identification.verdict import Units
from commissioning.result.experiment import Limits
from commissioning.rig import preflight
from commissioning.rig.methods import PACE_IS_LONG, Measured, measure
from commissioning.rig.points import points
from commissioning.rig.preflight import (
    cautious_speed,
    prove_watchdog,
    set_limits,
    still_moving,
    widen_speed,
)
from commissioning.runner import Recorder, run
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.errors import DriveFault, PreflightRefused, WriteFailed
from drivers.sample import Sample
from profiles.axis import Axis
from profiles.errors import TwoRelayError
from profiles.procedures import Mode

__all__ = ["Measurement"]

T = TypeVar("T")

_THERMAL = 5.0  # s at twice-and-a-bit the rated torque: budget in rated² seconds
_BRAKING_SHARE = 0.7  # of the braking that was seen, for what is certain
_SOUND = 0.35, 0.72  # f/d1 of well-conditioned oscillations
_KNOWN = 0.3  # relative half-width of f up to which it is worth a new design
_CHANGED = 0.87  # of d1: a smaller change is none
_STALL = 1.5  # cycles
_COASTS = 1.5  # of the time that friction alone takes to stop the axis
_NOTICE = 4  # cycles: three missed ones and the one under way


class Measurement:
    """One measurement on one connected drive."""

    def __init__(
        self,
        axis: Axis,
        options: Options,
        desk: Desk,
        drive: Drive,
        limits: preflight.Limits,
        recorder: Recorder,
        settings: Settings,
        guardian: Guardian,
    ) -> None:
        self.axis = axis
        self.options = options
        self.desk = desk
        self.drive = drive
        self.limits = limits
        self.recorder = recorder
        self.settings = settings
        self.guardian = guardian
        parameters = drive.profile.parameters
        self.context = Context(
            cycle=drive.cycle,
            resolution=abs(drive.scaling.step(parameters[preflight.POSITION])),
            start=limits.start,
            travel=limits.travel,
            torque=limits.torque,
            speed=limits.speed,
            torque_resolution=drive.scaling.step(parameters[preflight.TORQUE]),
            position_unit=axis.position_unit,
            effort_unit=axis.effort_unit,
            tell=recorder.phase,
        )
        self.units = Units(axis.position_unit, axis.effort_unit)
        self.solver: Solver = "thesis" if options.solver == "thesis" else "bracket"
        loops = drive.profile.loops
        self.loop_lag = drive.read(loops.lag) if loops and loops.lag else 0.0  # s
        self._prepared_for = Mode.TORQUE  # by its `before`, which `set_limits` has written
        self._watchdog_fault: str | None = None  # which its proof left behind; None: no proof yet
        self._heat, self._heated = 0.0, 0  # i²t that is left over, and up to which sample
        self.known: FirstLook
        self.stopping: Stopping
        self.plan: RelayDesign
        self.envelope = Envelope(
            centre=limits.start,
            travel=limits.travel,
            speed=limits.speed,
            cautious=True,
            torque=limits.torque,
            duration=limits.duration,
            rated=limits.rated,
            thermal=_THERMAL * limits.rated**2,
            cycle=drive.cycle,
            resolution=self.context.resolution,
            position_unit=axis.position_unit,
            effort_unit=axis.effort_unit,
        )

    @property
    def allowed(self) -> Limits:
        """What the run was allowed, for its result."""
        return Limits(self.limits.travel, self.limits.torque, self.limits.speed)

    def as_the_drive_counts(self, name: str, value: float) -> tuple[float | None, str | None]:
        """A torque, N.m or N, in steps of the drive, and what a step is; None for other quantities."""
        if name not in ("coulomb", "offset"):
            return None, None
        parameter = self.drive.profile.parameters[preflight.TORQUE]
        scaling = self.drive.scaling
        return value / scaling.step(parameter), scaling.raw_unit(parameter)

    def measure(self) -> list[Measured]:
        """All experiments; the oscillations are run as often as `repeat` says, each with its reading."""
        return self.within_settings(self._experiments)

    def torque_steps(self) -> Record:
        """Short pushes both ways at low speed, and nothing else."""
        return self.within_settings(self._torque_steps)

    def within_settings(self, work: Callable[[], T]) -> T:
        """The drive's limits and watchdog around `work`; put back on every way out."""
        failure: BaseException | None = None
        try:
            with self.desk.interruption.deferred():
                set_limits(self.drive, self.settings, self.limits, self.desk.tell)
            return work()
        except BaseException as error:
            failure = error
            raise
        finally:
            self._put_back(failure)

    def follow(self, path: TrackingPath) -> TrackingSamples:
        """Follow a path in position mode; its samples are no part of the torque record."""
        envelope = replace(self.envelope, cautious=False, rated=inf, thermal=inf, bias=nan)
        self._prepare(Mode.POSITION)
        here = self.drive.read("position_actual")
        return run(
            track(self.context, path, here), self.drive, envelope, Recorder(), self.desk.interruption,
            mode=Mode.POSITION, guardian=self.guardian,
        )  # fmt: skip

    def _put_back(self, error: BaseException | None) -> None:
        with self.desk.interruption.deferred():
            with contextlib.suppress(TwoRelayError):
                self._clear_own_fault()
            outcome = self.settings.restore()
            if outcome.complete:
                return
            text = (
                f"settings of the experiment are not all back: {outcome}; 'tworelay restore "
                f"{self.settings.run}' tries again"
            )
            if error is None:
                raise WriteFailed(text)
            if isinstance(error, TwoRelayError):
                error.args = (f"{error}; {text}",)

    def _clear_own_fault(self) -> None:
        """Acknowledge what the drive's watchdog said of the silence in which it was stopped."""
        if self._watchdog_fault and self.drive.fault_text() == self._watchdog_fault:
            self.drive.reset_fault()

    def _prepare(self, mode: Mode) -> None:
        """Write what the drive needs in a mode, where it was prepared for another one."""
        if mode is self._prepared_for:
            return
        with self.desk.interruption.deferred():
            for name, raw in self.drive.preparations(mode).items():
                self.settings.write("experiment", name, raw)
        self._prepared_for = mode

    def prove_watchdog(self, rest: float) -> None:
        """See the drive stop by itself under the torque `rest` (N.m or N) that holds the axis."""
        self._prepare(Mode.TORQUE)
        tell = self.recorder.phase if self._watchdog_fault is None else lambda text: None
        self._watchdog_fault = prove_watchdog(
            self.drive, rest, self.limits.travel, self.desk.interruption, tell,
            without=self.options.without_watchdog, before=self._watchdog_fault,
        )  # fmt: skip

    def _move(self, plan: Plan[T], rest: float, *, leave_moving: bool = False) -> T:
        """Drive a plan that moves the axis: the drive's watchdog is proved first."""
        self.prove_watchdog(rest)
        return self._run(plan, rest, leave_moving=leave_moving)

    def _run(self, plan: Plan[T], rest: float, *, leave_moving: bool = False) -> T:
        spent = self.recorder.samples[-1].time - self.recorder.samples[0].time if (
            self.recorder.samples
        ) else 0.0  # fmt: skip
        envelope = replace(self.envelope, spent=spent, heat=self._heat_left())
        self._prepare(Mode.TORQUE)
        return run(
            plan, self.drive, envelope, self.recorder, self.desk.interruption,
            rest=rest, leave_moving=leave_moving, guardian=self.guardian,
        )  # fmt: skip

    def _torque_steps(self) -> Record:
        known = self._first_look()
        self.recorder.phase(f"{STEPS} torque steps, both ways")
        begin = len(self.recorder.samples)
        self._move(torque_steps(self._cautious(), known), known.offset)
        return self._record_of(self.recorder.samples[begin:], self.recorder.samples[begin:])

    def _first_look(self) -> FirstLook:
        """The first motions, from rest and with the watchdog proved."""
        rest = self._holding_torque() if self.axis.mechanics.held_by != "friction" else 0.0
        self.context = replace(self.context, rest=rest)
        self.recorder.phase("does the axis stay at rest?")
        self._run(stand(self.context), rest)
        known = self._move(first_look(self._cautious()), rest)
        self.envelope = replace(self.envelope, bias=known.offset)
        if abs(known.offset) > known.breakaway and self.axis.mechanics.held_by == "friction":
            e = self.axis.effort_unit
            raise PreflightRefused(
                f"the load of {known.offset:.4g} {e} is more than friction holds "
                f"({known.breakaway:.4g} {e}): the axis falls when the torque goes. Declare its "
                "brake, counterbalance or fixture in an axis file ([mechanics] held_by)"
            )
        return known

    def _cautious(self, dead_time: float | None = None) -> Context:
        """For the motions before the stop path is proved: as slow as the drive's own limit is then."""
        return replace(self.context, speed=cautious_speed(self.drive, self.limits, dead_time))

    def _widen(self, speed: float) -> None:
        with self.desk.interruption.deferred():
            widen_speed(self.drive, self.settings, speed)

    def prepare(self) -> None:
        """All that comes before the oscillations: first motions, proof of the stop path, design."""
        self.known = self._first_look()
        self.stopping = self._prove_stop(self.known)
        self._widen(self.limits.speed)
        self._rest = self.known.offset
        self.context = replace(self.context, rest=self._rest)
        self._design()

    def _experiments(self) -> list[Measured]:
        self.prepare()
        found = [self._once() for _ in range(self.options.repeat)]
        points(found[-1], self, move=self.options.points)
        return found

    def _once(self) -> Measured:
        measured = measure(self.options.method, self)
        value = measured.found.coulomb.value
        if not 0 < value < self.plan.d1:
            e = self.axis.effort_unit
            raise MeasurementRejected(
                f"the oscillations give a friction of {value:.4g} {e}, which their own amplitude of "
                f"{self.plan.d1:.4g} {e} contradicts; is the axis rigid, and free to move?"
            )
        return measured

    def _design(self) -> None:
        """Choose the oscillations, and what the envelope must allow for them."""
        pace = LONG if self.options.method in PACE_IS_LONG else SHORT
        self.plan = design(self.context, self.known, self.stopping, pace)
        self.envelope = replace(
            self.envelope,
            cautious=False,
            stopping=self.stopping,
            relay_torque=self.plan.most,
        )

    def redesign(self, found: ModulatingEstimate) -> bool:
        """Choose the oscillations anew from what a first record tells; False: they were right."""
        f, before = found.coulomb.value, self.plan
        if not 0 < f < self.context.torque or found.coulomb.half_width > _KNOWN:
            return False
        if not found.inertia.value > 0:
            return False
        if _SOUND[0] <= f / before.d1 <= _SOUND[1]:
            return False
        kept = self.known, self.plan, self.envelope
        self.known = replace(
            self.known,
            coulomb=f,
            breakaway=max(f, found.low_speed),
            inertia=found.inertia.value,
            viscous=max(found.viscous.value, 0.0),
        )
        try:
            self._design()
        except (MeasurementRejected, PreflightRefused):
            self.known, self.plan, self.envelope = kept
            return False
        if self.plan.d1 < _CHANGED * before.d1 or self.plan.d1 * _CHANGED > before.d1:
            e = self.axis.effort_unit
            self.recorder.phase(
                f"the friction is about {f:.3g} {e}: again with ±{self.plan.d1:.4g} and "
                f"±{self.plan.d2:.4g} {e}"
            )
            return True
        self.known, self.plan, self.envelope = kept
        return False

    def run(self, plan: Plan[T]) -> T:
        """Drive a plan to its end, from and to the torque that balances the axis."""
        return self._move(plan, self._rest)

    def attempt(self, plan: Plan[T]) -> T:
        """The same for what need not be: a limit that ends it rejects it, once the axis is safe."""
        try:
            return self.run(plan)
        except EnvelopeTripped as error:
            if isinstance(error, FeedbackReversed) or self.drive.is_energised():
                raise
            raise MeasurementRejected(str(error)) from None

    @property
    def time_left(self) -> float:
        """Of the duration that is allowed, s."""
        samples = self.recorder.samples
        spent = samples[-1].time - samples[0].time if samples else 0.0
        return self.limits.duration - spent

    def _heat_left(self) -> float:
        """Of the i²t budget, what the experiments so far have not given back, (N.m)²·s or N²·s."""
        samples = self.recorder.samples
        fresh = samples[max(self._heated - 1, 0) :]
        self._heated = len(samples)
        if len(fresh) > 1:
            time, command = (np.array([getattr(s, k) for s in fresh]) for k in ("time", "command"))
            steps = np.diff(time)
            # between two experiments the drive is off
            power = np.where(steps < 1.0, command[1:] ** 2, 0.0) - self.limits.rated**2
            total = self._heat + np.cumsum(power * steps)
            self._heat = float(total[-1] - min(total.min(), 0.0))
        return self._heat

    def heat(self, torque: float, seconds: float) -> float:
        """Share of the i²t budget in use after ± a torque (N.m or N) about the bias for some seconds."""
        more = torque**2 + self.known.offset**2 - self.limits.rated**2
        return (self._heat_left() + max(more, 0.0) * seconds) / self.envelope.thermal

    def record(self, begin: float, end: float) -> Record:
        """What was recorded between two instants (s), a filter in the position signal undone."""
        # commands before the record act in it, too
        early = begin - self.plan.period
        cut = [s for s in self.recorder.samples if early <= s.time <= end]
        # a host that stalls within an exchange stamps it wrongly; it shows in the next one's lateness
        stall = _STALL * self.context.cycle
        kept = [
            s for s, after in zip(cut, [*cut[1:], cut[-1]], strict=True) if after.lateness <= stall
        ]
        whole = self._record_of(kept, cut)
        if self.options.output_filter:
            whole = unfiltered(whole, self.options.output_filter)
        return whole.between(begin, end)

    def _record_of(self, seen: list[Sample], commanded: list[Sample]) -> Record:
        return Record.of(
            [s.time for s in seen],
            [s.position for s in seen],
            [s.sent for s in commanded],
            [s.command for s in commanded],
            self.context.resolution,
        )

    def _holding_torque(self) -> float:
        """Torque that holds the axis, read while the drive holds its position."""
        if "torque_actual" not in self.drive.profile.cycle.in_:
            raise PreflightRefused(
                f"the axis is held by a {self.axis.mechanics.held_by}, but profile "
                f"'{self.drive.profile.name}' does not exchange torque_actual, so the torque that "
                "holds it cannot be known"
            )
        self.recorder.phase("holding torque: creep up and down in position mode")
        before = len(self.recorder.samples)
        envelope = replace(self.envelope, rated=inf, thermal=inf, bias=nan)
        self._prepare(Mode.POSITION)
        start = self.drive.read("position_actual")
        torque = run(
            balancing_torque(replace(self.context, start=start)),
            self.drive, envelope, self.recorder, self.desk.interruption, mode=Mode.POSITION,
            guardian=self.guardian,
        )  # fmt: skip
        # the position commands were no torques: they do not belong to the torque record
        del self.recorder.samples[before:]
        return torque

    def _prove_stop(self, known: FirstLook) -> Stopping:
        """Set the axis in motion, stop it by the stop path, and see what braking is certain."""
        cautious = self._cautious(known.dead_time)
        self._widen(cautious.speed)
        position, speed = self._move(run_up(cautious, known), known.offset, leave_moving=True)
        # a drive calls standstill what is slow to it; the axis may coast on
        self._clear_own_fault()
        coasting = (
            known.inertia * speed / max(known.coulomb - abs(known.offset), 0.1 * known.coulomb)
        )
        moved = still_moving(self.drive, 1.0 + _COASTS * coasting)
        if moved:
            raise DriveFault(
                "the stop path could not be proved: the drive has no energy any more, and the axis still "
                f"moves ({moved:.3g} {self.axis.position_unit} between two looks); nothing larger is moved"
            )
        distance = abs(self.drive.read("position_actual") - position)
        delay = known.dead_time + self.drive.cycle
        counted = max(distance - speed * delay, 0.25 * distance, 1e-12)
        braking = _BRAKING_SHARE * known.inertia * speed**2 / (2 * counted)
        certain = max(braking, known.coulomb - abs(known.offset))
        if not certain > 0 or not speed > 0:
            raise DriveFault(
                f"the stop path could not be proved ({distance:.3g} {self.axis.position_unit} from "
                f"{speed:.3g} {self.axis.position_unit}/s); nothing larger is moved"
            )
        self.recorder.phase(
            f"stop path proved: {speed:.3g} {self.axis.position_unit}/s to rest within "
            f"{distance:.3g} {self.axis.position_unit}"
        )
        watchdog = self.drive.profile.watchdog
        silent = watchdog.timeout if watchdog.kind != "none" else 0.0
        reaction = max(_NOTICE * self.drive.cycle, silent) + delay
        watches = silent if silent > _NOTICE * self.drive.cycle else 0.0
        return Stopping(known.inertia, known.coulomb, certain, reaction, delay, watches)
