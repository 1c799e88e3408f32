"""Results in words and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from commissioning.cli.terminal import Screen
from commissioning.identification.reasons import Weight
from commissioning.result.words import (
    LOOP_TITLES,
    POINT_LABELS,
    QUANTITY_LABELS,
    VERDICTS,
    act_ended,
    counted,
    distorted,
    duration,
    found_as,
    gains_text,
    helps,
    interval,
    nothing_proposed,
    number,
    repeated,
    si,
    tone,
    unit,
    why_not,
)

if TYPE_CHECKING:
    from commissioning.result.changes import Change
    from commissioning.result.document import RunResult
    from commissioning.result.worth import GainSet
    from commissioning.session.adopt import Adopted
    from commissioning.settings import Return
    from drivers.drive import Drive
    from profiles.axis import Axis

__all__ = [
    "adopted", "ending", "found", "going_back", "in_the_drive", "outcome", "proposal", "summary",
    "verification",
]  # fmt: skip


_MOST_REASONS = 4
_WEIGHTS = (Weight.CONTRADICTION, Weight.DOUBT, Weight.NOTE)
_COLOURS = {"good": "green", "doubt": "yellow", "bad": "red"}
_VERDICT_COLOURS = {"good": "green", "usable": "yellow", "curve-only": "yellow", "rejected": "red"}


def found(result: RunResult, screen: Screen) -> None:
    """Verdict and friction: the number that matters."""
    quality, friction = result.quality, result.friction.coulomb
    text = VERDICTS[quality.verdict]
    if friction is not None:
        there = counted(friction)
        text += f": Coulomb friction {found_as(friction)}" + (f", {there}" if there else "")
    screen.say(text, _VERDICT_COLOURS.get(quality.verdict or ""))


def summary(result: RunResult, screen: Screen) -> None:
    """What was found; with its theory where that is asked for."""
    if screen.verbose:
        _in_full(result, screen)
        return
    found(result, screen)
    for keys in (("offset", "viscous"), ("inertia", "dead_time")):
        told = [
            f"{QUANTITY_LABELS[key]} {found_as(quantity)}"
            for key in keys
            if (quantity := result.friction.quantity(key)) is not None
        ]
        if told:
            screen.say(f"  {', '.join(told)}")
    if result.experiment is not None and result.experiment.spread is not None:
        coulomb = result.friction.coulomb
        if coulomb is not None:
            screen.say(f"  {repeated(result.experiment, coulomb)}")
    if wrong := distorted(result):
        screen.say(f"  {wrong}")
    reasons = sorted(result.quality.reasons, key=lambda reason: _WEIGHTS.index(reason.weight))
    for reason in reasons[:_MOST_REASONS]:
        screen.say(f"  {reason.text}")
    if more := len(reasons[_MOST_REASONS:]):
        screen.say(f"  and {more} more: -v")


def _in_full(result: RunResult, screen: Screen) -> None:
    found = result.friction
    rows = [
        [name, si(q.value, q.unit), interval(q.low, q.high), counted(q)]
        for key, name in QUANTITY_LABELS.items()
        if (q := getattr(found, key)) is not None
    ]
    screen.table(f"found by {found.method}", ["", "value", "interval", "drive's unit"], rows)
    f, offset = found.coulomb, found.offset
    if f is not None and offset is not None:
        up, down = offset.value + f.value, offset.value - f.value
        screen.say(
            f"torque that overcomes friction and offset: {up:+.4g} {unit(f.unit)} one way, "
            f"{down:+.4g} {unit(f.unit)} the other"
        )
    if result.experiment is not None and result.experiment.spread is not None and f is not None:
        screen.say(repeated(result.experiment, f))
    points(result, screen)
    quality, watched = result.quality, result.experiment
    if watched is not None:
        screen.say(
            f"{VERDICTS[quality.verdict]}: {watched.periods:g} periods, {watched.duration:.1f} s, "
            f"{watched.travel:.3g} {result.units.position} of travel used"
        )
    for reason in quality.reasons:
        screen.say(f"  {reason.text}")


def points(result: RunResult, screen: Screen) -> None:
    """The plant's points, distorted and right."""
    found = result.critical_point
    if found is None:
        return
    rows = []
    for key, label in POINT_LABELS.items():
        point = found.point(key)
        if point is None:
            continue
        how = f", {point.how}" if key.startswith("at_") else ""
        gain, turned = point.gain_high, point.phase_high_deg
        rows.append(
            [
                label + how,
                number(point.gain) + (f" ± {gain - point.gain:.1g}" if gain else ""),
                f"{point.phase_deg:.1f}°"
                + (f" ± {turned - point.phase_deg:.1f}°" if turned is not None else ""),
                f"{1000 * point.period:.4g} ms",
                number(point.ku)
                + (f" ± {high - ku:.1g}" if (high := point.ku_high) and (ku := point.ku) else ""),
            ]
        )
    units = result.units
    columns = ["", "gain", "phase", "period", "Ku"]
    screen.table(f"the plant: gain in {units.gain}, Ku in {units.stiffness}", columns, rows)
    if result.quality.has("point.not-measured"):
        return  # it was asked for, and said there
    for key in ("at_180", "at_135"):
        point = found.point(key)
        if point and point.how == "computed" and point.travel_needed:
            screen.say(
                f"  {POINT_LABELS[key]}: to measure it takes ±{point.travel_needed:.3g} "
                f"{units.position} of travel (--points)"
            )


