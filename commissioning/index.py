"""The index of all runs: what each of them measured, under which conditions, and notes of people.

It is made of the runs' own results and made anew where it is damaged; notes are not.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import astuple, fields, replace
from typing import Any

from commissioning.journal_file import OpenJournal
from commissioning.result.document import RunResult
from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity
from commissioning.result.history import IndexedRun, Note, conditions_of, numbers_of

__all__ = ["Index"]

_CONDITIONS = tuple(one.name for one in fields(Conditions))
_MOST_NAMES = 500  # of one question
Row = tuple[Any, ...]


class Index(OpenJournal):
    """The index in the journal's file; raises JournalError."""

    def index(self, run: str, result: RunResult | None) -> None:
        """Put in what a run says now; None: its files are gone, and say nothing."""
        about, results, conditions = _rows(result)
        digest = _digest(about, results, conditions)
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            self._db.execute("DELETE FROM results WHERE run=?", (run,))
            self._db.execute(
                "INSERT OR REPLACE INTO indexed(run, host, version, method, verdict, digest) "
                "VALUES (?,?,?,?,?,?)",
                (run, *about, digest),
            )
            self._db.executemany(
                "INSERT INTO results(run, quantity, value, low, high, unit) VALUES (?,?,?,?,?,?)",
                [(run, *row) for row in results],
            )
            marks = ",".join("?" * (1 + len(_CONDITIONS)))
            self._db.execute(
                f"INSERT OR REPLACE INTO conditions(run, {', '.join(_CONDITIONS)}) "  # noqa: S608
                f"VALUES ({marks})",
                (run, *conditions),
            )
            self._db.execute("COMMIT")

    def not_indexed(self) -> list[str]:
        """Runs that the index does not have, in their order."""
        with self._errors():
            rows = self._db.execute(
                "SELECT id FROM runs WHERE id NOT IN (SELECT run FROM indexed) ORDER BY rowid"
            ).fetchall()
        return [str(row[0]) for row in rows]

    def clear_index(self) -> int:
        """Forget it, to be made anew; what lies nowhere else stays: returns of how many runs."""
        gone = "SELECT run FROM events WHERE text = 'files deleted'"
        with self._errors():
            self._db.executescript(
                f"BEGIN IMMEDIATE; DELETE FROM results WHERE run NOT IN ({gone}); "  # noqa: S608
                f"DELETE FROM conditions WHERE run NOT IN ({gone}); "
                f"DELETE FROM indexed WHERE run NOT IN ({gone}); COMMIT"
            )
            return int(self._db.execute("SELECT COUNT(*) FROM indexed").fetchone()[0])

    def axes(self) -> dict[str, int]:
        """Names of axes that have runs, and the place of the last one."""
        with self._errors():
            rows = self._db.execute(
                "SELECT axis, MAX(rowid) FROM runs GROUP BY axis ORDER BY axis"
            ).fetchall()
        return {str(axis): int(last) for axis, last in rows}

    def last_measured(self, axis: str, serial: str | None) -> str | None:
        """The last run of this computer that measured an axis; on the drive `serial`, if given."""
        with self._errors():
            row = self._db.execute(
                "SELECT own.id FROM own JOIN indexed ON indexed.run = own.id WHERE axis=? AND "
                "(? IS NULL OR serial=?) AND verdict IN ('good', 'usable') "
                "ORDER BY number DESC LIMIT 1",
                (axis, serial, serial),
            ).fetchone()
        return None if row is None else str(row[0])

    def entry(self, run: str) -> IndexedRun | None:
        """One run; None where the index does not have it, or is damaged there."""
        found, damaged = self._entries("id = ?", (run,))
        return None if damaged or not found else found[0]

    def entries(self, axes: Sequence[str]) -> tuple[list[IndexedRun], list[str]]:
        """Runs of axes of these names in their order, and those of which the index is damaged."""
        return self._entries(f"axis IN ({','.join('?' * len(axes))})", tuple(axes))

    def _entries(self, where: str, names: Row) -> tuple[list[IndexedRun], list[str]]:
        chosen = f"SELECT id FROM runs WHERE {where}"  # noqa: S608
        with self._errors():
            runs = self._db.execute(
                "SELECT runs.rowid, runs.id, created, axis, serial, link, "  # noqa: S608
                "adopted.run IS NOT NULL, indexed.run, host, version, method, verdict, digest "
                "FROM runs LEFT JOIN adopted ON adopted.run = runs.id "
                f"LEFT JOIN indexed ON indexed.run = runs.id WHERE {where} ORDER BY runs.rowid",
                names,
            ).fetchall()
            found = self._db.execute(
                "SELECT run, quantity, value, low, high, unit FROM results "  # noqa: S608
                f"WHERE run IN ({chosen}) ORDER BY run, rowid",
                names,
            ).fetchall()
            seen = self._db.execute(
                f"SELECT run, {', '.join(_CONDITIONS)} FROM conditions "  # noqa: S608
                f"WHERE run IN ({chosen})",
                names,
            ).fetchall()
        results: dict[str, list[Row]] = {}
        for run, *row in found:
            results.setdefault(run, []).append(tuple(row))
        conditions = {row[0]: tuple(row[1:]) for row in seen}
        entries, damaged = [], []
        for number, run, began, axis, serial, link, adopted, *about in runs:
            bare = IndexedRun(run, number, began, axis, serial, link, bool(adopted))
            entry = _filled(bare, tuple(about), results.get(run, []), conditions.get(run))
            entries.append(entry or bare)
            if entry is None:
                damaged.append(str(run))
        return entries, damaged

    # -- what people say -------------------------------------------------------------------------

    def note_on(self, note: Note) -> bool:
        """Keep a note, unless it is there; returns whether it was new."""
        with self._errors():
            known = self._db.execute(
                "SELECT 1 FROM maintenance WHERE axis=? AND at=? AND text=?",
                (note.axis, note.at, note.text),
            ).fetchone()
            if known is None:
                self._db.execute(
                    "INSERT INTO maintenance(axis, at, who, host, text, number) "
                    "VALUES (?,?,?,?,?,?)",
                    (note.axis, note.at, note.who, note.host, note.text, note.number),
                )
        return known is None

    def notes(self, axes: Sequence[str]) -> list[Note]:
        """Notes on axes of these names, in the order in which they were made."""
        marks = ",".join("?" * len(axes))
        with self._errors():
            rows = self._db.execute(
                "SELECT axis, at, text, who, host, number FROM maintenance "  # noqa: S608
                f"WHERE axis IN ({marks}) ORDER BY seq",
                tuple(axes),
            ).fetchall()
        return [Note(*row) for row in rows]

    def last_number(self) -> int:
        """Place of the last run."""
        with self._errors():
            return int(self._db.execute("SELECT IFNULL(MAX(rowid), 0) FROM runs").fetchone()[0])

    def rename(self, old: str, new: str) -> None:
        """The axis that was called `old` is called `new` from now on."""
        number = self.last_number()
        with self._errors():
            self._db.execute(
                "INSERT OR REPLACE INTO axis_names(old, new, number, at) VALUES (?,?,?,?)",
                (old, new, number, time.time()),
            )

    def renamed(self) -> dict[str, tuple[str, int]]:
        """What axes were called before: what then, and up to which run's place."""
        with self._errors():
            rows = self._db.execute("SELECT old, new, number FROM axis_names").fetchall()
        return {str(old): (str(new), int(number)) for old, new, number in rows}

    def names_of_drives(self, serials: Iterable[str]) -> dict[str, list[str]]:
        """What axes with drives of these serial numbers are called, in order."""
        asked = list(dict.fromkeys(serials))[:_MOST_NAMES]
        marks = ",".join("?" * len(asked))
        with self._errors():
            rows = self._db.execute(
                "SELECT serial, axis, MAX(rowid) AS last FROM runs "  # noqa: S608
                f"WHERE serial IN ({marks}) GROUP BY serial, axis ORDER BY last",
                asked,
            ).fetchall()
        found: dict[str, list[str]] = {}
        for serial, axis, _ in rows:
            found.setdefault(str(serial), []).append(str(axis))
        return found


