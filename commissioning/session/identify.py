"""Measure one axis: from the link to a proposal. Nothing is changed for good."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from math import inf
from typing import Any, TypeVar

from commissioning.compensation import Change, Known, propose
from commissioning.envelope import Envelope
from commissioning.experiments.approach import approach
from commissioning.experiments.creep import balancing_torque
from commissioning.experiments.first_look import FirstLook, first_look
from commissioning.experiments.plan import Context, Plan, stand
from commissioning.experiments.stopping import Stopping, run_up
from commissioning.experiments.two_relay import RelayDesign, Solver, TwoRelay, design, two_relay
from commissioning.identification.critical_point import corrected, friction_of, from_model
from commissioning.identification.modulating import ModulatingEstimate, Record
from commissioning.identification.modulating import estimate as modulating
from commissioning.identification.two_relay import Estimate, FrictionEstimate, from_cycles
from commissioning.runner import Recorder, run
from commissioning.runs import RunFolder, Samples
from commissioning.session.desk import Desk, Options, connect, none_unfinished
from commissioning.session.preflight import (
    Limits,
    choose_limits,
    look,
    prove_watchdog,
    set_limits,
    writes,
)
from commissioning.session.result import (
    blank,
    changes_json,
    critical_points,
    cycles_json,
    friction_json,
    method_json,
    modulating_json,
)
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.sample import Sample
from profiles.axis import Axis
from profiles.errors import (
    DriveFault,
    MeasurementRejected,
    PreflightRefused,
    TwoRelayError,
    WriteFailed,
)
from profiles.library import digest, source_text
from profiles.schema import CompensationLaw, Mode

__all__ = ["Failure", "identify"]

T = TypeVar("T")

_LOW_SPEED = 0.35  # of the speed limit, while nothing is known
_THERMAL = 5.0  # s at twice-and-a-bit the rated torque: budget in rated² seconds
_BRAKING_SHARE = 0.7  # of the braking that was seen, for what is certain
_NOTICE = 4  # cycles: three missed ones and the one under way
_LEAST_PERIOD = 20  # dead times
_LEAST_CYCLES = 25  # a period
_SECOND_PERIODS = 6.5  # of test 2, for modulating functions
_SEEN = 0.6  # relative half-width up to which viscous friction counts as seen
_LARGEST_RESIDUAL = 0.03  # of the right-hand side
_LARGEST_DIFFERENCE = 0.02  # of the friction, between two halves of the record
_LIMITED_SHARE = 0.002  # of the cycles


class Failure(Exception):
    """A job that ended early: its error, and the result as far as it got."""

    def __init__(self, error: TwoRelayError, result: dict[str, Any]) -> None:
        super().__init__(str(error))
        self.error = error
        self.result = result


@dataclass(frozen=True, slots=True)
class _Measured:
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
        return found if _half_width(found) <= _SEEN else None


def _half_width(estimate: Estimate) -> float:
    """Relative half-width of an interval."""
    return (estimate.high - estimate.low) / (2 * abs(estimate.value))


def identify(axis: Axis, options: Options, desk: Desk) -> dict[str, Any]:
    """Run the experiments on `axis` and return the result JSON.

    Raises
    ------
    Failure
        Around any TwoRelayError, with the result so far. The axis is at rest and de-energised, and
        every setting of the experiment is back, or the error says what is not.
    """
    result = blank(axis, axis.link, None, None)
    try:
        with connect(axis, options.cycle, desk) as drive:
            return _identify(axis, options, desk, drive, result)
    except TwoRelayError as error:
        result["status"] = error.status
        result["quality"] = {"verdict": "rejected", "reasons": [str(error)]}
        raise Failure(error, result) from error


def _identify(
    axis: Axis, options: Options, desk: Desk, drive: Drive, result: dict[str, Any]
) -> dict[str, Any]:
    identity = drive.identity()
    result |= blank(axis, drive.link, drive.profile, identity)
    desk.tell(f"drive: {identity}; profile {drive.profile.name} {drive.profile.version}")
    none_unfinished(desk, identity.serial)
    look(drive, axis)
    limits = choose_limits(drive, axis, options)
    if options.dry_run:
        return _dry_run(axis, drive, limits, desk, result)
    desk.agree(_arming_text(axis, limits), axis.name)
    look(drive, axis)  # the question may have stood for long
    none_unfinished(desk, identity.serial)
    limits = choose_limits(drive, axis, options)
    profile_text = source_text(axis.profile or drive.profile.name)
    run_id = desk.journal.begin(
        axis=axis.name,
        link=drive.link,
        profile=drive.profile.name,
        profile_hash=digest(drive.profile),
        serial=identity.serial,
        context={
            "axis": axis.model_dump(mode="json"),
            "fraction": options.fraction,
            "pid": os.getpid(),
        },
    )
    result["run"] = run_id
    recorder = Recorder(on_phase=desk.tell)
    folder = RunFolder.of(desk.journal, run_id)
    folder.save(result, None, profile_text)  # so that `restore` knows the drive after a crash
    try:
        job = _Job(
            axis, options, desk, drive, limits, recorder, Settings(desk.journal, run_id, drive)
        )
        measured = job.measure()
        _fill(result, measured, axis, drive, recorder, limits)
        try:
            changes = _proposal(drive, measured, options.fraction)
        except WriteFailed as error:
            changes = []
            result["quality"]["reasons"].append(f"nothing is proposed: {error}")
        result["compensation"] = changes_json(changes)
        result["status"] = "completed"
    except TwoRelayError as error:
        result["friction"] = blank(axis, drive.link, drive.profile, identity)["friction"]
        result["critical_point"] = None
        result["status"] = error.status
        result["quality"] = {"verdict": "rejected", "reasons": [str(error)]}
        raise
    finally:
        with desk.interruption.deferred():
            if result["experiment"] is None:
                result["experiment"] = _experiment(recorder, drive.cycle, 0)
            desk.journal.finish(run_id, result["status"])
            folder.save(result, Samples.of(recorder), None)
    return result


def _arming_text(axis: Axis, limits: Limits) -> str:
    p, e = axis.position_unit, axis.effort_unit
    return (
        f"Axis '{axis.name}' will MOVE by itself: up to ±{limits.travel:.4g} {p} about its present "
        f"position, with up to {limits.torque:.4g} {e} and {limits.speed:.4g} {p}/s, for about a "
        "minute. tworelay is not a safety function: keep people clear and the emergency stop in "
        "reach."
    )


def _dry_run(
    axis: Axis, drive: Drive, limits: Limits, desk: Desk, result: dict[str, Any]
) -> dict[str, Any]:
    """Say what would be written; write nothing."""
    desk.tell(_arming_text(axis, limits))
    for name, raw in writes(drive, limits).items():
        there, parameter = drive.read_raw(name), drive.profile.parameters[name]
        if there != raw:
            desk.tell(
                f"would set {name} ({parameter.address}): {there} → {raw} "
                f"(x {drive.scaling.raw_unit(parameter)}), and put it back"
            )
    desk.tell("would set mode, target torque and controlword to move the axis, and put them back")
    desk.tell("dry run: nothing was written or moved")
    result["status"] = "completed"
    result["quality"]["reasons"] = ["dry run: nothing was measured"]
    return result


class _Job:
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

    def measure(self) -> _Measured:
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

    def _experiments(self) -> _Measured:
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
        measured = _Measured(
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


def _fill(
    result: dict[str, Any],
    measured: _Measured,
    axis: Axis,
    drive: Drive,
    recorder: Recorder,
    limits: Limits,
) -> None:
    """Put the numbers into the result."""
    known, first = measured.look, measured.tests.first
    balance, fast = measured.balance, measured.modulating
    estimates: dict[str, Estimate | None] = {
        "coulomb": measured.coulomb,
        "offset": measured.offset,
        "viscous": measured.viscous,
    }
    if fast is not None:
        estimates |= {"inertia": fast.inertia, "dead_time": fast.dead_time}
        result["methods"]["modulating"] = modulating_json(fast)
        right = from_model(
            fast.inertia.value, fast.viscous.value, fast.dead_time.value, first.period
        )
        complex_coulomb = friction_of(first, right)
    if balance is not None:
        result["methods"]["two-relay"] = method_json(balance)
        if fast is None:
            complex_coulomb = balance.complex_coulomb
            right = corrected(first, complex_coulomb)
    method = "modulating" if fast is not None else "two-relay"
    result["friction"] = friction_json(method, estimates, axis, drive.profile, drive.scaling)
    result["critical_point"] = critical_points(first, right)
    result["experiment"] = _experiment(recorder, drive.cycle, measured.tests.periods)
    result["experiment"]["cycles"] = cycles_json((first, measured.tests.second))
    result["experiment"]["complex_coulomb"] = [complex_coulomb.real, complex_coulomb.imag]
    result["experiment"] |= {
        "spans": [list(measured.tests.first_span), list(measured.tests.second_span)],
        "tests": measured.tests.tests,
        "limits": {
            "travel": limits.travel,
            "torque": limits.torque,
            "speed": limits.speed,
        },
        "first_look": {
            "breakaway": known.breakaway,
            "coulomb": known.coulomb,
            "offset": known.offset,
            "viscous": known.viscous,
            "inertia": known.inertia,
            "dead_time": known.dead_time,
        },
    }
    if recorder.samples:
        begin = recorder.samples[0].sent
        result["experiment"]["spans"] = [
            [t - begin for t in span] for span in result["experiment"]["spans"]
        ]
    result["quality"] = _quality(measured, drive.cycle, recorder.samples)


def _quality(measured: _Measured, cycle: float, samples: list[Sample]) -> dict[str, Any]:
    reasons = []
    tests, f = measured.tests, measured.coulomb.value
    for number, test in ((1, tests.first), (2, tests.second)):
        if not test.settled and measured.balance is not None:
            reasons.append(f"relay test {number} did not settle within {test.periods} periods")
    if tests.first.period < _LEAST_PERIOD * measured.look.dead_time:
        reasons.append(
            f"the period of {tests.first.period * 1000:.3g} ms is short against the dead time of "
            f"{measured.look.dead_time * 1000:.3g} ms; more travel would allow a longer one"
        )
    cycles = tests.first.period / cycle
    if cycles < _LEAST_CYCLES:
        reasons.append(
            f"a period has only {cycles:.0f} cycles of {cycle * 1000:g} ms; more travel or a "
            "shorter --cycle would give more"
        )
    fast = measured.modulating
    if fast is not None and fast.residual > _LARGEST_RESIDUAL:
        reasons.append(
            f"the rigid axis explains the record only to {100 * fast.residual:.1f} %: the axis is "
            "elastic, its friction is not Coulomb-like, or it dwells at rest"
        )
    if fast is not None and fast.halves > _LARGEST_DIFFERENCE:
        reasons.append(f"two halves of the record differ by {100 * fast.halves:.1f} % in friction")
    limited = sum(s.status.limit for s in samples) / max(len(samples), 1)
    if limited > _LIMITED_SHARE:
        reasons.append(
            f"the drive's own limiter acted in {100 * limited:.1f} % of the cycles, so that the axis "
            "did not get the torque that was commanded; raise the drive's limits or lower --max-torque"
        )
    share = f / tests.first.relay_amplitude
    if not 0.2 <= share <= 0.8:
        reasons.append(f"friction is {share:.2f} of the smaller relay amplitude (0.2–0.8 is sound)")
    return {"verdict": "usable" if reasons else "good", "reasons": reasons}


def _experiment(recorder: Recorder, cycle: float, periods: int) -> dict[str, Any]:
    samples = recorder.samples
    if not samples:
        return {
            "periods": 0, "duration": 0.0, "cycle": cycle, "late_share": 0.0, "lost_share": 0.0,
            "travel": 0.0,
        }  # fmt: skip
    positions = [s.position for s in samples]
    late = sum(s.lateness > 0.5 * cycle for s in samples)
    lost = sum(s.missed for s in samples)
    return {
        "periods": periods,
        "duration": samples[-1].time - samples[0].sent,
        "cycle": cycle,
        "late_share": late / len(samples),
        "lost_share": lost / (len(samples) + lost),
        "travel": max(positions) - min(positions),
    }


def _proposal(drive: Drive, measured: _Measured, fraction: float) -> list[Change]:
    law = drive.profile.compensation
    if law.law is CompensationLaw.NONE:
        return []
    old = {name: drive.read_raw(name) for name in law.terms.values()}
    viscous = measured.viscous
    known = Known(
        measured.coulomb.value,
        measured.offset.value,
        viscous.value if viscous else None,
        _half_width(viscous) if viscous else 0.0,
    )
    return propose(drive.profile, drive.scaling, known, old, fraction)
