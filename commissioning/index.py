"""The index of all runs: what each of them measured, under which conditions, and notes of people.

It is made of the runs' own results and made anew where it is damaged; notes are not.
"""

from __future__ import annotations

import hashlib
import sqlite3
import time
from collections.abc import Collection, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import astuple, fields, replace
from functools import partial
from typing import Any

from commissioning.journal_file import OpenJournal
from commissioning.result.document import RunResult
from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity
from commissioning.result.history import (
    IndexedRun,
    Note,
    Renamed,
    conditions_of,
    names_before,
    noted_name,
    numbers_of,
)

__all__ = ["Index"]

_CONDITIONS = tuple(one.name for one in fields(Conditions))
_DAY = 86400.0  # s
Row = tuple[Any, ...]


class Index(OpenJournal):
    """The index in the journal's file; raises JournalError."""

    def index(self, run: str, result: RunResult | None) -> None:
        """Put in what a run says now; None: its files are gone, and say nothing."""
        about, results, conditions = _rows(result)
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            if result is None and self._has(run):
                self._db.execute("ROLLBACK")  # what it measured stands nowhere else
                return
            self._db.execute("DELETE FROM results WHERE run=?", (run,))
            self._db.execute(
                "INSERT OR REPLACE INTO indexed(run, host, version, method, verdict, digest) "
                "VALUES (?,?,?,?,?,?)",
                (run, *about, _digest(about, *results)),
            )
            self._db.executemany(
                "INSERT INTO results(run, quantity, value, low, high, unit) VALUES (?,?,?,?,?,?)",
                [(run, *row) for row in results],
            )
            marks = ",".join("?" * (2 + len(_CONDITIONS)))
            self._db.execute(
                "INSERT OR REPLACE INTO conditions(run, digest, "  # noqa: S608
                f"{', '.join(_CONDITIONS)}) VALUES ({marks})",
                (run, _digest(conditions), *conditions),
            )
            self._db.execute("COMMIT")

    def _has(self, run: str) -> bool:
        found = self._db.execute(
            "SELECT 1 FROM indexed WHERE run=? UNION SELECT 1 FROM results WHERE run=?", (run, run)
        ).fetchone()
        return found is not None

    def not_indexed(self) -> list[str]:
        """Runs that the index does not have, in their order."""
        with self._errors():
            rows = self._db.execute(
                "SELECT id FROM runs WHERE id NOT IN (SELECT run FROM indexed) ORDER BY rowid"
            ).fetchall()
        return [str(row[0]) for row in rows]

    def axes(self) -> list[str]:
        """Names of axes as their runs have them."""
        with self._errors():
            rows = self._db.execute("SELECT DISTINCT axis FROM runs ORDER BY axis").fetchall()
        return [str(row[0]) for row in rows]

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
        """One run, as far as the index is sound; None where there is none."""
        found, _ = self._entries("id = ?", (run,))
        return found[0] if found else None

    def entries(self, axes: Sequence[str]) -> tuple[list[IndexedRun], list[str]]:
        """Runs of axes of these names in their order, and those of which the index is damaged."""
        return self._entries(f"axis IN ({','.join('?' * len(axes))})", tuple(axes))

    def _entries(self, where: str, names: Row) -> tuple[list[IndexedRun], list[str]]:
        chosen = f"SELECT id FROM runs WHERE {where}"  # noqa: S608
        with self._errors():
            runs = self._db.execute(
                "SELECT runs.rowid, runs.id, created, axis, serial, link, "  # noqa: S608
                "adopted.run IS NOT NULL FROM runs LEFT JOIN adopted ON adopted.run = runs.id "
                f"WHERE {where} ORDER BY runs.rowid",
                names,
            ).fetchall()
        about, results, conditions = (
            self._of_index(f"SELECT run, {columns} WHERE run IN ({chosen})", names)
            for columns in (
                "host, version, method, verdict, digest FROM indexed",
                "quantity, value, low, high, unit FROM results",
                f"digest, {', '.join(_CONDITIONS)} FROM conditions",
            )
        )
        entries, damaged = [], []
        for number, run, began, axis, serial, link, adopted in runs:
            bare = IndexedRun(run, number, began, axis, serial, link, bool(adopted))
            parts = (found.get(run, []) for found in (about, results, conditions))
            entry, sound = _filled(bare, *parts)
            entries.append(entry)
            if not sound:
                damaged.append(str(run))
        return entries, damaged

    def _of_index(self, question: str, names: Row) -> dict[str, list[Row]]:
        """Rows of the index by their run; none where they cannot even be read."""
        found: dict[str, list[Row]] = {}
        try:
            for run, *row in self._db.execute(question, names):
                found.setdefault(run, []).append(tuple(row))
        except sqlite3.OperationalError:  # of a text that is none
            return {}
        return found

    # -- what people say -------------------------------------------------------------------------

    def note_on(self, note: Note) -> None:
        """Keep a note."""
        with self._errors():
            self._db.execute(
                "INSERT INTO axis_notes(axis, of_host, at, who, host, text, number, renamed, "
                "dated) VALUES (?,?,?,?,?,?,?,?,?)",
                (
                    note.axis, note.of_host, note.at, note.who, note.host, note.text, note.number,
                    note.renamed, note.dated,
                ),
            )  # fmt: skip

    def remove_note(self, note: Note) -> None:
        """Forget a note."""
        with self._errors():
            self._db.execute(
                "DELETE FROM axis_notes WHERE seq = (SELECT MAX(seq) FROM axis_notes WHERE axis=? "
                "AND of_host IS ? AND at=? AND text=?)",
                (note.axis, note.of_host, note.at, note.text),
            )

    def notes(self, axes: Sequence[str]) -> list[Note]:
        """Notes on axes of these names, in the order in which they were made."""
        marks = ",".join("?" * len(axes))
        with self._errors(), self._any_text():
            rows = self._db.execute(
                "SELECT axis, of_host, at, who, host, text, number, renamed, dated "  # noqa: S608
                f"FROM axis_notes WHERE axis IN ({marks}) ORDER BY seq",
                tuple(axes),
            ).fetchall()
        return [_note(tuple(row)) for row in rows]

    def notes_on(
        self, axis: str, of_hosts: Collection[str | None], renamed: Sequence[Renamed]
    ) -> list[Note]:
        """Notes on the axis that is called so now, of these computers; None: of this one."""
        return [
            note
            for note in self.notes(names_before(axis, renamed))
            if noted_name(note, renamed) == axis and note.of_host in of_hosts
        ]

    def new_notes(self, axis: str, notes: Iterable[Note], of_host: str | None) -> list[Note]:
        """Notes of another computer on an axis that are not known, as they go in.

        `of_host` : whose axis it is; None: this computer's
        """
        renamed = self.renamed()
        there = {(n.at, n.text) for n in self.notes_on(axis, (of_host,), renamed)}
        last, now = self.last_number(), time.time()
        seq = max((one.seq for one in renamed), default=0)
        return [
            Note(axis, min(n.at, now), n.text, n.who, n.host, last, seq, True, of_host)
            for n in notes
            if (min(n.at, now), n.text) not in there
        ]

    @contextmanager
    def _any_text(self) -> Generator[None]:
        """Words of people are read, whatever became of them."""
        self._db.text_factory = partial(str, encoding="utf-8", errors="replace")
        try:
            yield
        finally:
            self._db.text_factory = str

    def last_number(self) -> int:
        """Place of the last run."""
        with self._errors():
            return int(self._db.execute("SELECT IFNULL(MAX(rowid), 0) FROM runs").fetchone()[0])

    def rename(self, old: str, new: str) -> None:
        """The axis of this computer that was called `old` is called `new` from now on."""
        number = self.last_number()
        with self._errors():
            self._db.execute(
                "INSERT INTO renamed_axes(old, new, number, at) VALUES (?,?,?,?)",
                (old, new, number, time.time()),
            )

    def take_back_rename(self) -> Renamed | None:
        """Forget the last renaming; returns it, or None where there is none.

        Notes that were made since go along.
        """
        found = self.renamed()
        if not found:
            return None
        last = found[-1]
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            self._db.execute("DELETE FROM renamed_axes WHERE seq=?", (last.seq,))
            self._db.execute(
                "UPDATE axis_notes SET axis=? WHERE axis=? AND of_host IS NULL AND renamed >= ?",
                (last.old, last.new, last.seq),
            )
            self._db.execute("COMMIT")
        return last

    def renamed(self) -> list[Renamed]:
        """What axes were called before, in the order in which they were renamed."""
        with self._errors(), self._any_text():
            rows = self._db.execute(
                "SELECT old, new, number, seq FROM renamed_axes ORDER BY seq"
            ).fetchall()
        return [
            Renamed(str(old), str(new), number, seq)
            for old, new, number, seq in rows
            if isinstance(number, int)
        ]

    def named(self, axes: Sequence[str], here: str) -> list[tuple[str, int, bool]]:
        """Name, place, and whether it is of another computer than `here`, of each run of these."""
        marks = ",".join("?" * len(axes))
        with self._errors():
            rows = self._db.execute(
                "SELECT axis, runs.rowid, adopted.run IS NOT NULL AND host IS NOT ? "  # noqa: S608
                "FROM runs LEFT JOIN adopted ON adopted.run = id LEFT JOIN indexed "
                f"ON indexed.run = id WHERE axis IN ({marks})",
                (here, *axes),
            ).fetchall()
        return [(str(axis), int(number), bool(adopted)) for axis, number, adopted in rows]

    def names_of_drive(self, serial: str) -> list[str]:
        """What axes with the drive of a serial number are called, the last one last."""
        with self._errors():
            rows = self._db.execute(
                "SELECT axis FROM runs WHERE serial=? GROUP BY axis ORDER BY MAX(rowid)", (serial,)
            ).fetchall()
        return [str(row[0]) for row in rows]


