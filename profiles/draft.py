"""Draft profiles from an EDS or DCF.

A draft is a profile text that loads, with what is not known left out and said. What a file cannot
tell – units, what a value does – stays the standard's word, and trust `derived`: `apply` needs
`verified` or better only for what it writes, and no draft has a compensation to write.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.toml_document import TOMLDocument

from profiles.eds import Eds, EdsEntry
from profiles.errors import ProfileError
from profiles.plain import plain

__all__ = ["Draft", "from_eds"]

_TORQUE, _CYCLIC_TORQUE = 3, 9  # bits of 6502h, supported drive modes
_NO_LIMIT = 10_000  # per mille of rated torque
# without these no relay experiment can be driven at all
_NEEDED = {
    (0x6040, 0): "controlword", (0x6041, 0): "statusword", (0x6060, 0): "modes of operation",
    (0x6064, 0): "position feedback",
}  # fmt: skip
_FRICTION = re.compile(r"friction|coulomb|stiction|breakaway|reibung|losbrech", re.IGNORECASE)
_MANUFACTURER = range(0x2000, 0x6000)
_MOST_CANDIDATES = 8
_VELOCITY, _CONSUMER_HEARTBEAT = 0x60A9, 0x1016
_REVOLUTION, _PER = 0xB4, {0x47: "min", 0x03: "s"}  # of an SI unit (CiA 303-2)


@dataclass(frozen=True, slots=True)
class Draft:
    """A profile as text, and what there is to say about it, for people."""

    text: str
    notes: tuple[str, ...]


def profile_name(*words: str) -> str:
    """A name that a profile may have."""
    name = re.sub(r"[^a-z0-9.-]+", "-", "-".join(w for w in words if w).lower()).strip("-.")
    return name or "drive"


def from_eds(eds: Eds, template: str, origin: str) -> Draft:
    """A CiA 402 profile of the drive that `eds` describes.

    Parameters
    ----------
    template : text of the generic CiA 402 profile
    origin : name of the file, for sources and messages

    Raises
    ------
    ProfileError
        The drive cannot be driven by torque: what is missing.
    """
    _refuse(eds, origin)
    document = tomlkit.parse(template)
    notes = [f"mended {item}" for item in eds.mended]
    document["name"] = profile_name(eds.vendor_name.split(" ")[0], eds.product_name)
    document["version"] = "0.1.0"
    document["title"] = " ".join(f"{eds.vendor_name} {eds.product_name}".split()) or origin
    document["sources"] = [Path(origin).name, "CiA 402 = IEC 61800-7-201"]
    if eds.vendor:
        identity = tomlkit.table()
        identity["vendor"] = f"0x{eds.vendor:08X}"
        if eds.product:
            identity["product"] = f"0x{eds.product:08X}"
        document["identity"] = identity
        notes.append(
            "the identity is the file's: compare it with what the drive says (tworelay scan)"
        )
    else:
        notes.append("the file says no vendor number: the profile fits no drive by itself, name it")
    notes += [f"{text}: 1018h counts" for text in eds.differs]
    notes += _take_entries(document, eds)
    notes += _without_what_is_missing(document, eds)
    candidates = _candidates(eds)
    notes += _told(candidates) + _velocity(eds)
    return Draft(tomlkit.dumps(document) + _described(candidates), tuple(notes))


def _refuse(eds: Eds, origin: str) -> None:
    missing = {at: name for at, name in _NEEDED.items() if eds.entry(*at) is None}
    if len(missing) == len(_NEEDED):
        raise ProfileError(
            f"{origin}: no CiA 402 drive: it has none of "
            + ", ".join(f"{index:04X}h {name}" for (index, _), name in missing.items())
        )
    if missing:
        told = ", ".join(f"no {name} {index:04X}h" for (index, _), name in missing.items())
        raise ProfileError(f"{origin}: the drive has {told}: it cannot be used")
    if eds.entry(0x6071) is None:
        offset = (
            " (its 60B2h torque offset is an addition, no command)" if eds.entry(0x60B2) else ""
        )
        raise ProfileError(
            f"{origin}: the drive has no 6071h target torque, so no torque can be commanded and no "
            f"relay experiment run{offset}; it cannot be used"
        )
    target = eds.entries[0x6071, 0]
    if target.access == "ro" and not target.mappable:
        raise ProfileError(
            f"{origin}: 6071h target torque is read only in this drive, and in no PDO: no torque "
            "can be commanded, it cannot be used"
        )
    supported = eds.value(0x6502)
    if supported and not supported >> _TORQUE & 1 and not supported >> _CYCLIC_TORQUE & 1:
        raise ProfileError(
            f"{origin}: 6502h supported drive modes is 0x{supported:X}: neither torque (bit 3) nor "
            "cyclic torque (bit 9); no relay experiment can be run, it cannot be used"
        )


def _take_entries(document: TOMLDocument, eds: Eds) -> list[str]:
    """Types, titles, access and limits as the file has them; parameters that it lacks go."""
    notes: list[str] = []
    missing: list[str] = []
    parameters: Any = document["parameters"]
    for name in list(parameters):
        parameter = parameters[name]
        address = parameter["address"]
        index, sub = int(address["index"]), int(address.get("sub", 0))
        entry = eds.entry(index, sub)
        if entry is None:
            del parameters[name]
            missing.append(f"{name} {index:04X}h" + (f":{sub:02X}" if sub else ""))
            continue
        if entry.type is not None and entry.type != address["type"]:
            notes.append(
                f"{name}: {index:04X}h is {entry.type}, not {address['type']} as in CiA 402"
            )
            address["type"] = entry.type
        if entry.name:
            parameter["title"] = entry.name
        parameter["trust"] = "derived"
        _take_access(parameter, entry, name, notes)
        if index != _CONSUMER_HEARTBEAT:  # whose value has the node in it
            _take_limits(parameter, entry)
    return notes + ([f"not in the file: {', '.join(missing)}"] if missing else [])


def _take_access(parameter: Any, entry: EdsEntry, name: str, notes: list[str]) -> None:
    if entry.access == "ro" and parameter.get("access") != "ro":
        if parameter.get("protection") == "command" and entry.mappable:
            notes.append(f"{name}: {entry.index:04X}h is written by PDO only")
            return
        parameter["access"] = "ro"
        parameter.pop("protection", None)
        notes.append(f"{name}: {entry.index:04X}h is read only in this drive")


def _take_limits(parameter: Any, entry: EdsEntry) -> None:
    if parameter.get("protection") not in ("experiment", "compensation"):
        return
    if entry.type == "f32":
        return
    bits = int((entry.type or "i32")[1:])
    signed = (entry.type or "i32")[0] == "i"
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    low, high = entry.low, entry.high
    if low is None or high is None or low >= high:
        return
    if lowest <= low and high <= highest and (low, high) != (lowest, highest):
        parameter["minimum"], parameter["maximum"] = low, high


def _without_what_is_missing(document: TOMLDocument, eds: Eds) -> list[str]:
    """Sections that name a parameter which the drive does not have."""
    notes: list[str] = []
    parameters: Any = document["parameters"]

    def has(name: str) -> bool:
        return name in parameters and parameters[name].get("access") != "ro"

    watchdog: Any = document["watchdog"]
    if not has("watchdog_time") and has("guard_time") and has("life_factor"):
        watchdog["kind"], watchdog["parameter"] = "guarding", "guard_time"
        watchdog.pop("guard_time")
        notes.append(
            "no consumer heartbeat 1016h, but life guarding (100Ch, 100Dh): it watches the link "
            "where the adapter sends remote frames"
        )
    elif not has("watchdog_time"):
        watchdog["kind"] = "none"
        del watchdog["parameter"]
        notes.append(
            "no consumer heartbeat 1016h, no life guarding 100Ch: the drive does not notice a dead "
            "link"
        )
    if not has("abort_connection_option"):
        watchdog.pop("reaction", None)
        watchdog.pop("reaction_raw", None)
    for key in ("guard_time", "life_factor"):
        if not has(key):
            watchdog.pop(key, None)
    limits: Any = document["limits"]
    if "max_current" not in parameters:
        limits.pop("current", None)
    for key, name in (("torque", "max_torque"), ("speed", "max_speed")):
        if not has(name):
            del limits[key]
            notes.append(f"no {key} limit in the drive ({name}): only the host limits it")
    if not has("torque_offset"):
        document["compensation"] = {"law": "none"}
        notes.append(
            "no 60B2h that can be written: a master cannot add what is missing; the friction is "
            "only reported, unless [compensation] says what the drive has of its own"
        )
    if not has("store_command"):
        document.remove("store")
        notes.append("no 1010h:1: what is written is lost at power-off")
    cycle: Any = document["cycle"]
    for key in ("out", "in"):
        cycle[key] = [name for name in cycle[key] if name in parameters]
    notes += _modes(document, eds)
    limit = eds.value(0x6072)
    if limit is not None and limit >= _NO_LIMIT:
        notes.append(
            f"6072h max torque is delivered with {limit} per mille, which means no limit: "
            "it is set and read back before every experiment"
        )
    if "rated_torque" not in parameters:
        notes.append("no 6076h: give rated_torque (N.m of the motor) in the axis file")
    if "encoder_increments" not in parameters:
        notes.append("no 608Fh: give encoder (increments per motor revolution) in the axis file")
    return notes


@dataclass(frozen=True, slots=True)
class _Candidate:
    """An object of the maker that may be the drive's friction compensation."""

    entry: EdsEntry
    name: str

    @property
    def at(self) -> str:
        entry = self.entry
        return f"{entry.index:04X}h:{entry.sub:02X}" if entry.sub else f"{entry.index:04X}h"