def tuning(result: RunResult, screen: Screen) -> None:
    """Every rule and what its gains are worth, naive beside corrected.

    The gains that are proposed.
    """
    units = result.units
    for loop, title in LOOP_TITLES.items():
        sets = result.of_loop(loop)
        if not sets:
            continue
        columns = ["rule", "from", "PM", "Ms", "rad/s", "over", "settles", "off by", ""]
        screen.table(f"{loop}: {title}", columns, [_set_row(s) for s in sets if s.gains])
        screen.say(
            f"  PM: phase margin; rad/s: where the loop's gain passes 1; over, settles, off by (in "
            f"{units.position}): a step of a twentieth of the travel, with this friction"
        )
        missing: dict[str, list[str]] = {}
        for item in sets:
            if not item.gains:
                missing.setdefault(item.why_not, []).append(f"{item.rule} ({item.source})")
        for reason, names in missing.items():
            screen.say(f"  not here: {', '.join(names)}: {reason}")
        for item in sets:
            if item.proposed:
                mark = "best" if item.best else "proposed"
                screen.say(f"  {mark}: {item.rule}: {gains_text(item, units)}")
        if not any(item.proposed for item in sets):
            screen.say("  none can be proposed for this loop")
        for change in next((s.parameters for s in sets if s.best), ()):
            screen.say(
                f"  in the drive: {change.parameter} = {change.new:.4g} {change.unit} "
                f"({change.new_raw} x {change.raw_unit})"
            )


def _set_row(item: GainSet) -> list[str]:
    step = item.step if item.stable else None
    over = ends = off = "–"
    if step:
        over, ends = f"{100 * step.overshoot:.0f} %", duration(step.settling)
        off = f"{max(abs(step.error), step.hunting):.0e}".replace("e-0", "e-")
    margin = item.phase_margin_deg
    return [
        item.rule,
        item.source,
        f"{margin:.0f}°" if margin is not None else "–",
        f"{item.ms:.1f}",
        _frequency(item.crossover),
        over,
        ends,
        off,
        "best" if item.best else "proposed" if item.proposed else why_not(item),
    ]


