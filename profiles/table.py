"""Draft profiles from a register table."""

from __future__ import annotations

import difflib
from typing import Any

import tomlkit

from profiles.address import WIDTH_BITS
from profiles.draft import Draft, profile_name
from profiles.errors import ProfileError
from profiles.law import CompensationLaw
from profiles.parameter import Unit
from profiles.table_rows import NAMES, Row

__all__ = ["from_table"]

_CIA402 = ("controlword", "statusword", "mode_of_operation", "mode_display")
_MODICON = 40001
_GAP = 8  # foreign registers that are read along


def from_table(rows: list[Row], title: str, origin: str) -> Draft:
    """A Modbus profile of the drive that has these registers; raises ProfileError."""
    found: dict[str, Row] = {}
    for row in rows:
        if row.name in found:
            raise ProfileError(f"{row.where}: '{row.name}' comes twice")
        if row.name not in NAMES and "before" not in row.cells:
            raise ProfileError(_unknown(row))
        found[row.name] = row
    is_cia402 = "controlword" in found
    needed = ("torque_target", "position_actual", *(_CIA402 if is_cia402 else ()))
    if missing := [name for name in needed if name not in found]:
        raise ProfileError(f"{origin}: the table lacks {', '.join(missing)}")
    if not is_cia402 and not ("servo_on" in found and "drive_status" in found):
        raise ProfileError(
            f"{origin}: how is the drive enabled? The table needs controlword, statusword, "
            "mode_of_operation and mode_display (CiA 402), or servo_on and drive_status"
        )
    document = tomlkit.document()
    head = {
        "name": profile_name(title), "version": "0.1.0", "title": title or origin, "bus": "modbus",
        "status": "from documents", "sources": [origin],
        "state_machine": "cia402" if is_cia402 else "procedure",
    }  # fmt: skip
    for key, value in head.items():
        document[key] = value
    notes: list[str] = []
    parameters = {name: _parameter(row, notes) for name, row in found.items()}
    document["identity"] = {"asked": False}
    document["cycle"] = _cycle(found, is_cia402=is_cia402)
    document.update(_power(found, is_cia402=is_cia402))
    kinds = "torque", "torque_negative", "speed", "speed_negative", "current"
    document["limits"] = {kind: f"max_{kind}" for kind in kinds if f"max_{kind}" in found}
    document["watchdog"] = _watchdog(found)
    if "store_command" in found:
        document["store"] = {"steps": _store(found)}
    if "own_friction" in found:
        document["own_estimates"] = {"coulomb": "own_friction"}
    if "motor_temperature" in found:
        document["conditions"] = {"motor_temperature": "motor_temperature"}
    document["compensation"] = _compensation(found)
    document["parameters"] = parameters
    unsaid = [
        row.name for row in found.values()
        if "32" in row.cells.get("type", "") and "word_order" not in row.cells
    ]  # fmt: skip
    if unsaid:
        notes.append(f"no word_order, taken as high-first: {', '.join(unsaid)}")
    doubted = [name for name in document["compensation"].values() if name in found
               and "trust" not in found[name].cells]  # fmt: skip
    if doubted:
        notes.append(
            f"no trust for {', '.join(doubted)}: unverified, so apply will refuse to write; once "
            "checked in the manual, 'trust' verified (or derived) in their rows"
        )
    notes += _notes(found)
    return Draft(tomlkit.dumps(document), tuple(notes))


def _unknown(row: Row) -> str:
    """What tworelay has no use for, and what was probably meant."""
    near = _nearest(row.name)
    meant = f": is it '{near}'?" if near else ""
    return (
        f"{row.where}: '{row.name}' is no name that tworelay knows{meant} (there are "
        f"{', '.join(NAMES)}; any other register has to say in 'before' what is written to it "
        "before the torque mode is enabled)"
    )


_SYNONYMS = {
    "forward": "positive", "fwd": "positive", "pos": "positive", "up": "positive", "cw": "positive",
    "backward": "negative", "reverse": "negative", "rev": "negative", "neg": "negative",
    "down": "negative", "ccw": "negative", "velocity": "speed", "status": "drive_status",
    "state": "drive_status", "save": "store", "command": "target", "cmd": "target",
    "setpoint": "target", "limit": "max", "resolution": "increments", "feedback": "actual",
    "timeout": "watchdog", "nominal": "rated", "serial": "serial_number", "reset": "fault_reset",
}  # fmt: skip
_ALIKE = 0.5  # share of words that two names have in common


