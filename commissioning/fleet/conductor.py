"""One fleet run, from the look at all its axes to its end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from datetime import datetime
from functools import partial

from commissioning.ending import operator, tool
from commissioning.errors import JournalError
from commissioning.fleet.board import Board, Standing
from commissioning.fleet.confirming import GOOD_FOR, Asked, question
from commissioning.fleet.crew import Crew, Worker
from commissioning.fleet.demand import Demand, Level
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.looking import (
    Seen,
    cut_off,
    look_and_pin,
    order_of,
    rules_of,
)
from commissioning.fleet.messages import Report
from commissioning.fleet.people import Answer, Ask, People
from commissioning.fleet.plan import Fleet
from commissioning.fleet.schedule import Rules, Task, obstacle, startable
from commissioning.fleet.serials import Pins
from commissioning.fleet.time_left import TimeLeft
from commissioning.fleet.zones import Zones
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.processes import clock
from commissioning.result.fleet import (
    FAILED,
    Confirmed,
    FleetResult,
    FleetState,
    JobState,
    in_doubt,
)
from commissioning.result.words import remaining
from drivers.home import home
from profiles.errors import Refused, TwoRelayError

__all__ = ["Conductor"]

_WAIT = 0.1  # s
_SHOWN = 0.25  # s between pictures
_RARELY = 10  # times as long as a picture takes: from the beginning of one to the next
_LATE = 0.05  # share of late cycles from which on nothing more starts beside it
_LEFT = "drive.left"  # a drive that was disabled without a fault, and not by us
_CLEAN = JobState.DONE, JobState.NOT_HELPED, JobState.REJECTED, JobState.REFUSED


class Conductor:
    """Runs a fleet.

    `in_advance` : how all is confirmed without a question; None: people are asked. `can_ask`:
    somebody is at the terminal. `doubtful`: axes that an earlier run has left, and why. `clock`: s,
    which never goes back, nor stands still.
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
        can_ask: bool = False,
        doubtful: Mapping[str, str] | None = None,
        clock: Callable[[], float] = clock,
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
        self._can_ask = can_ask
        self._doubtful = doubtful or {}
        self._clock = clock
        self._rules: Rules = rules_of(self.fleet, at_once)
        self._estimate = TimeLeft(self.fleet.job, self._rules, clock)
        self._zones = Zones(clock)
        self._question: tuple[Ask, Callable[[Answer], None]] | None = None
        self._asks = ""
        self._names: frozenset[str] = frozenset()
        self._shown = self._costly = 0.0
        self._demand = Demand(interruption, lambda: ledger.request(board.run), clock)
        self.error: TwoRelayError | None = None

    # -- from the look to the end ----------------------------------------------------------------

    def run(self, names: Collection[str]) -> FleetResult:
        """Do the job on these axes; returns the run as it ended, `error` says what ended it early.

        What moves is not left, whatever happens.
        """
        self._names = frozenset(names)
        self._people.show(self.result())
        try:
            self._look()
        except TwoRelayError as error:
            self.error = error
        else:
            self._go(FleetState.RUNNING)
            self._carry_on()
        if self._question is not None:
            self._people.withdraw()
        left = self.board.of(JobState.WAITING, JobState.PLANNED)
        over = self.error is None and not left and not self.draining
        self._go(FleetState.FINISHED if over else FleetState.STOPPED)
        self.error = self.error or self.board.failure
        self._estimate.over()
        for one in self._to_come():
            one.doing = ""
        self._people.show(result := self.result())
        return result

    @property
    def draining(self) -> bool:
        """Whether nothing more is to start."""
        return self._demand.level > Level.GO_ON

    def _carry_on(self) -> None:
        while True:
            self._heed()
            self._block()
            self._hear_people()
            self._go_on_in_zones()
            if not self.draining:
                self._seek_confirmation()
                self._start()
            if not self._running() and self._is_over():
                return
            heard = self._crew.hear(_WAIT)
            while heard is not None:  # all that is there, before anything is decided
                self._hear(*heard)
                heard = self._crew.hear(0.0)
            self._show()

    def result(self) -> FleetResult:
        """The run as it is now."""
        notes = [f"zone '{zone}' is paused" for zone in self._zones.paused]
        if self._question is not None and not self.draining:
            notes.append(f"its terminal waits for an answer: {self._asks}")
        return self.board.view(self.state, tool(), self._estimate.left(), tuple(notes))

    def _go(self, state: FleetState) -> None:
        if state is self.state:
            return
        self.state = state
        try:
            self._ledger.set_state(self.board.run, state)
        except JournalError as error:
            self.board.failure = self.board.failure or error

    def _look(self) -> None:
        """What the look at each axis comes to, for it, its group and its zone."""
        chosen = [one for one in self.board if one.name in self._names]

        def tell(name: str, found: Seen) -> None:
            said = found.looked.identity if found.looked else found.error and found.error.text
            self.board[name].doing = said or ""
            self._show()

        self._people.tell(f"looking at {len(chosen)} {'axis' if len(chosen) == 1 else 'axes'}")
        axes = [one.planned for one in chosen]
        found = look_and_pin(
            self.fleet, axes, self._crew, self._rules, self._pins, tell, self._check_while_looking
        )
        for one in chosen:
            one.looked = looked = found[one.name].looked
            one.serial = one.serial if looked is None else looked.serial
        self.board.move_all({one.name: found[one.name] for one in chosen})
        for one in self.board:
            self._blocks_its_group(one)
            if why := self._doubtful.get(one.name, ""):
                self._block_group(one.planned.group or "", why)
            if in_doubt(one.state, one.outcome):
                why = f"'{one.name}' in it is not verified to be at rest"
            if why and one.planned.zone:
                self._pause(one.planned.zone, why)
        with Journal(home(), reading=True) as journal:
            for name, run in cut_off(self.fleet, self._pins.known, journal).items():
                group = self.fleet.axis(name).group or ""
                why = f"run {run} on '{name}' of its group '{group}' was cut off"
                self._block_group(group, why)

    def _check_while_looking(self) -> None:
        """Raise what ends the look: a signal, or another process that asks for it."""
        self._interruption.check()
        if self._demand.heard():
            raise Refused(f"{self._demand.who} has ended the look", code="fleet.stopped")

    # -- what is so ------------------------------------------------------------------------------

    def _task(self, one: Standing) -> Task:
        return one.task(self._estimate.seconds(stepping=one.planned.is_stepping))

    def _waiting(self) -> list[Standing]:
        """Those that are asked for, and still to start."""
        return [one for one in self.board.of(JobState.WAITING) if one.name in self._names]

    def _to_come(self) -> list[Standing]:
        """Those, and what is still to be looked at."""
        to_come = self.board.of(JobState.WAITING, JobState.PLANNED)
        return [one for one in to_come if one.name in self._names]

    def _running(self) -> list[Standing]:
        return self.board.of(JobState.GRANTED, JobState.STARTED)

    def _may_start(self, among: Iterable[Standing]) -> list[Standing]:
        tasks = startable(
            [self._task(one) for one in among],
            [self._task(one) for one in self._running()],
            {one.name for one in self.board.of(JobState.DONE)},
            self._rules,
            paused=self._zones.paused,
            late=self._late(),
        )
        return [self.board[task.name] for task in tasks]

    def _late(self) -> set[str]:
        """Computers whose cycles come late."""
        return {one.planned.gateway or "" for one in self._running() if one.late > _LATE}

    def _is_over(self) -> bool:
        """Whether nothing can start any more."""
        waiting = self._waiting()
        if self.draining or not waiting:
            return True
        if self._question is not None:
            return False
        return not self._may_start(waiting)

    # -- people ----------------------------------------------------------------------------------

    def _heed(self) -> None:
        """Let nothing more start, or stop what runs, where that is asked for."""
        demand = self._demand
        try:
            new = demand.heard()
        except JournalError as error:
            self.board.failure = error
            new = False
        if self.board.failure is not None:
            why = f"the ledger takes no more ({self.board.failure.text})"
            new = demand.raised(Level.DRAIN, why) or new
        if not new:
            return
        self._show(now=True)
        if demand.level is Level.DRAIN:
            more = "; once more stops it" if self._interruption.count else ""
            self._people.tell(f"{demand.who}: {self._what_runs()}nothing more starts{more}")
            if self._question is not None:
                self._question = None
                self._people.withdraw()
            return
        self._people.tell(f"{demand.who}: what runs is stopped")
        workers = self._crew.at_work()
        for one in self._running():
            if (worker := workers.get(one.name)) is not None:
                worker.interrupt()

    def _what_runs(self) -> str:
        """What is still to be finished, and how long that takes."""
        running = self._running()
        if not running:
            return ""
        names = ", ".join(f"'{one.name}'" for one in running)
        self._expect(only_running=True)
        return f"finishing {names}, about {remaining(self._estimate.left() or 0.0)} more; "

    def _drain(self, why: str) -> None:
        """Let nothing more start."""
        if self._demand.raised(Level.DRAIN, why):
            self._people.tell(f"{why}: {self._what_runs()}nothing more starts")

    def _ask(self, text: str, word: str, then: Callable[[Answer], None]) -> None:
        """One question at a time; `then` gets what becomes of it."""
        self._question, self._asks = (self._people.ask(text, word), then), f"Type {word}"

    def _hear_people(self) -> None:
        """See whether the question was answered."""
        if self._question is None:
            return
        pending, then = self._question
        answer = pending()
        if answer is None:
            return
        self._question = None
        if answer is Answer.NOBODY:
            self._drain("nobody is at the terminal")
        else:
            then(answer)

    def _seek_confirmation(self) -> None:
        """Ask for what could start, if only it might."""
        now = self._clock()
        waiting = self._waiting()
        candidates = [one for one in self._may_start(waiting) if one.confirmed_until < now]
        if not candidates or self._question is not None:
            return
        if self._in_advance is not None:
            for one in waiting:
                self._confirm(one, self._in_advance)
            return
        first = candidates[0]
        with_room = [(o.planned, o.looked.room) for o in waiting if o.looked is not None]
        seconds = self._estimate.seconds(stepping=first.planned.is_stepping)
        asked = question(self.fleet, first.planned, with_room, seconds)
        self._ask(asked.text, asked.word, partial(self._told_of_axes, asked))

    def _told_of_axes(self, asked: Asked, answer: Answer) -> None:
        waiting = [self.board[name] for name in asked.axes]
        for one in (one for one in waiting if one.state is JobState.WAITING):
            if answer is Answer.YES:
                self._confirm(one, f"'{asked.word}' was typed")
            else:
                self.board.move(one, JobState.REFUSED, "not confirmed: nothing was moved")
                self._blocks_its_group(one)

    def _confirm(self, one: Standing, how: str) -> None:
        assert one.looked is not None
        at = datetime.now().astimezone().isoformat(timespec="seconds")
        one.confirmed = Confirmed(operator() or "unknown", at, how, one.looked.room)
        one.confirmed_until = self._clock() + GOOD_FOR

    def _show(self, *, now: bool = False) -> None:
        """A picture of the run, now and then, or `now`."""
        begun = self._clock()
        if begun - self._shown < max(self._costly, 0.0 if now else _SHOWN):
            return
        self._shown = begun
        tasks = [self._task(one) for one in self._running()]
        done = {one.name for one in self.board.of(JobState.DONE)}
        late = self._late()
        for one in self._waiting():
            what = obstacle(self._task(one), tasks, done, paused=self._zones.paused, late=late)
            unconfirmed = "" if one.confirmed_until else "to be confirmed"
            one.doing = "" if self.draining else what or unconfirmed
        self._people.show(self.result())
        self._costly = _RARELY * (self._clock() - begun)  # of many axes a picture takes its time

    # -- starting --------------------------------------------------------------------------------

    def _start(self) -> None:
        now = self._clock()
        confirmed = [o for o in self._waiting() if o.confirmed_until >= now]
        for one in self._may_start(confirmed):
            if self.board.grant(one):
                one.since = now
                self._begin(one)
            self._expect()
            self._show(now=True)

    def _begin(self, one: Standing) -> None:
        assert one.looked is not None
        order = order_of(
            self.fleet, one.planned, "job", self.board.run, one.attempt, one.looked, one.confirmed
        )
        self._crew.order(order, anew=not one.planned.is_stepping)

    def _expect(self, *, only_running: bool = False) -> None:
        """How long it still takes."""

        def work() -> tuple[list[Task], dict[Task, float]]:
            now = self._clock()
            running = {self._task(one): now - one.since for one in self._running()}
            waiting = [] if only_running or self.draining else self._waiting()
            return [self._task(one) for one in waiting], running

        self._estimate.renew(work)

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
        elif report.kind == "alarm":
            self._people.tell(f"'{name}': {report.text}")
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
        if state is JobState.STOPPED and self._demand.level is Level.STOP:
            why = f"stopped ({self._demand.who}); --again {one.name} does it again"
            self.board.explain(one, why)
        if state is JobState.DONE:
            self._estimate.learn(self._clock() - one.since, stepping=stepping)
        self._fell(one)

    def _settle(self, one: Standing, why: str) -> None:
        """Its process has not started it, or is gone."""
        if one.is_under_way:
            self.board.revoke(one, why)
            self._fell(one)

    # -- what follows from an end ----------------------------------------------------------------

    def _fell(self, one: Standing) -> None:
        """What follows from the end of an axis."""
        self._blocks_its_group(one)
        error = one.outcome.error if one.outcome else None
        name, zone = one.name, one.planned.zone
        if in_doubt(one.state, one.outcome):
            why = one.why.partition(";")[0]
            self._people.tell(f"'{name}': NOT VERIFIED that it is at rest: {why}")
            if zone:
                self._pause(zone, f"'{name}' in it is not verified to be at rest")
        elif error is not None and error.code == _LEFT and zone:
            why = f"'{name}' was disabled without a fault, as an emergency stop does"
            self._pause(zone, why, may_be_woken=True)
        self._expect()
        self._show(now=True)

    def _blocks_its_group(self, one: Standing) -> None:
        group = one.planned.group
        if not group or one.state not in FAILED:
            return
        if self.fleet.groups[group].on_failure == "stop-group" or in_doubt(one.state, one.outcome):
            self._block_group(group, f"'{one.name}' of its group '{group}' is {one.state}")

    def _block_group(self, group: str, why: str) -> None:
        for other in self._to_come():
            if group and other.planned.group == group:
                self.board.move(other, JobState.BLOCKED, why)

    def _block(self) -> None:
        """What waits for an axis that will not be done in this run."""
        for one, why in list(self.board.in_vain(self._names)):
            self.board.move(one, JobState.BLOCKED, why)

    def _pause(self, zone: str, why: str, *, may_be_woken: bool = False) -> None:
        self._zones.pause(zone, may_be_woken=may_be_woken)
        self._people.tell(f"zone '{zone}' is paused: {why}")

    def _go_on_in_zones(self) -> None:
        """Where an axis has shown that its zone is enabled still, or where somebody says so."""
        for one in self._zones.woken(self._running()):
            self._people.tell(
                f"zone '{one.planned.zone}' goes on: '{one.name}' in it stays enabled, so that it "
                "was no emergency stop"
            )
        held = self._zones.held(self._waiting(), self._running())
        self._go(FleetState.PAUSED if held else FleetState.RUNNING)
        if held and self._question is None and self._can_ask and not self.draining:
            text = (
                f"Zone '{held[0]}' is paused. When all its axes are at rest, its emergency stop is "
                "released and nobody is in it:"
            )
            self._ask(text, held[0], partial(self._told_of_zone, held[0]))

    def _told_of_zone(self, zone: str, answer: Answer) -> None:
        self._zones.free(zone)
        for one in self._waiting():
            if one.planned.zone != zone:
                continue
            one.confirmed_until = 0.0  # what was seen before is not what is there now
            if answer is Answer.NO:
                self.board.move(one, JobState.BLOCKED, f"zone '{zone}' is paused")
