"""Before energy: is the drive fit to be moved, and which limits hold (safety 1–6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

from commissioning.desk import Options
from commissioning.interruption import Interruption
from commissioning.runner import verified
from commissioning.settings import Settings
from drivers.drive import Drive
from drivers.errors import (
    AccessDenied,
    DriveEnabled,
    DriveFault,
    LinkError,
    PreflightRefused,
    WriteDenied,
)
from profiles.axis import Axis
from profiles.errors import UsageError
from profiles.procedures import Mode

__all__ = [
    "CYCLES_A_WATCHDOG",
    "Limits",
    "cautious_speed",
    "check_watchdog",
    "choose_limits",
    "look",
    "prove_watchdog",
    "set_limits",
    "still_moving",
    "writes",
]

POSITION, TORQUE = "position_actual", "torque_target"  # as every profile names them

_AT_REST_COUNTS = 3
_LOOK_INTERVAL, _TIME_TO_REST = 0.05, 1.0  # s; it may still settle from what was before
CYCLES_A_WATCHDOG = 3
_FEWEST_COUNTS = 500  # of travel
SILENCE = 3  # of the watchdog's time-out, in its proof
_PROOF_CYCLES = 5
_LARGEST_MOVE_IN_PROOF = 0.05  # of the travel, in the proof
_DRIVE_SPEED = 1.2  # of our limit: what the drive is told
_LONGEST_DEAD_TIME, _CYCLES_TO_STOP, _CYCLES_TO_STOP_KNOWN = 0.03, 6, 3  # s, cycles


@dataclass(frozen=True, slots=True)
class Limits:
    """What holds in this run, SI at the axis.

    Attributes
    ----------
    start : position at the beginning, rad or m
    travel, torque, speed : rad or m, N.m or N, rad/s or m/s
    rated : rated torque at the axis, N.m or N
    duration : s, of the whole experiment
    """

    start: float
    travel: float
    torque: float
    speed: float
    rated: float
    duration: float


def look(drive: Drive, axis: Axis) -> None:
    """Read-only checks; raises PreflightRefused, Refused."""
    if drive.state().in_fault:
        raise PreflightRefused(
            f"the drive is in fault: {drive.state().text}",
            code="preflight.fault",
            hint="remove the cause and reset it, then try again",
        )
    if drive.state().is_energised:
        raise DriveEnabled(
            "the drive is already enabled, so somebody else controls it (or a dead process left "
            "it so: 'tworelay stop' makes it safe)"
        )
    watchdog = drive.watchdog
    if watchdog.kind != "none" and drive.cycle > watchdog.timeout / CYCLES_A_WATCHDOG:
        raise PreflightRefused(
            f"a cycle of {drive.cycle * 1000:g} ms is too slow for the drive's watchdog of "
            f"{watchdog.timeout * 1000:g} ms, which needs {CYCLES_A_WATCHDOG} cycles",
            code="preflight.cycle",
            value=drive.cycle,
            limit=watchdog.timeout / CYCLES_A_WATCHDOG,
            unit="s",
            hint=f"give a --cycle of {watchdog.timeout / CYCLES_A_WATCHDOG:.3g} s or less",
        )
    other = drive.line.other_master()
    if other:
        raise PreflightRefused(
            f"another master is on the bus ({other} was heard): two masters move an axis against "
            "each other",
            code="preflight.master",
            hint="disconnect it or stop its program (if it only produces SYNC: sync=bus in the "
            "link)",
        )
    drive.preparation.check_requirements()
    drive.preparation.settings(Mode.TORQUE)  # refuses a drive without torque mode
    law, there = drive.compensation, _compensation(drive)
    if Mode.TORQUE in law.acts_in:
        active = [name for name, raw in there.items() if raw != 0]
        if active:
            raise PreflightRefused(
                f"this drive's compensation acts in torque mode too, and {', '.join(active)} is "
                "not zero: the friction would be measured less what is compensated",
                code="preflight.compensation",
                hint="set it to zero first",
            )
    moved = still_moving(drive)
    if moved:
        raise PreflightRefused(
            f"the axis moves by itself: {moved:.3g} {axis.position_unit} in {_LOOK_INTERVAL:g} s",
            code="preflight.not-at-rest",
            hint="bring it to rest first",
        )


def _compensation(drive: Drive) -> dict[str, int]:
    """What the terms of the drive's law read; raises PreflightRefused where one cannot be read.

    After the motion would be too late to learn that an address is wrong.
    """
    found = {}
    for name in drive.compensation.terms.values():
        try:
            found[name] = drive.read(name).raw
        except AccessDenied as denied:
            if denied.busy:
                raise
            raise PreflightRefused(
                f"the drive does not have its compensation where its profile says: {denied}",
                code="preflight.compensation-address",
                hint=f"look '{name}' up in its manual; nothing was moved",
                parameter=name,
            ) from None
    return found


def still_moving(drive: Drive, patience: float = _TIME_TO_REST) -> float:
    """How far the axis moves by itself in a moment, rad or m; 0 as soon as it is at rest.

    `patience` : s until it has to be
    """
    step = _count(drive)
    for _ in range(ceil(patience / _LOOK_INTERVAL)):
        before = drive.read("position_actual").si
        drive.wait(_LOOK_INTERVAL)
        moved = abs(drive.read("position_actual").si - before)
        if moved <= _AT_REST_COUNTS * step:
            return 0.0
    return moved


def _count(drive: Drive) -> float:
    """Position of one encoder count, rad or m."""
    return abs(drive.parameters[POSITION].step)


def choose_limits(drive: Drive, axis: Axis, options: Options) -> Limits:
    """Travel, torque and speed of this run: the user's, else the axis', else the drive's.

    Raises UsageError, PreflightRefused, LinkError.
    """
    travel = _travel(drive, axis, options)
    rated = drive.scaling.rated_torque * axis.mechanics.effort_per_torque
    torque = _torque(drive, axis, options, rated)
    speed = _speed(drive, axis, options)
    drive.preparation.check_set_points(Mode.TORQUE, torque)
    start = drive.read(POSITION).si
    _between_ends(axis, start, travel)
    duration = options.duration or axis.limits.duration
    return Limits(start, travel, torque, speed, rated, duration)


def _travel(drive: Drive, axis: Axis, options: Options) -> float:
    """Room on either side, rad or m."""
    travel = options.travel or axis.travel
    if travel is None:
        raise UsageError(
            f"how far may the axis move? Give --travel ±X in {axis.position_unit} about the "
            "present position, or an axis file with travel"
        )
    count = _count(drive)
    if travel < _FEWEST_COUNTS * count:
        raise PreflightRefused(
            f"the travel of ±{travel:.4g} {axis.position_unit} is too small: it is "
            f"{travel / count:.0f} encoder counts, and a measurement needs {_FEWEST_COUNTS}",
            code="preflight.travel",
            value=travel,
            limit=_FEWEST_COUNTS * count,
            unit=axis.position_unit,
            hint=f"give more --travel; or is the position's scale wrong (now "
            f"{axis.mechanics.travel_per_revolution / count:.6g} counts a motor revolution: the "
            "drive's encoder resolution, its word_order in the profile)?",
        )
    return travel


def _between_ends(axis: Axis, start: float, travel: float) -> None:
    """Raise PreflightRefused where the axis could leave its travel."""
    if axis.limits.ends is None:
        return
    low, high = axis.limits.ends
    room, unit = min(start - low, high - start), axis.position_unit
    if travel > room:
        where = "outside of" if room < 0 else f"{room:.4g} {unit} from"
        raise PreflightRefused(
            f"the axis stands at {start:.4g} {unit}, {where} the ends of its travel "
            f"({low:g}…{high:g} {unit}), and may move ±{travel:.4g} {unit}",
            code="preflight.ends",
            value=travel,
            limit=max(room, 0.0),
            unit=unit,
            hint="move it towards the middle, or give less --travel",
        )


def _torque(drive: Drive, axis: Axis, options: Options, rated: float) -> float:
    """Largest torque, N.m or N."""
    by_torque, by_current = _lowest(drive, "torque"), drive.limits.get("current")
    e, asked = axis.effort_unit, options.max_torque or axis.limits.torque
    most = abs(drive.read(by_torque).si) if by_torque else rated
    if most <= 0:
        if asked is None:
            raise PreflightRefused(
                f"the drive's own torque limit ('{by_torque}') reads {most:g} {e}, which is no "
                f"limit, or no torque: set it in the drive, or give --max-torque in {e}, which is "
                "set for the experiment",
                code="preflight.torque-limit",
            )
        most = asked
    by = drive.parameters[by_torque].address if by_torque else "rated torque"
    if by_current and 0 < (current := drive.read(by_current).si) < most:
        most, by = current, drive.parameters[by_current].address
    torque = asked or min(rated, most)
    if torque > most * (1 + 1e-9):
        raise PreflightRefused(
            f"max torque of {torque:.4g} {e} is above the drive's own limit of {most:.4g} {e} "
            f"({by})",
            code="preflight.torque",
            hint="ask for less, or raise that limit in the drive",
            value=torque,
            limit=most,
            unit=e,
        )
    return torque


def _lowest(drive: Drive, kind: str) -> str | None:
    """Parameter of the lower one of a limit's directions; None: the drive has no such limit."""
    found = {name: abs(drive.read(name).si) for name in _both_ways(drive, kind)}
    # 0 is no limit, and is told where there is no other
    return min(found, key=lambda name: found[name] or float("inf"), default=None)


