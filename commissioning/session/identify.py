"""Measure one axis: from the link to a proposal. Nothing is changed for good."""

from __future__ import annotations

import os
from typing import Any

from commissioning.compensation import Change, Known, propose
from commissioning.identification.critical_point import corrected, friction_of, from_model
from commissioning.identification.two_relay import Estimate
from commissioning.runner import Recorder
from commissioning.runs import RunFolder, Samples
from commissioning.session.desk import Desk, Options, connect, none_unfinished
from commissioning.session.measurement import Measured, Measurement, half_width
from commissioning.session.preflight import (
    Limits,
    choose_limits,
    look,
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
    TwoRelayError,
    WriteFailed,
)
from profiles.library import digest, source_text
from profiles.schema import CompensationLaw

__all__ = ["Failure", "identify"]

_LEAST_PERIOD = 20  # dead times
_LEAST_CYCLES = 25  # a period
_LARGEST_RESIDUAL = 0.015  # of the right-hand side
_LARGEST_DIFFERENCE = 0.02  # of the friction, between two halves of the record
_LIMITED_SHARE = 0.002  # of the cycles


class Failure(Exception):
    """A job that ended early: its error, and the result as far as it got."""

    def __init__(self, error: TwoRelayError, result: dict[str, Any]) -> None:
        super().__init__(str(error))
        self.error = error
        self.result = result


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
        job = Measurement(
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


def _fill(
    result: dict[str, Any],
    measured: Measured,
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


def _quality(measured: Measured, cycle: float, samples: list[Sample]) -> dict[str, Any]:
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
            "elastic or strongly damped, its friction is not Coulomb-like, or it dwells at rest"
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


def _proposal(drive: Drive, measured: Measured, fraction: float) -> list[Change]:
    law = drive.profile.compensation
    if law.law is CompensationLaw.NONE:
        return []
    old = {name: drive.read_raw(name) for name in law.terms.values()}
    viscous = measured.viscous
    known = Known(
        measured.coulomb.value,
        measured.offset.value,
        viscous.value if viscous else None,
        half_width(viscous) if viscous else 0.0,
    )
    return propose(drive.profile, drive.scaling, known, old, fraction)
