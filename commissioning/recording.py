"""Recordings of other tools: CSV with a header, or .mat, as columns in SI.

Files are hostile: sizes are limited, nothing in them is executed, and every error names row and
column.
"""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from profiles.errors import UsageError
from profiles.files import contents

__all__ = ["Column", "Recording", "Table", "column_of", "read", "table_of"]

Array = NDArray[np.float64]

_LARGEST = 300_000_000  # bytes
_MOST_ROWS = 2_000_000
_MOST_CELLS = 10_000_000
_LONGEST_GAP = 2000  # usual steps
_SEARCHED = 200  # lines for the header
_FEWEST = 50  # samples

# unit: (what, factor to SI, whether linear; None: either)
UNITS: dict[str, tuple[str, float, bool | None]] = {
    "s": ("time", 1.0, None), "ms": ("time", 1e-3, None), "us": ("time", 1e-6, None),
    "rad": ("position", 1.0, False), "deg": ("position", math.pi / 180, False),
    "rev": ("position", 2 * math.pi, False), "m": ("position", 1.0, True),
    "mm": ("position", 1e-3, True), "um": ("position", 1e-6, True),
    "rad/s": ("velocity", 1.0, False), "deg/s": ("velocity", math.pi / 180, False),
    "rpm": ("velocity", 2 * math.pi / 60, False), "m/s": ("velocity", 1.0, True),
    "mm/s": ("velocity", 1e-3, True),
    "Nm": ("torque", 1.0, False), "N.m": ("torque", 1.0, False), "mNm": ("torque", 1e-3, False),
    "N": ("torque", 1.0, True), "kN": ("torque", 1e3, True),
}  # fmt: skip

_DEFAULTS = {
    "time": ("time_s",),
    "position": ("position_rad", "position_m"),
    "velocity": ("velocity_rad/s", "velocity_m/s"),
    "torque": ("command_Nm", "command_N", "torque_Nm", "force_N"),
}
_LIMITS = {  # what no servo axis does: (smallest, largest, hint)
    "step": (1e-6, 0.5, "is the time in milliseconds? --time COLUMN:ms"),
    "speed": (0.0, 1e5, "is the position in counts or degrees? --position COLUMN:deg"),
    "torque": (1e-7, 1e7, "give its scale: --torque 'COLUMN:0.001 Nm'"),
}


@dataclass(frozen=True, slots=True)
class Column:
    """A column as the user names it.

    Name, factor to SI (None: by its own unit), linear or rotary.
    """

    name: str
    factor: float | None
    linear: bool | None


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of a file as they stand there; `units` where a row of units was seen."""

    path: Path
    columns: dict[str, Array]
    units: dict[str, str]
    scalars: dict[str, float]
    first_row: int  # line of the first number, for messages


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording in SI.

    Attributes
    ----------
    time : (n,) s
    torque : (n,) N.m or N
    position, velocity : (n,) or None; rad or m, rad/s or m/s
    sent : (n,) s, when each torque was commanded; equal to `time` where the file does not say
    linear : m and N instead of rad and N.m
    analysed : (n,) whether the numbers of the run that this is an export of are of the sample; None
        where the file does not say
    lateness : (n,) s, of each exchange, of an export
    """

    time: Array
    torque: Array
    position: Array | None
    velocity: Array | None
    sent: Array
    linear: bool
    analysed: NDArray[np.bool_] | None = None
    lateness: Array | None = None