def _speed(drive: Drive, axis: Axis, options: Options) -> float:
    """Largest speed, rad/s or m/s."""
    by_speed = _lowest(drive, "speed")
    fastest = abs(drive.read(by_speed).si) if by_speed else None
    speed = options.max_speed or axis.limits.speed or fastest
    if not speed:
        has = (
            "The drive has no speed limit"
            if by_speed is None
            else f"The drive's speed limit ({drive.parameters[by_speed].address}) reads 0"
        )
        raise UsageError(
            f"how fast may the axis move? {has}: give --max-speed in {axis.position_unit}/s"
        )
    return min(speed, fastest) if fastest else speed


def writes(drive: Drive, limits: Limits) -> dict[str, int]:
    """Raw value of every parameter that is set for the experiment and put back after it."""
    # first what keeps the drive from moving and from storing; it is put back last
    found = drive.preparation.settings(Mode.TORQUE)
    for kind, value in (
        ("torque", limits.torque),
        ("speed", _DRIVE_SPEED * cautious_speed(drive, limits)),
    ):
        for name in _both_ways(drive, kind):
            found[name] = _limited(drive, name, value, drive.read(name).raw)
    found |= drive.preparation.watchdog()
    return found


def _both_ways(drive: Drive, kind: str) -> list[str]:
    """Parameters of one of the drive's limits: one, one of each direction, or none."""
    named = (drive.limits.get(key) for key in (kind, f"{kind}_negative"))
    return [name for name in named if name is not None]


