"""The steps of a job by name, and how long each takes, as far as that is known before it moves."""

from __future__ import annotations

from math import inf

from commissioning.desk import Options
from commissioning.experiments.plan import Context
from commissioning.experiments.tracking import SWING, path_for
from commissioning.result.readings import MethodName
from commissioning.rig.preflight import POSITION, SILENCE, TORQUE, Limits
from commissioning.watching import Setting, Stage
from drivers.drive import Drive
from profiles.axis import Axis

__all__ = [
    "AS_IT_IS",
    "AT_REST",
    "FIRST_MOTIONS",
    "POINTS",
    "SHARES",
    "STOP_PATH",
    "STORING",
    "WRITING",
    "context_of",
    "lasting",
    "of_commissioning",
    "of_measuring",
    "of_proving",
    "oscillating",
    "proving",
    "proving_seconds",
    "setting_of",
    "to_one_side",
]

AT_REST, FIRST_MOTIONS = "watchdog and rest", "first motions"
STOP_PATH, POINTS = "proof of the stop path", "points"
WRITING, STORING = "writing", "storing"
AS_IT_IS = "as it is"

# s, as they took on the virtual axes and on those of the recordings
_AT_REST, _FIRST_MOTIONS, _STOP_PATH, _POINTS = 1.0, 2.5, 0.6, 8.0
_OSCILLATING: dict[str, float] = {
    MethodName.AUTO: 4.0, MethodName.OUTPUT_ERROR: 4.0, MethodName.MODULATING: 4.0,
    MethodName.LOCK_IN: 8.0, MethodName.PHASE_LOCKED: 15.0,
}  # fmt: skip
_LONG = 60.0  # of the thesis' methods
_WRITING, _STORING, _BETWEEN = 0.3, 0.3, 0.3
SHARES = 0.5, 0.7  # of the friction that are tried before what is asked for


def oscillating(number: int, of: int) -> str:
    """Name of the step that measures."""
    return "oscillations" if of == 1 else f"oscillations {number} of {of}"


def proving(fraction: float) -> str:
    """Name of the step that proves so much of the compensation."""
    return f"proof with {100 * fraction:g} %" if fraction else "proof without compensation"


def of_measuring(options: Options, drive: Drive) -> list[Stage]:
    """Steps of the measurement."""
    silence = _silence(options, drive)
    steps = [
        Stage(AT_REST, _AT_REST + silence),
        Stage(FIRST_MOTIONS, _FIRST_MOTIONS + silence),
        Stage(STOP_PATH, _STOP_PATH + silence),
    ]
    seconds = _OSCILLATING.get(options.method, _LONG)
    count = options.repeat
    steps += [Stage(oscillating(number, count), seconds) for number in range(1, count + 1)]
    if options.points:
        steps.append(Stage(POINTS, _POINTS))
    return steps


def of_proving(fraction: float, seconds: float) -> list[Stage]:
    """Steps of a proof, of `seconds` each."""
    parts = [0.0, *(part for part in SHARES if part < fraction), fraction]
    return [*(Stage(proving(part), seconds) for part in parts), Stage(STORING, _STORING)]


def of_commissioning(
    options: Options, axis: Axis, drive: Drive, limits: Limits
) -> tuple[list[Stage], list[Stage]]:
    """Steps of the measurement, and of what comes after it where what is found is written."""
    measuring = of_measuring(options, drive)
    if not options.writes:
        return measuring, []
    seconds = proving_seconds(context_of(axis, drive, limits), options, drive)
    return measuring, [Stage(WRITING, _WRITING), *of_proving(options.fraction, seconds)]


def proving_seconds(
    context: Context,
    options: Options,
    drive: Drive,
    coulomb: float = inf,
    inertia: float | None = None,
) -> float:
    """Time of one step of the proof, s; without friction and inertia as for a light axis."""
    return path_for(context, coulomb, inertia).seconds + _silence(options, drive) + _BETWEEN


def to_one_side(limits: Limits) -> float:
    """How far a proof moves the axis, rad or m."""
    return SWING * limits.travel


def _silence(options: Options, drive: Drive) -> float:
    """Time of a proof of the watchdog, s."""
    return 0.0 if options.without_watchdog else SILENCE * drive.watchdog.timeout


def lasting(periods: float, period: float) -> float:
    """Time of so many periods of an oscillation, with the way there, s."""
    return _BETWEEN + (periods + 2) * period


def setting_of(axis: Axis, drive: Drive, limits: Limits) -> Setting:
    """What moves, for those who look on."""
    return Setting(
        axis.name, drive.link, limits.start, limits.travel, limits.torque, limits.speed,
        axis.position_unit, axis.effort_unit, drive.cycle, drive.in_real_time,
    )  # fmt: skip


def context_of(axis: Axis, drive: Drive, limits: Limits) -> Context:
    """What every experiment needs to know of an axis; it tells nobody anything."""
    return Context(
        cycle=drive.cycle,
        resolution=abs(drive.parameters[POSITION].step),
        start=limits.start,
        travel=limits.travel,
        torque=limits.torque,
        speed=limits.speed,
        torque_resolution=drive.parameters[TORQUE].step,
        position_unit=axis.position_unit,
        effort_unit=axis.effort_unit,
    )
