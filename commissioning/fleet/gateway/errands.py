"""What a fleet run has done on a gateway: looked at, started at most once, followed, stopped."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import secrets
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, replace
from typing import Any

from commissioning.ending import error_of
from commissioning.fleet.crew import Spoken, Worker
from commissioning.fleet.gateway.lines import PATIENCE, Far, Heard
from commissioning.fleet.gateway.messages import (
    Going,
    Offered,
    Start,
    Started,
    Stop,
    Stopped,
    Which,
    Work,
)
from commissioning.fleet.messages import Order, Report
from commissioning.fleet.settling import ON_GATEWAY
from commissioning.result.changes import Written
from commissioning.result.endings import Error
from commissioning.result.fleet import ENDED, JobState, Outcome
from drivers.errors import LinkLost
from profiles.errors import TwoRelayError

__all__ = ["FarWorker", "FleetOf", "TakeIn"]

_LOOK = 90.0  # s that a look may take
_SEEN = 2.0  # s without news, after which the ledger there is asked
_CONFIRMED = 1.0  # s in which a stop is confirmed, or people are told that it is not
_STOPS = 0.5  # s between two
Begin = Callable[[Coroutine[Any, Any, None]], Callable[[], object]]  # returns what cancels it
TakeIn = Callable[
    [Far, str, tuple[Written, ...]], Awaitable[str]
]  # a run of a gateway: fetched; its id here


@dataclass(frozen=True, slots=True)
class FleetOf:
    """The fleet run, for the ledger of a gateway.

    Attributes
    ----------
    run : as no other client can have it
    below : defaults of its fleet file, as JSON
    """

    run: str
    below: str
    fleet: str
    operator: str
    host: str


class FarWorker(Worker):
    """Does what a worker of this computer does, through a gateway."""

    def __init__(
        self, far: Far, whose: FleetOf, heard: queue.SimpleQueue[Spoken | None], begin: Begin,
        take_in: TakeIn,
    ) -> None:  # fmt: skip
        self.busy = ""
        self.moves = False
        self.gateway = far.name
        self._far, self._whose, self._heard, self._begin = far, whose, heard, begin
        self._take_in = take_in
        self._order: Order | None = None
        self._at_work = False
        self._is_stopping = False
        self._cancel: Callable[[], object] = lambda: None
        self._process = 0

    @property
    def pid(self) -> int:
        """Of the process there; 0 until it is known."""
        return self._process

    def order(self, order: Order) -> bool:
        """Begin it on the gateway; what becomes of it is heard."""
        self.busy, self.moves = order.name, order.act == "job"
        self._is_stopping, self._process = False, 0
        if order.act == "look":  # by a number of its own, so that an old answer is none
            order = replace(order, attempt=1 + secrets.randbelow(2**31))
        self._order, self._at_work = order, True
        self._cancel = self._begin(self._do(order))
        return True

    def interrupt(self) -> None:
        """Have it stopped there, and people told while that is not confirmed."""
        if not self._at_work or self._order is None:
            return
        if self._order.act == "look":
            self._cancel()
            self._at_work = False
            self._say(Report("ended", state=JobState.STOPPED))
            return
        self._begin(self._stop(self._order, secrets.token_hex(8)))

    def dismiss(self) -> None:
        """A gateway keeps its own processes."""

    @property
    def has_ended(self) -> bool:
        """Whether it is at nothing, as far as that can be known here."""
        return not self._at_work

    def give_up(self) -> None:
        """Wait for it no longer; for a look."""
        self._cancel()
        self._at_work = False

    def close(self) -> None:
        """There is nothing here to be let go of."""

    def _say(self, report: Report) -> None:
        self._heard.put(Spoken(self, report))

    # -- on the loop ------------------------------------------------------------------------------

    async def _do(self, order: Order) -> None:
        try:
            self._far.listen(order.name, order.attempt)
            last = await (self._look(order) if order.act == "look" else self._job(order))
        except TwoRelayError as error:
            last = _refused(order, error)
        except Exception as error:  # ours: what becomes of the axis is not known here
            said = Error("internal", f"internal error ({type(error).__name__}: {error})")
            last = _of_unknown(order, said)
        finally:
            self._far.forget(order.name, order.attempt)
        self._at_work = False
        self._say(last)

    async def _look(self, order: Order) -> Report:
        whose = self._whose
        asked = Work(whose.run, order, whose.below)
        heard = self._far.listen(order.name, order.attempt)
        await self._far.insist("look", asked, Started)
        until = asyncio.get_running_loop().time() + _LOOK
        while (left := until - asyncio.get_running_loop().time()) > 0:
            with contextlib.suppress(TimeoutError):
                piece = await asyncio.wait_for(heard.get(), left)
                if piece is None:  # it may have been told while nobody heard
                    await self._far.insist("look", asked, Started)
                elif piece.report.kind in ("looked", "ended"):
                    return piece.report
        raise LinkLost(
            f"gateway '{self.gateway}' has not said in {_LOOK:.0f} s what the look has shown",
            code="gateway.lost",
        )

    async def _job(self, order: Order) -> Report:
        whose = self._whose
        offer = Work(whose.run, order, whose.below)
        try:
            offered = await self._far.insist("offer", offer, Offered)
        except LinkLost as lost:
            return Report("void", text=f"{lost.text}: it was not started")
        if self._is_stopping:
            return Report("void", text="stopped before it was started")
        start = Start(offered.nonce, whose.fleet, whose.operator, whose.host)
        try:
            self._process = (await self._far.ask("start", start, Started)).process
        except TwoRelayError:  # heard or not, once or twice: the ledger there knows
            ended = await self._settled(order)
            if ended is not None:
                return ended
        return await self._followed(order)

    async def _followed(self, order: Order) -> Report:
        """To the end of a job that was started."""
        heard, was_lost = self._far.listen(order.name, order.attempt), False
        while True:
            report = await _next(heard)
            if report is not None and report.kind not in ("ended", "void"):
                self._say(report)
                continue
            if report is not None and report.outcome is not None and report.state is not None:
                at = Going(order.name, order.attempt, report.state, False, report.outcome)
                return await self._ended(order, at)
            if self._far.lost_since is not None:
                was_lost = True
                lost = f"gateway '{self.gateway}' does not answer; it is waited for, up to "
                self._say(Report("alarm", text=f"{lost}{PATIENCE:.0f} s"))
            ended = await self._settled(order)
            if was_lost and self._far.lost_since is None:
                was_lost = False
                self._say(Report("alarm", text=f"gateway '{self.gateway}' is back"))
            if ended is not None:
                return ended

    async def _settled(self, order: Order) -> Report | None:
        """How it has ended by the ledger of the gateway; None: it is under way."""
        which = Which(self._whose.run, order.name, order.attempt, order.job)
        try:
            going = await self._far.insist("settle", which, Going)
        except TwoRelayError as error:
            return _is_lost(order, error)
        if going.alive and going.state not in ENDED:
            return None
        return await self._ended(order, going)

    async def _ended(self, order: Order, going: Going) -> Report:
        """The last report, with the run fetched where all is well; else people are told first."""
        if going.state is JobState.REVOKED:
            return Report("void", text=going.why or "it was never started")
        outcome = going.outcome
        if outcome is None:
            said = Error("gateway.unknown", going.why or "nobody knows how it ended")
            return _of_unknown(order, said)
        if outcome.run is not None and (not outcome.at_rest or outcome.error is not None):
            left = f"run {outcome.run} {ON_GATEWAY} '{self.gateway}' until the end"
            outcome = replace(outcome, remark="; ".join(filter(None, (outcome.remark, left))))
        elif outcome.run is not None:
            self._say(Report("tell", text=f"fetching run {outcome.run}"))
            try:
                outcome = replace(
                    outcome, run=await self._take_in(self._far, outcome.run, outcome.written)
                )
            except Exception as error:  # the axis has ended well, whatever becomes of its files
                left = f"run {outcome.run} {ON_GATEWAY} '{self.gateway}': {error}"
                outcome = replace(outcome, remark="; ".join(filter(None, (outcome.remark, left))))
        return Report("ended", state=going.state, outcome=outcome, error=outcome.error)

    async def _stop(self, order: Order, request: str) -> None:
        """Until the gateway says that it has told the process, or the job has ended."""
        self._is_stopping = True
        loop = asyncio.get_running_loop()
        since, told = loop.time(), False
        while self._at_work and self._order is order:
            stop = Stop(self._whose.run, request, order.name)
            try:
                reached = (await self._far.ask("stop", stop, Stopped, _CONFIRMED)).axes
            except Exception:  # whatever it is: it is not known to have been told
                if not told and loop.time() - since >= _CONFIRMED:
                    told = True
                    text = (
                        f"NOT VERIFIED: gateway '{self.gateway}' has not confirmed the stop; the "
                        "emergency stop, if it must stop now"
                    )
                    self._say(Report("alarm", text=text))
                await asyncio.sleep(_STOPS)
                continue
            if told:
                self._say(Report("alarm", text=f"gateway '{self.gateway}' has the stop now"))
            if order.name in reached:
                return
            told = False  # its process is only just being started there
            await asyncio.sleep(_CONFIRMED / 10)


def _refused(order: Order, error: TwoRelayError) -> Report:
    """It was never started, and why."""
    said = error_of(error)
    if order.act == "look":
        return Report("looked", error=said, exit_code=error.exit_code)
    state = JobState.LINK if error.exit_code == LinkLost.exit_code else JobState.REFUSED
    return Report("ended", state=state, outcome=Outcome(error=said, at_rest=True), error=said)


def _of_unknown(order: Order, said: Error) -> Report:
    if order.act == "look":
        return Report("looked", error=said, exit_code=1)
    outcome = Outcome(error=said, at_rest=False)
    return Report("ended", state=JobState.UNKNOWN, outcome=outcome, error=said)


def _is_lost(order: Order, error: TwoRelayError) -> Report:
    text = f"{error.text}: nobody here knows how '{order.name}' stands"
    hint = "look at the axis; when its gateway answers, --resume asks it what became of it"
    return _of_unknown(order, Error(error.code, text, hint))


async def _next(heard: Heard) -> Report | None:
    """The next report; None: there was none, or some may be lost."""
    try:
        piece = await asyncio.wait_for(heard.get(), _SEEN)
    except TimeoutError:
        return None
    return None if piece is None else piece.report
