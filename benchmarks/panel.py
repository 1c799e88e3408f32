"""Lateness of the loop with and without the panel, in turn, on one served drive in real time."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.links import WIRES, served
from commissioning.desk import Desk, Options
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.panel.feed import Panel
from commissioning.processes import start
from commissioning.rig.armed import Failure
from commissioning.session.identify import identify
from commissioning.watching import Watcher
from drivers.link import axis_of

__all__ = ["panel"]

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
    return lines
