"""Fleet results to and from JSON: tworelay.fleet/1."""

from __future__ import annotations

import json
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from commissioning.result.codec import closed, first_error, tree_of
from commissioning.result.fleet import FleetResult

__all__ = ["fleet_schema", "fleet_text", "json_of", "of_json"]

T = TypeVar("T")


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def json_of(part: Any) -> str:
    """A part of a fleet result, for a row of the ledger."""
    return json.dumps(tree_of(part), allow_nan=False)


def of_json(text: str, kind: type[T]) -> T:
    """A part as it was written; raises ValueError with the place that is wrong."""
    try:
        kinds: Any = kind
        found: T = _adapter(kinds).validate_json(text)
    except ValidationError as error:
        raise ValueError(first_error(error)) from None
    return found


def fleet_text(result: FleetResult) -> str:
    """The result as JSON, in ASCII."""
    return json.dumps(tree_of(result), indent=1, allow_nan=False) + "\n"


def fleet_schema() -> dict[str, Any]:
    """JSON Schema of what `fleet_text` gives."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **closed(_adapter(FleetResult).json_schema(mode="serialization")),
        "title": "A tworelay fleet run",
        "description": "SI units, ASCII names. Not measured is null, never 0.",
    }


if __name__ == "__main__":
    print(json.dumps(fleet_schema(), indent=1))  # noqa: T201
