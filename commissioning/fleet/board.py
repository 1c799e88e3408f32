"""Where every axis of a fleet run is: in memory, and before that in the ledger."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from commissioning.errors import JournalError
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.looking import Seen, task_of
from commissioning.fleet.messages import Looked
from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.fleet.rows import LedgerRow
from commissioning.fleet.schedule import Task
from commissioning.fleet.view import view
from commissioning.result.document import Tool
from commissioning.result.fleet import (
    ENDED,
    Confirmed,
    FleetAxis,
    FleetResult,
    FleetState,
    JobState,
    Outcome,
)
from commissioning.result.words import iso

__all__ = ["Board", "Standing"]

_ACTIVE = (  # of which there is to be told
    JobState.PLANNED, JobState.WAITING, JobState.GRANTED, JobState.STARTED,
)  # fmt: skip


@dataclass
class Standing:
    """One axis of the run, as it stands.

    Attributes
    ----------
    began, ended : of the present attempt, s since 1970
    since : s of the monotonic clock, when it was granted
    moving_at : s of the monotonic clock, when it was last seen in motion, enabled
    late : share of its cycles that came late, of late
    """

    planned: PlannedAxis
    attempt: int
    state: JobState
    serial: str | None = None
    looked: Looked | None = None
    confirmed: Confirmed | None = None
    confirmed_until: float = 0.0
    step: int = 0
    steps: int = 0
    doing: str = ""
    why: str = ""
    began: float | None = None
    ended: float | None = None
    since: float = 0.0
    moving_at: float = 0.0
    late: float = 0.0
    outcome: Outcome | None = None
    _task: Task | None = None

    @property
    def name(self) -> str:
        """Of the axis."""
        return self.planned.name

    def task(self, seconds: float) -> Task:
        """As the schedule sees it, if it takes so long."""
        if self._task is None or self._task.seconds != seconds:
            self._task = task_of(self.planned, seconds)
        return self._task

    @property
    def is_under_way(self) -> bool:
        """Whether a process has it."""
        return self.state in (JobState.GRANTED, JobState.STARTED)


class Board:
    """All axes of a run.

    Attributes
    ----------
    failure : why the ledger takes no more; then nothing more is begun
    """

    def __init__(self, fleet: Fleet, ledger: Ledger, run: str) -> None:
        self.fleet = fleet
        self.run = run
        self.failure: JournalError | None = None
        self._ledger = ledger
        self._record = ledger.record(run)
        rows = ledger.rows(run)
        self._all = {
            one.name: _standing(one, rows[one.name]) for one in fleet.axes if one.name in rows
        }

    def __iter__(self) -> Iterator[Standing]:
        return iter(self._all.values())

    def __getitem__(self, name: str) -> Standing:
        return self._all[name]

    def of(self, *states: JobState) -> list[Standing]:
        """Those that are in one of these states."""
        return [one for one in self._all.values() if one.state in states]

    def in_vain(self, asked: Collection[str]) -> Iterator[tuple[Standing, str]]:
        """Of those that are asked for, what waits for one that will not be done, and why."""
        under_way = JobState.GRANTED, JobState.STARTED, JobState.DONE
        hopeful = {one.name for one in self.of(*under_way)}
        to_come = self.of(JobState.WAITING, JobState.PLANNED)
        hopeful |= {one.name for one in to_come if one.name in asked}
        for one in to_come:
            lost = [name for name in one.planned.after if name not in hopeful]
            if lost and one.state is JobState.WAITING and one.name in asked:
                yield one, f"is to run after '{lost[0]}', which is {self[lost[0]].state}"

    def move(
        self, one: Standing, new: JobState, why: str = "", given: Sequence[JobState] = ()
    ) -> None:
        """A transition, in the ledger first; a ledger that fails is kept as the `failure`."""
        try:
            moved = self._ledger.move(
                self.run, one.name, one.attempt, new, why=why, given=given,
                also={"serial": one.serial},
            )  # fmt: skip
        except JournalError as error:
            self.failure = self.failure or error
        else:
            if not moved:
                self._learn(one, why)
                return
        one.state, one.why = new, why

    def move_all(self, seen: Mapping[str, Seen]) -> None:
        """What the look at each has come to."""
        try:
            with self._ledger.together():
                for name, its in seen.items():
                    self.move(self[name], its.state, its.error.text if its.error else "")
        except JournalError as error:
            self.failure = self.failure or error

    def grant(self, one: Standing) -> bool:
        """Let it be started, once; False: it must not."""
        assert one.confirmed is not None
        try:
            granted = self._ledger.grant(
                self.run, one.name, one.attempt, one.confirmed, one.serial or "",
                one.planned.gateway,
            )  # fmt: skip
        except JournalError as error:
            self.failure = self.failure or error
            return False
        if not granted:
            self._learn(one, "it was not to be granted")
        if granted:
            one.state = JobState.GRANTED
            one.began, one.moving_at, one.late = time.time(), 0.0, 0.0
        return granted

    def revoke(self, one: Standing, why: str) -> None:
        """Take a grant back; where it was started, the ledger knows how it stands.

        What was handed to a gateway is taken back only when that has said that it did not start it.
        """
        of_it = self.run, one.name, one.attempt
        try:
            if one.planned.gateway is not None:
                self._ledger.learn(*of_it, JobState.REVOKED, None, why)
            elif not self._ledger.revoke(*of_it, why):
                self._learn(one, why, dead=True)
                return
        except JournalError as error:
            self.failure = self.failure or error
            self._ended(one, JobState.UNKNOWN, why)
            return
        self._ended(one, JobState.REVOKED, why)

    def _learn(self, one: Standing, why: str, *, dead: bool = False) -> None:
        """How an axis stands that somebody else has moved on, or whose process is `dead`."""
        try:
            row = self._ledger.rows(self.run)[one.name]
            if row.state is JobState.STARTED and dead:
                self._ledger.move(
                    self.run, one.name, one.attempt, JobState.UNKNOWN, why=why,
                    given=(JobState.STARTED,),
                )  # fmt: skip
        except JournalError as error:
            self.failure = self.failure or error
            self._ended(one, JobState.UNKNOWN, why)
            return
        if row.state is JobState.STARTED:  # of a process that is dead, or not of this runner
            self._ended(one, JobState.UNKNOWN, why)
            return
        one.outcome = row.outcome
        self._ended(one, row.state, row.why)

    def end(self, one: Standing, state: JobState, outcome: Outcome) -> None:
        """A job has ended; its own process has kept that, if it could."""
        why = outcome.error.text if outcome.error else outcome.remark
        try:
            self._ledger.end(self.run, one.name, one.attempt, state, outcome, why)
        except JournalError as error:
            self.failure = self.failure or error
        one.outcome = outcome
        self._ended(one, state, why)

    def explain(self, one: Standing, why: str) -> None:
        """Say why it ended, where its process could not know."""
        try:
            self._ledger.explain(self.run, one.name, one.attempt, why)
        except JournalError as error:
            self.failure = self.failure or error
        one.why = why

    @staticmethod
    def _ended(one: Standing, state: JobState, why: str) -> None:
        one.state, one.why, one.ended = state, why, time.time()

    def view(
        self, state: FleetState, tool: Tool | None, left: float | None, notes: tuple[str, ...] = ()
    ) -> FleetResult:
        """The run as it is now."""
        over = state in (FleetState.FINISHED, FleetState.STOPPED)
        record = replace(self._record, ended=time.time() if over else None)
        axes = [_shown(one, one.planned.link or self._record.place(one.name).link) for one in self]
        return view(record, axes, state, tool, left, notes, rehearsed=self.fleet.rehearsed)


def _standing(planned: PlannedAxis, row: LedgerRow) -> Standing:
    return Standing(
        planned, row.attempt, row.state, row.serial, confirmed=row.confirmed, why=row.why,
        began=row.began, ended=row.at if row.state in ENDED else None, outcome=row.outcome,
    )  # fmt: skip


def _shown(one: Standing, link: str) -> FleetAxis:
    planned, outcome = one.planned, one.outcome
    return FleetAxis(
        one.name, one.state, one.attempt, link, planned.group, planned.zone, one.serial,
        one.step, one.steps, one.doing if one.state in _ACTIVE else "", one.why,
        None if one.began is None else one.confirmed,
        iso(one.began), iso(one.ended), outcome, planned.gateway,
    )  # fmt: skip
