"""Prove that the compensation helps, where it acts.

In position mode, before and after, step by step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from commissioning.desk import Desk, Options, connect, none_unfinished, same_drive
from commissioning.ending import axis_state, close_act, cut_off
from commissioning.errors import DoesNotHelp
from commissioning.experiments.tracking import TURNS, TrackingPath, TrackingSamples, path_for
from commissioning.guardian import guarded
from commissioning.identification.tracking import TrackingError, at_rest, creeping, reversal_error
from commissioning.journal import RESTORED, STORED, RunRecord
from commissioning.result.changes import Written
from commissioning.result.document import RunResult
from commissioning.result.words import remaining
from commissioning.result.worth import Trial, Verification
from commissioning.rig.armed import noted
from commissioning.rig.expected import (
    AS_IT_IS,
    SHARES,
    STORING,
    context_of,
    of_proving,
    proving,
    proving_seconds,
    setting_of,
    to_one_side,
)
from commissioning.rig.preflight import check_watchdog, choose_limits, look
from commissioning.rig.rig import Rig
from commissioning.session.named import axis_of_run, own_run
from commissioning.session.storing import all_writable, store
from commissioning.settings import Settings
from commissioning.watching import Stage
from drivers.drive import Drive
from drivers.errors import PreflightRefused
from drivers.sample import Sample
from profiles.axis import Axis
from profiles.errors import Refused, TwoRelayError
from profiles.procedures import Mode
from profiles.schema import Profile

__all__ = ["Wishes", "follow_as_it_is", "provable", "verify"]

_HARMFUL_RISE = 1.05  # of the error before, and
_HARMFUL_COUNTS = 2.0  # counts more: from here on a step does harm
_EXPECTED_SHARE = 0.6  # of the share that is compensated, in the error that goes with it
_TRACE_POINTS = 400  # points of a trace

Raw = dict[str, int]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Step:
    """One set of values in the drive, and how the axis followed with it."""

    fraction: float  # of the friction that is compensated
    raw: Raw
    error: TrackingError
    trace: Array  # (3, n): time, command, error

    def trial(self, *, kept: bool) -> Trial:
        """For the result; rad or m."""
        error = self.error
        return Trial(self.fraction, error.reversal, error.low_speed, error.rest, error.hunts, kept)


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is to be other than in the run; None: as it was there."""

    travel: float | None = None
    max_speed: float | None = None
    cycle: float | None = None
    without_watchdog: bool = False
    max_torque: float | None = None


def verify(
    run: str, link: str | None, desk: Desk, wishes: Wishes, *, unproved: bool = False
) -> RunResult:
    """Measure without and with the compensation of `run` and leave the best in the drive.

    `unproved`: what is in the drive was written for this proof only, and whoever did so takes it
    back should this fail. Returns the result.

    Raises
    ------
    DoesNotHelp
        No step helps; the values from before the run are in the drive, and in its memory.
    TwoRelayError
        Anything else; the drive has the values that it had when this began, or the message says
        what it has.
    """
    run_id, folder = own_run(desk.journal, run)
    history = desk.journal.history(run_id)
    record, result = history.run, folder.result(history)
    _check(result, run_id, record.context.fraction)
    axis = axis_of_run(record, folder, link)
    options = _options(result, wishes, adopted=record.adopted)
    with connect(axis, options.cycle, desk, f"run {run_id}") as drive:
        _look(drive, axis, options, desk, record)
        settings = Settings(desk.journal, run_id, drive)
        room = choose_limits(drive, axis, options)
        notes: list[str] = []
        with desk.finishing():
            folder.save(cut_off(result))
            try:
                with guarded(
                    drive, axis, folder.profile_path(), run_id, desk.journal.folder
                ) as guardian:
                    recorder = desk.record()
                    rig = Rig.of(axis, options, desk, drive, room, recorder, settings, guardian)
                    try:
                        steps, kept = _with_steps(rig, result, unproved=unproved)
                    finally:
                        notes += noted(guardian)
            except TwoRelayError as error:
                result = replace(result, notes=(*result.notes, *notes))
                close_act(desk, folder, result, axis_state(drive, axis), error)
                raise
            result = replace(result, notes=(*result.notes, *notes))
            result = _proved(result, drive, steps, kept)
            doubt = _little(result.verification)
            if doubt:
                desk.tell(doubt)
                result = replace(result, notes=(*result.notes, doubt))
            useless = None if kept else _no_help(result, steps)
            curves = {f"verify.{number}": step.trace for number, step in enumerate(steps)}
            result = close_act(desk, folder, result, axis_state(drive, axis), useless, curves)
    if useless is not None:
        raise useless
    return result


