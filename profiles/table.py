"""Draft profiles from a register table: CSV, a row a parameter.

Columns, in any order: `name`, `register` (as on the wire, 813, 0x32D or 32Dh) or `modicon` (40001
…), `type`; and, where they are needed, `title`, `unit`, `scale`, `minimum`, `maximum`, `access`,
`word_order`, `function` (6 or 16), `trust`, `mask`, `on`, `off`. For a drive without CiA 402, the
row `servo_on` says in `on` and `off` what is written, and the row `drive_status` in `mask` and `on`
how the drive shows that it is enabled.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from typing import Any

import tomlkit

from profiles.address import WIDTH_BITS
from profiles.draft import Draft, profile_name
from profiles.errors import ProfileError
from profiles.parameter import Unit

__all__ = ["COLUMNS", "NAMES", "Row", "from_table", "read_csv"]

COLUMNS = (
    "name", "register", "modicon", "type", "title", "unit", "scale", "minimum", "maximum", "access",
    "stop", "reset", "fault",
    "word_order", "function", "trust", "mask", "on", "off",
)  # fmt: skip
NAMES = {  # what tworelay asks of a drive: unit, protection, and what it is
    "torque_target": ("rated", "command", "torque command"),
    "position_actual": ("increment", "read", "actual position"),
    "torque_actual": ("rated", "read", "actual torque"),
    "controlword": ("1", "command", "controlword of CiA 402"),
    "statusword": ("1", "read", "statusword of CiA 402"),
    "mode_of_operation": ("1", "command", "mode of operation (6060h)"),
    "mode_display": ("1", "read", "mode of operation display (6061h)"),
    "servo_on": ("1", "command", "servo on, for a drive without controlword"),
    "drive_status": ("1", "read", "status that shows that it is enabled"),
    "alarm": ("1", "read", "alarm code, 0 for none"),
    "rated_torque": ("N.m", "read", "rated torque of the motor"),
    "encoder_increments": ("1", "read", "increments of the position per revolution"),
    "max_torque": ("rated", "experiment", "torque limit"),
    "max_speed": ("rpm", "experiment", "speed limit"),
    "watchdog_time": ("s", "experiment", "time-out of communication"),
    "store_command": ("1", "maintenance", "writing 1 stores the parameters"),
    "torque_offset": ("rated", "compensation", "offset torque"),
    "coulomb_positive": ("rated", "compensation", "friction torque, positive direction"),
    "coulomb_negative": ("rated", "compensation", "friction torque, negative direction"),
    "viscous_gain": ("rated/(rad/s)", "compensation", "viscous friction"),
    "friction": ("rated", "compensation", "friction torque, both directions"),
    "friction_speed": ("rpm", "compensation", "speed up to which it is linear"),
}  # fmt: skip
_CIA402 = ("controlword", "statusword", "mode_of_operation", "mode_display")
_MODICON = 40001
_GAP = 8  # foreign registers that are read along
LARGEST = 1_000_000


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter: its cells by column, without the empty ones, and where it stands."""

    where: str
    cells: dict[str, str]

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.cells["name"]

    def integer(self, column: str) -> int | None:
        """A cell as a number: 12, -12, 0xC or 0Ch; None: it is empty."""
        text = self.cells.get(column)
        if text is None:
            return None
        digits = re.fullmatch(r"([+-]?)(?:0x([0-9a-f]+)|([0-9a-f]+)h|(\d+))", text, re.IGNORECASE)
        if digits is None or len(text) > 12:
            raise ProfileError(
                f"{self.where}: {column} '{text[:40]}' must be a number such as 813, 0x32D or 32Dh"
            )
        sign, first, second, decimal = digits.groups()
        value = int(decimal) if decimal else int(first or second, 16)
        return -value if sign == "-" else value


def read_csv(data: bytes, origin: str) -> list[Row]:
    """Rows of a register table; raises ProfileError."""
    if len(data) > LARGEST or b"\0" in data:
        raise ProfileError(f"{origin}: no register table: it is too long, or no text")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise ProfileError(f"{origin}: the table is empty")
    delimiter = max(";\t,", key=lines[0].count)
    try:
        table = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise ProfileError(f"{origin}: no CSV: {error}") from None
    header = [cell.strip().lower().replace(" ", "_") for cell in table[0]]
    if unknown := [cell for cell in header if cell and cell not in COLUMNS]:
        raise ProfileError(
            f"{origin}: no column '{unknown[0][:40]}'; there are {', '.join(COLUMNS)}"
        )
    if twice := {cell for cell in header if cell and header.count(cell) > 1}:
        raise ProfileError(f"{origin}: column '{min(twice)}' comes twice")
    rows = []
    for number, cells in enumerate(table[1:], 2):
        where = f"{origin} row {number}"
        if len(cells) > len(header) and any(cell.strip() for cell in cells[len(header) :]):
            raise ProfileError(f"{where}: {len(cells)} cells under {len(header)} columns")
        filled = {
            column: cell.strip()
            for column, cell in zip(header, cells, strict=False)
            if column and cell.strip()
        }
        if not filled:
            continue
        if "name" not in filled or not re.fullmatch(r"[a-z][a-z0-9_]*", filled["name"]):
            raise ProfileError(
                f"{where}: name '{filled.get('name', '')[:40]}' must be of lower-case letters, "
                f"digits and _; tworelay knows {', '.join(NAMES)}"
            )
        rows.append(Row(where, filled))
    return rows