def _candidates(eds: Eds) -> list[_Candidate]:
    found = []
    for (index, sub), entry in sorted(eds.entries.items()):
        record = eds.records.get(index, "")
        named = f"{record}: {entry.name}" if record and sub else entry.name
        if index in _MANUFACTURER and _FRICTION.search(named) and (sub or not record):
            found.append(_Candidate(entry, named))
    return found


def _told(candidates: list[_Candidate]) -> list[str]:
    """Which there are."""
    if not candidates:
        return []
    listed = ", ".join(
        f"{one.at} '{one.name}' ({one.entry.type or 'no number'}"
        f"{', read only' if one.entry.access == 'ro' else ''})"
        for one in candidates[:_MOST_CANDIDATES]
    )
    more = f", and {len(candidates) - _MOST_CANDIDATES} more" * (len(candidates) > _MOST_CANDIDATES)
    stands = "stands" if len(candidates) == 1 else "stand"
    way = "describe in [compensation] what the drive has of its own; the draft ends with them"
    return [f"{listed}{more} {stands} in the file; {way}"]


def _described(candidates: list[_Candidate]) -> str:
    """Parameters of those that can be written, for whoever knows what they are."""
    lines = []
    for one in candidates[:_MOST_CANDIDATES]:
        entry = one.entry
        if entry.access == "ro" or entry.type is None:
            continue
        name = profile_name(entry.name).replace("-", "_").replace(".", "_")
        sub = f", sub = {entry.sub}" if entry.sub else ""
        lines += [
            f"# [parameters.{name}]",
            f'# address = {{ index = 0x{entry.index:04X}{sub}, type = "{entry.type}" }}',
            f'# title = "{plain(one.name).replace(chr(34), chr(39))}"',
            '# unit = "rated"  # and scale: what one step is of it, by the manual',
            "# scale = 0.001",
            '# protection = "compensation"',
            '# trust = "derived"  # once it is looked up',
            "",
        ]
    if not lines:
        return ""
    head = (
        "\n# objects of the maker that [compensation] may name, where the manual confirms them\n\n"
    )
    return head + "\n".join(lines)


