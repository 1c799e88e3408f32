"""Register tables as they are written: CSV, a row a parameter.

Columns, in any order: `name`, `register` (as on the wire, 813, 0x32D or 32Dh) or `modicon` (40001
…), `type`; and, where they are needed, `title`, `unit`, `scale`, `minimum`, `maximum`, `access`,
`word_order`, `function` (6 or 16), `trust`, `sign`. What a register does stands in the others: for
a drive without CiA 402 the row `servo_on` says in `on`, `off`, `stop` and `reset` what is written
(keys one after the other: `0x55 0xAA`), and the row `drive_status` in `mask`, `on`, `stopping` and
`fault_value` (or `fault`: bits) what it reads. `before`: what is written before the torque mode is
enabled; `torque` and `position` of `mode_of_operation`: the codes of the modes.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass

from profiles.errors import ProfileError

__all__ = ["COLUMNS", "LARGEST", "NAMES", "Row", "read_csv"]

LARGEST = 1_000_000  # bytes
COLUMNS = (
    "name", "register", "modicon", "type", "title", "unit", "scale", "minimum", "maximum", "access",
    "stop", "reset", "fault", "fault_value", "stopping", "before", "torque", "position", "sign",
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
    "servo_on_2": ("1", "command", "a second register that is written to enable, after servo_on"),
    "drive_status": ("1", "read", "status that shows that it is enabled"),
    "alarm": ("1", "read", "alarm code, 0 for none"),
    "fault_reset": ("1", "maintenance", "register that acknowledges a fault"),
    "position_target": ("increment", "command", "position command, for the proof"),
    "product_code": ("1", "read", "what the drive is, as a number"),
    "revision_code": ("1", "read", "its revision"),
    "serial_number": ("1", "read", "its serial number"),
    "rated_torque": ("N.m", "read", "rated torque of the motor"),
    "encoder_increments": ("1", "read", "increments of the position per revolution"),
    "max_torque": ("rated", "experiment", "torque limit"),
    "max_torque_negative": ("rated", "experiment", "torque limit of the negative direction"),
    "max_speed": ("rpm", "experiment", "speed limit"),
    "max_speed_negative": ("rpm", "experiment", "speed limit of the negative direction"),
    "max_current": ("rated", "read", "current limit, which limits the torque, too"),
    "rated_current": ("A", "read", "rated current of the motor"),
    "motor_temperature": ("degC", "read", "temperature of the motor"),
    "own_friction": ("N.m", "read", "friction as the drive itself has found it"),
    "watchdog_time": ("s", "experiment", "time-out of communication"),
    "store_command": ("1", "maintenance", "writing 1, or 'on', stores the parameters"),
    "store_status": ("1", "read", "reads 'on' once they are stored"),
    "torque_offset": ("rated", "compensation", "offset torque"),
    "coulomb_positive": ("rated", "compensation", "friction torque, positive direction"),
    "coulomb_negative": ("rated", "compensation", "friction torque, negative direction"),
    "viscous_gain": ("rated/(rad/s)", "compensation", "viscous friction"),
    "friction": ("rated", "compensation", "friction torque, both directions"),
    "friction_speed": ("rpm", "compensation", "speed up to which it is linear"),
}  # fmt: skip


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
        return None if text is None else self._number(column, text)

    def integers(self, column: str) -> list[int]:
        """A cell as numbers, one after the other: 0x55 0xAA; none: it is empty."""
        parts = re.split(r"[\s,/]+", self.cells.get(column, "").strip())
        return [self._number(column, part) for part in parts if part]

    def _number(self, column: str, text: str) -> int:
        digits = re.fullmatch(r"([+-]?)(?:0x([0-9a-f]+)|([0-9a-f]+)h|(\d+))", text, re.IGNORECASE)
        if re.fullmatch(r"0\d+", text):
            raise ProfileError(
                f"{self.where}: {column} '{text}': is it hexadecimal ({text}h) or decimal "
                f"({text.lstrip('0') or '0'})?"
            )
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
    rows: list[Row] = []
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
