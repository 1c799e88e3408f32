"""TOML file → strict model, with errors that name file, section, key and what is allowed."""

from __future__ import annotations

import difflib
import json
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from profiles.errors import ProfileError
from profiles.files import contents

__all__ = ["load_model", "parse_model", "parse_tree", "read_text", "validated"]

_TAGS = ("canopen", "modbus")  # of addresses, told apart by their keys
_LARGEST = 1_000_000  # bytes; a profile has some kilobytes

M = TypeVar("M", bound=BaseModel)


def load_model(path: Path, model: type[M]) -> M:
    """Read `path` as TOML into `model`.

    Raises ProfileError with one line that says what is wrong.
    """
    return parse_model(read_text(path), model, str(path))


def read_text(path: Path) -> str:
    """Text of a TOML file; raises ProfileError."""
    try:
        return contents(path, _LARGEST).decode("utf-8")
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ProfileError(f"{path}: is not UTF-8 text (byte {error.start})") from None


def parse_model(text: str, model: type[M], origin: str) -> M:
    """Parse TOML `text` into `model`; `origin` is the file name for messages."""
    return validated(parse_tree(text, origin), model, origin)


def parse_tree(text: str, origin: str) -> dict[str, Any]:
    """TOML text as a tree; raises ProfileError."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # no TOML, or a number of thousands of digits
        raise ProfileError(f"{origin}: is not TOML: {error}") from None


def validated(tree: dict[str, Any], model: type[M], origin: str, *, lenient: bool = False) -> M:
    """A tree as a `model`; raises ProfileError. `lenient`: without the keys that are not known."""
    try:
        # JSON mode: strict about types, yet an enumeration is written by its value
        return model.model_validate_json(json.dumps(tree, default=str))
    except ValidationError as error:
        if lenient and _without_unknown(tree, error):
            return validated(tree, model, origin)
        raise ProfileError(f"{origin}: {_explain(error, model)}") from None


def _without_unknown(tree: dict[str, Any], error: ValidationError) -> bool:
    """Take the keys that are not known out of a tree; whether there were any."""
    found = False
    for detail in error.errors(include_url=False):
        if detail["type"] != "extra_forbidden":
            continue
        place: Any = tree
        way, key = detail["loc"][:-1], detail["loc"][-1]
        for part in way:
            if not isinstance(place, dict) or part in place:  # no tag of an address
                place = place[part]
        found |= key in place
        place.pop(key, None)
    return found


def _explain(error: ValidationError, model: type[BaseModel]) -> str:
    """First finding in words: section, key, what is wrong, what is allowed."""
    details = error.errors(include_url=False)
    chosen = next((d for d in details if d["type"] == "extra_forbidden"), details[0])
    path = [str(part) for part in chosen["loc"] if str(part) not in _TAGS]
    section, key = ".".join(path[:-1]), path[-1] if path else ""
    where = f"[{section}] {key}" if section else key
    more = f" (and {len(details) - 1} more)" if len(details) > 1 and not section else ""
    if chosen["type"] == "extra_forbidden":
        allowed = _allowed_keys(model, [str(part) for part in chosen["loc"][:-1]])
        near = difflib.get_close_matches(key, allowed, 1)
        hint = f", did you mean '{near[0]}'?" if near else f"; allowed: {', '.join(allowed)}"
        return f"{where}: unknown key{hint}"
    message = chosen["msg"].removeprefix("Value error, ")
    if chosen["type"] == "missing":
        message = "is missing"
    elif chosen["type"] not in ("value_error",):
        message = f"{message[0].lower()}{message[1:]}, not {chosen['input']!r:.60}"
    return (f"{where}: " if where else "") + message + more


def _allowed_keys(model: type[BaseModel], path: list[str]) -> list[str]:
    """Keys that the model at `path` has."""
    current: Any = model
    for part in path:
        if isinstance(current, type) and issubclass(current, BaseModel):
            by_alias = {(f.alias or n): f.annotation for n, f in current.model_fields.items()}
            current = by_alias.get(part, current)
        models = _models_in(current)
        named = [m for m in models if m.__name__.lower().startswith(part)]
        current = (named or models or [current])[0]
    if isinstance(current, type) and issubclass(current, BaseModel):
        return sorted(f.alias or n for n, f in current.model_fields.items())
    return []


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Every model that an annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    found: list[type[BaseModel]] = []
    for argument in getattr(annotation, "__args__", ()):
        found += _models_in(argument)
    return found
