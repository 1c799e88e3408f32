"""How a result is worded: the one table of labels and units, for screen and report alike."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from math import degrees, floor, log10, pi
from typing import Literal

from commissioning.result.changes import Change, Host
from commissioning.result.document import RunResult
from commissioning.result.endings import AxisState, CompensationState, DriveState, SettingsState
from commissioning.result.experiment import Experiment
from commissioning.result.found import Quantity, Units
from commissioning.result.language import digits, said
from commissioning.result.worth import GainSet, Trial, Verification

__all__ = [
    "GAINS",
    "LOOP_TITLES",
    "POINT_LABELS",
    "QUANTITY_LABELS",
    "VERDICTS",
    "WHY_NOT",
    "act_ended",
    "axis_words",
    "both_ways",
    "change_state",
    "counted",
    "distorted",
    "duration",
    "found_as",
    "gains_lines",
    "gains_text",
    "helps",
    "host_law",
    "interval",
    "iso",
    "measured",
    "nothing_proposed",
    "now_against_then",
    "number",
    "percent",
    "remaining",
    "repeated",
    "rpm",
    "si",
    "tone",
    "uncertain",
    "unit",
    "why_not",
]

QUANTITY_LABELS = {
    "coulomb": "Coulomb friction",
    "offset": "offset",
    "viscous": "viscous friction B",
    "inertia": "inertia J",
    "dead_time": "dead time",
    "lag": "of it a lag",
}
POINT_LABELS = {
    "naive": "naive: a relay autotuner",
    "hysteresis": "with its hysteresis",
    "corrected": "with friction, too",
    "measured": "at another amplitude",
    "at_180": "at −180°",
    "at_135": "at −135°",
}
LOOP_TITLES = {
    "host": "the loop over this link, its dead time included",
    "drive": "the drive's own loops, the link's share of the dead time removed",
}
# gain: (symbol, name of its unit in the result's `units`, or the unit itself)
GAINS = {
    "gain": ("K", "stiffness"), "integral_time": ("Ti", "s"), "derivative_time": ("Td", "s"),
    "velocity_gain": ("Kv", "viscous"), "position_gain": ("Kp", "1/s"),
}  # fmt: skip
VERDICTS = {
    "good": "good",
    "usable": "usable",
    "rejected": "rejected",
    "curve-only": "curve only",
    None: "not measured",
}


def number(value: float | None, of: str = "") -> str:
    """Four digits and the unit, or a dash."""
    return "–" if value is None else digits(f"{value:.4g} {of}".rstrip())


def repeated(watched: Experiment, friction: Quantity) -> str:
    """What repeats scatter by, and whether they drift."""
    share = 100 / abs(friction.value) if friction.value else 0.0
    text = f"{len(watched.repeats)} repeats: spread ±{(watched.spread or 0.0) * share:.2g} %"
    if watched.drift is None:
        return text
    drift, low, high = (60 * share * value for value in watched.drift)
    return f"{text}, drift {drift:+.2g} % a minute ({low:+.2g} … {high:+.2g} %)"


def measured(value: float, low: float | None, high: float | None, of: str = "") -> str:
    """A value to two digits of what it is uncertain by, and the unit."""
    if low is None or high is None or not high > low:
        return number(value, of)
    places = 1 - floor(log10((high - low) / 2))
    return digits(f"{round(value, places) + 0.0:.6g} {of}".rstrip())


_SKEWED = 0.15  # of the interval: the value is so far from its middle that both ends are said
_POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def uncertain(value: float, low: float | None, high: float | None, of: str = "") -> str:
    """A value and half of its interval, to two digits of that, and the unit.

    Both ends where the value is not in their middle: '2.59 (2.43 … 2.73) N·m'.
    """
    if low is None or high is None or not high > low:
        return number(value, of)
    half = (high - low) / 2
    power = 3 * floor(log10(max(abs(value), half)) / 3)
    power = power if not -5 < log10(max(abs(value), half)) < 6 else 0
    value, low, high, half = (one / 10.0**power for one in (value, low, high, half))
    places = max(1 - floor(log10(half)), 0)

    def shown(one: float) -> str:
        rounded = round(one, places) + 0.0
        return f"{rounded:.{places}f}" if rounded else "0"

    is_skewed = abs(value - (low + high) / 2) > _SKEWED * half
    ends = f"({shown(low)} … {shown(high)})" if is_skewed else f"± {shown(half)}"
    text = f"{shown(value)} {ends}"
    if power:
        text = f"({text})" if not is_skewed else text
        text += f"·10{str(power).translate(_POWERS)}"
    return digits(f"{text} {of}".rstrip())


def found_as(found: Quantity) -> str:
    """A quantity with its interval and its unit."""
    ends = found.value, found.low, found.high
    if found.unit != "s":
        return uncertain(*ends, unit(found.unit))
    value, low, high = (None if one is None else 1000 * one for one in ends)
    assert value is not None
    return uncertain(value, low, high, "ms")


def counted(found: Quantity) -> str:
    """A quantity as the drive counts it, shares of rated torque in per cent; '' where not."""
    if found.raw is None or found.raw_unit is None:
        return ""
    scale, _, name = found.raw_unit.rpartition(" ")
    if name == "rated":
        return digits(f"{100 * found.raw * float(scale or 1):.2f} % of rated")
    return digits(f"{found.raw:.1f} x {found.raw_unit}")


def both_ways(value: float, of: str) -> str:
    """A position as it is, and in degrees or millimetres."""
    other = f"{degrees(value):.4g}°" if of == "rad" else f"{1000 * value:.4g} mm"
    return digits(f"{value:.4g} {of} ({other})")


def rpm(value: float) -> str:
    """A speed in rad/s, in revolutions per minute."""
    return digits(f"{value * 30 / pi:.4g} rpm")


def si(value: float, of: str) -> str:
    """Four digits and the unit, as it is printed."""
    return number(value, unit(of))


def unit(ascii_name: str) -> str:
    """A unit as it is printed."""
    return ascii_name.replace("kg.m2", "kg·m²").replace(".", "·")


def interval(low: float | None, high: float | None) -> str:
    """Both ends, with as many digits as tell them apart."""
    if low is None or high is None:
        return "–"
    largest = max(abs(low), abs(high), 1e-300)
    width = max(high - low, 1e-6 * largest)
    places = min(max(2 - floor(log10(width / largest)), 3), 6)
    return digits(f"{low:.{places}g} … {high:.{places}g}")


def duration(value: float | None) -> str:
    """A time in ms below a second, else in s; None: never."""
    if value is None:
        return said("never")
    return digits(f"{value:.2f} s") if value >= 1 else f"{1000 * value:.0f} ms"


def iso(instant: float | None) -> str | None:
    """ISO 8601, with the zone of this computer."""
    if instant is None:
        return None
    return datetime.fromtimestamp(instant).astimezone().isoformat(timespec="seconds")


def percent(change: float) -> str:
    """A change, to a tenth of a percent or two digits."""
    if abs(change) < 0.05:
        return "±0.0 %"
    return f"{change:+.1f} %" if abs(change) < 10 else f"{change:+.0f} %"


def remaining(value: float) -> str:
    """A time that people wait, in whole s, min or h."""
    seconds = round(value)
    if seconds < 60:
        return f"{seconds} s"
    if seconds < 3600:
        return f"{seconds // 60} min {seconds % 60:02d} s"
    return f"{seconds // 3600} h {seconds % 3600 // 60:02d} min"


WHY_NOT = {  # of gains that are not proposed, for a column
    "gains.unstable": "unstable", "gains.no-crossover": "no crossover",
    "gains.margin": "PM too small",
    "gains.sensitivity": "Ms too large", "gains.too-fast": "too fast",
    "gains.off-goal": "off its goal",
    "gains.overshoots": "overshoots", "gains.unsettled": "does not settle",
    "gains.out-of-range": "out of range", "gains.too-fine": "too fine",
    "gains.distorted": "distorted", "gains.no-point": "no such point",
}  # fmt: skip


def why_not(item: GainSet) -> str:
    """Why gains are not proposed, in a word or two where there is one."""
    return WHY_NOT.get(item.why_not_code, item.why_not)


def gains_text(item: GainSet, units: Units) -> str:
    """Gains by name with their units, in one line."""
    return ", ".join(gains_lines(item, units))


def gains_lines(item: GainSet, units: Units) -> list[str]:
    """Each gain by name with its unit; an integral part that is not there is left out."""
    found = []
    for name, value in item.gains.items():
        symbol, of = GAINS[name]
        if value:
            found.append(f"{symbol} = {value:.4g} {getattr(units, of, of)}")
    return found


# -- what is changed ------------------------------------------------------------------------------


def host_law(terms: Host) -> str:
    """What the master of a drive without a compensation of its own adds in every cycle."""
    return (
        f"this drive leaves friction to its master: in cyclic position or velocity mode add to "
        f"{terms.parameter} ({terms.address}) in every cycle {terms.offset_raw:+d} "
        f"{terms.coulomb_raw:+d} * sign(velocity command), in steps of {terms.raw_unit} "
        f"({terms.offset:+.4g} {terms.unit} and {terms.coulomb:+.4g} {terms.unit})"
    )


def change_state(change: Change, result: RunResult) -> str:
    """Whether a value of the proposal is in the drive."""
    there = next((w for w in result.written if w.parameter == change.parameter), None)
    if there is None:
        return "proposed"
    if not there.certain:
        return f"not known: the write of {there.raw} was cut off"
    return "written, read back" if there.raw == change.new_raw else f"{there.raw} is in the drive"


def nothing_proposed(result: RunResult) -> str:
    """Why a run proposes nothing to be written."""
    if result.friction.coulomb is None:
        return said("no friction was measured, so there is nothing to write")
    if result.host_compensation is not None:
        return host_law(result.host_compensation)
    if result.quality.has("proposal.impossible"):
        return said("the drive cannot hold what was found: the reasons are above")
    if result.identity is None:
        return said("a recording has no drive to write to")
    return said("this drive has no friction compensation to write to: identify and report only")


def distorted(result: RunResult) -> str:
    """How wrong a relay autotuner would be on this axis; '' where that is not known."""
    points = result.critical_point
    if points is None or points.naive is None or points.corrected is None:
        return ""
    gain = 100 * (points.naive.gain / points.corrected.gain - 1)
    turned = points.naive.phase_deg - points.corrected.phase_deg
    return (
        f"a relay autotuner would have the gain of the critical point wrong by {gain:+.0f} %, its "
        f"phase by {turned:+.1f}°"
    )


def helps(found: Verification) -> str:
    """What a proof says."""
    kept = found.kept
    if kept is None or found.percent is None:
        return said("verified: the compensation did not help; the old values were put back")
    text = said(
        "verified: {percent} % less error after reversals with {share} % of the friction "
        "compensated ({before} → {after} {unit})"
    )
    return digits(
        text.format(
            percent=f"{found.percent:.0f}", share=f"{100 * kept.fraction:g}", unit=found.unit,
            before=f"{found.steps[0].reversal_error:.3g}", after=f"{kept.reversal_error:.3g}",
        )
    )  # fmt: skip


def now_against_then(now: Trial, result: RunResult) -> list[str]:
    """How the axis follows with what is in the drive, and how it did at its proof."""
    unit_of, proof = result.units.position, result.verification
    lines = [
        digits(
            f"now: {now.reversal_error:.3g} {unit_of} after reversals, {now.low_speed_error:.3g} "
            f"{unit_of} rms at low speed, ±{now.rest_swing:.2g} {unit_of} at rest"
            + (": it hunts" if now.hunts else "")
        )
    ]
    if proof is not None and proof.kept is not None:
        then = proof.kept.reversal_error
        change = percent(100 * (now.reversal_error / then - 1)) if then > 0 else "–"
        lines.append(
            digits(
                f"at the proof of run {result.run}: {then:.3g} {unit_of} after reversals, {change} "
                f"now; {proof.steps[0].reversal_error:.3g} {unit_of} without compensation"
            )
        )
    return lines


# -- how it ended ---------------------------------------------------------------------------------

_AXIS = {
    AxisState.AT_REST: "axis at rest and off",
    AxisState.HELD: "axis off and held by its brake",
    AxisState.NOT_MOVED: "axis not moved",
    AxisState.ENABLED: "the drive is ENABLED, by somebody else or by a job that died",
    AxisState.NOT_RECORDED: "how its axis was left was not recorded by that version",
    AxisState.NOT_VERIFIED: "it is NOT VERIFIED that the axis is at rest: use the emergency stop",
}
_NAMES_SHOWN = 4


def axis_words(state: AxisState) -> str:
    """What is known of an axis."""
    return said(_AXIS[state])


def act_ended(result: RunResult) -> str:
    """The line of truth of an act.

    Axis, experiment's settings, compensation in the drive, who ended it.

    What no act has just looked at is said to be the journal's word.
    """
    ending = result.ending
    if ending is None:
        return said(
            "under way, or cut off: nothing is known of its end; 'tworelay stop' and 'tworelay "
            "restore' finish it"
        )
    known = []
    if ending.settings is not None and result.run is not None:
        known.append(_settings(ending.settings, result.run))
    if ending.drive is not None:
        known.append(_drive(ending.drive, result))
    asked = ending.axis in (AxisState.AT_REST, AxisState.HELD)
    source = "" if asked or not known else said("by the journal, ")
    parts = [axis_words(ending.axis), *([source + "; ".join(known)] if known else [])]
    if ending.said_by is not None:
        parts.append(f"{said('ended by')} {ending.said_by}")
    return "; ".join(parts)


def tone(result: RunResult) -> Literal["good", "doubt", "bad"]:
    """What the line of truth means: all is well, something is to be looked at, or to be done."""
    ending = result.ending
    if ending is None or ending.axis in (AxisState.ENABLED, AxisState.NOT_VERIFIED):
        return "bad"
    if ending.settings is not None and ending.settings.names:
        return "bad"
    there = ending.drive
    if there is not None and there.compensation is CompensationState.NOT_KNOWN:
        return "bad"
    lost = there is not None and (
        there.compensation is CompensationState.PARTLY
        or (there.compensation is CompensationState.OF_RUN and not there.stored)
        or (there.compensation is CompensationState.AS_FOUND and there.stored is not None)
    )
    return "doubt" if lost or ending.axis is AxisState.NOT_RECORDED else "good"


def _settings(state: SettingsState, run: str) -> str:
    names = state.names
    if not names:
        return said("settings put back")
    text = said("settings NOT put back: {names} ('tworelay restore {run}' tries again)")
    return text.format(names=_some(names), run=run)


def _some(names: Sequence[str]) -> str:
    left = len(names) - _NAMES_SHOWN
    more = f" {said('and {count} more').format(count=left)}" if left > 0 else ""
    return ", ".join(names[:_NAMES_SHOWN]) + more


def _drive(state: DriveState, result: RunResult) -> str:
    way = said("('tworelay restore {run}' puts the old values back)").format(run=result.run)
    if state.compensation is CompensationState.NOT_KNOWN:
        known = said("it is NOT KNOWN what compensation the drive has")
        return f"{known} {way}" + _gains(result)
    if state.compensation is CompensationState.OF_OTHER:
        return said("the drive's compensation is of another run")
    if state.compensation is CompensationState.AS_FOUND:
        other = said("in its RAM: its memory may have others")
        memory = "" if state.stored is None else f", {other} {way}"
        return said("the drive's compensation is as it was found") + memory + _gains(result)
    what = said("of this run")
    if state.compensation is CompensationState.PARTLY:
        values = [f"{w.parameter} = {w.raw}" for w in result.written if w.kind == "compensation"]
        left = said("what this run left on its way ({values}, raw)")
        what = left.format(values=_some(values))
    stored = {
        True: "stored",
        False: "in its RAM only, lost at power-off",
        None: "not known to be stored",
    }
    text = said("the drive's compensation is {what}, {stored}")
    return text.format(what=what, stored=said(stored[state.stored])) + _gains(result)


def _gains(result: RunResult) -> str:
    """Gains of the drive's own loops that the run has left there."""
    gains = [one for one in result.written if one.kind == "gain"]
    sure = [one.parameter for one in gains if one.certain]
    unsure = [one.parameter for one in gains if not one.certain]
    text = ""
    if sure:
        text += ", " + said("with gains of this run ({names})").format(names=_some(sure))
    if unsure:
        text += ", " + said("and NOT KNOWN gains ({names})").format(names=_some(unsure))
    return text