def column_of(text: str | None, quantity: str, scalars: dict[str, float]) -> Column | None:
    """COL, COL:UNIT or COL:SCALE UNIT; a scale may be a scalar of a .mat file.

    Raises UsageError.
    """
    if text is None:
        return None
    name, colon, unit_text = text.rpartition(":")
    if not colon:
        return Column(text, None, None)
    words = unit_text.split()
    scale = 1.0
    if len(words) == 2:
        try:
            scale = scalars[words[0]] if words[0] in scalars else float(words[0])
        except ValueError:
            raise UsageError(
                f"--{quantity} {text}: '{words[0]}' is no number; write COLUMN:SCALE UNIT, as in "
                f"--torque 'current:0.12 Nm'"
            ) from None
    unit = words[-1] if words else ""
    if len(words) > 2 or unit not in UNITS or UNITS[unit][0] != quantity:
        known = ", ".join(name for name, (what, _, _) in UNITS.items() if what == quantity)
        raise UsageError(f"--{quantity} {text}: '{unit_text}' is no unit of it; there are {known}")
    if not math.isfinite(scale) or scale == 0:
        raise UsageError(f"--{quantity} {text}: a scale of {scale:g} makes no numbers")
    return Column(name, scale * UNITS[unit][1], UNITS[unit][2])


def table_of(path: Path) -> Table:
    """Read a file as a table; raises UsageError."""
    try:
        data = contents(path, _LARGEST)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    if path.suffix.lower() == ".mat":
        return _mat(path, data)
    if b"\0" in data[:1000]:
        raise UsageError(f"{path}: is no text; a recording is CSV with a header, or .mat")
    if data.count(b"\n") > _MOST_ROWS:
        raise UsageError(f"{path}: more than {_MOST_ROWS} rows; cut the recording")
    if data.count(b",") + data.count(b";") + data.count(b"\t") > 4 * _MOST_CELLS:
        raise UsageError(f"{path}: more than {_MOST_CELLS} cells; cut the recording")
    try:
        return _csv(path, data.decode("utf-8-sig", "replace"))
    except csv.Error as error:
        raise UsageError(f"{path}: cannot be read as CSV: {error}") from None


_NUMBERS = {  # classes of a .mat
    "double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64",
    "logical",
}  # fmt: skip


def _mat(path: Path, data: bytes) -> Table:
    import scipy.io

    try:
        # a small compressed file may hold a large array, and a small cell anything: only what is a
        # small array of numbers is inflated
        shapes = scipy.io.whosmat(io.BytesIO(data))  # type: ignore[arg-type]
        small = [
            name
            for name, shape, kind in shapes
            if kind in _NUMBERS and math.prod(shape) <= _MOST_CELLS
        ]
        found = scipy.io.loadmat(io.BytesIO(data), variable_names=small)  # type: ignore[arg-type]
    except Exception as error:  # the reader has no error class of its own
        raise UsageError(
            f"{path}: cannot be read as .mat ({error}); save it as version 7 or older, or as CSV"
        ) from None
    columns, scalars = {}, {}
    for name, value in found.items():
        if (
            name.startswith("__")
            or not isinstance(value, np.ndarray)
            or value.dtype.kind not in "fiu"
        ):
            continue
        if value.size == 1:
            scalars[name] = float(value.ravel()[0])
        elif value.ndim <= 2 and min(value.shape) == 1:
            columns[name] = np.asarray(value, float).ravel()
    if not columns:
        raise UsageError(f"{path}: holds no vector of numbers")
    return Table(path, columns, {}, scalars, 1)


def _csv(path: Path, text: str) -> Table:
    lines = text.splitlines()
    delimiter, first = _layout(path, lines)
    decimal_comma = delimiter != "," and any(
        re.search(r"\d,\d", line) for line in lines[first : first + 20]
    )
    rows = list(csv.reader(lines[:first], delimiter=delimiter))
    header, units = _header(path, rows, len(next(csv.reader([lines[first]], delimiter=delimiter))))
    cells = []
    body = csv.reader(lines[first:], delimiter=delimiter, quoting=csv.QUOTE_NONE)
    for number, row in enumerate(body, first + 1):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) < len(header):
            raise UsageError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}")
        for name, cell in zip(header, row, strict=False):
            try:
                cells.append(float(cell.replace(",", ".") if decimal_comma else cell))
            except ValueError:
                raise UsageError(
                    f"{path}: row {number}, column '{name}': '{cell.strip()[:40]}' is no number"
                ) from None
    matrix = np.array(cells).reshape(-1, len(header))
    return Table(path, {n: matrix[:, k] for k, n in enumerate(header)}, units, {}, first + 1)


