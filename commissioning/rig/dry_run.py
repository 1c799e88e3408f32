"""Every write that an experiment would make, for people; nothing is written."""

from __future__ import annotations

from collections.abc import Iterator

from commissioning.rig.preflight import POSITION, TORQUE, Limits, writes
from drivers.drive import Drive
from profiles.axis import Axis
from profiles.procedures import Mode, Step

__all__ = ["would_write"]


def would_write(drive: Drive, axis: Axis, limits: Limits) -> Iterator[str]:
    """Settings, set-points, keys and objects of the bus, each with where it is.

    And what is to be compared with the drive's own display first. Raises LinkError.
    """
    yield from _to_compare(drive, axis, limits)
    yield from _law(drive)
    for name, raw in writes(drive, limits).items():
        there, what = drive.read(name).raw, drive.parameters[name]
        if there != raw:
            node = ""
            if name == drive.watchdog.parameter and drive.watchdog.kind == "heartbeat":
                node = f", that is node {raw >> 16}, {raw & 0xFFFF} ms"  # CiA 301, object 1016h
            yield (
                f"would set {name} ({what.address}): {there} → {raw} (x {what.raw_unit}{node}), "
                "and put it back"
            )
    if "speed" in drive.limits:
        yield (
            f"(the speed limit is that low until the stop path is proved; then up to "
            f"{limits.speed:.4g} {axis.position_unit}/s)"
        )
    code = drive.preparation.code_of(Mode.TORQUE)
    if code is not None:
        mode = drive.parameters["mode_of_operation"]
        yield f"would set mode_of_operation ({mode.address}) to {code}, and put it back"
    target = drive.parameters[TORQUE]
    most = target.raw(limits.torque)
    yield (
        f"would command {TORQUE} ({target.address}) in every cycle, 0 first, within ±{most} "
        f"(x {target.raw_unit}, ±{limits.torque:.4g} {axis.effort_unit})"
    )
    for act, steps in drive.preparation.procedures().items():
        if steps:
            yield f"would {act}: {_steps(drive, steps)}"
    for name, (old, new) in drive.preparation.bus().items():
        if old != new:
            yield f"would set {name} (of the bus): {old:X}h → {new:X}h, and put it back"


def _to_compare(drive: Drive, axis: Axis, limits: Limits) -> Iterator[str]:
    """What the drive says, in units that its own display has."""
    here = drive.read(POSITION)
    p, e = axis.position_unit, axis.effort_unit
    turns = here.si / axis.mechanics.travel_per_revolution
    yield (
        f"compare with the drive's own display: position {here.si:.6g} {p} ({here.raw} of "
        f"{drive.parameters[POSITION].address}, {turns:.4f} motor revolutions); rated torque "
        f"{limits.rated:.4g} {e} at the axis"
    )
    for kind, name in drive.limits.items():
        there, by = drive.read(name), drive.parameters[name]
        yield (
            f"compare: {kind.replace('_', ' ')} limit {there.si:.4g} {by.unit} ({there.raw} of "
            f"{by.address})"
        )


def _law(drive: Drive) -> Iterator[str]:
    """Where the friction compensation is, and what stands there."""
    law = drive.compensation
    for term, name in law.terms.items():
        there, by = drive.read(name), drive.parameters[name]
        yield (
            f"compare: {term} of the compensation, {name} ({by.address}, {by.parameter.title}) "
            f"reads {there.raw}, that is {there.si:.4g} {by.unit}"
        )


def _steps(drive: Drive, steps: tuple[Step, ...]) -> str:
    """What a procedure does."""
    told = []
    for step in steps:
        if step.write is not None:
            told.append(
                f"{_raw(step.raw)} to {step.write} ({drive.parameters[step.write].address})"
            )
        elif step.until is not None:
            told.append(f"until {step.until} reads {step.equals}")
    return ", ".join(told)


def _raw(value: int | None) -> str:
    """As manuals have it: 5A5Ah, and small numbers plainly."""
    number = value or 0
    return str(number) if 0 <= number < 10 else f"{number:X}h" if number > 0 else str(number)