def _frequency(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def outcome(result: RunResult, screen: Screen) -> None:
    """What can be done about it now."""
    if result.compensation:
        if screen.verbose:
            proposal(result.compensation, screen)
        else:
            screen.say(f"proposed: {_values(result.compensation)}")
        screen.say(f"to write it: tworelay apply {result.run}")
    else:
        screen.say(nothing_proposed(result))


def ending(result: RunResult, screen: Screen) -> None:
    """The line of truth, and the run."""
    screen.say(act_ended(result), _COLOURS[tone(result)])
    if result.run is not None:
        screen.say(f"run {result.run}")


def _values(changes: Sequence[Change]) -> str:
    """Parameters and what they are set to."""
    return ", ".join(f"{one.parameter} {si(one.new, one.unit)}" for one in changes)


def in_the_drive(result: RunResult, screen: Screen) -> None:
    """What this run has left in the drive, and the way back."""
    if not result.written:
        return
    there = ", ".join(
        f"{one.parameter} {one.raw if one.value is None else si(one.value, one.unit)}"
        for one in result.written
    )
    screen.say(f"in the drive: {there}")
    screen.say(f"to take it back: tworelay restore {result.run}")


def verification(result: RunResult, screen: Screen) -> None:
    """How the axis followed, without and with the compensation."""
    found = result.verification
    if found is None:
        return
    if not screen.verbose:
        screen.say(helps(found), "green" if found.kept is not None else "yellow")
        return
    rows = [
        [
            f"{100 * step.fraction:g} %" if step.fraction else "none",
            number(step.reversal_error),
            number(step.low_speed_error),
            f"±{step.rest_swing:.2g}",
            "hunts" if step.hunts else "",
            "stays" if step.kept else "",
        ]
        for step in found.steps
    ]
    columns = ["compensation", "after reversals", "at low speed", "at rest", "", ""]
    screen.table(f"following error in {found.unit}: peak, rms, half-swing", columns, rows)
    screen.say(helps(found))


def proposal(changes: Sequence[Change], screen: Screen) -> None:
    """What would be written."""
    rows = [
        [
            change.parameter,
            "?" if change.old is None else f"{change.old:.4g}",
            f"{change.new:.4g}",
            change.unit,
            "" if "bits" in change.raw_unit else f"{change.old_raw} → {change.new_raw}",
            f"{change.rounded_by:+.2g}",
        ]
        for change in changes
    ]
    screen.table("proposal", ["parameter", "old", "new", "unit", "raw", "rounded by"], rows)
    for change in changes:
        screen.say(f"  {change.parameter}: {change.why}")


def going_back(rows: list[Return], drive: Drive, screen: Screen) -> None:
    """What a restore would write, in SI and raw."""
    table = [
        [
            row.parameter, _in_si(row.parameter, row.there, drive), _in_si(row.parameter, row.old,
            drive),
            f"{'?' if row.there is None else row.there} → {row.old}", row.why_not or _remark(row),
        ]
        for row in rows
    ]  # fmt: skip
    if table:
        screen.table("restore", ["parameter", "now", "before", "raw", ""], table)


def _in_si(name: str, raw: int | None, drive: Drive) -> str:
    """A raw value with its unit; '' where it is a code or cannot be read."""
    what = drive.parameters[name]
    unit = what.unit
    return "" if raw is None or unit == "1" else number(what.si(raw), unit)


def _remark(row: Return) -> str:
    return "as it is" if row.there == row.old else "will be written"


def _mechanics(axis: Axis) -> str:
    """What scales its torques and positions, and what holds it."""
    parts = [
        axis.mechanics.motion,
        f"gear {axis.mechanics.gear:g}",
        f"held by {axis.mechanics.held_by}",
    ]
    given = {
        "feed": (axis.mechanics.feed, "m"), "rated torque": (axis.rated_torque, "N.m"),
        "torque constant": (axis.torque_constant, "N.m/A"), "encoder": (axis.encoder, "increments"),
    }  # fmt: skip
    parts += [
        f"{name} {value:g} {unit}" for name, (value, unit) in given.items() if value is not None
    ]
    return ", ".join(parts)


def adopted(found: Adopted, screen: Screen) -> None:
    """A run of another computer, before it is taken in."""
    parameters = found.profile.parameters
    screen.say(f"run {found.run}")
    called = "" if found.named == found.axis.name else f", called {found.named} now"
    screen.say(f"  axis     {found.axis.name}{called}: {_mechanics(found.axis)}")
    for text in found.notes:
        screen.say(f"  note     {text}")
    screen.say(f"  link     {found.axis.link}")
    screen.say(f"  drive    serial {found.serial or 'unknown'}")
    screen.say(f"  profile  {found.profile.name} {found.profile.version}, as known here")
    open_ones = [i for i in found.intents if i.is_open]
    names = dict.fromkeys(i.parameter for i in open_ones)
    rows = []
    for name in names:
        of_it = [i for i in open_ones if i.parameter == name]
        address = str(parameters[name].address) if name in parameters else "PDO"
        first, last = of_it[0], of_it[-1]
        rows.append([name, address, first.kind, str(first.old), str(last.new)])
    columns = ["parameter", "address", "kind", "before", "written"]
    if rows:
        screen.table("what it has left in the drive, raw values", columns, rows)
    screen.say(f"{len(found.intents) - len(open_ones)} more writes are put back already")
