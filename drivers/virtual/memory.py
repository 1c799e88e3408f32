"""Non-volatile memory of a virtual drive: what `store` keeps over a power-off."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

from profiles.files import contents, replace

__all__ = ["Memory"]

_LARGEST = 1_000_000  # bytes


class Memory:
    """Named raw values in a JSON file, or in no file at all (`path` None).

    A damaged file reads as empty: the drive starts with its defaults, as a real one does.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._values: dict[str, int] = {}
        if path is not None:
            with contextlib.suppress(OSError, ValueError):
                found = json.loads(contents(path, _LARGEST))
                if isinstance(found, dict):
                    self._values = {
                        str(key): value for key, value in found.items() if type(value) is int
                    }

    def load(self) -> dict[str, int]:
        """All values that were saved."""
        return dict(self._values)

    def save(self, values: dict[str, int]) -> None:
        """Replace everything by `values`, all or nothing; raises OSError."""
        self._values = dict(values)
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace(self.path, json.dumps(self._values, indent=1, sort_keys=True).encode())
