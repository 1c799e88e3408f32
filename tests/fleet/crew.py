"""A crew without processes: it says what a test wants, when the test wants it."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path

from commissioning.errors import JournalError
from commissioning.fleet.board import Board
from commissioning.fleet.conductor import Conductor
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.loading import load_fleet
from commissioning.fleet.messages import Looked, Order, Report
from commissioning.fleet.people import Answer, Ask
from commissioning.fleet.plan import Fleet
from commissioning.fleet.serials import Pins
from commissioning.fleet.taking_up import begin
from commissioning.interruption import Interruption
from commissioning.result.endings import Error
from commissioning.result.fleet import FleetResult, JobState, Outcome, Room

__all__ = ["FakeCrew", "FakePeople", "Stage", "failed", "good"]

ROOM = Room(3.0, 1.0, 30.0)


class FakeWorker:
    def __init__(self, crew: FakeCrew) -> None:
        self.busy = ""
        self.interrupted = 0
        self._crew = crew

    def interrupt(self) -> None:
        self.interrupted += 1
        self._crew.interrupted.append(self.busy)


class FakeCrew:
    """`does` : what the job on an axis comes to, by its name; by default it is done.

    `at` : called each time that it is listened to, with the number of that
    """

    def __init__(
        self,
        ledger: Ledger,
        does: dict[str, Iterable[Report | None]],
        seen: dict[str, Error],
        at: Callable[[int], None],
    ) -> None:
        self.ledger, self.does, self.seen, self.at = ledger, does, seen, at
        self.orders: list[Order] = []
        self.interrupted: list[str] = []
        self._workers: list[FakeWorker] = []
        self._said: deque[tuple[FakeWorker, Report | None]] = deque()
        self._heard = 0

    def order(self, order: Order, *, anew: bool) -> FakeWorker:
        worker = FakeWorker(self)
        worker.busy = order.name
        self._workers.append(worker)
        if order.act == "look":
            error = self.seen.get(order.name)
            serial = f"0x{sum(map(ord, order.name)):08X}"
            looked = None if error else Looked(serial, "a drive", "p 1", ROOM)
            self._said.append((worker, Report("looked", looked=looked, error=error, exit_code=3)))
            return worker
        self.orders.append(order)
        for report in self.does.get(order.name, good()):
            if report is not None and report.kind == "ended" and report.outcome is not None:
                assert report.state is not None
                self._said.append((worker, Report("step", step=1, steps=1)))
            self._said.append((worker, report))
        return worker

    def at_work(self) -> dict[str, FakeWorker]:
        return {worker.busy: worker for worker in self._workers if worker.busy}

    def hear(self, seconds: float) -> tuple[FakeWorker, Report | None] | None:
        self.at(self._heard)
        self._heard += 1
        if not self._said:
            return None
        worker, report = self._said.popleft()
        order = next((o for o in reversed(self.orders) if o.name == worker.busy), None)
        if order is not None and report is not None and report.kind != "void":
            with contextlib.suppress(JournalError):
                self.ledger.start(order.fleet_run, order.name, order.attempt)
        return worker, report

    def say(self, name: str, *reports: Report | None) -> None:
        worker = self.at_work()[name]
        self._said.extend((worker, report) for report in reports)

    def take_back(self, worker: FakeWorker) -> None:
        worker.busy = ""

    let_go = buried = take_back

    def close(self) -> None:
        """There is nothing to close."""


class FakePeople:
    def __init__(self, answers: dict[str, Answer]) -> None:
        self.answers = answers
        self.asked: list[tuple[str, str]] = []
        self.told: list[str] = []
        self.is_asked = False

    def tell(self, text: str) -> None:
        self.told.append(text)

    def ask(self, text: str, word: str) -> Ask:
        assert not self.is_asked, "there is one terminal, for one question"
        self.asked.append((word, text))
        self.is_asked = True

        def answered() -> Answer | None:
            answer = self.answers.get(word)
            self.is_asked = answer is None
            return answer

        return answered

    def withdraw(self) -> None:
        self.is_asked = False

    def show(self, result: FleetResult) -> None:
        self.last = result


def good(seconds: float = 1.0) -> list[Report | None]:
    outcome = Outcome(at_rest=True, seconds=seconds)
    return [Report("ended", state=JobState.DONE, outcome=outcome)]


def failed(state: JobState, code: str = "x") -> list[Report | None]:
    outcome = Outcome(at_rest=True, error=Error(code, f"{code} happened"))
    return [Report("ended", state=state, outcome=outcome, error=outcome.error)]


class Stage:
    """A fleet run with a fake crew, in simulated time: a tenth of a second each look round."""

    def __init__(self, folder: Path, text: str, home: Path) -> None:
        path = folder / "line.toml"
        path.write_text(text, "utf-8")
        self.fleet: Fleet = load_fleet(path)
        self.ledger = Ledger(home)
        self.run_id = begin(self.fleet, self.ledger, [one.name for one in self.fleet.axes])
        self.does: dict[str, Iterable[Report | None]] = {}
        self.seen: dict[str, Error] = {}
        self.now = 1000.0
        self.steps: dict[int, Callable[[], None]] = {}
        self.interruption = Interruption()
        self.people = FakePeople({})
        self.in_advance: str | None = "in a test"
        self.can_ask = False
        self.at_once: int | None = 4

    def _at(self, number: int) -> None:
        self.now += 0.1
        if number in self.steps:
            self.steps[number]()
        assert number < 20_000, "the run never ends"

    def run(self, names: Iterable[str] | None = None) -> FleetResult:
        self.crew = FakeCrew(self.ledger, self.does, self.seen, self._at)
        conductor = Conductor(
            Board(self.fleet, self.ledger, self.run_id), self.ledger, self.crew, self.people,  # type: ignore[arg-type]
            self.interruption, pins=Pins(self.fleet.path), at_once=self.at_once,
            in_advance=self.in_advance, can_ask=self.in_advance is None or self.can_ask,
            clock=lambda: self.now,
        )  # fmt: skip
        self.conductor = conductor
        with self.interruption.deferred():
            return conductor.run([one.name for one in self.fleet.axes] if names is None else names)

    def states(self) -> dict[str, str]:
        return {name: str(row.state) for name, row in self.ledger.rows(self.run_id).items()}
