"""A computer with a gateway: a real station and ledger; its processes are fakes that outlive it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any
from unittest import mock

from commissioning.fleet.gateway.folder import AxisFolder
from commissioning.fleet.gateway.messages import Going, Which
from commissioning.fleet.gateway.station import Station
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.messages import Looked, Order, Report
from commissioning.processes import boot, this_process
from commissioning.result.fleet import JobState, Outcome, Room
from commissioning.result.fleet_codec import json_of, of_json
from profiles.errors import TwoRelayError

if TYPE_CHECKING:
    from tests.gateways.world import World

__all__ = ["NOBODY", "Gateway"]

ROOM = Room(3.0, 1.0, 30.0)
NOBODY = 2**30  # number of a process that there is not
BEGINS = 0.3  # s until a job is started


class FakeProcess:
    """A worker on a gateway, which outlives it."""

    gateway = ""

    def __init__(self, at: Gateway, heard: deque[tuple[Any, Report | None]]) -> None:
        self.busy = ""
        self.moves = False
        self.pid = next(at.numbers)
        self.at = at
        self.heard = heard
        self.signals = 0
        self.is_dead = False
        self.has_started = False
        self._task: asyncio.Task[None] | None = None

    def order(self, order: Order) -> bool:
        self.busy, self.moves = order.name, order.act == "job"
        self._task = self.at.world.loop.create_task(self._do(order))
        self.at.tasks.append(self._task)
        return True

    def say(self, report: Report | None) -> None:
        self.heard.append((self, report))

    async def _do(self, order: Order) -> None:
        await asyncio.sleep(BEGINS)
        if order.act == "look":
            serial = f"0x{sum(map(ord, order.name)):08X}"
            self.say(Report("looked", looked=Looked(serial, "a drive", "p 1", ROOM)))
            return
        of_it = order.fleet_run, order.name, order.attempt
        if self.is_told():
            self.say(Report("ended", state=JobState.STOPPED))
            return
        me: Any = {**this_process(), "boot": boot()}
        with Ledger(self.at.home) as ledger:
            granted = ledger.move(*of_it, JobState.STARTED, given=(JobState.GRANTED,), also=me)
        if not granted:
            self.say(Report("void", text="not granted"))
            return
        self.has_started = True
        beside = {one.fleet_run for one in self.at.order_of.values()} - {order.fleet_run}
        self.at.world.clashes += [f"{order.fleet_run} beside {one}" for one in beside]
        self.at.world.moved[of_it] += 1
        self.at.order_of[self] = order
        self.say(Report("step", text="measuring", step=1, steps=1))
        state, until = JobState.DONE, self.at.world.loop.time() + self.at.world.lasts
        while self.at.world.loop.time() < until:
            await asyncio.sleep(0.25)
            self.say(Report("pulse", moving=True))
            if self.is_told():
                state = JobState.STOPPED
                break
        outcome = Outcome(at_rest=True, seconds=1.0)
        with Ledger(self.at.home) as ledger:
            ledger.end(*of_it, state, outcome, "")
        self.at.order_of.pop(self, None)
        self.say(Report("ended", state=state, outcome=outcome))

    def interrupt(self) -> None:
        self.signals += 1

    def is_told(self) -> bool:
        return self.signals > 0

    def dismiss(self) -> None:
        """It ends by itself."""

    def kill(self) -> None:
        """As by SIGKILL: it says nothing any more, and its row has no process."""
        if self._task is not None:
            self._task.cancel()
        self.is_dead = True
        order = self.at.order_of.pop(self, None)
        if order is not None:
            with Ledger(self.at.home) as ledger:
                ledger._db.execute(
                    "UPDATE fleet_axes SET pid=? WHERE fleet_run=? AND axis=? AND attempt=?",
                    (NOBODY, order.fleet_run, order.name, order.attempt),
                )
        self.say(None)


class FakeCrew:
    """The processes of one life of a gateway."""

    def __init__(self, at: Gateway) -> None:
        self.at = at
        self.all: list[FakeProcess] = []
        self.heard: deque[tuple[FakeProcess, Report | None]] = deque()

    def order(self, order: Order, *, anew: bool) -> FakeProcess:
        worker = FakeProcess(self.at, self.heard)
        self.all.append(worker)
        worker.order(order)
        return worker

    def hear(self, seconds: float) -> tuple[FakeProcess, Report | None] | None:
        return self.heard.popleft() if self.heard else None

    def take_back(self, worker: FakeProcess) -> None:
        if worker in self.all:
            self.all.remove(worker)

    let_go = buried = take_back


class Gateway:
    """A computer: its home and processes stay, its gateway is started and killed."""

    def __init__(self, world: World, name: str, axes: list[str]) -> None:
        self.world, self.name = world, name
        self.home = world.folder / f"home-{name}"
        self.folder = world.folder / f"axes-{name}"
        self.folder.mkdir()
        for n, axis in enumerate(axes):
            (self.folder / f"{axis}.toml").write_text(f'link = "virtual://bench?seed={n}"\n')
        self.numbers = itertools.count(1)
        self.tasks: list[asyncio.Task[None]] = []
        self.order_of: dict[FakeProcess, Order] = {}
        self.station: Station | None = None
        self.crew = FakeCrew(self)
        self.asleep = 0.0  # s that it was stopped for
        self.skew = 0.0  # s that its calendar is off by
        self.frozen = asyncio.Event()
        self.frozen.set()
        self.start()

    def start(self) -> None:
        self.crew = FakeCrew(self)
        self.station = Station(
            self.name, AxisFolder(self.folder), self.home, self.crew,  # type: ignore[arg-type]
            clock=self.world.loop.time,
        )  # fmt: skip
        self._ear = self.world.loop.create_task(self._hear(self.station))

    async def _hear(self, station: Station) -> None:
        while True:
            await self.frozen.wait()
            with self.calendar(), contextlib.suppress(TwoRelayError):
                while station.hear(0.0):
                    pass
            await asyncio.sleep(0.05)

    def die(self) -> None:
        """As by SIGKILL; its processes go on."""
        self.station = None
        self._ear.cancel()

    @contextlib.contextmanager
    def calendar(self) -> Iterator[None]:
        """With the date that this computer takes for today's."""
        now = time.time

        def skewed() -> float:
            return now() + self.skew

        with mock.patch("commissioning.fleet.ledger.time.time", skewed):
            yield

    def going(self, key: str, axis: str, attempt: int) -> Going:
        """How it stands, without any wire."""
        if self.station is None:
            self.start()
        assert self.station is not None
        text = self.station.handle("settle", json_of(Which(key, axis, attempt)))
        assert text.startswith("+"), text
        return of_json(text[1:], Going)
