"""Results in words and tables."""

from __future__ import annotations

from math import floor, log10
from typing import TYPE_CHECKING, Any

from commissioning.cli.terminal import Screen
from commissioning.report.words import GAINS, duration, host_law

if TYPE_CHECKING:
    from commissioning.session.adopt import Adopted
    from commissioning.settings import Return
    from drivers.drive import Drive
    from profiles.axis import Axis

__all__ = ["adopted", "going_back", "outcome", "proposal", "summary", "verification"]

_NAMES = {
    "coulomb": "Coulomb friction",
    "offset": "offset",
    "viscous": "viscous friction B",
    "inertia": "inertia J",
    "dead_time": "dead time",
}


def number(value: float | None, unit: str = "") -> str:
    """A number with its unit, or a dash."""
    return "–" if value is None else f"{value:.4g} {unit}".rstrip()


def _interval(low: float, high: float) -> str:
    """Both ends, with as many digits as tell them apart."""
    largest = max(abs(low), abs(high), 1e-300)
    width = max(high - low, 1e-6 * largest)
    digits = min(max(2 - floor(log10(width / largest)), 3), 6)
    return f"{low:.{digits}g} … {high:.{digits}g}"


def _in_drive(item: dict[str, Any]) -> str:
    """A quantity as the drive counts it; shares of rated torque in per cent."""
    if item["raw"] is None:
        return ""
    scale, _, unit = item["raw_unit"].rpartition(" ")
    if unit == "rated":
        return f"{100 * item['raw'] * float(scale or 1):.2f} % of rated"
    return f"{item['raw']:.1f} x {item['raw_unit']}"


def summary(result: dict[str, Any], screen: Screen) -> None:
    """What was found."""
    friction = result["friction"]
    rows = []
    for key, name in _NAMES.items():
        item = friction[key]
        if item["value"] is None:
            continue
        interval = _interval(item["low"], item["high"])
        rows.append([name, number(item["value"], item["unit"]), interval, _in_drive(item)])
    screen.table(f"found by {friction['method']}", ["", "value", "interval", "drive's unit"], rows)
    f, offset = friction["coulomb"], friction["offset"]
    if f["value"] is not None and offset["value"] is not None:
        up, down = offset["value"] + f["value"], offset["value"] - f["value"]
        screen.say(
            f"torque that overcomes friction and offset: {up:+.4g} {f['unit']} one way, "
            f"{down:+.4g} {f['unit']} the other"
        )
    points(result, screen)
    quality, experiment = result["quality"], result["experiment"]
    screen.say(
        f"{quality['verdict']}: {experiment['periods']} periods, {experiment['duration']:.1f} s, "
        f"{experiment['travel']:.3g} {result['units']['position']} of travel used"
    )
    for reason in quality["reasons"]:
        screen.say(f"  {reason}")


_POINTS = {
    "naive": "naive: a relay autotuner",
    "hysteresis": "with its hysteresis",
    "corrected": "with friction, too",
    "measured": "at another amplitude",
    "at_180": "at −180°",
    "at_135": "at −135°",
}


def points(result: dict[str, Any], screen: Screen) -> None:
    """The plant's points, distorted and right."""
    found = result["critical_point"]
    if not found:
        return
    rows = []
    for key, label in _POINTS.items():
        point = found[key]
        if point is None:
            continue
        how = f", {point['how']}" if key.startswith("at_") else ""
        gain, turned = point["gain_high"], point["phase_high_deg"]
        rows.append(
            [
                label + how,
                number(point["gain"]) + (f" ± {gain - point['gain']:.1g}" if gain else ""),
                f"{point['phase_deg']:.1f}°"
                + (f" ± {turned - point['phase_deg']:.1f}°" if turned is not None else ""),
                f"{1000 * point['period']:.4g} ms",
                number(point["ku"]),
            ]
        )
    gain_unit, ku_unit = result["units"]["gain"], result["units"].get("stiffness", "")
    columns = ["", "gain", "phase", "period", "Ku"]
    screen.table(f"the plant: gain in {gain_unit}, Ku in {ku_unit}", columns, rows)
    if any("plant at" in reason for reason in result["quality"]["reasons"]):
        return  # it was asked for, and said there
    for key in ("at_180", "at_135"):
        point = found[key]
        if point and point["how"] == "computed" and point["travel_needed"]:
            screen.say(
                f"  {_POINTS[key]}: to measure it takes ±{point['travel_needed']:.3g} "
                f"{result['units']['position']} of travel (--points)"
            )


_LOOPS = {
    "host": "the loop over this link, its dead time included",
    "drive": "the drive's own loops, the link's share of the dead time removed",
}


def tuning(result: dict[str, Any], screen: Screen) -> None:
    """Every rule and what its gains are worth, naive beside corrected; the gains that are proposed."""
    units = result["units"]
    for loop, title in _LOOPS.items():
        sets = [s for s in result["tuning"] if s["loop"] == loop]
        if not sets:
            continue
        columns = ["rule", "from", "PM", "Ms", "rad/s", "over", "settles", "off by", ""]
        screen.table(f"{loop}: {title}", columns, [_set_row(s) for s in sets if s["gains"]])
        screen.say(
            f"  PM: phase margin; rad/s: where the loop's gain passes 1; over, settles, off by (in "
            f"{units['position']}): a step of a twentieth of the travel, with this friction"
        )
        missing: dict[str, list[str]] = {}
        for item in sets:
            if not item["gains"]:
                missing.setdefault(item["why_not"], []).append(f"{item['rule']} ({item['source']})")
        for reason, names in missing.items():
            screen.say(f"  not here: {', '.join(names)}: {reason}")
        for item in sets:
            if item["proposed"]:
                mark = "best" if item["best"] else "proposed"
                screen.say(f"  {mark}: {item['rule']}: {gains_text(item, units)}")
        if not any(item["proposed"] for item in sets):
            screen.say("  none can be proposed for this loop")
        for change in next((s["parameters"] for s in sets if s["best"]), ()):
            screen.say(
                f"  in the drive: {change['parameter']} = {change['new']:.4g} {change['unit']} "
                f"({change['new_raw']} x {change['raw_unit']})"
            )


