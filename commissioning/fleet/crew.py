"""The processes that act for a fleet run: started, ordered about, heard, and ended."""

from __future__ import annotations

import contextlib
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import NamedTuple

from commissioning.fleet.messages import Order, Report
from commissioning.processes import start
from commissioning.result.fleet_codec import json_of, of_json

__all__ = ["Crew", "Spoken", "Worker"]

_TO_END = 5.0  # s


class Spoken(NamedTuple):
    """What a worker said; None: it has ended."""

    worker: Worker
    report: Report | None


class Worker:
    """One process.

    Attributes
    ----------
    busy : axis that it is at; '': none
    """

    def __init__(self, log: Path, heard: queue.SimpleQueue[Spoken]) -> None:
        self.busy = ""
        with log.open("ab") as errors:
            self._process = start(
                "commissioning.fleet.worker", stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=errors,
            )  # fmt: skip
        self._ear = threading.Thread(target=self._hear, args=(heard,), daemon=True)
        self._ear.start()

    @property
    def pid(self) -> int:
        """Number of its process."""
        return int(self._process.pid)

    def _hear(self, heard: queue.SimpleQueue[Spoken]) -> None:
        assert self._process.stdout is not None
        with contextlib.suppress(OSError):
            for line in self._process.stdout:
                with contextlib.suppress(ValueError):  # half a line of one that was killed
                    heard.put(Spoken(self, of_json(line.decode("utf-8", "replace"), Report)))
        self._process.wait()
        heard.put(Spoken(self, None))

    def order(self, order: Order) -> bool:
        """Tell it what to do; False: it hears no more."""
        assert self._process.stdin is not None
        self.busy = order.name
        try:
            self._process.stdin.write((json_of(order) + "\n").encode())
            self._process.stdin.flush()
        except OSError:
            return False
        return True

    def interrupt(self) -> None:
        """As a Ctrl-C: it stops its axis, and ends its job."""
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                self._process.send_signal(signal.CTRL_BREAK_EVENT)
            else:
                self._process.send_signal(signal.SIGINT)

    def dismiss(self) -> None:
        """Let it go; it ends its job first."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def close(self) -> None:
        """Wait until it has ended; one that does not is left alone, for its axis' sake."""
        self.dismiss()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(None if self.busy else _TO_END)
        self._ear.join(_TO_END)
        assert self._process.stdout is not None
        self._process.stdout.close()


class Crew:
    """The workers of one fleet run."""

    def __init__(self, folder: Path) -> None:
        self._log = folder / "workers.log"
        self._queue: queue.SimpleQueue[Spoken] = queue.SimpleQueue()
        self._all: list[Worker] = []
        self._idle: list[Worker] = []

    def order(self, order: Order, *, anew: bool) -> Worker:
        """A worker that does this: a used one, or one `anew`."""
        while self._idle and not anew:
            worker = self._idle.pop()
            if worker.order(order):
                return worker
            worker.busy = ""  # it has died meanwhile, which is still to be heard
        worker = Worker(self._log, self._queue)
        self._all.append(worker)
        worker.order(order)
        return worker

    def at_work(self) -> dict[str, Worker]:
        """Those that have an axis, by its name."""
        return {worker.busy: worker for worker in self._all if worker.busy}

    def hear(self, seconds: float) -> Spoken | None:
        """The next thing that a worker says, or nothing for so long."""
        try:
            return self._queue.get(timeout=seconds)
        except queue.Empty:
            return None

    def take_back(self, worker: Worker) -> None:
        """It has ended its order cleanly, and may have another."""
        worker.busy = ""
        self._idle.append(worker)

    def let_go(self, worker: Worker) -> None:
        """It gets no more orders."""
        worker.busy = ""
        worker.dismiss()
        if worker in self._idle:
            self._idle.remove(worker)

    def buried(self, worker: Worker) -> None:
        """It has ended."""
        if worker in self._idle:
            self._idle.remove(worker)
        if worker in self._all:
            self._all.remove(worker)
            worker.busy = ""
            worker.close()

    def close(self) -> None:
        """Wait for those that are at work, and let all go."""
        for worker in self._all:
            worker.dismiss()
        for worker in self._all:
            worker.close()
