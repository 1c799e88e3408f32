"""One fleet run, from the look at all its axes to its end."""

from __future__ import annotations

import signal
import statistics
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from datetime import datetime
from typing import Protocol

from commissioning.ending import operator, tool
from commissioning.fleet.board import Board, Standing
from commissioning.fleet.confirming import GOOD_FOR, Asked, question
from commissioning.fleet.crew import Crew, Worker
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.looking import Seen, judged, look_at_all, order_of, rules_of, task_of
from commissioning.fleet.messages import Report
from commissioning.fleet.plan import Fleet
from commissioning.fleet.schedule import Rules, Task, makespan, startable
from commissioning.fleet.serials import NO_SERIAL, Pins
from commissioning.interruption import Interruption
from commissioning.result.fleet import (
    FAILED,
    Confirmed,
    FleetResult,
    FleetState,
    JobState,
)

__all__ = ["Conductor", "People", "seconds_of"]

_WAIT = 0.1  # s
_SHOWN, _ASKED = 0.25, 0.5  # s between pictures, and between looks at what is asked for
_LATE = 0.05  # share of late cycles from which on nothing more starts beside it
_STILL_ENABLED = 0.5  # s after which an axis of a zone shows that it was no emergency stop
_LEFT = "drive.left"  # a drive that was disabled without a fault, and not by us
_CLEAN = JobState.DONE, JobState.NOT_HELPED, JobState.REJECTED, JobState.REFUSED
_SECONDS = {  # of one axis: in real time, and in simulated time
    "identify": (13.0, 1.0), "commission": (57.0, 3.0), "verify": (50.0, 2.0),
}  # fmt: skip


def seconds_of(job: str, *, stepping: bool) -> float:
    """That a job on one axis takes, as far as experience goes."""
    return _SECONDS[job][stepping]


class People(Protocol):
    """Whoever looks on, and is asked."""

    def tell(self, text: str) -> None:
        """One line."""

    def ask(self, text: str, word: str) -> Callable[[], bool | None]:
        """Ask for a word; what is returned says whether it was typed; None: not answered yet."""

    def show(self, result: FleetResult) -> None:
        """The run as it is now."""