def _velocity(eds: Eds) -> list[str]:
    """What velocities are counted in, where the file says it (60A9h)."""
    unit = eds.value(_VELOCITY)
    if unit is None:
        return []
    exponent = (unit >> 24 & 0xFF) - (0x100 if unit >> 31 & 1 else 0)
    above, below = unit >> 16 & 0xFF, unit >> 8 & 0xFF
    if above != _REVOLUTION or below not in _PER:
        return [f"60A9h counts velocities in {unit:08X}h, which is no speed of a shaft: look it up"]
    if (exponent, _PER[below]) == (0, "min"):
        return []
    step = f"10^{exponent} " if exponent else ""
    way = "6080h is rpm by the standard: compare max_speed with the drive's own display"
    return [f"60A9h counts velocities in {step}rev/{_PER[below]}; {way}"]


def _modes(document: TOMLDocument, eds: Eds) -> list[str]:
    """The modes that the drive has, as far as the file tells."""
    notes = []
    parameters: Any = document["parameters"]
    modes: Any = document["modes"]
    bits = eds.value(0x6502)
    if "mode_display" not in parameters:
        notes.append("no 6061h: the mode is read back where it is written (6060h)")
    if "position_target" not in parameters:
        modes.remove("position")
    elif bits and not any(bits >> int(mode["supported_bit"]) & 1 for mode in modes["position"]):
        modes.remove("position")
        notes.append(
            f"no cyclic position mode in 6502h = 0x{bits:X}: what is written cannot be proved here"
        )
    has_slope = "torque_slope" in parameters and parameters["torque_slope"].get("access") != "ro"
    kept = tomlkit.aot()
    for mode in modes["torque"]:
        if bits and not bits >> int(mode["supported_bit"]) & 1:
            notes.append(f"mode {mode['code']} is not in 6502h = 0x{bits:X}")
            continue
        if "before" in mode and not has_slope:
            del mode["before"]
        elif "before" in mode:  # the steepest slope that the drive takes
            slope = parameters["torque_slope"]
            steepest = slope.get("maximum", mode["before"][0]["raw"])
            mode["before"][0]["raw"] = min(int(mode["before"][0]["raw"]), int(steepest))
        if "supported_modes" not in parameters:
            mode.pop("supported_bit", None)
        kept.append(mode)
    modes["torque"] = kept
    if "supported_modes" not in parameters:
        for mode in modes.get("position", ()):
            mode.pop("supported_bit", None)
    return notes