def _limited(drive: Drive, name: str, value: float, most: int) -> int:
    """Raw value of a limit (SI), within `most`, which is what the drive had; 0: it had none.

    A limit of the negative direction may be counted below zero: as what is there is, or its range.
    """
    what = drive.parameters[name]
    there = what.si(most)
    highest = max(bound * what.step for bound in what.parameter.range)
    sign = -1.0 if there < 0 or (there == 0 and highest <= 0) else 1.0
    limit = sign * (min(value, abs(there)) if there else value)
    raw = what.raw(limit)
    return raw or (1 if limit * what.step > 0 else -1)  # 0 would be none


def cautious_speed(drive: Drive, limits: Limits, dead_time: float | None = None) -> float:
    """Speed until the stop path is proved, rad/s or m/s.

    Half the travel for as long as a stop may take.

    `dead_time` : s, once it has been seen
    """
    cycles = _CYCLES_TO_STOP if dead_time is None else _CYCLES_TO_STOP_KNOWN
    slowest = _LONGEST_DEAD_TIME if dead_time is None else dead_time
    return min(limits.speed, 0.5 * limits.travel / (slowest + cycles * drive.cycle))


def widen_speed(drive: Drive, settings: Settings, speed: float) -> None:
    """The drive may let the axis go faster than before, as fast as `speed` (rad/s or m/s) says."""
    for name in _both_ways(drive, "speed"):
        limit = _limited(drive, name, _DRIVE_SPEED * speed, settings.oldest(name))
        settings.write("experiment", name, limit)


def set_limits(
    drive: Drive, settings: Settings, limits: Limits, tell: Callable[[str], None]
) -> None:
    """Write the drive-side limits and arm the watchdog.

    Refused when the drive does not take them.
    """
    for name, raw in writes(drive, limits).items():
        try:
            settings.write("experiment", name, raw)
        except WriteDenied as denied:
            if denied.busy or name not in drive.preparation.dispensable:
                raise
            tell(f"{denied}: it stays at {drive.read(name).raw}, and the job goes on without")
    for name in drive.preparation.set_points():
        settings.remember(name)
    settings.remember_power()
    settings.remember_bus()
    for code in drive.preparation.mode_codes():
        settings.write("experiment", "mode_of_operation", code)
    if drive.state().is_energised:
        verified(drive.stop(), None)
        raise PreflightRefused(
            "the drive became enabled while it was prepared, before any command: what enables it? "
            "Look at its inputs and at [[modes.torque]] before in the profile",
            code="preflight.enabled-itself",
        )


