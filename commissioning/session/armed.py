"""A run that moves an axis: checks, arming, journal and record around whatever work is done in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from commissioning.guardian import Guardian, guarded
from commissioning.runner import Recorder
from commissioning.runs import RunFolder, Samples
from commissioning.session.desk import Desk, Options, begin_run, connect, none_unfinished
from commissioning.session.measurement import Measurement
from commissioning.session.preflight import Limits, check_watchdog, choose_limits, look, writes
from commissioning.session.result import blank
from commissioning.settings import Settings
from drivers.drive import Drive
from profiles.axis import Axis
from profiles.errors import TwoRelayError
from profiles.library import source_text

__all__ = ["Failure", "Work", "experiment_json", "in_a_run", "noted"]

Work = Callable[[Measurement, dict[str, Any]], None]


class Failure(Exception):
    """A job that ended early: its error, and the result as far as it got."""

    def __init__(self, error: TwoRelayError, result: dict[str, Any]) -> None:
        super().__init__(str(error))
        self.error = error
        self.result = result


def in_a_run(axis: Axis, options: Options, desk: Desk, work: Work) -> dict[str, Any]:
    """Do `work` on the armed drive of `axis`; it fills the result JSON, which is returned.

    Raises
    ------
    Failure
        Around any TwoRelayError, with the result so far. The axis is at rest and de-energised, and
        every setting of the experiment is back, or the error says what is not.
    """
    result = blank(axis, axis.link, None, None)
    try:
        with connect(axis, options.cycle, desk, f"a job on axis {axis.name}") as drive:
            return _run(axis, options, desk, drive, result, work)
    except TwoRelayError as error:
        result["status"] = error.status
        result["quality"] = {"verdict": "rejected", "reasons": [str(error)]}
        raise Failure(error, result) from error


def _run(
    axis: Axis, options: Options, desk: Desk, drive: Drive, result: dict[str, Any], work: Work
) -> dict[str, Any]:
    identity = drive.identity()
    result |= blank(axis, drive.link, drive.profile, identity)
    desk.tell(f"drive: {identity}; profile {drive.profile.name} {drive.profile.version}")
    for line in drive.lacking:
        desk.tell(line)
    none_unfinished(desk, identity.serial)
    look(drive, axis)
    check_watchdog(drive, without=options.without_watchdog)
    limits = choose_limits(drive, axis, options)
    if options.dry_run:
        return _dry_run(axis, drive, limits, desk, result)
    desk.agree(_arming_text(axis, limits), axis.name, "nothing was moved or written")
    look(drive, axis)  # the question may have stood for long
    none_unfinished(desk, identity.serial)
    limits = choose_limits(drive, axis, options)
    profile_text = source_text(axis.profile or drive.profile.name)
    run_id = begin_run(desk, drive, identity, axis, options.fraction)
    result["run"] = run_id
    recorder = Recorder(on_phase=desk.tell)
    folder = RunFolder.of(desk.journal, run_id)
    folder.save(result, None, profile_text)  # so that `restore` knows the drive after a crash
    try:
        settings = Settings(desk.journal, run_id, drive)
        home = desk.journal.folder
        with guarded(drive, axis, folder.profile_path(), run_id, home) as guardian:
            job = Measurement(axis, options, desk, drive, limits, recorder, settings, guardian)
            try:
                work(job, result)
            finally:
                result["notes"] += [*drive.lacking, *noted(guardian)]
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
                result["experiment"] = experiment_json(recorder, drive.cycle, 0)
            desk.journal.finish(run_id, result["status"])
            folder.save(result, Samples.of(recorder), None)
    return result


def noted(guardian: Guardian) -> list[str]:
    """What the result keeps of what the guardian did."""
    acted = guardian.acted()
    return [acted, *(f"guardian: {line}" for line in guardian.said[1:])] if acted else []


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


def experiment_json(recorder: Recorder, cycle: float, periods: int) -> dict[str, Any]:
    """The `experiment` object of what was recorded."""
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
