"""The journal's file: its tables, how it is opened, and why it cannot be written."""

from __future__ import annotations

import re
import sqlite3
import time
import unicodedata
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Self

from commissioning.errors import JournalError
from commissioning.sqlite_reading import read_only
from profiles.errors import UsageError

__all__ = ["OpenJournal", "slug"]

TRIES, PAUSE = 200, 0.05  # s: until another process has opened the file
SCHEMA_VERSION = 1
UNWRITABLE = {  # primary result codes of SQLite: of permissions, of others, and of the disk
    sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_CANTOPEN,
}  # fmt: skip
SCHEMA = """
CREATE TABLE IF NOT EXISTS runs (
    id TEXT PRIMARY KEY, created REAL NOT NULL, axis TEXT NOT NULL, link TEXT NOT NULL,
    profile TEXT NOT NULL, profile_hash TEXT NOT NULL, serial TEXT NOT NULL,
    status TEXT NOT NULL, context TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS intents (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, run TEXT NOT NULL REFERENCES runs(id),
    kind TEXT NOT NULL, parameter TEXT NOT NULL, old INTEGER NOT NULL, new INTEGER NOT NULL,
    state TEXT NOT NULL, at REAL NOT NULL
);
CREATE TABLE IF NOT EXISTS events (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, run TEXT NOT NULL REFERENCES runs(id),
    at REAL NOT NULL, text TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS adopted (run TEXT PRIMARY KEY REFERENCES runs(id), at REAL NOT NULL);
CREATE INDEX IF NOT EXISTS intents_of_run ON intents(run);
CREATE TABLE IF NOT EXISTS fleet_runs (
    id TEXT PRIMARY KEY, created REAL NOT NULL, name TEXT NOT NULL, file TEXT NOT NULL,
    job TEXT NOT NULL, definition TEXT NOT NULL, state TEXT NOT NULL, host TEXT NOT NULL,
    operator TEXT NOT NULL, pid INTEGER NOT NULL, started REAL NOT NULL, boot TEXT NOT NULL,
    ended REAL, request TEXT NOT NULL DEFAULT ''
);
CREATE TABLE IF NOT EXISTS fleet_axes (
    fleet_run TEXT NOT NULL REFERENCES fleet_runs(id), axis TEXT NOT NULL,
    attempt INTEGER NOT NULL, state TEXT NOT NULL, at REAL NOT NULL, serial TEXT, run TEXT,
    pid INTEGER, started REAL, boot TEXT, confirmed TEXT, outcome TEXT,
    why TEXT NOT NULL DEFAULT '', began REAL,
    PRIMARY KEY (fleet_run, axis, attempt)
);
CREATE TABLE IF NOT EXISTS fleet_events (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, fleet_run TEXT NOT NULL, axis TEXT NOT NULL,
    attempt INTEGER NOT NULL, at REAL NOT NULL, text TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS axis_notes (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, axis TEXT NOT NULL, of_host TEXT, at REAL NOT NULL,
    who TEXT, host TEXT, text TEXT NOT NULL, number INTEGER NOT NULL, renamed INTEGER NOT NULL,
    dated INTEGER NOT NULL
);
CREATE TABLE IF NOT EXISTS renamed_axes (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, old TEXT NOT NULL, new TEXT NOT NULL,
    number INTEGER NOT NULL, at REAL NOT NULL
);
CREATE INDEX IF NOT EXISTS runs_of_axis ON runs(axis);
CREATE INDEX IF NOT EXISTS runs_of_drive ON runs(serial);
CREATE INDEX IF NOT EXISTS events_of_run ON events(run);
"""
# what the runs' own files say: made anew where it is damaged
INDEX = {
    "indexed": "run TEXT PRIMARY KEY, host TEXT, version TEXT, method TEXT, verdict TEXT, "
    "digest TEXT",
    "results": "run TEXT, quantity TEXT, value REAL, low REAL, high REAL, unit TEXT, "
    "PRIMARY KEY (run, quantity)",
    "conditions": "run TEXT PRIMARY KEY, digest TEXT, motor_temperature REAL, "
    "drive_temperature REAL, minutes_on REAL, position REAL, third INTEGER, cycle REAL",
}
TABLE = re.compile(r"CREATE TABLE IF NOT EXISTS (\w+)")


# this connection's own: the runs of this computer, in their order; an adopted one was measured
# elsewhere
VIEWS = """
CREATE TEMP VIEW own AS
    SELECT rowid AS number, * FROM runs WHERE id NOT IN (SELECT run FROM adopted);
CREATE TEMP VIEW of_drive AS
    SELECT rowid AS number, *,
        CASE WHEN serial IN ('', '0x00000000') THEN link ELSE '' END AS nameless
    FROM runs;
"""


