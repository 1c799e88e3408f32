"""A gateway as a process, with the real engine, and jobs that are fake: python -m
tests.gateways.fake_gateway --listen HOST:PORT --axes DIR --keys DIR --name NAME [--lasts S].

Each start is a line in the file `moves` of its home, which nothing takes back. A job ends after S
seconds, or when there is a file `may-end`.
"""

from __future__ import annotations

import argparse
import queue
import sys
import threading
import time
from pathlib import Path

from commissioning.fleet.crew import Crew, Spoken, Worker
from commissioning.fleet.gateway.serving import run_gateway
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.messages import Looked, Order, Report
from commissioning.interruption import Interruption
from commissioning.result.fleet import JobState, Outcome, Room
from drivers.home import home

ROOM = Room(3.0, 1.0, 30.0)


class FakeWorker(Worker):
    """A thread that acts as if."""

    gateway = ""

    def __init__(self, heard: queue.SimpleQueue[Spoken | None], lasts: float) -> None:
        self.busy, self.moves = "", False
        self._heard, self._lasts = heard, lasts
        self._stop = threading.Event()

    @property
    def pid(self) -> int:
        return 1

    def order(self, order: Order) -> bool:
        self.busy, self.moves = order.name, order.act == "job"
        self._stop.clear()
        if self._lasts:
            threading.Thread(target=self._do, args=(order,), daemon=True).start()
        else:
            self._do(order)
        return True

    def _do(self, order: Order) -> None:
        if order.act == "look":
            serial = f"0x{sum(ord(c) * 31**n for n, c in enumerate(order.name)) % 2**32:08X}"
            self._say(Report("looked", looked=Looked(serial, "a drive", "p 1", ROOM)))
            return
        of_it = order.fleet_run, order.name, order.attempt
        with Ledger(home()) as ledger:
            if not ledger.start(*of_it):
                self._say(Report("void", text="not granted"))
                return
            with (home() / "moves").open("a") as file:
                file.write(f"{order.fleet_run} {order.name} {order.attempt}\n")
            self._say(Report("step", text="measuring", step=1, steps=1))
            begun, state = time.monotonic(), JobState.DONE
            may_end = home() / "may-end"
            while (left := begun + self._lasts - time.monotonic()) > 0 and not may_end.exists():
                if self._stop.wait(min(left, 0.1)):
                    state = JobState.STOPPED
                    with (home() / "stops").open("a") as file:
                        file.write(f"{order.name} {time.time():.6f}\n")
                    break
                self._say(Report("pulse", moving=True))
            outcome = Outcome(at_rest=True, seconds=1.0)
            ledger.end(*of_it, state, outcome, "")
        self._say(Report("ended", state=state, outcome=outcome))

    def _say(self, report: Report) -> None:
        self._heard.put(Spoken(self, report))

    def interrupt(self) -> None:
        self._stop.set()

    def dismiss(self) -> None:
        """It ends by itself."""

    has_ended = True

    def give_up(self) -> None:
        self._stop.set()

    def close(self) -> None:
        """There is nothing."""


class FakeCrew(Crew):
    """Threads instead of processes."""

    def __init__(self, folder: Path, lasts: float) -> None:
        super().__init__(folder)
        self._lasts = lasts

    def _hired(self, gateway: str) -> Worker:
        return FakeWorker(self._queue, self._lasts)


def main() -> None:
    parser = argparse.ArgumentParser()
    for word in ("--listen", "--axes", "--keys", "--name"):
        parser.add_argument(word, required=True)
    parser.add_argument("--lasts", type=float, default=0.3)
    said = parser.parse_args()
    host, _, port = said.listen.rpartition(":")

    def tell(text: str) -> None:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    with Interruption() as interruption:
        run_gateway(
            (host, int(port)), Path(said.axes), Path(said.keys), said.name, tell, interruption,
            lambda folder: FakeCrew(folder, said.lasts),
        )  # fmt: skip


if __name__ == "__main__":
    main()