def from_table(rows: list[Row], title: str, origin: str) -> Draft:
    """A Modbus profile of the drive that has these registers; raises ProfileError."""
    found: dict[str, Row] = {}
    for row in rows:
        if row.name in found:
            raise ProfileError(f"{row.where}: '{row.name}' comes twice")
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
    document["limits"] = {
        kind: name for kind, name in (("torque", "max_torque"), ("speed", "max_speed"))
        if name in found
    }  # fmt: skip
    document["watchdog"] = _watchdog(found)
    if "store_command" in found:
        document["store"] = {"steps": [{"write": "store_command", "raw": 1}]}
    document["compensation"] = _compensation(found)
    document["parameters"] = parameters
    notes += _notes(found)
    return Draft(tomlkit.dumps(document), tuple(notes))


def _parameter(row: Row, notes: list[str]) -> dict[str, Any]:
    unit, protection, what = NAMES.get(row.name, ("1", "read", row.name))
    if row.name not in NAMES:
        notes.append(f"{row.where}: '{row.name}' is kept to be read; tworelay has no use for it")
    cells = row.cells
    register = row.integer("register")
    if register is None and (modicon := row.integer("modicon")) is not None:
        register = modicon - _MODICON
    if register is None:
        raise ProfileError(f"{row.where}: '{row.name}' has no register")
    kind = cells.get("type", "u16").lower()
    if kind not in WIDTH_BITS:
        raise ProfileError(f"{row.where}: type '{kind[:40]}' is none of {', '.join(WIDTH_BITS)}")
    if (given := cells.get("unit")) is not None and given not in list(Unit):
        raise ProfileError(
            f"{row.where}: unit '{given[:40]}' is none of {', '.join(Unit)}; what one raw step is "
            "of it stands in scale (ms: unit s, scale 0.001; 0.1 %: unit rated, scale 0.001)"
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


def _cycle(found: dict[str, Row], *, is_cia402: bool) -> dict[str, Any]:
    status = "statusword" if is_cia402 else "drive_status"
    single = found["torque_target"].integer("function") == 6
    return {
        "function": "fc6+3" if single else "fc16+3",
        "gap": _GAP,
        "out": ["torque_target"],
        "in": [status, "position_actual", *(["torque_actual"] if "torque_actual" in found else [])],
    }


def _power(found: dict[str, Row], *, is_cia402: bool) -> dict[str, Any]:
    mode: dict[str, Any] = {"set_point": "torque_target"}
    if is_cia402:
        return {
            "modes": {"torque": [{"code": 10, **mode}]},
            "stop": [{"write": "controlword", "raw": 2}],
            "disable": [{"write": "controlword", "raw": 0}],
        }
    switch, status = found["servo_on"], found["drive_status"]
    on, off = switch.integer("on"), switch.integer("off")
    off_step = [{"write": "servo_on", "raw": 0 if off is None else off}]
    quick, reset = switch.integer("stop"), switch.integer("reset")
    stop_step = off_step if quick is None else [{"write": "servo_on", "raw": quick}]
    enabled, mask, fault = (status.integer(column) for column in ("on", "mask", "fault"))
    if enabled is None:
        raise ProfileError(
            f"{status.where}: drive_status needs 'on' (and 'mask'): what does it read when the "
            "drive is enabled?"
        )
    power: dict[str, Any] = {
        "enable": [{"write": "servo_on", "raw": 1 if on is None else on}],
        "enabled": {
            "parameter": "drive_status", "mask": -1 if mask is None else mask, "equals": enabled,
        },
    }  # fmt: skip
    if "alarm" in found:
        power["fault"] = {"parameter": "alarm", "differs": 0}
    elif fault is not None:
        power["fault"] = {"parameter": "drive_status", "mask": fault, "differs": 0}
    if reset is not None:
        power["reset"] = [{"write": "servo_on", "raw": reset}, *off_step]
    return {"modes": {"torque": [mode]}, "power": power, "stop": stop_step, "disable": off_step}


def _watchdog(found: dict[str, Row]) -> dict[str, Any]:
    if "watchdog_time" not in found:
        return {"kind": "none"}
    return {"kind": "traffic", "parameter": "watchdog_time", "timeout": 0.1}


def _compensation(found: dict[str, Row]) -> dict[str, Any]:
    law: dict[str, Any] = {"law": "none"}
    if "coulomb_positive" in found and "coulomb_negative" in found:
        law = {
            "law": "offset+asymmetric", "positive": "coulomb_positive",
            "negative": "coulomb_negative",
        }  # fmt: skip
        if "viscous_gain" in found:
            law |= {"law": "coulomb+viscous", "viscous": "viscous_gain"}
    elif "friction" in found:
        law = {"law": "single-gain", "gain": "friction"}
        if "friction_speed" in found:
            law |= {"law": "saturated-linear", "speed": "friction_speed"}
    if law["law"] != "none" and "torque_offset" in found:
        law["offset"] = "torque_offset"
    return law


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
        if switch.integer("stop") is None:
            notes.append(
                "servo_on has no 'stop': the axis is stopped by switching it off, and coasts"
            )
        if "alarm" not in found and status.integer("fault") is None:
            notes.append("no alarm, and no 'fault' bits in drive_status: a fault is not recognised")
        if switch.integer("reset") is None:
            notes.append(
                "servo_on has no 'reset': a fault is reset at the drive, also the one that the "
                "proof of its watchdog makes (--without-watchdog leaves that proof out)"
            )
    if not {"coulomb_positive", "friction"} & set(found):
        notes.append(
            "no coulomb_positive and coulomb_negative, and no friction: nothing can be compensated"
        )
    notes.append(
        "what the torque mode needs (mode, source of the command) stands in 'before' of "
        "[[modes.torque]]"
    )
    return notes
