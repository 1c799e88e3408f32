"""What a gateway does for its clients: it looks, offers, starts at most once, stops and tells.

No engine is known here: a request comes as text, and so goes the answer. What an engine may do to
them – deliver one twice, late, or never – moves nothing twice: a job begins by a nonce that is good
once, and by a row of the ledger of this computer that can be inserted once.
"""

from __future__ import annotations

import contextlib
import hashlib
import platform
import secrets
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from commissioning.ending import tool
from commissioning.errors import JournalError
from commissioning.fleet.acts import outcome_now
from commissioning.fleet.crew import Crew, Worker
from commissioning.fleet.file import Keys
from commissioning.fleet.gateway.folder import AxisFolder
from commissioning.fleet.gateway.messages import (
    KINDS,
    PROTOCOL,
    Ask,
    Axes,
    Chunk,
    Declined,
    Going,
    Greeting,
    News,
    Offered,
    PutBack,
    Restore,
    Since,
    Start,
    Started,
    Stop,
    Stopped,
    Which,
    Work,
)
from commissioning.fleet.gateway.news import Newsroom
from commissioning.fleet.gateway.parcels import Parcels
from commissioning.fleet.gateway.putting_back import put_back
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.messages import Order, Report
from commissioning.fleet.rows import LedgerRow, Whose
from commissioning.fleet.stopping import interrupt
from commissioning.journal import Journal
from commissioning.processes import clock, processors
from commissioning.result.endings import Error
from commissioning.result.fleet import ENDED, JobState
from commissioning.result.fleet_codec import json_of, of_json
from drivers.link_text import is_stepped
from profiles.axis import Axis
from profiles.errors import Refused, TwoRelayError, UsageError

__all__ = ["GOOD_FOR", "Station"]

_RECENT = 3.0  # s, in which a client that is there asks for news
GOOD_FOR = 30.0  # s: an offer, by the clock of the gateway
_CLEAN = JobState.DONE, JobState.NOT_HELPED, JobState.REJECTED, JobState.REFUSED


class _Offered(NamedTuple):
    """A job that may be started, until `until`; `confirmed`: SHA-256 of what was confirmed."""

    offer: Work
    until: float
    confirmed: str

    @property
    def of_it(self) -> tuple[str, str, int]:
        """Fleet run, axis and attempt."""
        return self.offer.run, self.offer.order.name, self.offer.order.attempt


@dataclass(frozen=True, slots=True)
class _At:
    """What a process is at."""

    run: str
    order: Order
    stepping: bool


