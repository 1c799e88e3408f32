"""What was done to which drive: runs, snapshots and intents, in SQLite, before it is done.

A write to a drive is journalled as an intent, then written, then read back, then marked. So a power
cut at any instant leaves either the old value, or an intent that `restore` can undo.
"""

from __future__ import annotations

import os
import platform
import re
import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from commissioning.errors import JournalError
from commissioning.index import Index
from commissioning.journal_file import slug
from commissioning.records import (
    END_OF_TIME,
    RESTORED,
    STORED,
    STORING,
    TAKEN_IN,
    UP_TO,
    Cell,
    Event,
    History,
    Intent,
    Kind,
    RunContext,
    RunRecord,
    State,
    context_text,
    image_of,
    intent_of,
    run_of,
)
from commissioning.result.history import (
    Note,
    computer_of,
    name_now,
)
from drivers.places import same_place
from profiles.errors import Refused, UnknownName, UsageError

__all__ = ["RESTORED", "STORED", "STORING", "Intent", "Journal", "Kind", "RunRecord"]

_RUNS_A_SECOND = 1000  # of one axis, at most
_LONGEST_HOST = 20  # characters


class Journal(Index):
    """The journal of this machine; raises JournalError when it cannot be read or written.

    `reading` : nothing is written, not even where there is no journal yet
    """

    def __init__(self, folder: Path, *, reading: bool = False) -> None:
        super().__init__(folder, reading=reading)
        self._images: tuple[object, dict[tuple[str, str], dict[str, Cell]]] = (None, {})

    @classmethod
    def empty(cls) -> Journal:
        """One without runs, that is nowhere."""
        return cls(Path(os.devnull) / "nowhere", reading=True)

    # -- runs ------------------------------------------------------------------------------------

    def begin(
        self,
        *,
        axis: str,
        link: str,
        profile: str,
        profile_hash: str,
        serial: str,
        context: RunContext,
    ) -> str:
        """Open a run; return its id, which begins with the time by this computer's clock."""
        with self._errors():
            now = time.time()
            if not 0 <= now < END_OF_TIME:
                raise Refused(
                    f"this computer's clock stands at {now:.0f} s since 1970, outside of 1970 to "
                    "9999: set it, so that runs have an order",
                    code="refused.clock",
                )
            stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(now))
            name = "-".join([stamp, slug(axis), *_host()])
            for n in range(_RUNS_A_SECOND):
                run = name + (f"-{n}" if n else "")
                try:
                    self._db.execute(
                        "INSERT INTO runs VALUES (?,?,?,?,?,?,?,?,?)",
                        (
                            run, now, axis, link, profile, profile_hash, serial, "running",
                            context_text(context),
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
                    "SELECT * FROM runs WHERE id = (SELECT id FROM own ORDER BY number DESC LIMIT "
                    "1)"
                ).fetchone()
            else:
                row = self._db.execute("SELECT * FROM runs WHERE id=?", (run,)).fetchone()
            if row is None and run == "last":
                raise UnknownName("run of this computer", run, [])
            if row is None:
                recent = self._db.execute("SELECT id FROM runs ORDER BY rowid DESC LIMIT 5")
                raise UnknownName("run", run, [found["id"] for found in recent])
            return self._record(row)

    def _record(self, row: sqlite3.Row) -> RunRecord:
        """A row as it must be; raises JournalError."""
        adopted = self._db.execute("SELECT 1 FROM adopted WHERE run=?", (row["id"],)).fetchone()
        try:
            return run_of(dict(row), adopted=adopted is not None)
        except (ValueError, TypeError, RecursionError, UsageError) as error:
            raise self._damaged(error) from None

    def note_stored(self, run: str, text: str) -> None:
        """Say what the drive does to its memory, and up to which write.

        STORING, STORED or RESTORED.
        """
        now = time.time()
        with self._errors():
            row = self._db.execute("SELECT IFNULL(MAX(seq), 0) FROM intents").fetchone()
            told = [text, f"{UP_TO}{row[0]}"]
            self._db.execute("BEGIN IMMEDIATE")
            self._db.executemany(
                "INSERT INTO events(run, at, text) VALUES (?,?,?)",
                [(run, now, one) for one in told],
            )
            self._db.execute("COMMIT")

    def note(self, run: str, text: str) -> None:
        """Append an event to the run's record."""
        with self._errors():
            self._db.execute(
                "INSERT INTO events(run, at, text) VALUES (?,?,?)", (run, time.time(), text)
            )

    def memory(self, run: str) -> str:
        """What the run did last to the drive's non-volatile memory.

        STORED: the run's values are in it; RESTORED: those from before; STORING: it was cut off
        while it stored; '': nothing.
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
                "SELECT COUNT(*) FROM events JOIN of_drive ON events.run = of_drive.id "
                "JOIN of_drive AS this ON this.id=? WHERE events.text IN (?,?) "
                "AND of_drive.serial = this.serial AND of_drive.nameless = this.nameless",
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

        An old value that is back settles every intent about it; a later one alone would name a
        value in between as the old one.
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
        try:
            found = [intent_of(dict(row)) for row in rows]
        except UsageError as error:
            raise self._damaged(error) from None
        return [i for i in found if i.is_open] if open_only else found

    def open_runs(self, *, adopted: bool = False) -> list[str]:
        """Runs with something to restore, the last to write first.

        Of this computer, or also `adopted`.
        """
        with self._errors():
            rows = self._db.execute(
                "SELECT runs.id FROM runs JOIN intents ON intents.run = runs.id "
                "WHERE (? OR runs.id IN (SELECT id FROM own)) GROUP BY runs.id "
                "HAVING SUM(intents.state <> 'restored') ORDER BY MAX(intents.seq) DESC",
                (adopted,),
            ).fetchall()
        return [str(row["id"]) for row in rows]

    def last_runs(self, most: int | None) -> tuple[list[str], int]:
        """The last `most` runs, in the order in which they came, and how many there are before."""
        with self._errors():
            rows = self._db.execute(
                "SELECT id FROM runs ORDER BY rowid DESC LIMIT ?", (-1 if most is None else most,)
            ).fetchall()
            count = self._db.execute("SELECT COUNT(*) FROM runs").fetchone()[0]
        return [str(row[0]) for row in reversed(rows)], int(count) - len(rows)

    def on_drive(self, serial: str) -> list[RunRecord]:
        """Runs on the drive of a serial number, in the order in which they came."""
        with self._errors():
            rows = self._db.execute(
                "SELECT * FROM runs WHERE serial=? ORDER BY rowid", (serial,)
            ).fetchall()
            return [self._record(row) for row in rows]

    def runs_before(self, instant: float) -> list[RunRecord]:
        """Runs that began before an instant (s since 1970), the oldest first."""
        with self._errors():
            rows = self._db.execute(
                "SELECT * FROM runs WHERE created < ? ORDER BY rowid", (instant,)
            ).fetchall()
            return [self._record(row) for row in rows]

    def last_written(self) -> str | None:
        """The run of this computer that wrote to a drive last."""
        with self._errors():
            row = self._db.execute(
                "SELECT own.id FROM own JOIN intents ON intents.run = own.id "
                "ORDER BY intents.seq DESC LIMIT 1"
            ).fetchone()
        return None if row is None else str(row["id"])

    def unfinished(self, serial: str, is_here: Callable[[str], bool]) -> list[str]:
        """Runs on a drive whose experiment settings were never put back, in their order.

        A drive that tells no serial number is the one on a link that `is_here`.
        """
        with self._errors():
            rows = self._db.execute(
                "SELECT DISTINCT of_drive.id, link, nameless, number FROM of_drive JOIN intents "
                "ON intents.run = of_drive.id WHERE intents.kind='experiment' "
                "AND intents.state <> 'restored' AND serial=? ORDER BY number",
                (serial,),
            ).fetchall()
        return [run for run, link, nameless, _ in rows if not nameless or is_here(link)]

    def unfinished_on(self, is_here: Callable[[str], bool]) -> list[str]:
        """Runs of this computer on such a link whose settings are not back, in their order."""
        with self._errors():
            rows = self._db.execute(
                "SELECT DISTINCT own.id, link, number FROM own JOIN intents ON intents.run = "
                "own.id WHERE intents.kind='experiment' AND intents.state <> 'restored' ORDER BY "
                "number"
            ).fetchall()
        return [run for run, link, _ in rows if is_here(link)]

    # -- moving a run to another machine -----------------------------------------------------------

    def history(self, run: str, *, of_drive: bool = True) -> History:
        """Everything that the journal knows of a run.

        `of_drive` : and of its drive, also where the run has written nothing there to stay
        """
        record = self.run(run)
        with self._errors():
            rows = self._db.execute(
                "SELECT at, text FROM events WHERE run=? ORDER BY seq", (record.id,)
            ).fetchall()
        events = tuple(Event(float(at), str(text)) for at, text in rows)
        now, notes = self._of_axis(record)
        intents = tuple(self.intents(record.id))
        needed = of_drive or any(intent.lasts for intent in intents)
        return History(record, intents, events, self._image(record) if needed else {}, notes, now)

    def _of_axis(self, record: RunRecord) -> tuple[str, tuple[Note, ...]]:
        """What the axis of a run is called now, and the notes on it."""
        entry, renamed, here = self.entry(record.id), self.renamed(), platform.node()
        assert entry is not None
        now, of_host = name_now(entry, renamed, here), computer_of(entry, here)
        return now, tuple(self.notes_on(now, (of_host,), renamed))

    def _image(self, record: RunRecord) -> dict[str, Cell]:
        """What the drive of a run has, by all that was written to it here, and its stores."""
        with self._errors():
            version = self._db.execute("PRAGMA data_version").fetchone()[0]
        now = version, self._db.total_changes
        if self._images[0] != now:  # somebody has written since
            self._images = now, {}
        drive = record.serial, record.link
        found = self._images[1].get(drive)
        if found is None:
            found = self._images[1][drive] = self._image_now(record)
        return found

    def _image_now(self, record: RunRecord) -> dict[str, Cell]:
        with self._errors():
            drives = self._db.execute(
                "SELECT id, link, nameless FROM of_drive WHERE serial=?", (record.serial,)
            ).fetchall()
            rows = self._db.execute(
                "SELECT intents.seq, run, intents.at, intents.* FROM intents JOIN of_drive "
                "ON of_drive.id = run WHERE serial=? AND kind <> 'experiment' ORDER BY intents.seq",
                (record.serial,),
            ).fetchall()
            told = self._db.execute(
                "SELECT seq, run, at, text FROM events WHERE run IN (SELECT id FROM runs WHERE "
                "serial=?) AND (text IN (?,?,?) OR text LIKE ? OR text LIKE ?) ORDER BY seq",
                (record.serial, STORING, STORED, RESTORED, f"{UP_TO}%", f"{TAKEN_IN}%"),
            ).fetchall()
        here = {
            run for run, link, nameless in drives if not nameless or same_place(record.link, link)
        }
        # of an adopted run: its event and its write up to which another computer did it
        taken_in = {
            run: (seq, _count(text)) for seq, run, _, text in told if text.startswith(TAKEN_IN)
        }
        try:
            writes = [
                intent_of(dict(row))
                for row in rows
                if row[1] in here and row[0] > taken_in.get(row[1], (0, 0))[1]
            ]
        except UsageError as error:
            raise self._damaged(error) from None
        stores: list[tuple[int, str]] = []
        for seq, run, at, text in told:
            if run not in here or seq <= taken_in.get(run, (0, 0))[0]:
                continue
            if text.startswith(UP_TO) and stores:
                stores[-1] = (_count(text), stores[-1][1])
            elif text in (STORING, STORED, RESTORED):
                then = (row[0] for row in rows if row[1] == run and row[2] <= at)
                stores.append((max(then, default=0), text))
        return image_of(writes, stores)

    def adopt(self, history: History, notes: Sequence[Note] = ()) -> str:
        """Take in the journal of a run of another computer, unless it is known; returns its id.

        `notes` : on its axis, as `new_notes` has them
        """
        run = history.run
        if self.knows(run.id):
            return run.id
        now = time.time()
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            for note in notes:
                self.note_on(note)
            self._db.execute(
                "INSERT INTO runs VALUES (?,?,?,?,?,?,?,?,?)",
                (
                    run.id, run.created, run.axis, run.link, run.profile, run.profile_hash,
                    run.serial,
                    run.status, context_text(run.context),
                ),
            )  # fmt: skip
            self._db.execute("INSERT INTO adopted VALUES (?,?)", (run.id, now))
            self._db.executemany(
                "INSERT INTO intents(run, kind, parameter, old, new, state, at) "
                "VALUES (?,?,?,?,?,?,?)",
                [
                    (run.id, i.kind, i.parameter, i.old, i.new, i.state, now)
                    for i in history.intents
                ],
            )
            last = self._db.execute("SELECT IFNULL(MAX(seq), 0) FROM intents").fetchone()[0]
            told = [(run.id, event.at, event.text) for event in history.events]
            self._db.executemany(
                "INSERT INTO events(run, at, text) VALUES (?,?,?)",
                [*told, (run.id, now, f"{TAKEN_IN}{last}")],
            )
            self._db.execute("COMMIT")
        return run.id

    def runs_of_host(self, axis: str, host: str) -> list[RunRecord]:
        """Adopted runs of an axis of another computer."""
        with self._errors():
            rows = self._db.execute(
                "SELECT runs.* FROM runs JOIN adopted ON adopted.run = id JOIN indexed ON "
                "indexed.run = id WHERE axis=? AND host=? ORDER BY runs.rowid",
                (axis, host),
            ).fetchall()
            return [self._record(row) for row in rows]

    def call_adopted(
        self, contexts: Mapping[str, RunContext], old: str, new: str, host: str
    ) -> None:
        """An axis of another computer is called otherwise there by now: its runs, and notes."""
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            self._db.executemany(
                "UPDATE runs SET axis=?, context=? WHERE id=?",
                [(new, context_text(context), run) for run, context in contexts.items()],
            )
            self._db.execute(
                "UPDATE axis_notes SET axis=? WHERE axis=? AND of_host=?", (new, old, host)
            )
            self._db.execute("COMMIT")

    def known_as(self, record: RunRecord) -> str | None:
        """What a run of another computer is called here; None: it is not known."""
        with self._errors():
            row = self._db.execute(
                "SELECT id FROM runs WHERE created=? AND serial=? AND link=?",
                (record.created, record.serial, record.link),
            ).fetchone()
        return None if row is None else str(row["id"])

    def free_id(self, run: str) -> str:
        """An id that no run has: this one, or with a number."""
        return next(
            one
            for n in range(1, _RUNS_A_SECOND)
            if not self.knows(one := run if n == 1 else f"{run}-{n}")
        )

    def knows(self, run: str) -> bool:
        """Whether there is a run of this id, as file names go: in capitals or not."""
        with self._errors():
            found = self._db.execute(
                "SELECT 1 FROM runs WHERE id=? COLLATE NOCASE", (run,)
            ).fetchone()
        return found is not None


def _host() -> list[str]:
    """The part of an id that tells runs of two computers apart."""
    name = platform.node().partition(".")[0]
    return [slug(name)[:_LONGEST_HOST].strip("._-")] if name else []


def _count(text: str) -> int:
    """The number at the end of an event; 0 where somebody wrote none there."""
    found = re.search(r"([0-9]{1,18})$", text)
    return int(found[1]) if found else 0
