"""Non-volatile memory of a virtual drive: what `store` keeps over a power-off."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

from profiles.errors import UsageError
from profiles.files import contents, replace

__all__ = ["Memory"]

_LARGEST = 1_000_000  # bytes
_SCHEMA = "tworelay.memory/1"
_OF_OLD = {"coulomb_positive", "coulomb_negative", "torque_offset"}  # before there was a schema


class Memory:
    """Named raw values in a JSON file, or in no file at all (`path` None).

    A file that is none of ours reads as empty, as a damaged memory does, and is never written.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._values = (_read(path) if path is not None else None) or {}

    @classmethod
    def at(cls, path: Path) -> Memory:
        """The memory in a file that is absent or ours; raises UsageError."""
        if _is_there(path) and _read(path) is None:
            raise UsageError(
                f"state {path}: is there, and is no memory of a virtual drive: it would be "
                "overwritten. Name another file, or remove this one"
            )
        return cls(path)

    def load(self) -> dict[str, int]:
        """All values that were saved."""
        return dict(self._values)

    def save(self, values: dict[str, int]) -> None:
        """Replace everything by `values`, all or nothing; raises OSError."""
        if self.path is not None:
            if _is_there(self.path) and _read(self.path) is None:
                raise OSError(errno.EEXIST, "is no memory of a virtual drive", str(self.path))
            self.path.parent.mkdir(parents=True, exist_ok=True)
            tree = {"schema": _SCHEMA, **values}
            replace(self.path, json.dumps(tree, indent=1, sort_keys=True).encode())
        self._values = dict(values)


def _is_there(path: Path) -> bool:
    return path.exists() or path.is_symlink()


def _read(path: Path) -> dict[str, int] | None:
    """What our own file holds; None where it is absent or not ours."""
    try:
        found: Any = json.loads(contents(path, _LARGEST))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    ours = found.pop("schema", None) == _SCHEMA or found.keys() >= _OF_OLD
    if not ours or not all(type(value) is int for value in found.values()):
        return None
    return found
