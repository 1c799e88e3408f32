"""Prove that the compensation helps, where it acts: in position mode, before and after, step by step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from commissioning.experiments.tracking import TURNS, TrackingPath, TrackingSamples, path_for
from commissioning.guardian import guarded
from commissioning.identification.tracking import TrackingError, at_rest, creeping, reversal_error
from commissioning.journal import RESTORED, STORED, STORING, RunRecord
from commissioning.runner import Recorder
from commissioning.session.apply import axis_of_run, own_run, store, unverified
from commissioning.session.armed import noted
from commissioning.session.desk import Desk, Options, connect, none_unfinished, same_drive
from commissioning.session.measurement import Measurement
from commissioning.session.preflight import check_watchdog, choose_limits, look
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.sample import Sample
from profiles.axis import Axis
from profiles.errors import PreflightRefused, Refused, TwoRelayError, WriteFailed
from profiles.schema import Mode, Profile

__all__ = ["provable", "verify"]

_STEPS = 0.5, 0.7  # of the friction; then the fraction of the run
_WHOLE = "offset", "points", "speed"  # terms of a law that are no friction
_WORSE = 1.05  # of the error before, and
_NOISE = 2.0  # counts more: from here on a step does harm
_SHOWN = 400  # points of a trace

Raw = dict[str, int]


@dataclass(frozen=True, slots=True)
class _Step:
    """One set of values in the drive, and how the axis followed with it."""

    fraction: float  # of the friction that is compensated
    raw: Raw
    error: TrackingError
    trace: dict[str, list[float]]

    def json(self, *, kept: bool) -> dict[str, Any]:
        """For the result; rad or m."""
        return {
            "fraction": self.fraction, "reversal_error": self.error.reversal,
            "low_speed_error": self.error.low_speed, "rest_swing": self.error.rest,
            "hunts": self.error.hunts, "kept": kept, "trace": self.trace,
        }  # fmt: skip


def verify(
    run: str, link: str | None, desk: Desk, limits: dict[str, Any], *, unproved: bool = False
) -> dict[str, Any]:
    """Measure without and with the compensation of `run` and leave the best in the drive.

    `limits`: options by name, where they are to be others than those of the run. `unproved`: what is in the
    drive was written for this proof only, and whoever did so takes it back should this fail. Returns the
    result JSON.

    Raises
    ------
    WriteFailed
        No step helps; the values from before the run are in the drive, and in its memory.
    TwoRelayError
        Anything else; the drive has the values that it had when this began, or the message says what it has.
    """
    run_id, folder = own_run(desk.journal, run)
    record, result = desk.journal.run(run_id), folder.result()
    _check(result, run_id)
    axis = axis_of_run(record, folder, link)
    options = _options(result, limits, adopted=record.adopted)
    with connect(axis, options.cycle, desk, f"run {run_id}") as drive:
        _look(drive, axis, options, desk, record)
        settings = Settings(desk.journal, run_id, drive)
        room = choose_limits(drive, axis, options)
        with guarded(drive, axis, folder.profile_path(), run_id, desk.journal.folder) as guardian:
            recorder = Recorder(on_phase=desk.tell)
            job = Measurement(axis, options, desk, drive, room, recorder, settings, guardian)
            try:
                steps, kept = _with_steps(job, result, unproved=unproved)
            finally:
                if told := noted(guardian):
                    result.setdefault("notes", []).extend(told)
                    folder.save(result, None, None)
    unit = axis.position_unit
    result["verification"] = {
        "unit": unit,
        "kept_fraction": None if kept is None else kept.fraction,
        "steps": [step.json(kept=step is kept) for step in steps],
    }
    for item in result["compensation"]:
        item["written"] = kept is not None
        if kept is not None:
            item["new_raw"] = kept.raw[item["parameter"]]
            item["new"] = drive.scaling.to_si(
                drive.profile.parameters[item["parameter"]], item["new_raw"]
            )
    folder.save(result, None, None)
    if kept is None:
        before, last = steps[0].error, steps[-1].error
        raise WriteFailed(
            f"the compensation does not help: error after reversals {before.reversal:.3g} {unit} without, "
            f"{last.reversal:.3g} {unit} with {100 * steps[-1].fraction:g} % of the friction compensated"
            + (", and the axis hunts" if last.hunts else "")
            + (
                ". The error grows with it: is the compensation's sign right in the profile (negative_sign), "
                "and the drive's polarity?"
                if last.reversal > _WORSE * before.reversal
                else ""
            )
            + "; the values from before the run are back in the drive"
        )
    return result


def _check(result: dict[str, Any], run_id: str) -> None:
    if result["status"] != "completed" or not result["compensation"]:
        reason = (
            "it proposes no compensation"
            if result["status"] == "completed"
            else f"its status is '{result['status']}'"
        )
        raise Refused(f"run {run_id} cannot be verified: {reason}")


def _options(result: dict[str, Any], limits: dict[str, Any], *, adopted: bool) -> Options:
    """Those of the run, unless they are given anew; of an adopted run nobody here has agreed to any."""
    experiment = {} if adopted else result["experiment"] or {}
    was = experiment.get("limits") or {}
    named = {
        "travel": was.get("travel"),
        "max_speed": was.get("speed"),
        "max_torque": was.get("torque"),
        "cycle": experiment.get("cycle"),
    }
    given = {name: value for name, value in limits.items() if value is not None}
    return Options(**{**named, **given})


def provable(profile: Profile) -> None:
    """Raises PreflightRefused where the compensation cannot be seen at work by tworelay."""
    if Mode.POSITION not in profile.compensation.acts_in or Mode.POSITION not in profile.modes:
        raise PreflightRefused(
            f"profile '{profile.name}' has no position mode in which its compensation acts, so it "
            "cannot be seen at work here: watch the following error in the machine's own controller"
        )
    if profile.compensation.acts_stored:
        raise PreflightRefused(
            f"the compensation of profile '{profile.name}' acts only once it is stored, so it cannot be "
            "tried step by step: watch the following error in the machine's own controller"
        )


def _look(drive: Drive, axis: Axis, options: Options, desk: Desk, record: RunRecord) -> None:
    """Everything that is looked at before the axis may move."""
    identity = drive.identity()
    same_drive(identity, record.serial, record.id, drive.link, desk)
    none_unfinished(desk, identity.serial)
    provable(drive.profile)
    law = drive.profile.compensation
    unverified(
        drive.profile, list(law.terms.values()), constant_known=axis.torque_constant is not None
    )
    look(drive, axis)
    check_watchdog(drive, without=options.without_watchdog)
    limits = choose_limits(drive, axis, options)
    unit = axis.position_unit
    desk.agree(
        f"Axis '{axis.name}' will MOVE in position mode, slowly, up to {limits.travel:.4g} {unit} to one "
        "side of its present position, and its compensation will be WRITTEN and stored. tworelay is not a "
        "safety function: keep people clear and the emergency stop in reach.",
        axis.name,
    )
    look(drive, axis)


def _with_steps(
    job: Measurement, result: dict[str, Any], *, unproved: bool
) -> tuple[list[_Step], _Step | None]:
    """The steps in their order, and the one that stays."""
    drive, journal, run = job.drive, job.desk.journal, job.settings.run
    names = [item["parameter"] for item in result["compensation"]]
    was, had = {name: drive.read_raw(name) for name in names}, journal.memory(run)
    try:
        steps, kept = job.within_settings(lambda: _raise(job, result))
        old = {item["parameter"]: int(item["old_raw"]) for item in result["compensation"]}
        final = old if kept is None else kept.raw
        # the experiment's settings are back, and are not stored with the rest
        with job.desk.interruption.deferred():
            with job.settings.exclusive_access():
                _write(job, final)
            memory = journal.memory(run)
            if kept is not None and (final != was or memory != STORED):
                store(drive, job.desk, run, final)
            elif kept is None and memory in (STORED, STORING):
                others = [
                    intent
                    for intent in journal.intents(run, open_only=True)
                    if intent.kind != "experiment" and intent.parameter not in final
                ]
                store(drive, job.desk, run, final, STORED if others else RESTORED)
            if kept is None:
                done = [i.seq for i in journal.intents(run, open_only=True) if i.parameter in final]
                journal.settle(done, "restored")
    except BaseException as error:
        if not unproved:
            _go_back(job, was, error)
            if journal.memory(run) != had and isinstance(error, TwoRelayError):
                text = (
                    f"{error}; the drive's memory may hold what was to stay: 'tworelay restore {run}' puts "
                    "the old values back"
                )
                error.args = (text,)
        raise
    return steps, kept


def _go_back(job: Measurement, was: Raw, error: BaseException) -> None:
    """The values from before into the drive again; what cannot be done is added to `error`."""
    try:
        with job.desk.interruption.deferred(), job.settings.exclusive_access():
            _write(job, was)
    except TwoRelayError as second:
        text = (
            f"{error}; the compensation is not back as it was: {second}; 'tworelay restore "
            f"{job.settings.run}' puts the old values back"
        )
        if isinstance(error, TwoRelayError):
            error.args = (text,)


def _write(job: Measurement, raw: Raw) -> None:
    for name, value in raw.items():
        job.settings.write("compensation", name, value)


def _raise(job: Measurement, result: dict[str, Any]) -> tuple[list[_Step], _Step | None]:
    """Without, then half, then more; the last step without harm stays."""
    desk, drive, friction = job.desk, job.drive, result["friction"]
    offset = friction["offset"]["value"] or 0.0
    rest = offset if job.axis.mechanics.held_by != "friction" else 0.0
    path = path_for(job.context, friction["coulomb"]["value"], friction["inertia"]["value"])
    new = {item["parameter"]: int(item["new_raw"]) for item in result["compensation"]}
    asked = desk.journal.run(job.settings.run).context.get("fraction", job.options.fraction)
    verified = result.get("verification") or {}  # before: the run holds what stayed then
    goal = verified.get("kept_fraction") or asked
    sets = [(0.0, _share(drive, new, 0.0))]
    sets += [(part, _share(drive, new, part / goal)) for part in _STEPS if part < goal]
    sets.append((goal, new))
    steps: list[_Step] = []
    kept: _Step | None = None
    for fraction, raw in sets:
        desk.tell(
            f"{100 * fraction:g} % of the friction compensated"
            if fraction
            else "without compensation"
        )
        with desk.interruption.deferred():
            _write(job, raw)
        job.prove_watchdog(rest)
        step = _followed(job, path, fraction, raw)
        steps.append(step)
        desk.tell(_words(step, job.axis.position_unit))
        if not fraction:
            continue
        before = steps[0].error
        limit = _WORSE * (kept or steps[0]).error.reversal + _NOISE * job.context.resolution
        harm = step.error.reversal > limit
        if harm or (step.error.hunts and not before.hunts):
            break
        kept = step
    if kept is not None and kept.error.reversal >= steps[0].error.reversal:
        kept = None
    return steps, kept


def _words(step: _Step, unit: str) -> str:
    error = step.error
    return (
        f"  reversal error {error.reversal:.3g} {unit}, at low speed {error.low_speed:.3g} {unit} rms, "
        f"at rest ±{error.rest:.2g} {unit}" + (": it hunts" if error.hunts else "")
    )


def _share(drive: Drive, new: Raw, share: float) -> Raw:
    """The proposal with a share of its friction; offset and speeds stay whole."""
    terms = drive.profile.compensation.terms
    whole = {name for term, name in terms.items() if term.startswith(_WHOLE)}
    found = {}
    for name, raw in new.items():
        parameter = drive.profile.parameters[name]
        found[name] = raw if name in whole else parameter.nearest_raw(share * parameter.number(raw))
    return found


def _followed(job: Measurement, path: TrackingPath, fraction: float, raw: Raw) -> _Step:
    samples = job.follow(path)
    command, position = _columns(samples.reversals)
    reversal, left = reversal_error(command, position, TURNS)
    swing, hunts = at_rest(_columns(samples.rest)[1], job.context.resolution)
    error = TrackingError(reversal, creeping(*_columns(samples.creep)), swing, hunts)
    return _Step(fraction, raw, error, _trace(samples, command, left, job.context.start))


def _columns(samples: list[Sample]) -> tuple[Any, Any]:
    return (
        np.array([s.command for s in samples], np.float64),
        np.array([s.position for s in samples], np.float64),
    )


def _trace(
    samples: TrackingSamples, command: Any, error: Any, start: float
) -> dict[str, list[float]]:
    """Time, command and error of the reversals, thinned for a picture."""
    every = max(1, len(error) // _SHOWN)
    begin = samples.reversals[0].time
    time = [s.time - begin for s in samples.reversals]
    return {
        "time": time[::every],
        "command": [float(value) - start for value in command[::every]],
        "error": [float(value) for value in error[::every]],
    }