class Station:
    """The gateway `name`: the axes of a folder, the ledger of a home, a crew.

    Raises nothing: `handle` answers with what was refused, too. `clock`: s, which nobody sets.
    `tell`: whoever stands beside it.
    """

    def __init__(
        self,
        name: str,
        folder: AxisFolder,
        home: Path,
        crew: Crew,
        clock: Callable[[], float] = clock,
        on_news: Callable[[], None] = lambda: None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._say = tell
        self.life = secrets.token_hex(8)
        self.name = name
        self.is_closing = False
        self._folder, self._home, self._crew, self._clock = folder, home, crew, clock
        self._news = Newsroom(self.life, on_news)
        self._parcels = Parcels(home)
        self._offers: dict[str, _Offered] = {}
        self._at: dict[Worker, _At] = {}
        self._stops: set[tuple[str, str, str]] = set()  # fleet run, axis, request
        self._asked = -_RECENT  # s, when a client was last heard
        self._lock = threading.Lock()  # of offers, workers and what they are at
        self._verbs: dict[str, Callable[[Any], object]] = {
            "hello": self._hello, "look": self._look, "offer": self._offer, "start": self._start,
            "settle": self._settle, "stop": self._stop, "news": self._tell, "fetch": self._fetch,
            "restore": self._restore,
        }  # fmt: skip

    def handle(self, verb: str, text: str) -> str:
        """The answer to a request: '+' and what it asks for, or '-' and why not."""
        try:
            if verb not in self._verbs:
                raise Refused(f"gateway '{self.name}' knows no '{verb}'", code="gateway.version")
            try:
                asked: object = of_json(text, KINDS[verb])
            except ValueError as error:
                raise Refused(
                    f"gateway '{self.name}' does not understand '{verb}': {error}",
                    code="gateway.version", hint="install one version on both computers",
                ) from None  # fmt: skip
            self._asked = self._clock()
            return "+" + json_of(self._verbs[verb](asked))
        except TwoRelayError as error:
            return "-" + json_of(Declined(error.code, error.text, error.exit_code, error.hint))
        except Exception as error:
            traceback.print_exc(file=sys.stderr)
            text = f"internal error on gateway '{self.name}' ({type(error).__name__}: {error})"
            return "-" + json_of(Declined("internal", text, 1))

    # -- who is there -----------------------------------------------------------------------------

    def _hello(self, ask: Ask) -> Axes:
        if ask.protocol != PROTOCOL:
            raise Refused(
                f"gateway '{self.name}' has tworelay {tool().version} (messages {PROTOCOL}), this "
                f"computer {ask.version} (messages {ask.protocol})",
                code="gateway.version",
                hint="install one version on both",
            )
        found = tuple(self._folder.tell(ask.axes, _below(ask.below), self._home))
        greeting = Greeting(
            PROTOCOL, tool().version, self.name, platform.node(), self.life, processors()
        )
        return Axes(greeting, found)

    # -- looking, offering, starting ---------------------------------------------------------------

    def _look(self, part: Work) -> Started:
        self._check_open()
        axis = self._folder.check_same(part.order.name, _below(part.below), part.order.axis)
        of_it = part.run, part.order.name, part.order.attempt
        with self._lock:
            for worker, at in self._at.items():
                if at.order.act == "look" and (at.run, at.order.name, at.order.attempt) == of_it:
                    return Started(worker.pid)  # it was asked for twice
        return Started(self._put_to_work(part.run, part.order, axis, anew=False))

    def _offer(self, offer: Work) -> Offered:
        self._check_open()
        order = offer.order
        self._folder.check_same(order.name, _below(offer.below), order.axis)
        now = self._clock()
        of_it = offer.run, order.name, order.attempt
        with self._lock:
            self._offers = {
                key: one for key, one in self._offers.items()
                if one.until > now and one.of_it != of_it
            }  # fmt: skip
            others = [one.offer for one in self._offers.values() if one.offer.run != offer.run]
        with Ledger(self._home) as ledger:
            known = ledger.row(*of_it)
            self._check_free(offer, ledger)
        for other in others:
            raise self._is_taken(other.run, other.order.name)
        if known is not None:
            raise Refused(
                f"attempt {order.attempt} at axis '{order.name}' is {known.state} on gateway "
                f"'{self.name}' already",
                code="gateway.once",
            )
        nonce = secrets.token_hex(16)
        with self._lock:
            self._offers[nonce] = _Offered(offer, now + GOOD_FOR, _hash(order))
        return Offered(nonce)

    def _check_free(self, offer: Work, ledger: Ledger) -> None:
        """Raises Refused where another fleet run moves something here, or this axis is moved."""
        with self._lock:
            taken = [(at.run, at.order.name) for at in self._at.values() if at.order.act == "job"]
        taken += [(run, row.axis) for run, row in ledger.moving()]
        for run, axis in taken:
            if run != offer.run or axis == offer.order.name:
                raise self._is_taken(run, axis)

    def _is_taken(self, run: str, axis: str) -> Refused:
        return Refused(
            f"gateway '{self.name}' has axis '{axis}' under way for fleet run {run}",
            code="run.in-progress",
            hint="wait until it has ended: one fleet run at a time moves what a gateway has",
        )

    def _start(self, start: Start) -> Started:
        self._check_open()
        now = self._clock()
        with self._lock:
            offered = self._offers.pop(start.nonce, None)
        if offered is None or offered.until < now:
            raise Refused(
                f"gateway '{self.name}' has no such offer: it came too late, twice, or was made "
                "before the gateway was started anew",
                code="gateway.nonce",
            )
        offer, order = offered.offer, offered.offer.order
        axis = self._folder.check_same(order.name, _below(offer.below), order.axis)
        with Ledger(self._home) as ledger:
            self._check_free(offer, ledger)
            granted = ledger.admit(
                offer.run, order.name, order.attempt, JobState.GRANTED, order.job,
                f"confirmed as {offered.confirmed[:16]}",
                Whose(start.fleet, start.host, start.operator), order.confirmed,
                order.options.serial,
            )  # fmt: skip
        if not granted:
            raise Refused(
                f"attempt {order.attempt} at axis '{order.name}' was begun already",
                code="gateway.once",
            )
        whose = " at ".join(filter(None, (start.operator, start.host))) or "another computer"
        self._say(f"'{order.name}': {order.job}, for {whose}")
        try:
            return Started(
                self._put_to_work(offer.run, order, axis, anew=not is_stepped(axis.link or ""))
            )
        except OSError as error:
            with Ledger(self._home) as ledger:
                ledger.revoke(offer.run, order.name, order.attempt, str(error))
            raise Refused(f"no process could be started: {error}", code="gateway.process") from None

    def _put_to_work(self, run: str, order: Order, axis: Axis, *, anew: bool) -> int:
        own = replace(order, fleet_run=run, axis=axis.as_said(), gateway="")
        with self._lock:
            worker = self._crew.order(own, anew=anew)
            self._at[worker] = _At(run, own, is_stepped(axis.link or ""))
        return worker.pid

    def _check_open(self) -> None:
        if self.is_closing:
            raise Refused(f"gateway '{self.name}' is being ended", code="gateway.closing")

    # -- how it stands, and its end ----------------------------------------------------------------

    def _settle(self, which: Which) -> Going:
        with self._lock:
            mine = any(
                at.run == which.run and at.order.name == which.axis
                and at.order.attempt == which.attempt and at.order.act == "job"
                for at in self._at.values()
            )  # fmt: skip
        with Ledger(self._home) as ledger:
            row = _settled(ledger, which, mine=mine)
        alive = row.state not in ENDED and (mine or row.is_alive)
        outcome = row.outcome
        if outcome is not None:  # with what its drive has by now
            with Journal(self._home, reading=True) as journal:
                outcome = outcome_now(outcome, journal)
        return Going(row.axis, row.attempt, row.state, alive, outcome, row.why)

    def _stop(self, stop: Stop) -> Stopped:
        with self._lock:
            self._offers = {
                key: one for key, one in self._offers.items() if not _is_of(stop, one.offer)
            }
            at_work = [(worker, at) for worker, at in self._at.items() if _is_of(stop, at)]
        for worker, at in at_work:
            if self._is_new(stop, at.order.name):
                worker.interrupt()
        told = [at.order.name for _, at in at_work]
        with contextlib.suppress(JournalError):
            with Ledger(self._home, reading=True) as ledger:  # of an earlier life of this gateway
                left = [row for run, row in ledger.moving() if run == stop.run]
            for row in left:
                if row.axis not in told and stop.axis in ("", row.axis):
                    told.append(row.axis)
                    if self._is_new(stop, row.axis):
                        with contextlib.suppress(OSError):
                            interrupt(row)
        return Stopped(tuple(told))

    def _is_new(self, stop: Stop, axis: str) -> bool:
        """Whether a process has not been told of this request: twice would mean more than once."""
        with self._lock:
            mark = stop.run, axis, stop.request
            is_new = mark not in self._stops
            self._stops.add(mark)
        return is_new

    def _tell(self, since: Since) -> News:
        return self._news.since(since)

    def _fetch(self, chunk: Chunk) -> Chunk:
        return self._parcels.chunk(chunk)

    def _restore(self, restore: Restore) -> PutBack:
        for axis in self.moving:
            raise self._is_taken("under way", axis)
        with Ledger(self._home, reading=True) as ledger:
            for run, row in ledger.moving():
                raise self._is_taken(run, row.axis)
            known = ledger.knows(restore.run)
        return put_back(restore) if known else PutBack(0, ("nothing to restore",))

    # -- what the processes say --------------------------------------------------------------------

    def hear(self, seconds: float) -> bool:
        """Take in the next thing that a process says; False: nothing in so long."""
        heard = self._crew.hear(seconds)
        if heard is None:
            return False
        worker, report = heard
        with self._lock:
            at = self._at.get(worker)
            if report is None:
                self._at.pop(worker, None)
                self._crew.buried(worker)
            elif at is not None and report.kind in ("looked", "ended", "void"):
                self._at.pop(worker)
                self._take_back(worker, at, report)
        if at is None:
            return True
        if report is None:
            report = self._of_dead(at)
        self._news.add(at.run, at.order.name, at.order.attempt, report)
        if at.order.act == "job" and report.kind in ("ended", "void"):
            self._say(f"'{at.order.name}': {report.state or 'not started'}")
        return True

    def _take_back(self, worker: Worker, at: _At, report: Report) -> None:
        ended = report.kind == "ended" and report.outcome is not None and report.state in _CLEAN
        if report.kind == "looked" or (ended and at.stepping):
            self._crew.take_back(worker)
        else:
            self._crew.let_go(worker)

    def _of_dead(self, at: _At) -> Report:
        """What is told of an axis whose process died."""
        if at.order.act == "look":
            text = f"the process that looked at it on gateway '{self.name}' ended without a word"
            return Report("looked", error=Error("internal", text), exit_code=1)
        which = Which(at.run, at.order.name, at.order.attempt, at.order.job)
        try:
            with Ledger(self._home) as ledger:
                row = _settled(ledger, which, mine=False)
        except JournalError as error:
            return Report("ended", text=str(error), state=JobState.UNKNOWN)  # to be settled later
        if row.state is JobState.REVOKED:
            return Report("void", text=row.why)
        return Report("ended", text=row.why, state=row.state, outcome=row.outcome)

    def interrupt(self) -> None:
        """Whoever sits at the gateway wants all of it stopped."""
        with self._lock:
            workers = list(self._at)
        for worker in workers:
            worker.interrupt()

    @property
    def is_awaited(self) -> bool:
        """Whether a client is there that has not heard all, or is fetching."""
        return self._clock() - self._asked < _RECENT

    @property
    def moving(self) -> tuple[str, ...]:
        """Axes that have a process of this life."""
        with self._lock:
            return tuple(at.order.name for at in self._at.values() if at.order.act == "job")


def _settled(ledger: Ledger, which: Which, *, mine: bool) -> LedgerRow:
    """An attempt as it stands; what was not started yet never will be, unless it is `mine`."""
    of_it = which.run, which.axis, which.attempt
    if ledger.row(*of_it) is None:
        ledger.admit(*of_it, JobState.REVOKED, which.job, "it was never started")
    row = ledger.row(*of_it)
    if row is not None and row.state is JobState.GRANTED and not mine:
        ledger.revoke(*of_it, "its process ended before it started")
        row = ledger.row(*of_it)
    if row is not None and row.state is JobState.STARTED and not (mine or row.is_alive):
        ledger.move(
            *of_it, JobState.UNKNOWN, given=(JobState.STARTED,),
            why="it was started, and its process is gone",
        )  # fmt: skip
        row = ledger.row(*of_it)
    assert row is not None
    return row


def _is_of(stop: Stop, one: Work | _At) -> bool:
    return one.run == stop.run and stop.axis in ("", one.order.name)


def _below(text: str) -> Keys:
    """Defaults of a fleet file, as they were sent; raises UsageError."""
    try:
        return Keys.model_validate_json(text)
    except ValueError as error:
        raise UsageError(f"the defaults of the fleet file are not understood: {error}") from None


def _hash(order: Order) -> str:
    """Of what was confirmed: the axis, what is asked of it, and the room that it has."""
    return hashlib.sha256(json_of(order).encode()).hexdigest()
