"""Gateways without processes and sockets: real stations, ledgers, lines and conductors, and a clock
that stands still while nothing waits.

A job is a fake one that counts in the drive how often it was begun; whatever the wire does to a
message, or a computer to its processes, is said by the test.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from commissioning.errors import Interrupted
from commissioning.fleet.board import Board
from commissioning.fleet.conductor import Conductor
from commissioning.fleet.crew import Crew, Spoken
from commissioning.fleet.gateway.gateways import Gateways, fleet_of
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.loading import load_fleet
from commissioning.fleet.people import Answer, Ask
from commissioning.fleet.plan import Fleet
from commissioning.fleet.rows import FleetRecord
from commissioning.fleet.serials import Pins
from commissioning.fleet.taking_up import again, begin, none_under_way, resume
from commissioning.interruption import Interruption
from commissioning.result.fleet import FleetResult, JobState
from drivers.errors import LinkError, LinkLost
from tests.gateways.computers import NOBODY, Gateway

__all__ = ["Client", "ClientDied", "Gateway", "Trouble", "World"]

LASTS = 6.0  # s that a job takes


class ClientDied(BaseException):
    """The client's process is gone: nothing of it is cleaned up."""


class SteppedLoop(asyncio.SelectorEventLoop):
    """Its time is that of the next thing that waits."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 1000.0

    def time(self) -> float:
        return self.now

    def _run_once(self) -> None:
        ready, scheduled = self._ready, self._scheduled  # type: ignore[attr-defined]
        if not ready and scheduled:
            self.now = max(self.now, scheduled[0].when())
        super()._run_once()  # type: ignore[misc]


class Hub:
    """Where what concerns gateways happens: on the stepped loop."""

    def __init__(self, loop: SteppedLoop) -> None:
        self.loop = loop
        self.begun: list[asyncio.Task[None]] = []

    def do(self, work: Coroutine[Any, Any, Any]) -> Any:
        return self.loop.run_until_complete(work)

    def begin(self, work: Coroutine[Any, Any, None]) -> Callable[[], object]:
        task = self.loop.create_task(work)
        self.begun.append(task)
        return task.cancel

    def close(self) -> None:
        for task in self.begun:
            task.cancel()


class SteppedCrew(Crew):
    """Listens in simulated time."""

    def __init__(self, world: World, folder: Path, gateways: Gateways) -> None:
        super().__init__(folder, gateways.worker)
        self._world = world

    def hear(self, seconds: float) -> Spoken | None:
        async def wait() -> None:
            until = self._world.loop.time() + seconds
            while self._queue.empty() and self._world.loop.time() < until:
                await asyncio.sleep(0.02)

        if seconds > 0 and self._queue.empty():
            self._world.loop.run_until_complete(wait())
        with contextlib.suppress(queue.Empty):
            return self._queue.get_nowait()
        return None

    def close(self, signals: Callable[[], int] = lambda: 0) -> None:
        """What moves on gateways is waited for."""
        for _ in range(20_000):
            left = [worker for worker in self._all if not worker.has_ended]
            for worker in left:
                if not (worker.busy and worker.moves):
                    worker.give_up()
            if not left:
                break
            self._world.go_on(0.1)
        else:
            raise AssertionError("a worker never ends")
        self._all.clear()


# -- the wire -------------------------------------------------------------------------------------


@dataclass
class Trouble:
    """What happens to the n-th message of a kind, and then to the wire.

    Attributes
    ----------
    does : before: it is lost; after: its answer is; twice: it comes twice; late: it comes so many
        s after it was given up; hang: no answer comes
    outage : s for which no line can be had
    """

    verb: str
    number: int = 1
    does: str = "before"
    late: float = 0.0
    outage: float = 0.0
    then: Callable[[], None] = lambda: None
    met: int = field(default=0, init=False)


class FakeWire:
    """A line to a gateway."""

    def __init__(self, world: World, gateway: Gateway) -> None:
        self._world, self._gateway = world, gateway
        self._life = gateway.station
        self._broken = False

    async def call(self, verb: str, text: str, seconds: float) -> str:
        try:
            return await asyncio.wait_for(self._called(verb, text), seconds)
        except TimeoutError:
            raise self._lost("no answer") from None

    async def _called(self, verb: str, text: str) -> str:
        await asyncio.sleep(0.002)
        trouble = self._world.trouble_of(verb)
        if self._broken or not self._world.has_wire(self._gateway):
            raise self._lost("the wire is cut")
        if trouble is None:
            return await self._delivered(verb, text)
        trouble.then()
        if trouble.outage:
            self._world.cut(self._gateway, trouble.outage)
        if trouble.does == "before":
            self._broken = True
        elif trouble.does == "after":
            await self._delivered(verb, text)
            self._broken = True
        elif trouble.does == "twice":
            await self._delivered(verb, text)
            return await self._delivered(verb, text)
        elif trouble.does == "late":
            self._broken = True
            self._world.later(trouble.late, self._gateway, verb, text)
        elif trouble.does == "hang":
            await self._delivered(verb, text)
            await asyncio.sleep(1e6)
        elif trouble.does == "pass":
            return await self._delivered(verb, text)
        raise self._lost(f"{verb}: {trouble.does}")

    async def _delivered(self, verb: str, text: str) -> str:
        gateway = self._gateway
        await gateway.frozen.wait()
        for _ in range(20):
            if gateway.station is None or gateway.station is not self._life:
                self._broken = True
                raise self._lost("it has died")
            with gateway.calendar():
                answer = gateway.station.handle(verb, text)
            if verb != "news" or not answer.endswith('"pieces": []}'):
                return answer
            await asyncio.sleep(0.05)
            await gateway.frozen.wait()
        return answer

    def _lost(self, why: str) -> LinkLost:
        return LinkLost(f"gateway '{self._gateway.name}' does not answer ({why})")

    async def close(self) -> None:
        self._broken = True


# -- all of it ------------------------------------------------------------------------------------


class People:
    """Looks on; `at` is called with the number of each picture."""

    def __init__(self, at: Callable[[int, FleetResult], None]) -> None:
        self.told: list[str] = []
        self._at, self._count = at, 0

    def tell(self, text: str) -> None:
        self.told.append(text)

    def ask(self, text: str, word: str) -> Ask:
        return lambda: Answer.YES

    def withdraw(self) -> None:
        """Nothing was asked."""

    def show(self, result: FleetResult) -> None:
        self._count += 1
        self._at(self._count, result)


class Client:
    """A computer from which a fleet is run."""

    def __init__(self, world: World, name: str, text: str) -> None:
        self.world, self.name = world, name
        self.home = world.folder / f"home-of-{name}"
        folder = world.folder / name
        folder.mkdir()
        self.path = folder / "line.toml"
        self.path.write_text(text, "utf-8")
        self.run_id = ""
        self.people: People | None = None
        self.interruption = Interruption()

    async def _opened(self, gateway: str) -> FakeWire:
        at = self.world.gateways[gateway]
        await asyncio.sleep(0.01)
        if at.station is None or not self.world.has_wire(at) or not at.frozen.is_set():
            await asyncio.sleep(1.0)
            raise LinkError(f"gateway '{gateway}' cannot be reached")
        return FakeWire(self.world, at)

    @contextlib.contextmanager
    def reach(self, record: FleetRecord) -> Iterator[Gateways]:
        gateways = Gateways(fleet_of(record), self._opened, Hub(self.world.loop))
        try:
            yield gateways
        finally:
            gateways.close()

    def run(
        self, *, at: Callable[[int, FleetResult], None] = lambda n, result: None,
        take_up: bool = False, do_again: tuple[str, ...] = (),
    ) -> FleetResult:  # fmt: skip
        """As `fleet run` does it."""
        world = self.world
        self.interruption = Interruption()
        hub = Hub(world.loop)
        fleet: Fleet = load_fleet(self.path)
        gateways = Gateways(fleet, self._opened, hub)
        self.people = People(at)
        try:
            gateways.meet()
            fleet = gateways.joined()
            with Ledger(self.home) as ledger:
                doubtful = none_under_way(fleet, ledger, self.reach)
                names: tuple[str, ...] = tuple(one.name for one in fleet.axes)
                if take_up or do_again:
                    if do_again:
                        names = again(fleet, ledger, self.run_id, do_again, names)
                    else:
                        names = resume(fleet, ledger, self.run_id, names)
                else:
                    self.run_id = begin(fleet, ledger, names)
                gateways.use(ledger.record(self.run_id).key)
                crew = SteppedCrew(world, world.folder / "logs", gateways)
                conductor = Conductor(
                    Board(fleet, ledger, self.run_id), ledger, crew, self.people,
                    self.interruption, pins=Pins(fleet.path, kept=False), at_once=None,
                    in_advance="in a test", clock=world.loop.time, doubtful=doubtful,
                )  # fmt: skip
                with contextlib.suppress(Interrupted), self.interruption.deferred():
                    result = conductor.run(names)
                crew.close()
            gateways.close()
        except ClientDied:
            hub.close()  # its loop dies with it: nothing is said to anybody
            world.go_on(0.0)
            with Ledger(self.home) as ledger:
                ledger._db.execute("UPDATE fleet_runs SET pid=? WHERE id=?", (NOBODY, self.run_id))
            raise
        return result

    @property
    def key(self) -> str:
        with Ledger(self.home) as ledger:
            return ledger.record(self.run_id).key

    def states(self) -> dict[str, tuple[int, JobState]]:
        with Ledger(self.home) as ledger:
            rows = ledger.rows(self.run_id)
        return {name: (row.attempt, row.state) for name, row in rows.items()}

    def attempts(self) -> list[tuple[str, int, JobState]]:
        with Ledger(self.home) as ledger:
            return [(row.axis, row.attempt, row.state) for row in ledger.attempts(self.run_id)]

    def grants(self) -> Counter[tuple[str, int]]:
        """How often each attempt was granted."""
        with Ledger(self.home) as ledger:
            events = ledger.events(self.run_id)
        return Counter((axis, n) for _, axis, n, text in events if text.startswith("granted"))


HEAD = 'name = "line"\njob = "identify"\nconfirm = "yes"\n'


class World:
    """Gateways with their axes, and time."""

    def __init__(self, folder: Path, axes: dict[str, list[str]], lasts: float = LASTS) -> None:
        self.folder = folder
        self.loop = SteppedLoop()
        asyncio.set_event_loop(self.loop)
        self.lasts = lasts
        self.moved: Counter[tuple[str, str, int]] = Counter()
        self.troubles: list[Trouble] = []
        self.clashes: list[str] = []  # two fleet runs that move axes of one gateway
        self._cut: dict[str, float] = {}
        self.gateways: dict[str, Gateway] = {}
        for name, its in axes.items():
            self.gateways[name] = Gateway(self, name, its)
        parts = [HEAD]
        parts += [f'[gateways.{name}]\naddress = "tls://127.0.0.1:1"\n' for name in axes]
        parts += [
            f'[[axes]]\nname = "{axis}"\ngateway = "{name}"\n'
            for name, its in axes.items() for axis in its
        ]  # fmt: skip
        self.text = "".join(parts)

    def client(self, name: str = "laptop") -> Client:
        return Client(self, name, self.text)

    def go_on(self, seconds: float) -> None:
        self.loop.run_until_complete(asyncio.sleep(seconds))

    def after(self, seconds: float, act: Callable[[], None]) -> None:
        self.loop.call_later(seconds, act)

    # -- trouble

    def trouble_of(self, verb: str) -> Trouble | None:
        for one in self.troubles:
            if one.verb == verb:
                one.met += 1
                if one.met == one.number:
                    return one
        return None

    def has_wire(self, gateway: Gateway) -> bool:
        return self.loop.time() >= self._cut.get(gateway.name, 0.0)

    def cut(self, gateway: Gateway, seconds: float) -> None:
        self._cut[gateway.name] = self.loop.time() + seconds

    def later(self, seconds: float, gateway: Gateway, verb: str, text: str) -> None:
        """A message that was given up comes, to whatever life there is."""

        def come() -> None:
            if gateway.station is not None:
                gateway.station.handle(verb, text)

        self.loop.call_later(seconds, come)

    def close(self) -> None:
        for task in asyncio.all_tasks(self.loop):
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            self.go_on(0.0)
        self.loop.close()
        asyncio.set_event_loop(None)

    # -- what must be so

    def check(self, *clients: Client) -> None:
        """Never two starts for one grant; whatever a client says has been so."""
        assert not self.clashes, self.clashes
        for of_it, times in self.moved.items():
            assert times == 1, f"{of_it} was started {times} times"
        for client in clients:
            key = client.key
            for attempted, times in client.grants().items():
                assert times == 1, f"{attempted} was granted {times} times"
            for axis, attempt, state in client.attempts():
                moved = self.moved[key, axis, attempt]
                if state is JobState.DONE:
                    assert moved == 1, f"{axis} is done, and never moved"
                if state in (JobState.REVOKED, JobState.REFUSED, JobState.BLOCKED):
                    assert moved == 0, f"{axis} is {state}, and has moved"
                assert state not in (JobState.GRANTED, JobState.STARTED), f"{axis} is {state}"