def _nearest(name: str) -> str:
    """The name that was probably meant, by its words, in whatever order; else by its letters."""
    words = set("_".join(_SYNONYMS.get(word, word) for word in name.split("_")).split("_"))
    if "friction" in words and words & {"positive", "negative"}:
        words = words - {"friction"} | {"coulomb"}

    def shared(known: str) -> float:
        there = set(known.split("_"))
        return len(there & words) / len(there | words)

    best = max(NAMES, key=shared)
    if shared(best) >= _ALIKE:
        return best
    return next(iter(difflib.get_close_matches(name, NAMES, 1)), "")


def _parameter(row: Row, notes: list[str]) -> dict[str, Any]:
    unit, protection, what = NAMES.get(row.name, ("1", "experiment", row.name.replace("_", " ")))
    cells = row.cells
    register = _register(row)
    kind = cells.get("type", "u16").lower()
    if kind not in WIDTH_BITS:
        raise ProfileError(f"{row.where}: type '{kind[:40]}' is none of {', '.join(WIDTH_BITS)}")
    if (given := cells.get("unit")) is not None and given not in list(Unit):
        raise ProfileError(
            f"{row.where}: unit '{given[:40]}' is none of {', '.join(Unit)}{_meant(given)}; what "
            "one raw step is of it stands in scale (ms: unit s, scale 0.001; 0.1 %: unit rated, "
            "scale 0.001)"
        )
    address: dict[str, Any] = {"register": register, "type": kind}
    if "word_order" in cells:
        address["word_order"] = cells["word_order"].lower()
    if (function := row.integer("function")) is not None:
        address["write_function"] = function
    parameter: dict[str, Any] = {
        "address": address, "title": cells.get("title", what), "unit": cells.get("unit", unit),
        "trust": cells.get("trust", "unverified").lower(),
    }  # fmt: skip
    if "scale" in cells:
        try:
            parameter["scale"] = float(cells["scale"].replace(",", "."))
        except ValueError:
            raise ProfileError(f"{row.where}: scale '{cells['scale'][:40]}' is no number") from None
    elif parameter["unit"] not in ("1", "increment", "rpm", "s"):
        notes.append(f"{row.where}: '{row.name}' has no scale: one raw step is taken as 1 {unit}")
    for bound in ("minimum", "maximum"):
        if (value := row.integer(bound)) is not None:
            parameter[bound] = value
    access = cells.get("access", "ro" if protection == "read" else "rw").lower()
    if access != "rw":
        parameter["access"] = access
    if protection != "read" and access != "ro":
        parameter["protection"] = protection
    return parameter


_UNITS = {
    "nm": "N.m", "n·m": "N.m", "%": "rated", "permille": "rated", "‰": "rated", "ms": "s",
    "us": "s", "counts": "increment", "count": "increment", "inc": "increment", "ma": "A",
    "arms": "A", "r/min": "rpm", "1/min": "rpm", "min-1": "rpm", "°c": "degC", "turn": "rev",
    "turns": "rev", "rad/sec": "rad/s",
}  # fmt: skip


def _meant(unit: str) -> str:
    """The unit that was probably meant."""
    plain = unit.strip().lower()
    near = _UNITS.get(plain) or next(iter(difflib.get_close_matches(unit, list(Unit), 1)), None)
    return f" ('{near}'?)" if near else ""


def _cycle(found: dict[str, Row], *, is_cia402: bool) -> dict[str, Any]:
    status = "statusword" if is_cia402 else "drive_status"
    single = found["torque_target"].integer("function") == 6
    into = (status, "alarm", "position_actual", "torque_actual")
    behind = _follows(found["torque_target"], found.get("position_target"))
    return {
        "function": "fc6+3" if single else "fc16+3",
        "gap": _GAP,
        "out": ["torque_target", *(["position_target"] if behind and not single else [])],
        "in": [name for name in into if name in found],
    }


def _register(row: Row) -> int:
    register = row.integer("register")
    if register is None and (modicon := row.integer("modicon")) is not None:
        register = modicon - _MODICON
    if register is None:
        raise ProfileError(f"{row.where}: '{row.name}' has no register")
    return register


def _follows(torque: Row, position: Row | None) -> bool:
    """Whether both are written in one block: the position's register follows the torque's."""
    if position is None:
        return False
    width = WIDTH_BITS.get(torque.cells.get("type", "u16").lower(), 16) // 16
    return _register(position) == _register(torque) + max(width, 1)


