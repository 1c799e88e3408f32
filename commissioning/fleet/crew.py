"""The processes that act for a fleet run: started, ordered about, heard, and ended."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from commissioning.fleet.messages import Order, Report
from commissioning.processes import start
from commissioning.result.fleet_codec import json_of, of_json

__all__ = ["Crew", "Elsewhere", "Spoken", "Worker"]

_TO_END, _LOOK = 5.0, 0.02  # s


class Spoken(NamedTuple):
    """What a worker said; None: it has ended."""

    worker: Worker
    report: Report | None


class Worker(Protocol):
    """Whoever acts for a fleet run: a process here, or one that is reached by a gateway.

    Attributes
    ----------
    busy : axis that it is at; '': none
    moves : and that it may move it
    gateway : on whose computer it is; '': this one
    """

    busy: str
    moves: bool
    gateway: str

    @property
    def pid(self) -> int:
        """Number of its process."""

    def order(self, order: Order) -> bool:
        """Tell it what to do; False: it hears no more."""

    def interrupt(self) -> None:
        """As a Ctrl-C: it stops its axis, and ends its job."""

    def dismiss(self) -> None:
        """Let it go; it ends its job first."""

    @property
    def has_ended(self) -> bool:
        """Whether nothing more comes from it."""

    def give_up(self) -> None:
        """End it at once; for one that moves nothing."""

    def close(self) -> None:
        """Let go of what led to it; it has ended."""


Elsewhere = Callable[
    [str, "queue.SimpleQueue[Spoken | None]"], Worker
]  # by the name of its gateway


class _Process:
    """A worker of this computer."""

    gateway = ""

    def __init__(self, log: Path, heard: queue.SimpleQueue[Spoken | None]) -> None:
        self.busy = ""
        self.moves = False
        with _opened(log) as errors:
            self._process = start(
                "commissioning.fleet.worker", stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=errors,
            )  # fmt: skip
        self._ear = threading.Thread(target=self._hear, args=(heard,), daemon=True)
        self._ear.start()

    @property
    def pid(self) -> int:
        return int(self._process.pid)

    def _hear(self, heard: queue.SimpleQueue[Spoken | None]) -> None:
        assert self._process.stdout is not None
        with contextlib.suppress(OSError):
            for line in self._process.stdout:
                with contextlib.suppress(ValueError):  # half a line of one that was killed
                    heard.put(Spoken(self, of_json(line.decode("utf-8", "replace"), Report)))
        self._process.wait()
        heard.put(Spoken(self, None))

    def order(self, order: Order) -> bool:
        assert self._process.stdin is not None
        self.busy, self.moves = order.name, order.act == "job"
        try:
            self._process.stdin.write((json_of(order) + "\n").encode())
            self._process.stdin.flush()
        except OSError:
            return False
        return True

    def interrupt(self) -> None:
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                self._process.send_signal(signal.CTRL_BREAK_EVENT)
            else:
                self._process.send_signal(signal.SIGINT)

    def dismiss(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def give_up(self) -> None:
        with contextlib.suppress(OSError):
            self._process.kill()

    def close(self) -> None:
        self._process.wait()
        self._ear.join(_TO_END)
        if self._process.stdout is not None and not self._ear.is_alive():
            self._process.stdout.close()


def _opened(log: Path) -> BinaryIO:
    """Where workers write what nobody expected; nowhere, if the folder is gone."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        return log.open("ab")
    except OSError:
        return Path(os.devnull).open("ab")


class Crew:
    """The workers of one fleet run; `elsewhere`: how one on a gateway is had."""

    def __init__(self, folder: Path, elsewhere: Elsewhere | None = None) -> None:
        self._elsewhere = elsewhere
        self._log = folder / "workers.log"
        self._queue: queue.SimpleQueue[Spoken | None] = queue.SimpleQueue()
        self._all: list[Worker] = []
        self._idle: list[Worker] = []

    def order(self, order: Order, *, anew: bool) -> Worker:
        """A worker that does this: a used one, or one `anew`."""
        while not anew and (idle := [w for w in self._idle if w.gateway == order.gateway]):
            worker = idle[-1]
            self._idle.remove(worker)
            if worker.order(order):
                return worker
            worker.busy = ""  # it has died meanwhile, which is still to be heard
        worker = self._hired(order.gateway)
        self._all.append(worker)
        worker.order(order)
        return worker

    def _hired(self, gateway: str) -> Worker:
        if not gateway:
            return _Process(self._log, self._queue)
        assert self._elsewhere is not None, "an axis of a gateway, and none was met"
        return self._elsewhere(gateway, self._queue)

    def at_work(self) -> dict[str, Worker]:
        """Those that have an axis, by its name."""
        return {worker.busy: worker for worker in self._all if worker.busy}

    def hear(self, seconds: float) -> Spoken | None:
        """The next thing that a worker says, or nothing for so long, or until it is woken."""
        try:
            return self._queue.get(block=seconds > 0, timeout=seconds or None)
        except queue.Empty:
            return None

    def wake(self) -> None:
        """Whoever listens is to look round now; called by signals, too."""
        self._queue.put(None)

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
            worker.dismiss()
            worker.close()

    def close(self, signals: Callable[[], int] = lambda: 0) -> None:
        """Let all go, and wait for those that move an axis.

        `signals` : how many have come; each new one is handed on to them. What only looks is not
        waited for.
        """
        heeded, since = signals(), time.monotonic()
        for worker in self._all:
            worker.dismiss()
            if worker.busy and not worker.moves:
                worker.interrupt()
        while left := [worker for worker in self._all if not worker.has_ended]:
            if signals() > heeded:
                heeded = signals()
                for worker in left:
                    worker.interrupt()
            if time.monotonic() - since > _TO_END:
                for worker in left:
                    if not (worker.busy and worker.moves):
                        worker.give_up()
            time.sleep(_LOOK)
        for worker in self._all:
            worker.close()
        self._all.clear()
