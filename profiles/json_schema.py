"""JSON Schema of a drive profile, for editors: `python -m profiles.json_schema` prints it.

A profile that extends another one may leave out whatever that one has, so nothing is required of
it.
"""

from __future__ import annotations

import json
from typing import Any

from profiles.schema import Profile

__all__ = ["json_schema"]

_VARIANT = {
    "extends": {"type": "string", "description": "Built-in profile that this one stands on."},
    "without": {
        "type": "array", "items": {"type": "string"},
        "description": "Sections and parameters of that profile that this drive does not have.",
    },
}  # fmt: skip


def json_schema() -> dict[str, Any]:
    """The schema (draft 2020-12)."""
    whole = Profile.model_json_schema(by_alias=True)
    definitions = whole.pop("$defs")
    variant = _renamed(whole)
    variant["properties"] |= _VARIANT
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "tworelay drive profile",
        "type": "object",
        "if": {"required": ["extends"]},
        "then": variant,
        "else": whole,
        "$defs": definitions | {f"Part.{name}": _renamed(d) for name, d in definitions.items()},
    }


def _renamed(node: Any) -> Any:
    """A schema with nothing required, all the way down."""
    if isinstance(node, list):
        return [_renamed(item) for item in node]
    if not isinstance(node, dict):
        return node
    return {
        key: f"#/$defs/Part.{value.rsplit('/', 1)[1]}" if key == "$ref" else _renamed(value)
        for key, value in node.items()
        if key != "required"
    }


if __name__ == "__main__":
    print(json.dumps(json_schema(), indent=1))  # noqa: T201
