"""The ledger of fleet runs, in the journal's file: each transition is kept before the act.

An axis moves at most once a grant. The runner grants; the process that will move it turns `granted`
into `started` before it opens the link; whoever takes over turns `granted` into `revoked` first. Of
the two, one changes the row, and the other lets the axis be.
"""

from __future__ import annotations

import json
import platform
import sqlite3
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from commissioning.errors import JournalError
from commissioning.fleet.rows import WHOSE, FleetRecord, LedgerRow, Whose, row_of
from commissioning.journal_file import OpenJournal, slug
from commissioning.processes import boot, this_process
from commissioning.result.fleet import (
    ENDED,
    Confirmed,
    FleetJob,
    FleetState,
    JobState,
    Outcome,
)
from commissioning.result.fleet_codec import json_of
from profiles.errors import UnknownName, UsageError

__all__ = ["Ledger"]

_RUNS_A_SECOND = 100
T = TypeVar("T")


class Ledger(OpenJournal):
    """The fleet runs of this computer; raises JournalError when they cannot be read or written."""

    _is_together = False

    @contextmanager
    def together(self) -> Generator[None]:
        """All that is written in it at once, or nothing; for what precedes no act."""
        with self._change():
            self._is_together = True
            try:
                yield
            finally:
                self._is_together = False

    @contextmanager
    def _change(self) -> Generator[sqlite3.Connection]:
        """All of it or nothing, on the disk when this returns."""
        if self._is_together:
            yield self._db
            return
        with self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            yield self._db
            self._db.execute("COMMIT")

    # -- fleet runs ------------------------------------------------------------------------------

    def begin(
        self, name: str, file: Path, job: str, definition: str, operator: str, axes: Sequence[str]
    ) -> str:
        """Open a fleet run with all its axes planned; returns its id."""
        now = time.time()
        stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(now))
        me = this_process()
        for n in range(_RUNS_A_SECOND):
            run = f"{stamp}-fleet-{slug(name)}" + (f"-{n}" if n else "")
            with self._change() as db:
                taken = db.execute("SELECT 1 FROM fleet_runs WHERE id=?", (run,)).fetchone()
                if taken is not None:
                    continue
                db.execute(
                    "INSERT INTO fleet_runs(id, created, name, file, job, definition, state, host, "
                    "operator, pid, started, boot) VALUES (?,?,?,?,?,?,?,?,?,?,?,?)",
                    (
                        run, now, name, str(file), job, definition, FleetState.CHECKING,
                        platform.node(), operator, me["pid"], me["started"], boot(),
                    ),
                )  # fmt: skip
                db.executemany(
                    "INSERT INTO fleet_axes(fleet_run, axis, attempt, state, at) VALUES "
                    "(?,?,1,?,?)",
                    [(run, axis, JobState.PLANNED, now) for axis in axes],
                )
            return run
        raise JournalError("no free id of a fleet run within this second")

    def take_over(self, run: str, operator: str) -> None:
        """The runner of `run` is the present process, from now on."""
        me = this_process()
        with self._change() as db:
            db.execute(
                "UPDATE fleet_runs SET pid=?, started=?, boot=?, operator=?, state=?, ended=NULL, "
                "request='' WHERE id=?",
                (me["pid"], me["started"], boot(), operator, FleetState.CHECKING, run),
            )
            self._tell(db, run, "", 0, f"taken over by process {me['pid']} ({operator})")

    def set_state(self, run: str, state: FleetState) -> None:
        """Where the fleet run is now."""
        over = state in (FleetState.FINISHED, FleetState.STOPPED)
        with self._change() as db:
            db.execute(
                "UPDATE fleet_runs SET state=?, ended=? WHERE id=?",
                (state, time.time() if over else None, run),
            )
            self._tell(db, run, "", 0, str(state))

    def ask(self, run: str, request: str) -> None:
        """Ask the runner of `run` for something."""
        with self._change() as db:
            db.execute("UPDATE fleet_runs SET request=? WHERE id=?", (request, run))
            self._tell(db, run, "", 0, f"asked to {request}")

    def request(self, run: str) -> str:
        """What somebody asks of this runner."""
        with self._errors():
            row = self._db.execute("SELECT request FROM fleet_runs WHERE id=?", (run,)).fetchone()
        return str(row["request"]) if row else ""

    def record(self, run: str, file: Path | None = None) -> FleetRecord:
        """A fleet run by its id, or the `last` (of that `file`); raises UnknownName."""
        with self._errors():
            if run == "last":
                of = None if file is None else str(file.resolve())
                row = self._db.execute(
                    "SELECT * FROM fleet_runs WHERE ? IS NULL OR file=? ORDER BY rowid DESC "
                    "LIMIT 1", (of, of),
                ).fetchone()  # fmt: skip
            else:
                row = self._db.execute("SELECT * FROM fleet_runs WHERE id=?", (run,)).fetchone()
            if row is None and run == "last":
                of = f" of {file}" if file else ""
                raise UsageError(f"no fleet run{of} yet: 'tworelay fleet run FLEET' begins one")
            if row is None:
                recent = self._db.execute("SELECT id FROM fleet_runs ORDER BY rowid DESC LIMIT 5")
                raise UnknownName("fleet run", run, [found["id"] for found in recent])
            return self._record(row)

    def live(self) -> list[FleetRecord]:
        """Runs that somebody runs, or of which a process still moves an axis, the last first."""
        with self._errors():
            rows = self._db.execute("SELECT * FROM fleet_runs ORDER BY rowid DESC").fetchall()
            found = [self._record(row) for row in rows]
        moving = {run for run, _ in self.moving()} | self._handed_over(found)
        over = FleetState.FINISHED, FleetState.STOPPED
        return [
            one for one in found if one.id in moving or (one.state not in over and one.is_alive)
        ]

    def _handed_over(self, among: Sequence[FleetRecord]) -> set[str]:
        """Runs of which an axis is under way on a gateway, as far as is known here."""
        with self._errors():
            rows = self._db.execute(
                "SELECT fleet_run, axis FROM fleet_axes WHERE state=?", (JobState.STARTED,)
            ).fetchall()
        of = {one.id: one for one in among}
        return {run for run, axis in rows if run in of and of[run].place(axis).gateway}

    def _record(self, row: sqlite3.Row) -> FleetRecord:
        return self._sound(lambda: FleetRecord(**{**row, "state": FleetState(row["state"])}))

    # -- axes ------------------------------------------------------------------------------------

    def rows(self, run: str) -> dict[str, LedgerRow]:
        """The last attempt at each axis, in the order of the file."""
        with self._errors():
            found = self._db.execute(
                "SELECT * FROM fleet_axes WHERE fleet_run=? ORDER BY attempt, rowid", (run,)
            ).fetchall()
            rows: dict[str, LedgerRow] = {}
            for row in found:
                rows[row["axis"]] = self._row(row)
        return rows

    def move(
        self,
        run: str,
        axis: str,
        attempt: int,
        new: JobState,
        *,
        why: str = "",
        given: Sequence[JobState] = (),
        also: Mapping[str, str | float | None] | None = None,
        over: JobState | None = None,
    ) -> bool:
        """One transition of one axis; whether the row was in a state `given`, and so is changed.

        Without `given` from any state that is no ending. `also`: other columns that it sets.
        `over`: a state that it goes through, of which there is to be told.
        """
        columns = also or {}
        allowed = given or [state for state in JobState if state not in ENDED]
        marks = ",".join("?" * len(allowed))
        sets = "".join(f", {column}=?" for column in columns)
        with self._change() as db:
            changed = db.execute(
                f"UPDATE fleet_axes SET state=?, at=?, why=?{sets} WHERE fleet_run=? AND axis=? "  # noqa: S608
                f"AND attempt=? AND state IN ({marks})",
                (new, time.time(), why, *columns.values(), run, axis, attempt, *allowed),
            ).rowcount
            if changed and over is not None:
                self._tell(db, run, axis, attempt, str(over))
            if changed:
                self._tell(db, run, axis, attempt, f"{new}: {why}" if why else str(new))
        return changed == 1

    def grant(
        self, run: str, axis: str, attempt: int, confirmed: Confirmed, serial: str,
        gateway: str | None = None,
    ) -> bool:  # fmt: skip
        """Let one process, once, move this axis.

        `gateway` : whose ledger knows from now on whether it was started
        """
        handed = gateway is not None
        return self.move(
            run, axis, attempt, JobState.STARTED if handed else JobState.GRANTED,
            why=f"handed to gateway '{gateway}'" if handed else "",
            given=(JobState.PLANNED, JobState.WAITING),
            also={
                "confirmed": json_of(confirmed), "serial": serial, "began": time.time(),
            },
            over=JobState.GRANTED if handed else None,
        )  # fmt: skip

    def start(self, run: str, axis: str, attempt: int) -> bool:
        """By the process that is to move the axis, before it opens the link; False: it must not."""
        me: dict[str, float] = {**this_process()}  # type: ignore[dict-item]
        return self.move(
            run, axis, attempt, JobState.STARTED,
            given=(JobState.GRANTED,), also={**me, "boot": boot()},
        )  # fmt: skip

    def learn(
        self, run: str, axis: str, attempt: int, state: JobState, outcome: Outcome | None, why: str
    ) -> bool:
        """What the ledger of its gateway says of an axis that was handed over."""
        also = {"run": outcome.run, "outcome": json_of(outcome)} if outcome else {}
        given = JobState.GRANTED, JobState.STARTED, JobState.UNKNOWN
        return self.move(run, axis, attempt, state, why=why, given=given, also=also)

    def fetched(self, run: str, axis: str, attempt: int, outcome: Outcome) -> None:
        """The run of an attempt that has ended is here now, as the outcome names it."""
        with self._change() as db:
            db.execute(
                "UPDATE fleet_axes SET run=?, outcome=? WHERE fleet_run=? AND axis=? AND attempt=?",
                (outcome.run, json_of(outcome), run, axis, attempt),
            )

    def revoke(self, run: str, axis: str, attempt: int, why: str) -> bool:
        """Take a grant back; False: it was started already, or never given."""
        return self.move(run, axis, attempt, JobState.REVOKED, why=why, given=(JobState.GRANTED,))

    def end(
        self, run: str, axis: str, attempt: int, state: JobState, outcome: Outcome, why: str
    ) -> bool:
        """How a job that was started has ended."""
        return self.move(
            run, axis, attempt, state, why=why, given=(JobState.STARTED,),
            also={"run": outcome.run, "outcome": json_of(outcome)},
        )  # fmt: skip

    def explain(self, run: str, axis: str, attempt: int, why: str) -> None:
        """Why an axis has ended, where its process could not know."""
        with self._change() as db:
            db.execute(
                "UPDATE fleet_axes SET why=? WHERE fleet_run=? AND axis=? AND attempt=?",
                (why, run, axis, attempt),
            )
            self._tell(db, run, axis, attempt, why)

    def gateway_of(self, run: str) -> tuple[str, str, str] | None:
        """Of a run that was fetched: its fleet run, axis and gateway."""
        with self._errors():
            rows = self._db.execute(
                "SELECT fleet_run, axis FROM fleet_axes WHERE run=? ORDER BY rowid DESC", (run,)
            ).fetchall()
        for row in rows:
            gateway = self.record(row["fleet_run"]).place(row["axis"]).gateway
            if gateway is not None:
                return str(row["fleet_run"]), str(row["axis"]), gateway
        return None

    # -- of other computers' runs, on a gateway ---------------------------------------------------

    def admit(
        self, key: str, axis: str, attempt: int, state: JobState, job: FleetJob, why: str = "",
        whose: Whose = WHOSE, confirmed: Confirmed | None = None, serial: str | None = None,
    ) -> bool:  # fmt: skip
        """A first word on this attempt: granted, or revoked for good; False: there is one."""
        me, now = this_process(), time.time()
        said = None if confirmed is None else json_of(confirmed)
        with self._change() as db:
            db.execute(
                "INSERT OR IGNORE INTO fleet_runs(id, created, name, file, job, definition, state, "
                "host, operator, pid, started, boot, ended) VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?)",
                (
                    key, now, whose.fleet or key, f"a file on {whose.host or 'another computer'}",
                    job, json.dumps({"axes": {}}), FleetState.FINISHED, whose.host, whose.operator,
                    me["pid"], me["started"], boot(), now,
                ),
            )  # fmt: skip
            new = db.execute(
                "INSERT OR IGNORE INTO fleet_axes(fleet_run, axis, attempt, state, at, why, "
                "confirmed, serial, began) VALUES (?,?,?,?,?,?,?,?,?)",
                (key, axis, attempt, state, now, why, said, serial, now),
            ).rowcount
            if new:
                self._tell(db, key, axis, attempt, f"{state}: {why}" if why else str(state))
        return new == 1

    def knows(self, run: str) -> bool:
        """Whether there is such a fleet run."""
        with self._errors():
            found = self._db.execute("SELECT 1 FROM fleet_runs WHERE id=?", (run,)).fetchone()
        return found is not None

    def row(self, run: str, axis: str, attempt: int) -> LedgerRow | None:
        """One attempt at one axis."""
        with self._errors():
            found = self._db.execute(
                "SELECT * FROM fleet_axes WHERE fleet_run=? AND axis=? AND attempt=?",
                (run, axis, attempt),
            ).fetchone()
            return None if found is None else self._row(found)

    def moving(self) -> list[tuple[str, LedgerRow]]:
        """Axes that a process of this computer has, and of which fleet run."""
        with self._errors():
            found = self._db.execute(
                "SELECT * FROM fleet_axes WHERE state=?", (JobState.STARTED,)
            ).fetchall()
            rows = [(str(row["fleet_run"]), self._row(row)) for row in found]
        return [(run, row) for run, row in rows if row.is_alive]

    def left_open(self, file: Path) -> list[tuple[str, LedgerRow]]:
        """Axes of any run of a fleet file that were granted, or started and not ended."""
        with self._errors():
            found = self._db.execute(
                "SELECT fleet_axes.* FROM fleet_axes JOIN fleet_runs ON fleet_run = id WHERE "
                "file=? AND fleet_axes.state IN (?,?)",
                (str(file.resolve()), JobState.GRANTED, JobState.STARTED),
            ).fetchall()
            return [(str(row["fleet_run"]), self._row(row)) for row in found]

    def attempts(self, run: str) -> list[LedgerRow]:
        """Every attempt at every axis, in the order in which they came."""
        with self._errors():
            found = self._db.execute(
                "SELECT * FROM fleet_axes WHERE fleet_run=? ORDER BY rowid", (run,)
            ).fetchall()
            return [self._row(row) for row in found]

    def again(self, run: str, attempts: Mapping[str, int]) -> None:
        """A new attempt at each of these axes, after the one that is given."""
        now = time.time()
        with self._change() as db:
            db.executemany(
                "INSERT INTO fleet_axes(fleet_run, axis, attempt, state, at) VALUES (?,?,?,?,?)",
                [(run, axis, n + 1, JobState.PLANNED, now) for axis, n in attempts.items()],
            )
            for axis, n in attempts.items():
                self._tell(db, run, axis, n + 1, "planned again")

    def note(self, run: str, text: str, axis: str = "", attempt: int = 0) -> None:
        """Something that happened to a fleet run, or to no run ('')."""
        with self._change() as db:
            self._tell(db, run, axis, attempt, text)

    def events(self, run: str) -> list[tuple[float, str, int, str]]:
        """All that happened: s since 1970, axis, attempt, text."""
        with self._errors():
            rows = self._db.execute(
                "SELECT at, axis, attempt, text FROM fleet_events WHERE fleet_run=? ORDER BY seq",
                (run,),
            ).fetchall()
        return [(row["at"], row["axis"], row["attempt"], row["text"]) for row in rows]

    def _row(self, row: sqlite3.Row) -> LedgerRow:
        return self._sound(lambda: row_of(dict(row)))

    def _sound(self, made: Callable[[], T]) -> T:
        """What a row says, if it is as it must be."""
        try:
            return made()
        except (ValueError, TypeError) as error:
            raise self._damaged(error) from None

    @staticmethod
    def _tell(db: sqlite3.Connection, run: str, axis: str, attempt: int, text: str) -> None:
        db.execute(
            "INSERT INTO fleet_events(fleet_run, axis, attempt, at, text) VALUES (?,?,?,?,?)",
            (run, axis, attempt, time.time(), text),
        )