class Conductor:
    """Runs a fleet.

    `in_advance` : how all is confirmed without a question; None: people are asked. `clock`: s,
    which never goes back.
    """

    def __init__(
        self,
        board: Board,
        ledger: Ledger,
        crew: Crew,
        people: People,
        interruption: Interruption,
        *,
        pins: Pins,
        at_once: int | None = None,
        in_advance: str | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.fleet: Fleet = board.fleet
        self.board = board
        self.state = FleetState.CHECKING
        self._ledger = ledger
        self._crew = crew
        self._people = people
        self._interruption = interruption
        self._pins = pins
        self._in_advance = in_advance
        self._clock = clock
        self._rules: Rules = rules_of(self.fleet, at_once)
        self._took: dict[bool, list[float]] = {True: [], False: []}
        self._paused: dict[str, float] = {}  # zone → s of the monotonic clock
        self._question: tuple[Asked, Callable[[], bool | None]] | None = None
        self._wake: tuple[str, Callable[[], bool | None]] | None = None
        self._shown = self._asked = 0.0
        self._heeded = 0
        self._left: tuple[float, float] | None = None  # s left, and when that was so
        self.draining = False

    # -- from the look to the end ----------------------------------------------------------------

    def run(self, names: Collection[str]) -> FleetResult:
        """Do the job on these axes; returns the run as it ended."""
        self._people.show(self.result())
        try:
            self._look([one for one in self.board if one.name in names])
        except BaseException:
            self._go(FleetState.STOPPED)
            raise
        self._go(FleetState.RUNNING)
        while True:
            self._heed()
            self._block()
            self._resume_zones()
            if not self.draining:
                self._ask()
                self._start()
            if not self.board.of(JobState.GRANTED, JobState.STARTED) and self._is_over():
                break
            heard = self._crew.hear(_WAIT)
            if heard is not None:
                self._hear(*heard)
            self._show()
        over = not self.board.of(JobState.WAITING) and not self.draining
        self._go(FleetState.FINISHED if over else FleetState.STOPPED)
        self._left = None
        result = self.result()
        self._people.show(result)
        return result

    def result(self) -> FleetResult:
        """The run as it is now."""
        left = None
        if self._left is not None:
            left = max(0.0, self._left[0] - (self._clock() - self._left[1]))
        return self.board.view(self.state, tool(), left)

    def _go(self, state: FleetState) -> None:
        if state is self.state:
            return
        self.state = state
        if self.board.failure is None:
            self._ledger.set_state(self.board.run, state)

    def _look(self, standings: Iterable[Standing]) -> None:
        """Look at each, hold each drive to its axis, and pin those that are new."""
        chosen = list(standings)

        def tell(name: str, found: Seen) -> None:
            said = found.looked.identity if found.looked else found.error and found.error.text
            self.board[name].doing = said or ""
            self._show()

        self._people.tell(f"looking at {len(chosen)} axes")

        seen = look_at_all(
            self.fleet, [one.planned for one in chosen], self._crew, self._rules, tell,
            self._interruption.check,
        )  # fmt: skip
        said = {one.name: one.serial for one in self.fleet.axes if one.serial is not None}
        pinned = {**self._pins.known, **said}
        found = judged(seen, pinned)
        self._pins.pin(
            {
                name: one.looked.serial
                for name, one in found.items()
                if one.error is None and one.looked and name not in pinned
                and one.looked.serial not in NO_SERIAL
            }
        )  # fmt: skip
        for one in chosen:
            its = found[one.name]
            one.looked = its.looked
            if its.looked is not None:
                one.serial = its.looked.serial
            if its.error is None:
                self.board.move(one, JobState.WAITING)
            else:
                self.board.move(one, its.state, its.error.text)
                self._blocks_its_group(one)
        for one in self.board.of(JobState.UNKNOWN):  # nobody knows where it stands
            self._blocks_its_group(one)

    # -- what is so ------------------------------------------------------------------------------

    def _task(self, one: Standing) -> Task:
        return task_of(one.planned, self._seconds(stepping=one.planned.is_stepping))

    def _seconds(self, *, stepping: bool) -> float:
        """That a job takes, by those that have ended, or by experience, s."""
        took = self._took[stepping]
        return statistics.fmean(took) if took else seconds_of(self.fleet.job, stepping=stepping)

    def _running(self) -> list[Standing]:
        return self.board.of(JobState.GRANTED, JobState.STARTED)

    def _may_start(self, among: Iterable[Standing]) -> list[Standing]:
        tasks = startable(
            [self._task(one) for one in among],
            [self._task(one) for one in self._running()],
            {one.name for one in self.board.of(JobState.DONE)},
            self._rules,
            paused=self._paused,
            late=any(one.late > _LATE for one in self._running()),
        )
        return [self.board[task.name] for task in tasks]

    def _is_over(self) -> bool:
        """Whether nothing can start any more."""
        waiting = self.board.of(JobState.WAITING)
        if self.draining or not waiting:
            return True
        if self._question is not None or self._wake is not None:
            return False
        return not self._may_start(waiting)

    # -- people ----------------------------------------------------------------------------------

    def _heed(self) -> None:
        """Signals, and what other processes ask for."""
        count = self._interruption.count
        if count > self._heeded:
            first = self._heeded == 0 and self._interruption.signal != signal.SIGTERM
            self._heeded = count
            self._stop_starting(
                "interrupted: what runs is finished, nothing more starts; once more stops it"
                if first
                else "interrupted: what runs is stopped"
            )
            if not first:
                self._stop_running()
        if self._clock() - self._asked < _ASKED or self.board.failure is not None:
            return
        self._asked = self._clock()
        request = self._ledger.request(self.board.run)
        if request and not self.draining:
            self._stop_starting("'tworelay fleet stop' ends this run")
            if request == "stop":
                self._stop_running()

    def _stop_starting(self, why: str) -> None:
        if not self.draining or why:
            self._people.tell(why)
        self.draining = True

    def _stop_running(self) -> None:
        for one in self._running():
            worker = self._workers.get(one.name)
            if worker is not None:
                worker.interrupt()

    @property
    def _workers(self) -> dict[str, Worker]:
        return self._crew.at_work()

    def _ask(self) -> None:
        """See what was answered; ask for what could start, if only it might."""
        if self._question is not None:
            asked, answer = self._question
            yes = answer()
            if yes is None:
                return
            self._question = None
            self._answered(asked, yes=yes)
        now = self._clock()
        waiting = self.board.of(JobState.WAITING)
        candidates = [one for one in self._may_start(waiting) if one.confirmed_until < now]
        if not candidates:
            return
        if self._in_advance is not None:
            for one in waiting:
                self._confirm(one, self._in_advance)
            return
        first = candidates[0]
        with_room = [(o.planned, o.looked.room) for o in waiting if o.looked is not None]
        seconds = self._seconds(stepping=first.planned.is_stepping)
        asked = question(self.fleet, first.planned, with_room, seconds)
        self._question = asked, self._people.ask(asked.text, asked.word)

    def _answered(self, asked: Asked, *, yes: bool) -> None:
        for name in asked.axes:
            one = self.board[name]
            if yes:
                self._confirm(one, f"'{asked.word}' was typed")
            else:
                self.board.move(one, JobState.REFUSED, "not confirmed: nothing was moved")

    def _confirm(self, one: Standing, how: str) -> None:
        assert one.looked is not None
        at = datetime.now().astimezone().isoformat(timespec="seconds")
        one.confirmed = Confirmed(operator() or "unknown", at, how, one.looked.room)
        one.confirmed_until = self._clock() + GOOD_FOR

    def _show(self) -> None:
        if self._clock() - self._shown >= _SHOWN:
            self._shown = self._clock()
            self._people.show(self.result())

    # -- starting --------------------------------------------------------------------------------

    def _start(self) -> None:
        if self.board.failure is not None:
            self._stop_starting(f"nothing more starts: {self.board.failure}")
            return
        now = self._clock()
        confirmed = [o for o in self.board.of(JobState.WAITING) if o.confirmed_until >= now]
        for one in self._may_start(confirmed):
            if self.board.grant(one):
                one.since = now
                self._begin(one)
            self._left = self._expected()

    def _begin(self, one: Standing) -> None:
        assert one.looked is not None
        order = order_of(self.fleet, one.planned, "job", self.board.run, one.attempt)
        options = replace(order.options, serial=one.looked.serial)
        order = replace(order, room=one.looked.room, options=options)
        self._crew.order(order, anew=not one.planned.is_stepping)

    def _expected(self) -> tuple[float, float]:
        """Seconds that are left, and when that was so."""
        now = self._clock()
        running = {}
        for one in self._running():
            task = self._task(one)
            running[task] = max(0.0, task.seconds - (now - one.since))
        waiting = [self._task(one) for one in self.board.of(JobState.WAITING)]
        return makespan(waiting, running, self._rules), now

    # -- what workers say ------------------------------------------------------------------------

    def _hear(self, worker: Worker, report: Report | None) -> None:
        name = worker.busy
        if report is None:
            self._crew.buried(worker)
            if name:
                self._settle(self.board[name], "its process died")
            return
        if not name:
            return
        one = self.board[name]
        if report.kind == "step":
            one.state = JobState.STARTED
            one.step, one.steps, one.doing = report.step, report.steps, report.text
        elif report.kind == "tell":
            one.doing = report.text
        elif report.kind == "pulse":
            one.late = report.late
            one.moving_at = self._clock() if report.moving else one.moving_at
        elif report.kind == "void":
            self._crew.let_go(worker)
            self._settle(one, report.text)
        elif report.kind == "ended":
            self._ended(worker, one, report)

    def _ended(self, worker: Worker, one: Standing, report: Report) -> None:
        state = report.state or JobState.UNKNOWN
        if report.outcome is None:  # a signal, before it was granted
            self._crew.let_go(worker)
            self._settle(one, "interrupted before it started")
            return
        self.board.end(one, state, report.outcome)
        stepping = one.planned.is_stepping
        if stepping and state in _CLEAN:
            self._crew.take_back(worker)
        else:
            self._crew.let_go(worker)
        if state is JobState.DONE:
            self._took[stepping].append(self._clock() - one.since)
        self._fell(one)

    def _settle(self, one: Standing, why: str) -> None:
        """Its process has not started it, or is gone."""
        if one.is_under_way:
            self.board.revoke(one, why)
            self._fell(one)

    # -- what follows from an end ----------------------------------------------------------------

    def _fell(self, one: Standing) -> None:
        if one.state in FAILED:
            self._blocks_its_group(one)
        error = one.outcome.error if one.outcome else None
        if error is not None and error.code == _LEFT and one.planned.zone:
            self._pause(one.planned.zone, one)
        self._left = self._expected()

    def _blocks_its_group(self, one: Standing) -> None:
        group = one.planned.group
        if not group or self.fleet.groups[group].on_failure == "go-on":
            return
        for other in self.board.of(JobState.WAITING, JobState.PLANNED):
            if other.planned.group == group:
                why = f"'{one.name}' of its group '{group}' is {one.state}"
                self.board.move(other, JobState.BLOCKED, why)

    def _block(self) -> None:
        """What waits for an axis that will not be done in this run."""
        hopeful = {o.name for o in self.board.of(JobState.WAITING, JobState.PLANNED)}
        hopeful |= {o.name for o in self._running()} | {
            o.name for o in self.board.of(JobState.DONE)
        }
        for one in self.board.of(JobState.WAITING):
            lost = [name for name in one.planned.after if name not in hopeful]
            if lost:
                state = self.board[lost[0]].state
                why = f"is to run after '{lost[0]}', which is {state}"
                self.board.move(one, JobState.BLOCKED, why)

    def _pause(self, zone: str, one: Standing) -> None:
        """It may have been the emergency stop: nothing starts there until somebody says so."""
        self._paused[zone] = self._clock()
        self._people.tell(
            f"'{one.name}' was disabled without a fault, as an emergency stop does: zone '{zone}' "
            "is paused"
        )

    def _resume_zones(self) -> None:
        for zone, since in list(self._paused.items()):
            awake = [
                one for one in self._running()
                if one.planned.zone == zone and one.moving_at > since + _STILL_ENABLED
            ]  # fmt: skip
            if awake:
                del self._paused[zone]
                self._people.tell(
                    f"zone '{zone}' goes on: '{awake[0].name}' in it stays enabled, so that it was "
                    "no emergency stop"
                )
        if self._wake is not None:
            zone, answer = self._wake
            yes = answer()
            if yes is not None:
                self._wake = None
                self._woken(zone, yes=yes)
        held = [
            zone for zone in self._paused
            if any(one.planned.zone == zone for one in self.board.of(JobState.WAITING))
        ]  # fmt: skip
        still = any(one.planned.zone in held for one in self._running())
        if held and self._wake is None and self._question is None and not still:
            if self._in_advance is not None:
                return  # nobody is at the terminal: the run ends without them
            text = (
                f"Zone '{held[0]}' is paused. When its emergency stop is released and nobody is in "
                "it:"
            )
            self._wake = held[0], self._people.ask(text, held[0])
        if self.state in (FleetState.RUNNING, FleetState.PAUSED):
            self._go(FleetState.PAUSED if held else FleetState.RUNNING)

    def _woken(self, zone: str, *, yes: bool) -> None:
        self._paused.pop(zone, None)
        for one in self.board.of(JobState.WAITING):
            if one.planned.zone != zone:
                continue
            one.confirmed_until = 0.0  # what was seen before is not what is there now
            if not yes:
                self.board.move(one, JobState.BLOCKED, f"zone '{zone}' is paused")