def unwritable(folder: Path, error: Exception) -> str:
    """Why the journal cannot be written, and what to do."""
    return (
        f"the journal in {folder} cannot be written ({error}); nothing is done without it. Free "
        "the disk or its permissions, or set TWORELAY_HOME to another folder"
    )


def open_to_write(path: Path) -> sqlite3.Connection:
    """The file, made where it is not there; raises OSError, sqlite3.Error."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return sqlite3.connect(path, timeout=10, isolation_level=None)


def open_to_read(path: Path, clean_up: ExitStack) -> sqlite3.Connection:
    """The journal as it is, or an empty one; raises OSError, sqlite3.Error."""
    db = read_only(path, clean_up) if path.exists() else sqlite3.connect(":memory:")
    there = {row[0] for row in db.execute("SELECT name FROM sqlite_master")}
    for statement in SCHEMA.split(";"):  # of an older version, or none
        name = TABLE.search(statement)
        if name is not None and name[1] not in there:
            db.execute(statement.replace("CREATE TABLE", "CREATE TEMP TABLE"))
    for table in _damaged(db):
        db.execute(f"CREATE TEMP TABLE {table} ({INDEX[table]})")
    return db


def _damaged(db: sqlite3.Connection) -> list[str]:
    """Tables of the index that are not there, or not as they must be."""
    found = []
    for name, columns in INDEX.items():
        there = [row[1] for row in db.execute(f"PRAGMA table_info({name})")]
        plain = columns.partition(", PRIMARY KEY (")[0]
        if there != [column.split()[0] for column in plain.split(", ")]:
            found.append(name)
    return found


def prepare(db: sqlite3.Connection) -> None:
    """Tables, and writes that are durable when they return; raises sqlite3.Error."""
    _write_ahead(db)
    db.execute("PRAGMA synchronous=FULL")
    db.execute("PRAGMA foreign_keys=ON")
    db.executescript(SCHEMA)
    db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
    db.execute("BEGIN IMMEDIATE")  # a journal that cannot be written shows now
    for name in _damaged(db):
        db.execute(f"DROP TABLE IF EXISTS {name}")
        db.execute(f"CREATE TABLE {name} ({INDEX[name]})")
    db.execute("COMMIT")


def _write_ahead(db: sqlite3.Connection) -> None:
    """WAL; the switch does not wait for another process that opens the file at this moment."""
    if db.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
        return
    for left in reversed(range(TRIES)):
        try:
            db.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError:
            if not left:
                raise
            time.sleep(PAUSE)


_LONGEST_SLUG = 40  # characters


def slug(name: str) -> str:
    """A name of an axis as a part of a file's name: letters, digits, dots and dashes of ASCII."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    slug = re.sub(r"[^A-Za-z0-9._-]+", "-", plain)[:_LONGEST_SLUG].strip("._-")
    return slug or "axis"


class OpenJournal:
    """The file, opened; what goes wrong with it is a JournalError, and what was begun is undone.

    `reading` : nothing is written, not even where there is no journal yet
    """

    def __init__(self, folder: Path, *, reading: bool = False) -> None:
        self.folder = folder
        self._clean_up = ExitStack()
        path = folder / "journal.sqlite"
        try:
            if reading:
                self._db = open_to_read(path, self._clean_up)
            else:
                self._db = open_to_write(path)
        except (OSError, sqlite3.Error) as error:
            self._clean_up.close()
            what = f"the journal in {folder} cannot be read ({error})"
            raise JournalError(what if reading else unwritable(folder, error)) from None
        self._clean_up.callback(self._db.close)
        with ExitStack() as undone, self._errors():
            undone.push(self._clean_up.pop_all())
            self._db.row_factory = sqlite3.Row
            version = self._db.execute("PRAGMA user_version").fetchone()[0]
            if version > SCHEMA_VERSION:
                raise JournalError(
                    f"{path} was written by a newer tworelay (schema {version})",
                    hint="update tworelay",
                )
            if not reading:
                prepare(self._db)
            self._db.executescript(VIEWS)
            self._clean_up = undone.pop_all()

    def close(self) -> None:
        """Close the file."""
        self._clean_up.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @contextmanager
    def _errors(self) -> Generator[None]:
        try:
            yield
        except (sqlite3.Error, OverflowError) as error:
            with suppress(sqlite3.Error):
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            if isinstance(error, sqlite3.DatabaseError) and code not in UNWRITABLE:
                raise self._damaged(error) from None
            raise JournalError(unwritable(self.folder, error)) from None
        except UnicodeEncodeError:
            raise UsageError("a name that is no valid text cannot be looked up") from None

    def _damaged(self, error: Exception) -> JournalError:
        return JournalError(
            f"the journal in {self.folder} is damaged ({error})",
            hint="put back a copy of journal.sqlite, or move it away (and keep it: what is to be "
            "restored in which drive stands nowhere else)",
        )