def check_watchdog(drive: Drive, *, without: bool) -> None:
    """Refuse a drive that would not notice a dead link, unless the user has said `without`."""
    if drive.watchdog.kind == "none" and not without:
        raise PreflightRefused(
            f"{drive.profile} has no drive-side watchdog for this drive and link, so a dead cable "
            "would leave the torque on; --without-watchdog takes that risk, with the emergency "
            "stop in your hand",
            code="preflight.no-watchdog",
        )


def prove_watchdog(
    drive: Drive,
    rest: float,
    travel: float,
    interruption: Interruption,
    tell: Callable[[str], None],
    *,
    without: bool,
    before: str | None = None,
) -> str:
    """Enable with the rest torque, fall silent; see the drive stop, and the axis stay.

    Returns the fault with which it stopped, '' without a watchdog. `before`: that of an earlier
    proof; another one stays in the drive, and is a DriveFault: it was not the watchdog. Raises
    PreflightRefused when drive or axis does otherwise, or when the drive has no watchdog and
    `without` is not set.
    """
    watchdog = drive.watchdog
    check_watchdog(drive, without=without)
    if without:
        tell(
            "no watchdog of the drive is proved: if the cable fails, nothing stops the axis"
            " (the guardian process stops it should this program fail)"
        )
        return ""
    with interruption.deferred():
        try:
            begin = drive.read("position_actual").si
            drive.enable(Mode.TORQUE, rest)
            for _ in range(_PROOF_CYCLES):
                if not drive.exchange(rest).status.enabled:
                    raise DriveFault(
                        f"the drive stopped before the proof of its watchdog: {drive.state().text}",
                        code="watchdog.stopped-before",
                    )
            drive.wait(SILENCE * watchdog.timeout)
            energised = drive.state().is_energised
            if energised:  # a brake takes its time
                drive.wait(drive.stop_time)
                energised = drive.state().is_energised
        except BaseException as error:
            verified(drive.stop(interruption.hurried), error)
            raise
        if energised:
            verified(drive.stop(interruption.hurried), None)
            raise PreflightRefused(
                f"the drive did not stop after {1000 * SILENCE * watchdog.timeout:.0f} ms of "
                "silence: "
                f"its watchdog ('{watchdog.parameter}') is not proved, so nothing is moved. (A "
                "served drive that steps needs clock=step in its link.)",
                code="watchdog.not-proved",
            )
        found = _what_stopped_it(drive, before, tell)
        moved = drive.read("position_actual").si - begin
        if abs(moved) > _LARGEST_MOVE_IN_PROOF * travel:
            raise PreflightRefused(
                f"the axis, or its encoder, moved by {moved:+.3g} (of ±{travel:.4g} that are "
                "allowed) while the watchdog was proved with the torque that holds it: find out "
                "why first",
                code="watchdog.moved",
                value=moved,
                limit=_LARGEST_MOVE_IN_PROOF * travel,
            )
    return found


def _what_stopped_it(drive: Drive, before: str | None, tell: Callable[[str], None]) -> str:
    """The fault with which the drive stopped in the proof, acknowledged; raises DriveFault."""
    said = drive.state()
    if said.code is None:
        raise LinkError(
            "the drive does not tell its error code: what stopped it in the proof of its "
            "watchdog is not known",
            code="watchdog.not-told",
            hint="try again",
        )
    if before is not None and said.fault != before:
        raise DriveFault(
            f"while its watchdog was proved the drive stopped with '{said.fault}', and with "
            f"'{before}' in an earlier proof: something else has stopped it",
            code="watchdog.another-fault",
            hint="look the code up in its manual, remove the cause, then try again",
        )
    if before is None:  # before a reset makes the drive forget it
        tell(f"the drive noticed it, by itself: {said.text}")
        if said.stranger:
            tell(
                f"that is no error of communication ({said.stranger}): was it its watchdog that "
                "stopped the drive, or something else at the same time?"
            )
    if said.in_fault:
        drive.reset_fault()
    return said.fault