def follow_as_it_is(
    run: str, link: str | None, desk: Desk, wishes: Wishes
) -> tuple[Trial, RunResult]:
    """How the axis follows with what is in the drive now, and the run; nothing is stored."""
    run_id, folder = own_run(desk.journal, run)
    history = desk.journal.history(run_id)
    record, result = history.run, folder.result(history)
    _check(result, run_id, record.context.fraction)
    axis = axis_of_run(record, folder, link)
    options = _options(result, wishes, adopted=record.adopted)
    coulomb, inertia = result.friction.coulomb, result.friction.inertia
    assert coulomb is not None
    with connect(axis, options.cycle, desk, f"run {run_id}") as drive:
        _look(drive, axis, options, desk, record, writes=False)
        settings = Settings(desk.journal, run_id, drive)
        room = choose_limits(drive, axis, options)
        with (
            desk.finishing(),
            guarded(drive, axis, folder.profile_path(), run_id, desk.journal.folder) as guardian,
        ):
            rig = Rig.of(axis, options, desk, drive, room, desk.record(), settings, guardian)
            path = path_for(rig.context, coulomb.value, inertia.value if inertia else None)
            desk.watcher.begins(setting_of(axis, drive, room), [Stage(AS_IT_IS, path.seconds)])

            def followed() -> _Step:
                desk.watcher.step(AS_IT_IS)
                rig.mover.prove_watchdog(_rest(rig, result))
                return _followed(rig, path, 0.0, {})

            step = rig.mover.within_settings(followed)
    return step.trial(kept=False), result


def _rest(rig: Rig, result: RunResult) -> float:
    """Torque that holds the axis at rest, N.m or N."""
    offset = result.friction.offset
    return offset.value if offset and rig.axis.mechanics.held_by != "friction" else 0.0


def _proved(result: RunResult, drive: Drive, steps: list[_Step], kept: _Step | None) -> RunResult:
    """The result with what was measured, and with the values that stay."""
    before = steps[0].error.reversal
    found = Verification(
        result.units.position,
        tuple(step.trial(kept=step is kept) for step in steps),
        None if kept is None else kept.fraction,
        None if kept is None else 100 * (1 - kept.error.reversal / before),
    )
    result = replace(result, verification=found)
    if kept is None:
        return replace(result, written=())
    stays = []
    for change in result.compensation:
        raw = kept.raw[change.parameter]
        if raw != change.new_raw:
            value = drive.parameters[change.parameter].si(raw)
            why = f"{100 * kept.fraction:g} % of the friction: the most that helped"
            change = replace(change, new_raw=raw, new=value, rounded_by=0.0, why=why)  # noqa: PLW2901
        stays.append(change)
    written = (
        Written(c.parameter, "compensation", c.new_raw, c.new, c.unit)
        for c in stays
        if c.old_raw != c.new_raw
    )
    others = (one for one in result.written if one.kind == "gain")
    return replace(
        result,
        compensation=tuple(stays),
        written=(*others, *written),
        status="completed",
        error=None,
    )


def _little(found: Verification | None) -> str:
    """What to look at where it helps, and less than that much compensation should; ''."""
    if found is None or found.kept_fraction is None or found.percent is None:
        return ""
    if found.percent >= 100 * _EXPECTED_SHARE * found.kept_fraction:
        return ""
    return (
        f"{found.percent:.0f} % less error is little for {100 * found.kept_fraction:g} % of the "
        "friction: does each term of [compensation] stand at its own address, in its unit, and for "
        "both directions?"
    )


def _no_help(result: RunResult, steps: list[_Step]) -> DoesNotHelp:
    before, last, unit = steps[0].error, steps[-1].error, result.units.position
    return DoesNotHelp(
        f"the compensation does not help: error after reversals {before.reversal:.3g} {unit} "
        f"without, {last.reversal:.3g} {unit} with {100 * steps[-1].fraction:g} % of the friction "
        "compensated"
        + (", and the axis hunts" if last.hunts else "")
        + (
            ". The error grows with it: is the compensation's sign right in the profile "
            "(negative_sign), and the drive's polarity?"
            if last.reversal > _HARMFUL_RISE * before.reversal
            else ""
        )
        + "; the values from before the run are back in the drive"
    )


def _check(result: RunResult, run_id: str, fraction: float | None) -> None:
    coulomb = result.friction.coulomb
    if result.measured and coulomb is not None and not coulomb.value > 0:
        raise Refused(
            f"run {run_id} cannot be verified: its friction is {coulomb.value:.3g}",
            code="verify.no-friction",
        )
    changes = result.compensation
    if fraction == 0:
        raise Refused(
            f"run {run_id} cannot be verified: it compensates 0 % of the friction",
            code="verify.no-proposal",
        )
    if not result.measured or not changes:
        reason = (
            "it proposes no compensation" if result.measured else f"its status is '{result.status}'"
        )
        raise Refused(
            f"run {run_id} cannot be verified: {reason}",
            code="verify.no-proposal",
            hint="'tworelay history' lists the runs",
        )