def _rows(result: RunResult | None) -> tuple[Row, list[Row], Row]:
    """What a run says, its numbers, and its conditions, as rows without its name."""
    if result is None:
        return (None,) * 4, [], (None,) * len(_CONDITIONS)
    version = result.tool.version if result.tool else None
    about = result.host, version, result.friction.method, result.quality.verdict
    results = [(name, q.value, q.low, q.high, q.unit) for name, q in numbers_of(result).items()]
    return about, results, astuple(conditions_of(result))


def _digest(about: Row, results: Sequence[Row], conditions: Row) -> str:
    """A mark by which a damaged row is known; of numbers as SQLite gives them back."""
    rows = [about, *sorted(results), conditions]
    text = repr([[float(v) if isinstance(v, int | float) else v for v in row] for row in rows])
    return hashlib.blake2b(text.encode(errors="replace"), digest_size=8).hexdigest()


def _filled(bare: IndexedRun, row: Row, numbers: list[Row], seen: Row | None) -> IndexedRun | None:
    """A run with what the index has; None where that is damaged, or does not have it."""
    known, host, version, method, verdict, digest = row
    if known is None or seen is None:
        return None
    try:
        if _digest((host, version, method, verdict), numbers, seen) != digest:
            return None
    except TypeError:
        return None
    return replace(
        bare,
        host=host,
        version=version,
        method=method,
        verdict=verdict,
        quantities={name: Quantity(*rest) for name, *rest in numbers},
        conditions=Conditions(*seen),
    )
