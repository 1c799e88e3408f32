"""What was done to which drive: runs, snapshots and intents, in SQLite, before it is done.

A write to a drive is journalled as an intent, then written, then read back, then marked. So a power
cut at any instant leaves either the old value, or an intent that `restore` can undo.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from commissioning.stored import END_OF_TIME, checked_intents, checked_journal, checked_run
from profiles.errors import JournalError, Refused, UnknownName, UsageError

__all__ = ["RESTORED", "STORED", "STORING", "Intent", "Journal", "RunRecord"]

Kind = Literal["experiment", "compensation", "gain"]
State = Literal["intended", "verified", "restored"]

_TRIES, _PAUSE = 200, 0.05  # s: until another process has opened the file
_SCHEMA_VERSION = 1
_UNWRITABLE = {  # primary result codes of SQLite: of permissions, of others, and of the disk
    sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_CANTOPEN,
}  # fmt: skip
_RUNS_A_SECOND = 1000  # of one axis, at most
STORING, STORED, RESTORED = "storing", "stored", "restored and stored"
_SCHEMA = """
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
CREATE VIEW IF NOT EXISTS own_runs AS SELECT * FROM runs WHERE id NOT IN (SELECT run FROM adopted);
"""


@dataclass(frozen=True, slots=True)
class RunRecord:
    """One run. `context` is what is needed to connect again: axis, profile, limits.

    `adopted` : it was measured on another computer, and taken in here
    """

    id: str
    created: float
    axis: str
    link: str
    profile: str
    profile_hash: str
    serial: str
    status: str
    context: dict[str, Any]
    adopted: bool = False

    @classmethod
    def exported(cls, run: dict[str, Any]) -> RunRecord:
        """The checked `run` of an exported journal."""
        return cls(**{name: run[name] for name in _FIELDS}, adopted=True)


_FIELDS = (  # of a run, as its table has them
    "id", "created", "axis", "link", "profile", "profile_hash", "serial", "status", "context",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Intent:
    """One parameter write: raw values before and after, and how far it got."""

    seq: int
    run: str
    kind: Kind
    parameter: str
    old: int
    new: int
    state: State


class Journal:
    """The journal of this machine; raises JournalError when it cannot be read or written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / "journal.sqlite"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, timeout=10, isolation_level=None)
        except (OSError, sqlite3.Error) as error:
            raise JournalError(_unwritable(folder, error)) from None
        with self._errors():
            self._db.row_factory = sqlite3.Row
            self._write_ahead()
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute("PRAGMA foreign_keys=ON")
            version = self._db.execute("PRAGMA user_version").fetchone()[0]
            if version > _SCHEMA_VERSION:
                raise JournalError(
                    f"{path} was written by a newer tworelay (schema {version}); update tworelay"
                )
            self._db.executescript(_SCHEMA)
            self._db.execute(f"PRAGMA user_version={_SCHEMA_VERSION}")
            self._db.execute("BEGIN IMMEDIATE")  # a journal that cannot be written shows now
            self._db.execute("ROLLBACK")

    def _write_ahead(self) -> None:
        """WAL; the switch does not wait for another process that opens the file at this moment."""
        if self._db.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
            return
        for left in reversed(range(_TRIES)):
            try:
                self._db.execute("PRAGMA journal_mode=WAL")
                return
            except sqlite3.OperationalError:
                if not left:
                    raise
                time.sleep(_PAUSE)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def __enter__(self) -> Journal:
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
            if isinstance(error, sqlite3.DatabaseError) and code not in _UNWRITABLE:
                raise self._damaged(error) from None
            raise JournalError(_unwritable(self.folder, error)) from None
        except UnicodeEncodeError:
            raise UsageError("a name that is no valid text cannot be looked up") from None

    # -- runs ------------------------------------------------------------------------------------

    def begin(
        self,
        *,
        axis: str,
        link: str,
        profile: str,
        profile_hash: str,
        serial: str,
        context: dict[str, Any],
    ) -> str:
        """Open a run; return its id, which sorts by time."""
        with self._errors():
            now = time.time()
            if not 0 <= now < END_OF_TIME:
                raise Refused(
                    f"this computer's clock stands at {now:.0f} s since 1970, outside of 1970 to 9999: "
                    "set it, so that runs have an order"
                )
            stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(now))
            for n in range(_RUNS_A_SECOND):
                run = f"{stamp}-{axis}" + (f"-{n}" if n else "")
                try:
                    self._db.execute(
                        "INSERT INTO runs VALUES (?,?,?,?,?,?,?,?,?)",
                        (
                            run, now, axis, link, profile, profile_hash, serial, "running",
                            json.dumps(context),
                        ),
                    )  # fmt: skip
                except sqlite3.IntegrityError:
                    continue
                return run
        raise JournalError("no free run id within this second")

    def finish(self, run: str, status: str) -> None:
        """Set the status of a run."""
        with self._errors():
            self._db.execute("UPDATE runs SET status=? WHERE id=?", (status, run))

    def run(self, run: str) -> RunRecord:
        """A run by its id, or `last`, which was measured here; raises UnknownName."""
        with self._errors():
            if run == "last":
                row = self._db.execute(
                    "SELECT * FROM own_runs ORDER BY created DESC, id DESC LIMIT 1"
                ).fetchone()
            else:
                row = self._db.execute("SELECT * FROM runs WHERE id=?", (run,)).fetchone()
            if row is None and run == "last":
                raise UnknownName("run of this computer", run, [])
            if row is None:
                recent = self._db.execute("SELECT id FROM runs ORDER BY created DESC LIMIT 5")
                raise UnknownName("run", run, [found["id"] for found in recent])
            return self._record(row)

    def _record(self, row: sqlite3.Row) -> RunRecord:
        """A row as it must be; raises JournalError."""
        run = dict(row)
        adopted = self._db.execute("SELECT 1 FROM adopted WHERE run=?", (run["id"],)).fetchone()
        try:
            run["context"] = json.loads(run["context"])
            checked_run(run, f"run {run['id']}")
        except (ValueError, TypeError, RecursionError, UsageError) as error:
            raise self._damaged(error) from None
        return RunRecord(**run, adopted=adopted is not None)

    def _damaged(self, error: Exception) -> JournalError:
        return JournalError(
            f"the journal in {self.folder} is damaged ({error}); put back a copy of journal.sqlite, or move "
            "it away (and keep it: what is to be restored in which drive stands nowhere else)"
        )

    def note(self, run: str, text: str) -> None:
        """Append an event to the run's record."""
        with self._errors():
            self._db.execute(
                "INSERT INTO events(run, at, text) VALUES (?,?,?)", (run, time.time(), text)
            )

    def memory(self, run: str) -> str:
        """What the run did last to the drive's non-volatile memory.

        STORED: the run's values are in it; RESTORED: those from before; STORING: it was cut off while it
        stored; '': nothing.
        """
        texts = (STORING, STORED, RESTORED)
        with self._errors():
            row = self._db.execute(
                "SELECT text FROM events WHERE run=? AND text IN (?,?,?) ORDER BY seq DESC LIMIT 1",
                (run, *texts),
            ).fetchone()
        return "" if row is None else str(row["text"])

    def stores(self, run: str) -> int:
        """How often the drive of `run` has stored, by this journal."""
        with self._errors():
            row = self._db.execute(
                "SELECT COUNT(*) FROM events JOIN runs ON events.run = runs.id "
                "JOIN runs AS this ON this.id=? WHERE events.text IN (?,?) AND runs.serial = this.serial "
                "AND (runs.serial NOT IN ('', '0x00000000') OR runs.link = this.link)",
                (run, STORED, RESTORED),
            ).fetchone()
        return int(row[0])

    # -- intents ---------------------------------------------------------------------------------

    def intend(self, run: str, kind: Kind, parameter: str, old: int, new: int) -> int:
        """Say that `parameter` will be written; durable when this returns."""
        with self._errors():
            row = self._db.execute(
                "INSERT INTO intents(run, kind, parameter, old, new, state, at) "
                "VALUES (?,?,?,?,?,'intended',?)",
                (run, kind, parameter, old, new, time.time()),
            )
            return int(row.lastrowid or 0)

    def settle(self, intents: list[int], state: State) -> None:
        """Say how far intents got: all of them at once, or none.

        An old value that is back settles every intent about it; a later one alone would name a value in
        between as the old one.
        """
        now = time.time()
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            self._db.executemany(
                "UPDATE intents SET state=?, at=? WHERE seq=?",
                [(state, now, seq) for seq in intents],
            )
            self._db.execute("COMMIT")

    def intents(self, run: str, *, open_only: bool = False) -> list[Intent]:
        """Intents of a run in order; `open_only`: those that `restore` would undo."""
        with self._errors():
            rows = self._db.execute(
                "SELECT seq, run, kind, parameter, old, new, state FROM intents WHERE run=? "
                "ORDER BY seq",
                (run,),
            ).fetchall()
        tree = [dict(row) for row in rows]
        try:
            checked_intents(tree, f"run {run}")
        except UsageError as error:
            raise self._damaged(error) from None
        found = [Intent(**row) for row in tree]
        return [i for i in found if i.state in ("intended", "verified")] if open_only else found

    def open_runs(self, *, adopted: bool = False) -> list[str]:
        """Runs with something to restore, the latest first; of this computer, unless `adopted`, too."""
        with self._errors():
            rows = self._db.execute(
                "SELECT DISTINCT runs.id, runs.created FROM runs "
                "JOIN intents ON intents.run = runs.id WHERE intents.state <> 'restored' "
                "AND (? OR runs.id IN (SELECT id FROM own_runs)) "
                "ORDER BY runs.created DESC, runs.id DESC",
                (adopted,),
            ).fetchall()
        return [str(row["id"]) for row in rows]

    def runs_before(self, instant: float) -> list[RunRecord]:
        """Runs that began before an instant (s since 1970), the oldest first."""
        with self._errors():
            rows = self._db.execute(
                "SELECT * FROM runs WHERE created < ? ORDER BY created, id", (instant,)
            ).fetchall()
            return [self._record(row) for row in rows]

    def last_written(self) -> str | None:
        """The latest run that wrote anything to a drive."""
        with self._errors():
            row = self._db.execute(
                "SELECT own.id FROM own_runs AS own JOIN intents ON intents.run = own.id "
                "ORDER BY own.created DESC, own.id DESC LIMIT 1"
            ).fetchone()
        return None if row is None else str(row["id"])

    def unfinished(self, serial: str) -> list[str]:
        """Runs on the drive `serial` whose experiment settings were never put back."""
        with self._errors():
            rows = self._db.execute(
                "SELECT DISTINCT runs.id FROM runs JOIN intents ON intents.run = runs.id "
                "WHERE intents.kind='experiment' AND intents.state <> 'restored' "
                "AND runs.serial=? ORDER BY runs.created",
                (serial,),
            ).fetchall()
        return [str(row["id"]) for row in rows]

    # -- moving a run to another machine -----------------------------------------------------------

    def export(self, run: str) -> dict[str, Any]:
        """Everything that the journal knows of a run, for JSON."""
        record = self.run(run)
        with self._errors():
            events = self._db.execute(
                "SELECT at, text FROM events WHERE run=? ORDER BY seq", (record.id,)
            ).fetchall()
        tree = {
            "schema": "tworelay.journal/1",
            "run": {name: getattr(record, name) for name in _FIELDS},
            "intents": [
                {name: getattr(i, name) for name in ("kind", "parameter", "old", "new", "state")}
                for i in self.intents(record.id)
            ],
            "events": [dict(row) for row in events],
        }
        try:
            return checked_journal(tree, f"run {record.id}")
        except UsageError as error:
            raise self._damaged(error) from None

    def adopt(self, tree: Any, origin: str) -> str:
        """Take in the journal of a run of another computer, unless it is known; returns its id.

        Raises UsageError where it is none.
        """
        tree = checked_journal(tree, origin)
        run = tree["run"]
        if self.knows(run["id"]):
            return str(run["id"])
        of_intent = ("kind", "parameter", "old", "new", "state")
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            self._db.execute(
                "INSERT INTO runs VALUES (?,?,?,?,?,?,?,?,?)",
                tuple(
                    run[name] if name != "context" else json.dumps(run[name]) for name in _FIELDS
                ),
            )
            self._db.execute("INSERT INTO adopted VALUES (?,?)", (run["id"], time.time()))
            self._db.executemany(
                "INSERT INTO intents(run, kind, parameter, old, new, state, at) "
                "VALUES (?,?,?,?,?,?,?)",
                [(run["id"], *(i[n] for n in of_intent), time.time()) for i in tree["intents"]],
            )
            self._db.executemany(
                "INSERT INTO events(run, at, text) VALUES (?,?,?)",
                [(run["id"], event["at"], event["text"]) for event in tree["events"]],
            )
            self._db.execute("COMMIT")
        return str(run["id"])

    def knows(self, run: str) -> bool:
        """Whether there is a run of this id, as file names go: in capitals or not."""
        with self._errors():
            found = self._db.execute(
                "SELECT 1 FROM runs WHERE id=? COLLATE NOCASE", (run,)
            ).fetchone()
        return found is not None


def _unwritable(folder: Path, error: Exception) -> str:
    return (
        f"the journal in {folder} cannot be written ({error}); nothing is done without it. Free "
        "the disk or its permissions, or set TWORELAY_HOME to another folder"
    )
