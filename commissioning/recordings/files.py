"""A recording of any tool as a table, by what its file is."""

from __future__ import annotations

from pathlib import Path

from commissioning.recordings.arrays import table_of_mat, table_of_npy, table_of_npz
from commissioning.recordings.table import LARGEST, Table
from commissioning.recordings.text import table_of_text
from profiles.errors import UsageError
from profiles.files import contents

__all__ = ["table_of"]


def table_of(path: Path) -> Table:
    """Read a file as a table; raises UsageError."""
    try:
        data = contents(path, LARGEST)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    readers = {".mat": table_of_mat, ".npz": table_of_npz, ".npy": table_of_npy}
    return readers.get(path.suffix.lower(), table_of_text)(path, data)
