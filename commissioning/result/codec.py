"""Results to and from JSON: the only place that knows keys. Reads tworelay.run/1 and /2, writes /2.

A file of a run is anybody's: it has the types and ranges of `document`, or it is refused with the
place that is wrong.
"""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from commissioning.result.document import SCHEMA, RunResult
from commissioning.result.found import QUANTITIES
from commissioning.result.kinds import LONGEST_TEXT
from profiles.errors import UsageError
from profiles.plain import plain_tree

__all__ = [
    "Curves",
    "closed",
    "decode",
    "encode",
    "first_error",
    "printable",
    "schema",
    "text_of",
    "tree_of",
]

Tree = dict[str, Any]
Curves = dict[
    str, tuple[tuple[float, ...], ...]
]  # pictures' columns by name: they lie beside the result

_NUMBERS = (*QUANTITIES, "lag", "low_speed")
_UNITS = {"low_speed": "coulomb", "lag": "dead_time"}  # of the quantity that it is one of
_BEFORE = "tworelay.run/1"
_WRONG = TypeError, ValueError, AttributeError, LookupError, ArithmeticError, RecursionError


@cache
def _adapter() -> TypeAdapter[RunResult]:
    return TypeAdapter(RunResult)


# -- out ------------------------------------------------------------------------------------------


def encode(result: RunResult) -> Tree:
    """The result as a tree for JSON."""
    tree: Tree = tree_of(result)
    for name in _NUMBERS:
        if tree["friction"][name] is None:
            unit = result.units.of_quantity(_UNITS.get(name, name))
            tree["friction"][name] = _not_measured(unit)
    tree["methods"] = {
        name.replace("_", "-"): reading
        for name, reading in tree["methods"].items()
        if reading is not None
    }
    return tree