def _options(result: RunResult, wishes: Wishes, *, adopted: bool) -> Options:
    """Options of the run, unless they are given anew.

    Of an adopted run nobody here has agreed to any.
    """
    was = None if adopted else result.experiment
    limits = was.limits if was else None
    return Options(
        travel=wishes.travel or (limits.travel if limits else None),
        max_speed=wishes.max_speed or (limits.speed if limits else None),
        max_torque=wishes.max_torque or (limits.torque if limits else None),
        cycle=wishes.cycle or (was.cycle if was else None),
        without_watchdog=wishes.without_watchdog,
    )


def provable(profile: Profile) -> None:
    """Raises PreflightRefused where the compensation cannot be seen at work by tworelay."""
    if Mode.POSITION not in profile.compensation.acts_in or Mode.POSITION not in profile.modes:
        raise PreflightRefused(
            f"profile '{profile.name}' has no position mode in which its compensation acts, so it "
            "cannot be seen at work here: watch the following error in the machine's own "
            "controller",
            code="verify.no-position-mode",
        )
    if profile.compensation.acts_stored:
        raise PreflightRefused(
            f"the compensation of profile '{profile.name}' acts only once it is stored, so it "
            "cannot be tried step by step: watch the following error in the machine's own "
            "controller",
            code="verify.acts-stored",
        )


def _look(
    drive: Drive,
    axis: Axis,
    options: Options,
    desk: Desk,
    record: RunRecord,
    *,
    writes: bool = True,
) -> None:
    """Everything that is looked at before the axis may move."""
    identity = drive.identity()
    same_drive(identity, record.serial, record.id, drive.link, desk)
    none_unfinished(desk, identity.serial, drive.link)
    provable(drive.profile)
    if writes:
        all_writable(drive, list(drive.compensation.terms.values()))
    look(drive, axis)
    check_watchdog(drive, without=options.without_watchdog)
    limits = choose_limits(drive, axis, options)
    unit = axis.position_unit
    seconds = proving_seconds(context_of(axis, drive, limits), options, drive)
    whole = sum(stage.seconds for stage in of_proving(options.fraction, seconds))
    names = ", ".join(drive.compensation.written)
    then = f"; WRITE its compensation ({names}), and STORE what helps" if writes else ""
    desk.agree(
        f"This will MOVE axis '{axis.name}' in position mode, slowly, {to_one_side(limits):.3g} "
        f"{unit} to one side of its present position and back, for about "
        f"{remaining(whole if writes else seconds)}{then}. tworelay is not a safety function: keep "
        "people clear and the emergency stop in reach.",
        axis.name,
    )
    look(drive, axis)


def _with_steps(rig: Rig, result: RunResult, *, unproved: bool) -> tuple[list[_Step], _Step | None]:
    """The steps in their order, and the one that stays."""
    drive, journal, run = rig.drive, rig.desk.journal, rig.settings.run
    names = [change.parameter for change in result.compensation]
    was, had = {name: drive.read(name).raw for name in names}, journal.memory(run)
    try:
        steps, kept = rig.mover.within_settings(lambda: _raise(rig, result))
        final = _before(rig, names, was) if kept is None else kept.raw
        rig.desk.watcher.step(STORING)
        rig.desk.interruption.check()  # the last moment at which nothing is decided yet
        # the experiment's settings are back, and are not stored with the rest
        with rig.desk.interruption.deferred():
            with rig.settings.exclusive_access():
                _write(rig, final)
            if not journal.history(run).has_stored(final):
                others = [
                    intent
                    for intent in journal.intents(run, open_only=True)
                    if intent.lasts and intent.parameter not in final
                ]
                lasts = kept is not None or bool(others)
                store(drive, rig.desk, run, final, STORED if lasts else RESTORED)
            if kept is None:
                done = [i.seq for i in journal.intents(run, open_only=True) if i.parameter in final]
                journal.settle(done, "restored")
            else:
                _nothing_to_undo(rig, final)
    except BaseException as error:
        if not unproved:
            _go_back(rig, was, error)
            if journal.memory(run) != had and isinstance(error, TwoRelayError):
                error.also(
                    f"the drive's memory may hold what was to stay: 'tworelay restore {run}' puts "
                    "the old values back"
                )
        raise
    return steps, kept