def _power(found: dict[str, Row], *, is_cia402: bool) -> dict[str, Any]:
    modes = _modes(found, is_cia402=is_cia402)
    if is_cia402:
        return {
            "modes": modes,
            "stop": [{"write": "controlword", "raw": 2}],
            "disable": [{"write": "controlword", "raw": 0}],
        }
    switches = [found[name] for name in ("servo_on", "servo_on_2") if name in found]
    off_steps = [
        {"write": row.name, "raw": raw}
        for row in reversed(switches)
        for raw in row.integers("off") or [0]
    ]
    stop_steps = _written(switches, "stop") or off_steps
    reset = _written([*switches, *_rows(found, "fault_reset")], "reset")
    if "fault_reset" in found:
        reset += [
            {"write": "fault_reset", "raw": raw}
            for raw in found["fault_reset"].integers("on") or [1]
        ]
    power: dict[str, Any] = {
        "enable": [
            {"write": row.name, "raw": raw} for row in switches for raw in row.integers("on") or [1]
        ],
        **_signs(found),
    }
    if reset:
        by_switch = any(step["write"] in ("servo_on", "servo_on_2") for step in reset)
        power["reset"] = [*reset, *(off_steps if by_switch else [])]
    return {"modes": modes, "power": power, "stop": stop_steps, "disable": off_steps}


def _rows(found: dict[str, Row], *names: str) -> list[Row]:
    return [found[name] for name in names if name in found]


def _written(rows: list[Row], column: str) -> list[dict[str, Any]]:
    """The steps that a column says."""
    return [{"write": row.name, "raw": raw} for row in rows for raw in row.integers(column)]


def _signs(found: dict[str, Row]) -> dict[str, Any]:
    """How the drive shows that it is enabled, brakes, and is in fault."""
    status = found["drive_status"]
    enabled, mask = status.integers("on"), status.integer("mask")
    if not enabled:
        raise ProfileError(
            f"{status.where}: drive_status needs 'on' (and 'mask'): what does it read when the "
            "drive is enabled?"
        )

    def reads(values: list[int]) -> dict[str, Any]:
        what: dict[str, Any] = {"parameter": "drive_status", "mask": -1 if mask is None else mask}
        return what | ({"equals": values[0]} if len(values) == 1 else {"among": values})

    signs = {"enabled": reads(enabled)}
    if stopping := status.integers("stopping"):
        signs["stopping"] = reads(stopping)
    fault, bits = status.integers("fault_value"), status.integer("fault")
    if "alarm" in found:
        signs["fault"] = {"parameter": "alarm", "differs": 0}
    elif fault:
        signs["fault"] = reads(fault)
    elif bits is not None:
        signs["fault"] = {"parameter": "drive_status", "mask": bits, "differs": 0}
    return signs


def _modes(found: dict[str, Row], *, is_cia402: bool) -> dict[str, Any]:
    """Torque, and position where its command can be given in the cycle."""
    mode = found.get("mode_of_operation")
    codes = {
        "torque": mode.integer("torque") if mode else None,
        "position": mode.integer("position") if mode else None,
    }
    if is_cia402:
        codes = {"torque": codes["torque"] or 10, "position": codes["position"] or 8}
    elif mode is not None and codes["torque"] is None:
        raise ProfileError(
            f"{mode.where}: mode_of_operation needs 'torque' (and 'position'): which value is "
            "that mode?"
        )
    before = [
        {"write": row.name, "raw": raw} for row in found.values() for raw in row.integers("before")
    ]
    modes: dict[str, Any] = {}
    for name, set_point in (("torque", "torque_target"), ("position", "position_target")):
        if set_point not in found or (name == "position" and mode is not None and not codes[name]):
            continue
        if name == "position" and not _follows(found["torque_target"], found[set_point]):
            continue
        modes[name] = [{"set_point": set_point}]
        if codes[name] is not None:
            modes[name][0] |= {"code": codes[name]}
        if name == "torque" and before:
            modes[name][0] |= {"before": before}
    return modes


