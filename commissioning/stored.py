"""Files of a run are anybody's: what they hold is looked at when it is read, before anything relies on it.

A result or a journal has the types and the ranges that tworelay writes, or it is refused with the place that
is wrong. Numbers are finite; what older versions did not write may be missing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from profiles.errors import UsageError
from profiles.files import contents

__all__ = [
    "END_OF_TIME",
    "checked_intents",
    "checked_journal",
    "checked_result",
    "checked_run",
    "json_file",
]

LARGEST = 20_000_000  # bytes
_LONGEST = 10_000  # characters of a text
_LARGEST_NUMBER = 1e300
END_OF_TIME = 253_402_300_800.0  # s since 1970, the year 10000

Check = Callable[[Any, str], None]
T = TypeVar("T")


class _Wrong(ValueError):
    """What is not as it must be, and where."""


def _fail(where: str, wanted: str) -> None:
    raise _Wrong(f"'{where or 'it'}' must be {wanted}")


def _number(value: Any, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        _fail(where, "a number")
    if not abs(value) < _LARGEST_NUMBER:  # also nan
        _fail(where, "a finite number")


def _positive(value: Any, where: str) -> None:
    _number(value, where)
    if not value > 0:
        _fail(where, "positive")


def _share(value: Any, where: str) -> None:
    _number(value, where)
    if not 0 <= value <= 1:
        _fail(where, "a share from 0 to 1")


def _count(value: Any, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 31:
        _fail(where, "a whole number from 0 on")


def _raw(value: Any, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int):
        raise _Wrong(f"'{where}' is invalid: a raw value is a whole number")
    if abs(value) >= 1 << 63:
        raise _Wrong(f"'{where}' is too large for a drive: it has 64 bits at most")


def _instant(value: Any, where: str) -> None:
    _number(value, where)
    if not 0 <= value < END_OF_TIME:
        _fail(where, "a time in s since 1970, before the year 10000")


def _text(value: Any, where: str) -> None:
    if not isinstance(value, str):
        raise _Wrong(f"'{where}' is no text")
    if len(value) > _LONGEST:
        _fail(where, f"at most {_LONGEST} characters long")
    try:
        value.encode()
    except UnicodeEncodeError:
        _fail(where, "a text of whole characters")


def _flag(value: Any, where: str) -> None:
    if not isinstance(value, bool):
        _fail(where, "true or false")


def _anything(value: Any, where: str) -> None:
    """Any tree of our own making: its numbers are finite, its texts are texts."""
    if isinstance(value, dict):
        _table(_anything)(value, where)
    elif isinstance(value, list):
        _each(_anything)(value, where)
    elif isinstance(value, str):
        _text(value, where)
    elif value is not None and not isinstance(value, bool):
        _number(value, where)


def _one_of(*known: str) -> Check:
    def check(value: Any, where: str) -> None:
        if not isinstance(value, str) or value not in known:
            _fail(where, f"one of {', '.join(known)}")

    return check


def _or_none(kind: Check) -> Check:
    def check(value: Any, where: str) -> None:
        if value is not None:
            kind(value, where)

    return check


def _each(kind: Check, count: int | None = None) -> Check:
    def check(value: Any, where: str) -> None:
        if not isinstance(value, list):
            _fail(where, "a list")
        if count is not None and len(value) != count:
            _fail(where, f"a list of {count}")
        for k, item in enumerate(value):
            kind(item, f"{where}.{k}")

    return check


def _table(kind: Check) -> Check:
    def check(value: Any, where: str) -> None:
        if not isinstance(value, dict):
            _fail(where, "a table")
        for key, item in value.items():
            _text(key, where)
            kind(item, f"{where}.{key:.40}")

    return check


def _record(must: Mapping[str, Check], may: Mapping[str, Check] | None = None) -> Check:
    """Keys that must be there and keys that may be; any other holds anything of ours."""
    known = {**must, **(may or {})}

    def check(value: Any, where: str) -> None:
        _table(lambda _, __: None)(value, where)
        for key in must:
            if key not in value:
                _fail(f"{where}.{key}".lstrip("."), "there")
        for key, item in value.items():
            known.get(key, _anything)(item, f"{where}.{key:.40}".lstrip("."))

    return check


def _columns(*names: str) -> Check:
    """Lists of numbers, of one length."""

    def check(value: Any, where: str) -> None:
        _record(dict.fromkeys(names, _each(_number)))(value, where)
        if len({len(value[name]) for name in names}) != 1:
            _fail(where, "lists of one length")

    return check


_maybe = _or_none(_number)
_estimate = _record(
    {"value": _maybe, "low": _maybe, "high": _maybe, "unit": _text},
    {"raw": _maybe, "raw_unit": _or_none(_text)},
)
_point = _or_none(
    _record(
        {
            "gain": _positive, "phase_deg": _number, "period": _positive, "ku": _maybe,
            "how": _one_of("measured", "computed"),
        },
        {
            "gain_low": _maybe, "gain_high": _maybe, "phase_low_deg": _maybe, "phase_high_deg": _maybe,
            "travel_needed": _maybe,
        },
    )
)  # fmt: skip
_change = {
    "parameter": _text, "new": _number, "unit": _text, "rounded_by": _number, "new_raw": _raw,
}  # fmt: skip
_step = _record(
    {"overshoot": _number, "settling": _maybe, "error": _number, "hunting": _number},
    {"size": _number, "time": _each(_number), "position": _each(_number)},
)
_gain_set = _record(
    {
        "rule": _text, "loop": _one_of("host", "drive"), "source": _one_of("naive", "corrected"),
        "gains": _or_none(_table(_maybe)), "phase_margin_deg": _maybe, "gain_margin_db": _maybe,
        "ms": _maybe, "stable": _or_none(_flag), "crossover": _maybe, "bandwidth": _maybe,
        "step": _or_none(_step), "proposed": _flag, "best": _flag, "why_not": _text,
        "parameters": _each(_record(_change, {"raw_unit": _text})),
    },
    {
        "point": _or_none(_record({"gain": _number, "phase_deg": _number, "period": _number})),
        "written": _flag,
    },
)  # fmt: skip


def _gains(value: Any, where: str) -> None:
    """Gains of one rule: with what they are worth where there are any, else not proposed."""
    _gain_set(value, where)
    if value["gains"] is None:
        if value["proposed"] or value["best"]:
            _fail(f"{where}.gains", "there where they are proposed")
        return
    _number(value["ms"], f"{where}.ms")
    _flag(value["stable"], f"{where}.stable")


_cycle = _record(
    {
        "name": _text, "relay_amplitude": _maybe, "hysteresis": _maybe, "bias": _maybe,
        "period": _positive, "half_swing": _maybe, "fundamental": _maybe, "duty": _maybe,
        "periods": _maybe,
    },
    {"settled": _flag},
)  # fmt: skip
_experiment = _record(
    {
        "periods": _number, "duration": _number, "cycle": _positive, "late_share": _number,
        "lost_share": _number, "travel": _number,
    },
    {
        "cycles": _each(_cycle), "complex_coulomb": _or_none(_each(_number, 2)),
        "spans": _each(_each(_number, 2)), "tests": _count, "repeats": _each(_number),
        "turnaround": _maybe, "loop_lag": _maybe, "resolution": _maybe, "bases": _table(_maybe),
        "limits": _record({"travel": _positive, "torque": _positive, "speed": _positive}),
        "first_look": _or_none(_table(_maybe)),
    },
)  # fmt: skip
_trial = _record(
    {
        "fraction": _number, "reversal_error": _number, "low_speed_error": _number,
        "rest_swing": _number, "hunts": _flag, "kept": _flag,
        "trace": _columns("time", "command", "error"),
    }
)  # fmt: skip
_result = _record(
    {
        "schema": _one_of("tworelay.run/1"),
        "status": _one_of("completed", "stopped", "failed", "refused", "rejected"),
        "run": _or_none(_text), "axis": _text, "link": _or_none(_text),
        "units": _record({"position": _one_of("rad", "m"), "effort": _text}, {"gain": _text}),
        "friction": _record(
            {
                "method": _or_none(_text), "coulomb": _estimate, "offset": _estimate,
                "viscous": _estimate, "inertia": _estimate, "dead_time": _estimate,
            }
        ),
        "methods": _table(_table(_anything)),
        "tuning": _each(_gains),
        "compensation": _each(
            _record(
                {**_change, "old": _number, "old_raw": _raw, "why": _text},
                {"raw_unit": _text, "written": _flag},
            )
        ),
        "quality": _record(
            {"verdict": _one_of("good", "usable", "rejected"), "reasons": _each(_text)}
        ),
        "experiment": _or_none(_experiment),
    },
    {
        "profile": _or_none(_record({"name": _text, "version": _text, "hash": _text})),
        "identity": _or_none(
            _record({"vendor": _text, "product": _text, "revision": _text, "serial": _text})
        ),
        "critical_point": _or_none(
            _record(
                dict.fromkeys(
                    ("naive", "hysteresis", "corrected", "measured", "at_180", "at_135"), _point
                )
            )
        ),
        "host_compensation": _or_none(
            _record(
                {
                    "parameter": _text, "address": _text, "offset": _number, "coulomb": _number,
                    "unit": _text, "offset_raw": _raw, "coulomb_raw": _raw, "raw_unit": _text,
                }
            )
        ),
        "verification": _or_none(
            _record(
                {"unit": _one_of("rad", "m"), "steps": _each(_trial)}, {"kept_fraction": _maybe}
            )
        ),
        "notes": _each(_text),
    },
)  # fmt: skip
_MOST_INTENTS = 10_000


def _few(kind: Check, most: int) -> Check:
    def check(value: Any, where: str) -> None:
        if isinstance(value, list) and len(value) > most:
            _fail(where, f"a list of at most {most}")
        _each(kind)(value, where)

    return check


_intents = _few(
    _record(
        {
            "kind": _one_of("experiment", "compensation", "gain"), "parameter": _text,
            "old": _raw, "new": _raw, "state": _one_of("intended", "verified", "restored"),
        }
    ),
    _MOST_INTENTS,
)  # fmt: skip
_context = _record(
    {}, {"axis": _table(_anything), "fraction": _share, "pid": _or_none(_count), "started": _maybe}
)
_run = _record(
    {
        "id": _text, "created": _instant, "axis": _text, "link": _text, "profile": _text,
        "profile_hash": _text, "serial": _text, "status": _text, "context": _context,
    }
)  # fmt: skip
_journal = _record(
    {
        "schema": _one_of("tworelay.journal/1"),
        "run": _run,
        "intents": _intents,
    },
    {"events": _each(_record({"at": _instant, "text": _text}))},
)  # fmt: skip


def checked_result(tree: Any, origin: str) -> dict[str, Any]:
    """The result JSON of a run, as it is; raises UsageError."""
    if not isinstance(tree, dict) or tree.get("schema") != "tworelay.run/1":
        raise UsageError(f"{origin}: is no result of tworelay")
    return _checked(_result, tree, origin)


def checked_journal(tree: Any, origin: str) -> dict[str, Any]:
    """The journal of an exported run, as it is; raises UsageError."""
    if not isinstance(tree, dict) or tree.get("schema") != "tworelay.journal/1":
        raise UsageError(f"{origin}: is no exported run (its schema is none of ours)")
    try:
        return {"events": [], **_checked(_journal, tree, origin)}
    except UsageError as error:
        raise UsageError(f"{error}; so it is no exported run that can be read") from None


def checked_run(row: dict[str, Any], origin: str) -> None:
    """Raises UsageError where a run of a journal is not what it must be."""
    _checked(_run, row, origin)


def checked_intents(rows: list[dict[str, Any]], origin: str) -> None:
    """Raises UsageError where intents of a journal are not what they must be."""
    _checked(_intents, rows, origin)


def _checked(check: Check, tree: T, origin: str) -> T:
    try:
        check(tree, "")
    except _Wrong as error:
        raise UsageError(f"{origin}: is damaged: {error}") from None
    except RecursionError:
        raise UsageError(f"{origin}: is damaged: it is nested too deeply") from None
    return tree


def json_file(path: Path) -> Any:
    """What a JSON file of ours holds; raises FileNotFoundError, UsageError."""
    try:
        return json.loads(contents(path, LARGEST, links=False), parse_constant=_no_constant)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is no JSON: {error}") from None


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")
