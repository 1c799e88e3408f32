"""A recording in SI, checked: every error names row, column or what to say."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from commissioning.recordings.table import Array, Table, unit_in
from profiles.errors import UsageError
from profiles.quantities import Kind, UnitOfUse, number, unit_named, units_of

__all__ = ["Column", "Recording", "Scales", "column_of", "read"]

_LONGEST_GAP = 2000  # usual steps
_FEWEST = 50  # samples
_RESTS = 5  # samples in which nothing changes, at the beginning

_KINDS: dict[str, tuple[Kind, ...]] = {
    "time": ("time",), "position": ("position",), "velocity": ("velocity",),
    "torque": ("torque", "current", "share"),
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
class Scales:
    """What turns counts, currents and shares into positions and torques; None: not said.

    Attributes
    ----------
    encoder : increments per revolution, of the position that was recorded
    feed : m per revolution, where that is of a linear axis
    torque_constant : N.m/A or N/A
    rated_torque : N.m or N that are 100 %
    period : s between two rows, where no column is a time
    """

    encoder: float | None = None
    feed: float | None = None
    torque_constant: float | None = None
    rated_torque: float | None = None
    period: float | None = None


@dataclass(frozen=True, slots=True)
class Column:
    """A column as the user names it.

    Attributes
    ----------
    unit : None: by the file
    scale : factor before the unit, or the base of a unit that takes one; None: none was said
    """

    name: str
    unit: UnitOfUse | None
    scale: float | None


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
    """COL, COL:UNIT or COL:SCALE UNIT; a scale may be a scalar of the file.

    Before a unit that takes a base, the scale is the base: 'pos:4096 counts' are 4096 a revolution,
    'I:0.05 A' are 0.05 N.m/A, 'M:1.27 %' are 1.27 N.m at 100 %. Raises UsageError.
    """
    if text is None:
        return None
    name, colon, unit_text = text.rpartition(":")
    if not colon:
        return Column(text, None, None)
    head, _, tail = unit_text.strip().partition(" ")
    scale, unit = None, unit_named(unit_text)
    if unit is None and tail:
        scale, unit = scalars.get(head), unit_named(tail)
        if scale is None and unit is not None:
            try:
                scale = number(head)
            except ValueError:
                raise UsageError(
                    f"--{quantity} {text}: '{head}' is no number; write COLUMN:SCALE UNIT, as in "
                    f"--torque 'current:0.12 A'"
                ) from None
    kinds = _KINDS[quantity]
    if unit is None or unit.kind not in kinds:
        raise UsageError(
            f"--{quantity} {text}: '{unit_text}' is no unit of it; there are {units_of(*kinds)}"
        )
    if scale is not None and (not math.isfinite(scale) or scale == 0):
        raise UsageError(f"--{quantity} {text}: a scale of {scale:g} makes no numbers")
    return Column(name, unit, scale)


def read(table: Table, named: dict[str, Column | None], bases: Scales | None = None) -> Recording:
    """The table in SI, checked; raises UsageError naming row, column or condition."""
    bases = bases or Scales()
    found: dict[str, Array | None] = {}
    linear: dict[str, bool] = {}
    for quantity in ("time", "position", "velocity", "torque"):
        column = named.get(quantity)
        if column is None and not (quantity == "time" and bases.period is not None):
            column = _default(table, quantity)
        if column is None:
            found[quantity] = None
            continue
        found[quantity], is_linear = _values(table, column, quantity, bases)
        if is_linear is not None:
            linear[quantity] = is_linear
    time: Array | None = found["time"]
    torque = found["torque"]
    if time is None and bases.period is not None and torque is not None:
        time = np.arange(len(torque), dtype=float) * bases.period
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
    recording = Recording(
        time,
        torque,
        found["position"],
        found["velocity"],
        _sent(table, named, time),
        any(linear.values()),
        _analysed(table),
        table.columns.get("lateness_s"),
    )
    return _since_it_moves(recording)


def _since_it_moves(recording: Recording) -> Recording:
    """Without the rows before the first change of torque and position, which tell nothing."""
    position, torque = recording.position, recording.torque
    if position is None or recording.analysed is not None:
        return recording
    changes = np.flatnonzero((position != position[0]) | (torque != torque[0]))
    first = int(changes[0]) if len(changes) else 0
    if first < _RESTS or len(position) - first < _FEWEST:
        return recording
    return replace(
        recording, time=recording.time[first:], torque=torque[first:], position=position[first:],
        velocity=None if recording.velocity is None else recording.velocity[first:],
        sent=recording.sent[first:],
        lateness=None if recording.lateness is None else recording.lateness[first:],
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
    """The column of our own names, else the only one in a unit of the quantity; None: neither."""
    for name in _DEFAULTS[quantity]:
        if name in table.columns:
            return Column(name, None, None)
    named = _in_its_unit(table, quantity)
    return Column(named[0], None, None) if len(named) == 1 else None


def _in_its_unit(table: Table, quantity: str) -> list[str]:
    """Columns that the file gives a unit of the quantity."""
    units = {name: unit_named(table.unit(name)) for name in table.columns}
    return [name for name, unit in units.items() if unit and unit.kind in _KINDS[quantity]]


def _values(
    table: Table, column: Column, quantity: str, bases: Scales
) -> tuple[Array, bool | None]:
    name = table.named(column.name)
    values = table.columns[name]
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise UsageError(
            f"{table.path}: row {table.first_row + int(bad[0])}, column '{name}': "
            f"{values[bad[0]]} is no finite number ({len(bad)} such cells)"
        )
    unit = column.unit or unit_named(table.unit(name)) or unit_named(unit_in(name))
    if unit is None or unit.kind not in _KINDS[quantity]:
        example = {"time": "s", "position": "rad", "velocity": "rpm", "torque": "0.001 Nm"}[
            quantity
        ]
        raise UsageError(
            f"{table.path}: the unit of column '{name}' is not known: "
            f"--{quantity} '{name}:{example}'"
        )
    if not unit.base:
        scale = 1.0 if column.scale is None else column.scale
        return values * unit.factor * scale, unit.linear
    factor, is_linear = _by_base(table, name, quantity, unit, column.scale, bases)
    return values * unit.factor * factor, is_linear


_BASES = {
    "encoder": ("encoder", "increments per revolution", "--encoder 4096"),
    "torque constant": ("torque_constant", "N.m/A", "--torque-constant 0.12"),
    "rated torque": ("rated_torque", "N.m at 100 %", "--rated-torque 1.27"),
}


def _by_base(
    table: Table, name: str, quantity: str, unit: UnitOfUse, scale: float | None, bases: Scales
) -> tuple[float, bool | None]:
    """Factor to SI of a unit that takes a base, and the kind of axis; raises UsageError."""
    attribute, what, example = _BASES[unit.base]
    base = getattr(bases, attribute) if scale is None else scale
    if base is None:
        raise UsageError(
            f"{table.path}: column '{name}' is in {unit.name}: what they are is not said; "
            f"{example} ({what}), or --{quantity} '{name}:{example.split()[1]} {unit.name}'"
        )
    if unit.base != "encoder":  # at the motor: by the feed it is a force
        effort = 1.0 if bases.feed is None else 2 * math.pi / bases.feed
        return float(base) * effort, None
    turn = 2 * math.pi if bases.feed is None else bases.feed
    return turn / float(base), bases.feed is not None


def _missing(table: Table, quantity: str) -> str:
    several = _in_its_unit(table, quantity)
    if len(several) > 1:
        return (
            f"{table.path}: which is the {quantity}: {', '.join(several)[:300]}? Say --{quantity} "
            "COLUMN"
        )
    wanted = " or ".join(f"'{name}'" for name in _DEFAULTS[quantity])
    period = ", or say --period 2ms" if quantity == "time" else ""
    return (
        f"{table.path}: no column {wanted}; name yours: --{quantity} COLUMN:UNIT{period}. There "
        f"are: {', '.join(table.columns)[:300]}"
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