def _layout(path: Path, lines: list[str]) -> tuple[str, int]:
    """Delimiter, and index of the first of several rows of numbers."""
    for delimiter in (";", "\t", ",", " "):
        for first in range(min(len(lines) - 2, _SEARCHED)):
            block = lines[first : first + 3]
            widths = {_numbers(line, delimiter) for line in block}
            if len(widths) == 1 and widths.pop() >= 2:
                return delimiter, first
    rows = sum(any(_numbers(line, d) >= 2 for d in ";\t,") for line in lines[:_SEARCHED])
    if 0 < rows < 3:
        raise UsageError(
            f"{path}: has {rows} row{'s' if rows > 1 else ''} of numbers; a measurement needs "
            "hundreds"
        )
    raise UsageError(
        f"{path}: has no rows of numbers within its first {_SEARCHED} lines; a recording is CSV "
        "with a header and two columns or more"
    )


def _numbers(line: str, delimiter: str) -> int:
    """How many cells a row has if each is a number, else 0."""
    cells = [cell.strip() for cell in line.split(delimiter)]
    if delimiter != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        for cell in cells:
            float(cell)
    except ValueError:
        return 0
    return len(cells)


def _header(path: Path, rows: list[list[str]], width: int) -> tuple[list[str], dict[str, str]]:
    """Names of the columns, and their units where the row below the names holds units."""
    last = [row for row in rows if any(cell.strip() for cell in row)]
    if not last or len(last[-1]) != width:
        raise UsageError(f"{path}: has no header above its {width} columns of numbers")
    names = [cell.strip() for cell in last[-1]]
    units: dict[str, str] = {}
    if (
        len(last) > 1
        and len(last[-2]) == width
        and all(name in UNITS or name == "%" for name in names)
    ):
        above = [cell.strip() for cell in last[-2]]
        merged = [name or unit for name, unit in zip(above, names, strict=True)]
        units = dict(zip(merged, names, strict=True))
        names = merged
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f"{path}: the column '{twice}' stands there twice")
    return names, units


def read(table: Table, named: dict[str, Column | None]) -> Recording:
    """The table in SI, checked; raises UsageError naming row, column or condition."""
    found: dict[str, Array | None] = {}
    linear: dict[str, bool] = {}
    for quantity in ("time", "position", "velocity", "torque"):
        column = named.get(quantity) or _default(table, quantity)
        if column is None:
            found[quantity] = None
            continue
        found[quantity], is_linear = _values(table, column, quantity)
        if is_linear is not None:
            linear[quantity] = is_linear
    time, torque = found["time"], found["torque"]
    for quantity, values in (("time", time), ("torque", torque)):
        if values is None:
            raise UsageError(_missing(table, quantity))
    if found["position"] is None and found["velocity"] is None:
        raise UsageError(_missing(table, "position"))
    assert time is not None
    assert torque is not None
    if len(set(linear.values())) > 1:
        kinds = ", ".join(f"{q} {'linear' if k else 'rotary'}" for q, k in linear.items())
        raise UsageError(f"{table.path}: units of a rotary and of a linear axis are mixed: {kinds}")
    _check(table, time, torque, found["position"], found["velocity"])
    return Recording(
        time, torque, found["position"], found["velocity"], _sent(table, named, time),
        any(linear.values()), _analysed(table),
        table.columns.get("lateness_s"),
    )  # fmt: skip


def _analysed(table: Table) -> NDArray[np.bool_] | None:
    """Which samples our own exports say that the run was analysed by."""
    told = table.columns.get("analysed")
    if told is None or "sent_s" not in table.columns:
        return None
    mask = np.asarray(told == 1, bool)
    return mask if np.count_nonzero(mask) >= _FEWEST else None


def _sent(table: Table, named: dict[str, Column | None], time: Array) -> Array:
    """When each torque was commanded: the column `sent_s` of our own exports, else `time`."""
    sent = table.columns.get("sent_s")
    if sent is None or named.get("torque") or named.get("time"):
        return time
    if len(sent) != len(time) or not np.all(np.isfinite(sent)) or np.any(np.diff(sent) <= 0):
        raise UsageError(
            f"{table.path}: column 'sent_s' must be finite and increase from row to row, as "
            "'time_s'"
        )
    return sent


