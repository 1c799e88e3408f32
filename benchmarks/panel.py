"""Lateness of the loop with and without the panel, in turn, on one served drive in real time."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import pty
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.links import WIRES, served
from commissioning.desk import Desk, Options
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.panel.course import Course
from commissioning.panel.feed import Panel
from commissioning.processes import start
from commissioning.rig.armed import Failure
from commissioning.session.commission import prove_and_store
from commissioning.session.identify import identify
from commissioning.watching import Setting, Stage, Watcher
from drivers.link import axis_of
from profiles.errors import TwoRelayError

__all__ = ["panel"]

AXES = {"bench": 3.14, "ur10e": 2.0, "hsm150": 12.5}  # and the travel that it is allowed
_PAIRS, _CYCLE, _TRAVEL = 6, 0.004, 3.14
_READER = "import os\nwhile os.read(0, 65536): pass"


@contextlib.contextmanager
def drawn() -> Iterator[Panel]:
    """A panel on a terminal of 80 by 24 that another process reads."""

    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    reader = subprocess.Popen([sys.executable, "-c", _READER], stdin=master)
    panel = Panel("bench", to_stderr=False, started=partial(start, stdout=slave))
    try:
        yield panel
    finally:
        panel.close()
        reader.kill()
        reader.wait()
        os.close(slave)
        os.close(master)


def lateness(link: str, watcher: Watcher) -> np.ndarray:
    """Of every cycle of a measurement, s."""
    with Journal(Path(os.environ["TWORELAY_HOME"])) as journal, Interruption() as interruption:
        desk = Desk(
            journal, interruption, lambda text: None, lambda question, word: True, watcher=watcher
        )
        with contextlib.suppress(Failure):  # of a busy machine: its cycles count as well
            identify(axis_of(link), Options(cycle=_CYCLE, travel=_TRAVEL), desk)
        assert desk.recorder is not None
        return np.array([sample.lateness for sample in desk.recorder.samples])


class Noting(Watcher):
    """Notes what was left at each step, and when that was."""

    def __init__(self) -> None:
        self.course = Course()
        self.noted: list[tuple[str, float, float]] = []

    def begins(self, setting: Setting, steps: Sequence[Stage]) -> None:
        self.course.add(steps)

    def step(self, name: str) -> None:
        now = time.monotonic()
        self.course.step(name, now)
        self.noted.append((name, self.course.left(now) or 0.0, now))

    def lasts(self, seconds: float) -> None:
        self.course.lasts(seconds, time.monotonic())


def _took(seconds: float) -> str:
    return "ended early" if math.isnan(seconds) else f"{seconds:.0f} s"


def time_left() -> list[str]:
    """What was said to be left of a whole job, at its beginning and at its proof, and what was."""
    lines = [
        "",
        "Time that was said to be left of `commission` in real time, and what it took:",
        "",
        "| axis | at the beginning | took | at the proof | took |",
        "| --- | --- | --- | --- | --- |",
    ]
    for axis, travel in AXES.items():
        watcher = Noting()
        with (
            served(*WIRES["Modbus TCP"], "--clock", "wall", axis=axis) as link,
            Journal(Path(os.environ["TWORELAY_HOME"])) as journal,
            Interruption() as interruption,
        ):
            quiet = lambda text: None  # noqa: E731
            desk = Desk(journal, interruption, quiet, lambda q, w: True, watcher=watcher)
            end = math.nan
            with contextlib.suppress(Failure, TwoRelayError):
                result = identify(axis_of(link), Options(travel=travel, writes=True), desk)
                prove_and_store(str(result.run), desk, lambda changes: None, without_watchdog=False)
                end = time.monotonic()
        first = watcher.noted[0]
        proof = next((n for n in watcher.noted if n[0].startswith("proof w")), None)
        cells = [f"{first[1]:.0f} s", _took(end - first[2])]
        cells += ["–", "–"] if proof is None else [f"{proof[1]:.0f} s", _took(end - proof[2])]
        lines.append(f"| {axis} | {' | '.join(cells)} |")
    return lines


def panel() -> list[str]:
    """The table."""
    found: dict[str, list[np.ndarray]] = {"without": [], "with": []}
    with served(*WIRES["Modbus TCP"], "--clock", "wall") as link:
        for _ in range(_PAIRS):
            found["without"].append(lateness(link, Watcher()))
            with drawn() as watcher:
                found["with"].append(lateness(link, watcher))
                assert not watcher.has_died
    lines = [
        "# Lateness of the loop with and without the panel",
        "",
        f"Written by `make bench`: {_PAIRS} measurements each, in turn, of `bench` over Modbus TCP",
        f"at {_CYCLE * 1000:g} ms in real time;",
        "the panel is drawn at 80 × 24 on a terminal that another process reads.",
        "",
        "| panel | cycles | median, ms | p99, ms | least and most p99 of one run, ms | late by half a cycle |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, runs in found.items():
        every = 1000 * np.concatenate(runs)
        each = [1000 * float(np.quantile(run, 0.99)) for run in runs]
        lines.append(
            f"| {name} | {len(every)} | {np.median(every):.3f} | {np.quantile(every, 0.99):.2f} | "
            f"{min(each):.2f} … {max(each):.2f} | {100 * np.mean(every > 500 * _CYCLE):.2f} % |"
        )
    return lines + time_left()
