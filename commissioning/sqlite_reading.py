"""A journal that is read and not written, from wherever it lies.

Also where nothing can be written.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from pathlib import Path
from urllib.parse import quote

__all__ = ["read_only"]


def read_only(path: Path, clean_up: contextlib.ExitStack) -> sqlite3.Connection:
    """A connection to the SQLite file `path` that writes nothing there.

    Raises OSError, sqlite3.Error.

    A journal is written ahead: beside it lie files that SQLite makes anew where they are missing.
    Where it cannot, a file that nobody has open is read as it is, and one with something in its
    `-wal` as a copy, which `clean_up` removes.
    """
    try:
        return _opened(path, "mode=ro")
    except sqlite3.OperationalError:
        ahead = path.with_name(path.name + "-wal")
        if not ahead.exists() or not ahead.stat().st_size:
            return _opened(path, "immutable=1")
    folder = Path(clean_up.enter_context(tempfile.TemporaryDirectory(prefix="tworelay-")))
    for file in (path, ahead):
        shutil.copyfile(file, folder / file.name)
    return _opened(folder / path.name, "mode=rw")


def _opened(path: Path, how: str) -> sqlite3.Connection:
    name = quote(str(path.absolute()).replace("\\", "/"))
    db = sqlite3.connect(f"file:{name}?{how}", timeout=10, isolation_level=None, uri=True)
    try:
        db.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()
    except sqlite3.Error:
        db.close()
        raise
    return db