def _default(table: Table, quantity: str) -> Column | None:
    for name in _DEFAULTS[quantity]:
        if name in table.columns:
            unit = name.partition("_")[2]
            return Column(name, UNITS[unit][1], UNITS[unit][2])
    named = [name for name, unit in table.units.items() if UNITS.get(unit, ("",))[0] == quantity]
    return Column(named[0], None, None) if len(named) == 1 else None


def _values(table: Table, column: Column, quantity: str) -> tuple[Array, bool | None]:
    values = table.columns.get(column.name)
    if values is None:
        raise UsageError(
            f"{table.path}: no column '{column.name}'; there are: {', '.join(table.columns)[:300]}"
        )
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise UsageError(
            f"{table.path}: row {table.first_row + int(bad[0])}, column '{column.name}': "
            f"{values[bad[0]]} is no finite number ({len(bad)} such cells)"
        )
    if column.factor is not None:
        return values * column.factor, column.linear
    unit = table.units.get(column.name) or column.name.rpartition("_")[2]
    what, factor, is_linear = UNITS.get(unit, ("", 1.0, None))
    if what != quantity:
        example = {"time": "s", "position": "rad", "velocity": "rpm", "torque": "0.001 Nm"}[
            quantity
        ]
        raise UsageError(
            f"{table.path}: the unit of column '{column.name}' is not known: "
            f"--{quantity} '{column.name}:{example}'"
        )
    return values * factor, is_linear


def _missing(table: Table, quantity: str) -> str:
    wanted = " or ".join(f"'{name}'" for name in _DEFAULTS[quantity])
    return (
        f"{table.path}: no column {wanted}; name yours: --{quantity} COLUMN:UNIT. There are: "
        f"{', '.join(table.columns)[:300]}"
    )


def _check(
    table: Table, time: Array, torque: Array, position: Array | None, velocity: Array | None
) -> None:
    path, first = table.path, table.first_row
    lengths = {len(v) for v in (time, torque, position, velocity) if v is not None}
    if len(lengths) > 1:
        raise UsageError(f"{path}: its columns have different lengths: {sorted(lengths)}")
    if len(time) < _FEWEST:
        raise UsageError(f"{path}: has {len(time)} samples; a measurement needs hundreds")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        k = int(back[0])
        raise UsageError(
            f"{path}: row {first + k + 1}: time goes from {time[k]:.6g} s to {time[k + 1]:.6g} s; "
            "it must increase from row to row"
        )
    steps = np.diff(time)
    if steps.max() > _LONGEST_GAP * float(np.median(steps)):
        k = int(steps.argmax())
        raise UsageError(
            f"{path}: row {first + k + 1}: a gap of {steps[k]:.3g} s, where the usual step is "
            f"{np.median(steps):.3g} s; cut the recording there"
        )
    if not np.any(np.diff(torque)):
        raise UsageError(
            f"{path}: the torque is constant at {torque[0]:.4g} in all rows: it excites nothing, "
            "or the wrong column was taken"
        )
    _absurd(path, "step", float(np.median(np.diff(time))), "time steps of {:.3g} s")
    _absurd(path, "torque", float(np.abs(torque).max()), "a torque of {:.3g} N.m or N")
    if position is not None:
        if not np.any(np.diff(position)):
            raise UsageError(f"{path}: the position never changes: the axis was not moved")
        speed = float(np.quantile(np.abs(np.diff(position) / np.diff(time)), 0.95))
        _absurd(path, "speed", speed, "a speed of {:.3g} rad/s or m/s")


def _absurd(path: Path, kind: str, value: float, text: str) -> None:
    low, high, hint = _LIMITS[kind]
    if not low <= value <= high:
        raise UsageError(f"{path}: {text.format(value)} is no servo axis; {hint}")