def tree_of(value: Any) -> Any:
    """A part of a result as JSON has it."""
    if is_dataclass(value):
        return {field.name: tree_of(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return [tree_of(item) for item in value]
    if isinstance(value, BaseModel):
        return value.model_dump()
    return str(value) if isinstance(value, StrEnum) else value


def printable(result: RunResult) -> RunResult:
    """A tree whose texts act on no screen, printer or browser."""
    return decode(_short(plain_tree(encode(result))), f"run {result.run}")[0]


def _short(tree: Any) -> Any:
    """A tree whose texts, longer by their escapes, are texts of ours still."""
    if isinstance(tree, dict):
        return {key: _short(item) for key, item in tree.items()}
    if isinstance(tree, list):
        return [_short(item) for item in tree]
    return tree[:LONGEST_TEXT] if isinstance(tree, str) else tree


def _not_measured(unit: str) -> Tree:
    return {"value": None, "low": None, "high": None, "unit": unit, "raw": None, "raw_unit": None}


def text_of(result: RunResult) -> str:
    """The result as JSON, in ASCII."""
    return json.dumps(encode(result), indent=1, allow_nan=False) + "\n"


# -- in -------------------------------------------------------------------------------------------


def decode(tree: Any, origin: str) -> tuple[RunResult, Curves]:
    """A result, and the curves that /1 has in it; raises UsageError."""
    named = tree.get("schema") if isinstance(tree, dict) else None
    if named not in (_BEFORE, SCHEMA):
        raise UsageError(f"{origin}: is no result of tworelay")
    try:
        curves: Curves = {}
        if named == _BEFORE:
            tree = _upgraded(tree, curves)
        tree = {**tree, "friction": dict(tree["friction"]), "methods": dict(tree["methods"])}
        for name in _NUMBERS:
            if (number := tree["friction"].get(name)) and number["value"] is None:
                tree["friction"][name] = None
        tree["methods"] = {n.replace("-", "_"): reading for n, reading in tree["methods"].items()}
        watched = tree.get("experiment")
        span = watched.get("analysed") if isinstance(watched, dict) else None
        if span is None or (span and not isinstance(span[0], list)):  # one stretch, before 2026-11
            spans = [] if span is None else [span]
            tree["experiment"] = watched and {**watched, "analysed": spans}
        return _adapter().validate_json(json.dumps(tree)), curves
    except ValidationError as error:
        raise UsageError(f"{origin}: is damaged: {first_error(error)}") from None
    except LookupError as error:
        raise UsageError(f"{origin}: is damaged: it lacks {error}") from None
    except _WRONG as error:
        raise UsageError(f"{origin}: is damaged ({type(error).__name__}: {error})") from None


def first_error(error: ValidationError) -> str:
    """Where a tree is wrong first, and what it must be."""
    one = error.errors(include_url=False, include_context=False, include_input=False)[0]
    where = ".".join(str(part)[:40] for part in one["loc"]) or "it"
    wanted = one["msg"].replace("Input should", "must").replace("Value error, ", "lacks ")
    return f"'{where}' {'must be there' if one['type'] == 'missing' else wanted}"


# -- from /1 --------------------------------------------------------------------------------------

_SAME = (
    "status", "run", "axis", "link", "profile", "identity", "units", "critical_point",
    "host_compensation", "notes",
)  # fmt: skip
_SETUP = "turnaround", "loop_lag", "resolution", "bases", "first_look"


def _upgraded(old: Tree, curves: Curves) -> Tree:
    """/1 as /2; columns of pictures go to `curves`."""
    new = {key: old[key] for key in _SAME if key in old} | {"schema": SCHEMA}
    methods = {name: dict(reading) for name, reading in old["methods"].items()}
    friction = dict(old["friction"])
    for reading in methods.values():
        curve = reading.pop("curve", None)
        if curve is not None and old["quality"]["verdict"] != "rejected":
            friction["curve"] = curve
    new |= {"friction": friction, "methods": methods}
    new["compensation"] = old["compensation"]
    new["tuning"] = [_gains_of_1(one, curves) for one in old["tuning"]]
    new["experiment"] = _experiment_of_1(old["experiment"])
    verdict = old["quality"]["verdict"]
    measured = any(friction[name]["value"] is not None for name in QUANTITIES)
    new["quality"] = {
        "verdict": verdict if measured or old["status"] == "rejected" else None,
        "reasons": [
            {"code": "", "weight": "note", "text": text} for text in old["quality"]["reasons"]
        ],
    }
    new["verification"] = _verification_of_1(old.get("verification"), curves)
    new["written"] = [
        _written_of_1(item, kind)
        for kind, items in (
            (
                "compensation",
                [
                    c
                    for c in old["compensation"]
                    if c.get("written") and c["old_raw"] != c["new_raw"]
                ],
            ),
            ("gain", [c for s in old["tuning"] if s.get("written") for c in s["parameters"]]),
        )
        for item in items
    ]
    return new


def _written_of_1(item: Tree, kind: str) -> Tree:
    return {
        "parameter": item["parameter"], "kind": kind, "raw": item["new_raw"], "value": item["new"],
        "unit": item["unit"],
    }  # fmt: skip


def _gains_of_1(one: Tree, curves: Curves) -> Tree:
    new = {**one, "gains": one["gains"] or {}}
    if one["step"]:
        step = dict(one["step"])
        columns = step.pop("time", None), step.pop("position", None)
        if all(columns):
            curves[f"step.{one['loop']}.{one['rule']}.{one['source']}"] = _columns(columns)
        new["step"] = step
    return new


def _verification_of_1(old: Tree | None, curves: Curves) -> Tree | None:
    if old is None:
        return None
    steps = []
    for number, one in enumerate(old["steps"]):
        step = dict(one)
        trace = step.pop("trace")
        curves[f"verify.{number}"] = _columns([trace[n] for n in ("time", "command", "error")])
        steps.append(step)
    before = steps[0]["reversal_error"]
    kept = [step["reversal_error"] for step in steps if step["kept"]]
    percent = 100 * (1 - kept[0] / before) if kept and before else None
    return {
        "unit": old["unit"], "steps": steps, "kept_fraction": old.get("kept_fraction"),
        "percent": percent,
    }  # fmt: skip


def _columns(rows: Any) -> tuple[tuple[float, ...], ...]:
    """Columns of finite numbers, of one length; raises ValueError."""
    columns = tuple(tuple(float(value) for value in row) for row in rows)
    if len({len(column) for column in columns}) != 1:
        raise ValueError("a picture's columns are not of one length")
    if not all(abs(value) < 1e300 for column in columns for value in column):
        raise ValueError("a picture's columns hold what is no finite number")
    return columns


def _experiment_of_1(old: Tree | None) -> Tree | None:
    if old is None:
        return None
    new = {key: value for key, value in old.items() if key not in (*_SETUP, "cycles", "spans")}
    new["cycles"] = [
        {**cycle, "begin": begin, "end": end}
        for cycle, (begin, end) in zip(old.get("cycles") or (), old.get("spans") or (), strict=True)
    ]
    if old.get("first_look") and all(key in old for key in ("turnaround", "resolution", "bases")):
        new["setup"] = {key: old[key] for key in _SETUP if key in old}
    return new


# -- the schema -----------------------------------------------------------------------------------


def closed(tree: Tree) -> Tree:
    """A schema by which everything is there, and nothing else."""
    for kind in (tree, *tree["$defs"].values()):
        if kind.get("type") == "object" and "properties" in kind:
            kind["required"] = list(kind["properties"])
            kind["additionalProperties"] = False
    return tree


def schema() -> Tree:
    """JSON Schema of what `encode` gives."""
    tree = closed(_adapter().json_schema(mode="serialization"))
    kinds = tree["$defs"]
    number = {
        **kinds["Quantity"],
        "description": "Not measured: only its unit is said.",
        "properties": {
            name: {**kind, "type": "null"} if name not in ("unit",) else kind
            for name, kind in kinds["Quantity"]["properties"].items()
        },
    }
    for kind in number["properties"].values():
        kind.pop("anyOf", None)
    kinds["NotMeasured"] = number
    for name in _NUMBERS:
        kinds["Found"]["properties"][name] = {
            "anyOf": [{"$ref": "#/$defs/Quantity"}, {"$ref": "#/$defs/NotMeasured"}]
        }
    methods = kinds["Methods"]
    methods["properties"] = {
        name.replace("_", "-"): next(one for one in kind["anyOf"] if "$ref" in one)
        for name, kind in methods["properties"].items()
    }
    methods["required"] = []
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **tree,
        "title": "Result of a tworelay run",
        "description": "SI units, ASCII names. Not measured is null, never 0.",
    }


if __name__ == "__main__":
    print(json.dumps(schema(), indent=1))  # noqa: T201