def _nothing_to_undo(rig: Rig, final: Raw) -> None:
    """What the drive had before the run as well needs no way back."""
    intents = rig.desk.journal.intents(rig.settings.run, open_only=True)
    for name, raw in final.items():
        of_it = [intent for intent in intents if intent.parameter == name]
        if of_it and of_it[0].old == raw:
            rig.desk.journal.settle([intent.seq for intent in of_it], "restored")


def _go_back(rig: Rig, was: Raw, error: BaseException) -> None:
    """The values from before into the drive again; what cannot be done is added to `error`."""
    try:
        with rig.desk.interruption.deferred(), rig.settings.exclusive_access():
            _write(rig, was)
    except TwoRelayError as second:
        if isinstance(error, TwoRelayError):
            error.also(
                f"the compensation is not back as it was: {second}; 'tworelay restore "
                f"{rig.settings.run}' puts the old values back"
            )


def _write(rig: Rig, raw: Raw) -> None:
    for name, value in raw.items():
        rig.settings.write("compensation", name, value)


def _before(rig: Rig, names: list[str], was: Raw) -> Raw:
    """The values from before the run.

    The oldest that it has written over, else those that stood there.
    """
    oldest: Raw = {}
    for intent in rig.desk.journal.intents(rig.settings.run, open_only=True):
        oldest.setdefault(intent.parameter, intent.old)
    return {name: oldest.get(name, was[name]) for name in names}


def _raise(rig: Rig, result: RunResult) -> tuple[list[_Step], _Step | None]:
    """Without, then half, then more; the last step without harm stays."""
    desk, drive, found = rig.desk, rig.drive, result.friction
    assert found.coulomb is not None
    rest = _rest(rig, result)
    inertia = found.inertia.value if found.inertia else None
    path = path_for(rig.context, found.coulomb.value, inertia)
    new = {change.parameter: change.new_raw for change in result.compensation}
    of_run = desk.journal.run(rig.settings.run).context.fraction
    asked = rig.options.fraction if of_run is None else of_run
    verified = result.verification  # before: the run holds what stayed then
    goal = (verified.kept_fraction if verified else None) or asked
    sets = [(0.0, _share(drive, new, 0.0))]
    sets += [(part, _share(drive, new, part / goal)) for part in SHARES if part < goal]
    sets.append((goal, new))
    seconds = proving_seconds(rig.context, rig.options, drive, found.coulomb.value, inertia)
    desk.watcher.begins(setting_of(rig.axis, drive, rig.limits), of_proving(goal, seconds))
    steps: list[_Step] = []
    kept: _Step | None = None
    for fraction, raw in sets:
        desk.watcher.step(proving(fraction))
        with desk.interruption.deferred():
            _write(rig, raw)
        rig.mover.prove_watchdog(rest)
        desk.watcher.lasts(path.seconds)
        step = _followed(rig, path, fraction, raw)
        steps.append(step)
        desk.watcher.phase(_words(step, rig.axis.position_unit))
        if not fraction:
            continue
        before = steps[0].error
        limit = (
            _HARMFUL_RISE * (kept or steps[0]).error.reversal
            + _HARMFUL_COUNTS * rig.context.resolution
        )
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
        f"  reversal error {error.reversal:.3g} {unit}, at low speed {error.low_speed:.3g} {unit} "
        "rms, "
        f"at rest ±{error.rest:.2g} {unit}" + (": it hunts" if error.hunts else "")
    )


def _share(drive: Drive, new: Raw, share: float) -> Raw:
    """The proposal with a share of its friction; offset and speeds stay whole."""
    friction = drive.compensation.friction
    return {
        name: drive.parameters[name].share(raw, share) if name in friction else raw
        for name, raw in new.items()
    }


def _followed(rig: Rig, path: TrackingPath, fraction: float, raw: Raw) -> _Step:
    samples = rig.follow(path)
    command, position = _columns(samples.reversals)
    reversal, left = reversal_error(command, position, TURNS)
    swing, hunts = at_rest(_columns(samples.rest)[1], rig.context.resolution)
    error = TrackingError(reversal, creeping(*_columns(samples.creep)), swing, hunts)
    return _Step(fraction, raw, error, _trace(samples, command, left, rig.context.start))


def _columns(samples: list[Sample]) -> tuple[Array, Array]:
    return (
        np.array([s.command for s in samples], np.float64),
        np.array([s.position for s in samples], np.float64),
    )


def _trace(samples: TrackingSamples, command: Array, error: Array, start: float) -> Array:
    """Time, command and error of the reversals, thinned for a picture, (3, n)."""
    every = max(1, len(error) // _TRACE_POINTS)
    time = np.array([s.time for s in samples.reversals], np.float64)
    return np.stack((time - time[0], command - start, error))[:, ::every]