def _rows(result: RunResult | None) -> tuple[Row, list[Row], Row]:
    """What a run says, its numbers, and its conditions, as rows without its name."""
    if result is None:
        return (None,) * 4, [], (None,) * len(_CONDITIONS)
    version = result.tool.version if result.tool else None
    about = result.host, version, result.friction.method, result.quality.verdict
    results = [(name, q.value, q.low, q.high, q.unit) for name, q in numbers_of(result).items()]
    return about, results, astuple(conditions_of(result))


def _digest(*rows: Row) -> str:
    """A mark by which damaged rows are known; of values as SQLite gives them back."""
    text = repr([[_plain(value) for value in row] for row in sorted(rows, key=repr)])
    return hashlib.blake2b(text.encode(errors="replace"), digest_size=8).hexdigest()


def _plain(value: object) -> object:
    if isinstance(value, str):
        return str(value)  # an enumeration's, too
    return float(value) + 0.0 if isinstance(value, int | float) else value  # no −0.0


def _filled(
    bare: IndexedRun, about: list[Row], numbers: list[Row], seen: list[Row]
) -> tuple[IndexedRun, bool]:
    """A run with what the index has of it that is sound, and whether that is all."""
    entry = bare
    sound = len(about) == 1 and len(seen) == 1
    if about:
        *told, digest = about[0]
        if _digest(tuple(told), *numbers) == digest:
            host, version, method, verdict = told
            quantities = {name: Quantity(*rest) for name, *rest in numbers}
            entry = replace(
                entry, host=host, version=version, method=method, verdict=verdict,
                quantities=quantities,
            )  # fmt: skip
        else:
            sound = False
    if seen:
        digest, *values = seen[0]
        if _digest(tuple(values)) == digest:
            entry = replace(entry, conditions=Conditions(*values))
        else:
            sound = False
    return entry, sound


def _note(row: Row) -> Note:
    """A note, whatever became of its row."""
    axis, of_host, at, who, host, text, number, renamed, dated = row
    is_date = isinstance(at, int | float) and 0 <= at < time.time() + _DAY
    return Note(
        str(axis),
        float(at) if is_date else 0.0,
        str(text),
        None if who is None else str(who),
        None if host is None else str(host),
        number if isinstance(number, int) else 0,
        renamed if isinstance(renamed, int) else 0,
        bool(dated),
        None if of_host is None else str(of_host),
    )