def _store(found: dict[str, Row]) -> list[dict[str, Any]]:
    """The word, or words, that store; and how it shows that it is done."""
    words = found["store_command"].integers("on") or [1]
    steps: list[dict[str, Any]] = [{"write": "store_command", "raw": raw} for raw in words]
    status = found.get("store_status")
    if status is not None:
        done = status.integer("on")
        if done is None:
            raise ProfileError(
                f"{status.where}: store_status needs 'on': what does it read once all is stored?"
            )
        mask = status.integer("mask")
        masked = {} if mask is None else {"mask": mask}
        steps.append({"until": "store_status", **masked, "equals": done, "within": 10.0})
    return steps


def _watchdog(found: dict[str, Row]) -> dict[str, Any]:
    if "watchdog_time" not in found:
        return {"kind": "none"}
    return {"kind": "traffic", "parameter": "watchdog_time", "timeout": 0.1}


def _compensation(found: dict[str, Row]) -> dict[str, Any]:
    """The law whose terms the table has."""
    terms = {
        "offset": "torque_offset", "positive": "coulomb_positive", "negative": "coulomb_negative",
        "gain": "friction", "speed": "friction_speed", "viscous": "viscous_gain",
    }  # fmt: skip
    there = {term: name for term, name in terms.items() if name in found}
    if "positive" in there and "negative" in there:
        there.pop("gain", None)
    for law in CompensationLaw:
        if there.keys() - {"offset"} and law.takes(frozenset(there)):
            negative = found[there["negative"]] if "negative" in there else None
            sign = {} if negative is None else {"negative_sign": _negative_sign(negative)}
            return {"law": str(law), **there, **sign}
    if there.keys() <= {"offset"}:
        return {"law": "none"}
    first = found[next(name for term, name in there.items() if term != "offset")]
    raise ProfileError(
        f"{first.where}: {', '.join(there.values())} are the terms of no law: there are "
        "coulomb_positive and coulomb_negative, or friction, each with or without friction_speed; "
        "viscous_gain with coulomb_positive and coulomb_negative; torque_offset with any"
    )


def _negative_sign(row: Row) -> int:
    """How the drive stores the friction of the negative direction: below zero where it can."""
    sign = row.integer("sign")
    if sign is not None:
        if sign not in (-1, 1):
            raise ProfileError(f"{row.where}: sign {sign} must be 1 or -1")
        return sign
    lowest = row.integer("minimum")
    signed = row.cells.get("type", "u16").lower().startswith("i")
    return -1 if signed and lowest is not None and lowest < 0 else 1


def _notes(found: dict[str, Row]) -> list[str]:
    texts = {
        "watchdog_time": "no watchdog_time: the drive does not notice a dead link",
        "max_torque": "no max_torque: only the host limits the torque",
        "max_speed": "no max_speed: only the host limits the speed",
        "rated_torque": "no rated_torque: give it (N.m of the motor) in the axis file",
        "encoder_increments": "no encoder_increments: give encoder in the axis file",
        "store_command": "no store_command: what is written is lost at power-off",
    }
    notes = [text for name, text in texts.items() if name not in found]
    if "servo_on" in found and "drive_status" in found:
        switch, status = found["servo_on"], found["drive_status"]
        if not switch.integers("stop"):
            notes.append(
                "servo_on has no 'stop': the axis is stopped by switching it off, and coasts"
            )
        if "alarm" not in found and not {"fault", "fault_value"} & status.cells.keys():
            notes.append(
                "no alarm, and no 'fault' or 'fault_value' in drive_status: a fault is not "
                "recognised"
            )
        if not switch.integers("reset") and "fault_reset" not in found:
            notes.append(
                "servo_on has no 'reset': a fault is reset at the drive, also the one that the "
                "proof of its watchdog makes (--without-watchdog leaves that proof out)"
            )
    if not {"coulomb_positive", "friction"} & set(found):
        notes.append(
            "no coulomb_positive and coulomb_negative, and no friction: nothing can be compensated"
        )
    if "coulomb_negative" in found and _negative_sign(found["coulomb_negative"]) < 0:
        notes.append(
            "coulomb_negative takes values below zero: the friction of the negative direction is "
            "written so (negative_sign = -1 in [compensation]; sign 1 in the table: above zero)"
        )
    if "position_target" in found and not _follows(
        found["torque_target"], found["position_target"]
    ):
        notes.append(
            "position_target does not follow torque_target, register by register, so both are not "
            "written in one block: there is no proof in position mode"
        )
    if not any("before" in row.cells for row in found.values()):
        notes.append(
            "what the torque mode needs (mode, source of the command) stands in column 'before', "
            "or in 'before' of [[modes.torque]]"
        )
    return notes