def _set_row(item: dict[str, Any]) -> list[str]:
    step = item["step"] if item["stable"] else None
    over = ends = off = "–"
    if step:
        over, ends = f"{100 * step['overshoot']:.0f} %", duration(step["settling"])
        off = f"{max(abs(step['error']), step['hunting']):.0e}".replace("e-0", "e-")
    margin = item["phase_margin_deg"]
    return [
        item["rule"],
        item["source"],
        f"{margin:.0f}°" if margin is not None else "–",
        f"{item['ms']:.1f}",
        _frequency(item["crossover"]),
        over,
        ends,
        off,
        "best"
        if item["best"]
        else "proposed"
        if item["proposed"]
        else item["why_not"].split(":")[0],
    ]


def _frequency(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def gains_text(item: dict[str, Any], units: dict[str, str]) -> str:
    """Gains by name with their units; an integral part that is not there is left out."""
    found = []
    for name, value in item["gains"].items():
        symbol, unit = GAINS[name]
        if value:
            found.append(f"{symbol} = {value:.4g} {units.get(unit, unit)}")
    return ", ".join(found)


def outcome(result: dict[str, Any], screen: Screen) -> None:
    """What can be done about it now."""
    if result["compensation"]:
        proposal(result["compensation"], screen)
        screen.say(f"to write it: tworelay apply {result['run']}")
    else:
        screen.say(host_law(result["host_compensation"]))
    screen.say(f"run {result['run']}")


def verification(result: dict[str, Any], screen: Screen) -> None:
    """How the axis followed, without and with the compensation."""
    found = result["verification"]
    unit = found["unit"]
    rows = [
        [
            f"{100 * step['fraction']:g} %" if step["fraction"] else "none",
            number(step["reversal_error"]),
            number(step["low_speed_error"]),
            f"±{step['rest_swing']:.2g}",
            "hunts" if step["hunts"] else "",
            "stays" if step["kept"] else "",
        ]
        for step in found["steps"]
    ]
    columns = ["compensation", "after reversals", "at low speed", "at rest", "", ""]
    screen.table(f"following error in {unit}: peak, rms, half-swing", columns, rows)
    before = found["steps"][0]
    kept = next(step for step in found["steps"] if step["kept"])
    less = 100 * (1 - kept["reversal_error"] / before["reversal_error"])
    screen.say(
        f"verified: {less:.0f} % less error after reversals with {100 * kept['fraction']:g} % of the "
        "friction compensated; these values are in the drive"
    )


def proposal(items: list[dict[str, Any]], screen: Screen) -> None:
    """What would be written."""
    rows = [
        [
            item["parameter"],
            f"{item['old']:.4g}",
            f"{item['new']:.4g}",
            item["unit"],
            "" if "bits" in item["raw_unit"] else f"{item['old_raw']} → {item['new_raw']}",
            f"{item['rounded_by']:+.2g}",
        ]
        for item in items
    ]
    screen.table("proposal", ["parameter", "old", "new", "unit", "raw", "rounded by"], rows)
    for item in items:
        screen.say(f"  {item['parameter']}: {item['why']}")


def going_back(rows: list[Return], drive: Drive, screen: Screen) -> None:
    """What a restore would write, in SI and raw."""
    table = [
        [
            row.parameter, _in_si(row.parameter, row.there, drive), _in_si(row.parameter, row.old, drive),
            f"{'?' if row.there is None else row.there} → {row.old}", row.why_not or _remark(row),
        ]
        for row in rows
    ]  # fmt: skip
    if table:
        screen.table("restore", ["parameter", "now", "before", "raw", ""], table)


def _in_si(name: str, raw: int | None, drive: Drive) -> str:
    """A raw value with its unit; '' where it is a code or cannot be read."""
    parameter = drive.profile.parameters[name]
    unit = drive.scaling.unit_text(parameter)
    return "" if raw is None or unit == "1" else number(drive.scaling.to_si(parameter, raw), unit)


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
    screen.say(f"  axis     {found.axis.name}: {_mechanics(found.axis)}")
    screen.say(f"  link     {found.axis.link}")
    screen.say(f"  drive    serial {found.serial or 'unknown'}")
    screen.say(f"  profile  {found.profile.name} {found.profile.version}, as known here")
    open_ones = [i for i in found.intents if i["state"] != "restored"]
    names = dict.fromkeys(i["parameter"] for i in open_ones)
    rows = []
    for name in names:
        of_it = [i for i in open_ones if i["parameter"] == name]
        address = str(parameters[name].address) if name in parameters else "PDO"
        first, last = of_it[0], of_it[-1]
        rows.append([name, address, first["kind"], str(first["old"]), str(last["new"])])
    columns = ["parameter", "address", "kind", "before", "written"]
    if rows:
        screen.table("what it has left in the drive, raw values", columns, rows)
    screen.say(f"{len(found.intents) - len(open_ones)} more writes are put back already")
