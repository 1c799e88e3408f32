"""The experiments of one measurement, in their order: each learns what the next one needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TypeVar

from commissioning.envelope import Envelope
from commissioning.experiments.approach import approach
from commissioning.experiments.creep import balancing_torque
from commissioning.experiments.first_look import FirstLook, first_look
from commissioning.experiments.plan import Context, Plan, stand
from commissioning.experiments.stopping import Stopping, run_up
from commissioning.experiments.two_relay import RelayDesign, Solver, TwoRelay, design, two_relay
from commissioning.identification.modulating import ModulatingEstimate, Record
from commissioning.identification.modulating import estimate as modulating
from commissioning.identification.two_relay import Estimate, FrictionEstimate, from_cycles
from commissioning.runner import Recorder, run
from commissioning.session.desk import Desk, Options
from commissioning.session.preflight import (
    Limits,
    prove_watchdog,
    set_limits,
)
from commissioning.settings import Settings
from drivers.drive import Drive
from profiles.axis import Axis
from profiles.errors import (
    DriveFault,
    MeasurementRejected,
    PreflightRefused,
    TwoRelayError,
    WriteFailed,
)
from profiles.schema import Mode

__all__ = ["Measured", "Measurement", "half_width"]

T = TypeVar("T")

_LOW_SPEED = 0.35  # of the speed limit, while nothing is known
_THERMAL = 5.0  # s at twice-and-a-bit the rated torque: budget in rated² seconds
_BRAKING_SHARE = 0.7  # of the braking that was seen, for what is certain
_NOTICE = 4  # cycles: three missed ones and the one under way
_SECOND_PERIODS = 6.5  # of test 2, for modulating functions
_SEEN = 0.6  # relative half-width up to which viscous friction counts as seen


@dataclass(frozen=True, slots=True)
class Measured:
    """What was found, and by what. `balance` and `modulating`: the methods that were asked for."""

    look: FirstLook
    plan: RelayDesign
    tests: TwoRelay
    balance: FrictionEstimate | None
    modulating: ModulatingEstimate | None

    @property
    def coulomb(self) -> Estimate:
        """From the chosen method."""
        return self._chosen.coulomb

    @property
    def offset(self) -> Estimate:
        """From the chosen method."""
        return self._chosen.offset

    @property
    def _chosen(self) -> ModulatingEstimate | FrictionEstimate:
        found = self.modulating or self.balance
        assert found is not None
        return found

    @property
    def viscous(self) -> Estimate | None:
        """Viscous friction where the record lets it be seen."""
        found = self.modulating.viscous if self.modulating else None
        if found is None or found.value <= 0:
            return None
        return found if half_width(found) <= _SEEN else None


def half_width(estimate: Estimate) -> float:
    """Relative half-width of an interval."""
    return (estimate.high - estimate.low) / (2 * abs(estimate.value))


class Measurement:
    """One measurement on one connected drive."""

    def __init__(
        self,
        axis: Axis,
        options: Options,
        desk: Desk,
        drive: Drive,
        limits: Limits,
        recorder: Recorder,
        settings: Settings,
    ) -> None:
        self.axis = axis
        self.options = options
        self.desk = desk
        self.drive = drive
        self.limits = limits
        self.recorder = recorder
        self.settings = settings
        parameters = drive.profile.parameters
        self.context = Context(
            cycle=drive.cycle,
            resolution=drive.scaling.step(parameters["position_actual"]),
            start=limits.start,
            travel=limits.travel,
            torque=limits.torque,
            speed=limits.speed,
            torque_resolution=drive.scaling.step(parameters["torque_target"]),
            position_unit=axis.position_unit,
            effort_unit=axis.effort_unit,
            tell=recorder.phase,
        )
        self.envelope = Envelope(
            centre=limits.start,
            travel=limits.travel,
            speed=_LOW_SPEED * limits.speed,
            stage=f" for the first motions ({_LOW_SPEED * 100:.0f} % of {limits.speed:.4g})",
            torque=limits.torque,
            duration=limits.duration,
            rated=limits.rated,
            thermal=_THERMAL * limits.rated**2,
            position_unit=axis.position_unit,
            effort_unit=axis.effort_unit,
        )

    def measure(self) -> Measured:
        """All experiments; the settings are put back on every way out."""
        failure: BaseException | None = None
        try:
            with self.desk.interruption.deferred():
                set_limits(self.drive, self.settings, self.limits)
            return self._experiments()
        except BaseException as error:
            failure = error
            raise
        finally:
            self._put_back(failure)

    def _put_back(self, error: BaseException | None) -> None:
        with self.desk.interruption.deferred():
            outcome = self.settings.restore()
            if outcome.complete:
                return
            text = f"settings of the experiment are not all back: {outcome}; 'tworelay restore' tries again"
            if error is None:
                raise WriteFailed(text)
            if isinstance(error, TwoRelayError):
                error.args = (f"{error}; {text}",)

    def _run(self, plan: Plan[T], rest: float, *, leave_moving: bool = False) -> T:
        spent = self.recorder.samples[-1].time - self.recorder.samples[0].time if (
            self.recorder.samples
        ) else 0.0  # fmt: skip
        envelope = replace(self.envelope, duration=max(self.limits.duration - spent, 0.0))
        return run(
            plan, self.drive, envelope, self.recorder, self.desk.interruption,
            rest=rest, leave_moving=leave_moving,
        )  # fmt: skip

    def _experiments(self) -> Measured:
        rest = self._holding_torque() if self.axis.mechanics.held_by != "friction" else 0.0
        self.context = replace(self.context, rest=rest)
        self.recorder.phase("does the axis stay at rest?")
        self._run(stand(self.context), rest)
        prove_watchdog(
            self.drive, rest, self.desk.interruption, self.recorder.phase,
            without=self.options.without_watchdog,
        )  # fmt: skip
        known = self._run(first_look(self.context), rest)
        if abs(known.offset) > known.breakaway and self.axis.mechanics.held_by == "friction":
            e = self.axis.effort_unit
            raise PreflightRefused(
                f"the load of {known.offset:.4g} {e} is more than friction holds "
                f"({known.breakaway:.4g} {e}): the axis falls when the torque goes. Declare its "
                "brake, counterbalance or fixture in an axis file ([mechanics] held_by)"
            )
        stopping = self._prove_stop(known)
        rest = known.offset
        self.context = replace(self.context, rest=rest)
        plan = design(self.context, known, stopping)
        self.envelope = replace(
            self.envelope,
            speed=self.limits.speed,
            stage="",
            stopping=stopping,
            relay_torque=plan.d2,
        )
        tests = self._run(self._relay_job(known, plan), rest)
        method = self.options.method
        measured = Measured(
            known,
            plan,
            tests,
            from_cycles(tests.first, tests.second, self.drive.cycle)
            if method != "modulating"
            else None,
            self._modulating(tests) if method != "two-relay" else None,
        )
        found = measured.coulomb.value
        if not 0 < found < plan.d1:
            raise MeasurementRejected(
                f"the relay tests give a friction of {found:.4g} "
                f"{self.axis.effort_unit}, which their own amplitude of {plan.d1:.4g} "
                f"{self.axis.effort_unit} contradicts; is the axis rigid, and free to move?"
            )
        return measured

    def _modulating(self, tests: TwoRelay) -> ModulatingEstimate:
        """Modulating functions on the last periods of test 1 and the first of test 2."""
        samples = self.recorder.samples
        begin, turn = tests.first_span
        end = turn + _SECOND_PERIODS * tests.first.period
        cut = [s for s in samples if begin <= s.time <= end]
        record = Record.of(
            [s.time for s in cut],
            [s.position for s in cut],
            [s.sent for s in cut],
            [s.command for s in cut],
            self.context.resolution,
        )
        try:
            return modulating(record)
        except ValueError as error:
            raise MeasurementRejected(f"modulating functions: {error}") from None

    def _relay_job(self, known: FirstLook, plan: RelayDesign) -> Plan[TwoRelay]:
        yield from approach(self.context, self.context.start, known)
        solver: Solver = "thesis" if self.options.solver == "thesis" else "bracket"
        if self.options.method == "modulating":
            solver = "none"
        return (yield from two_relay(self.context, plan, known, solver=solver))

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
        envelope = replace(self.envelope, rated=inf, thermal=inf)
        start = self.drive.read("position_actual")
        torque = run(
            balancing_torque(replace(self.context, start=start)),
            self.drive, envelope, self.recorder, self.desk.interruption, mode=Mode.POSITION,
        )  # fmt: skip
        # the position commands were no torques: they do not belong to the torque record
        del self.recorder.samples[before:]
        return torque

    def _prove_stop(self, known: FirstLook) -> Stopping:
        """Set the axis in motion, stop it by the stop path, and see what braking is certain."""
        position, speed = self._run(run_up(self.context, known), known.offset, leave_moving=True)
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
        return Stopping(known.inertia, known.coulomb, certain, reaction)
