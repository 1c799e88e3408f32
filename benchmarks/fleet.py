"""What a fleet costs: against the same axes as single commands, and in processor seconds."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

from commissioning.fleet.ledger import Ledger
from commissioning.result.fleet import Confirmed, JobState, Outcome, Room

ROOT = Path(__file__).parent.parent
AXES, SINGLE, WRITTEN = 200, 20, 100


def link(n: int) -> str:
    return f"virtual://bench?seed={n + 1}&coulomb={0.05 + 0.001 * n:.3f}"


def fleet() -> list[str]:
    """200 axes, `identify`, stepped; 20 of them also as single commands, one after the other."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "big.toml"
        lines = ['job = "identify"', 'confirm = "yes"']
        for n in range(AXES):
            lines += ["[[axes]]", f'name = "a{n:03d}"', f'link = "{link(n)}"']
        path.write_text("\n".join(lines) + "\n")
        single, single_cpu = [], []
        for half in (range(SINGLE // 2), range(SINGLE // 2, SINGLE)):
            for n in half:
                begin, cpu = time.perf_counter(), _children()
                _call("identify", link(n), "--yes", home=folder)
                single.append(time.perf_counter() - begin)
                single_cpu.append(_children() - cpu)
            if not half.start:
                begin, cpu = time.perf_counter(), _children()
                memory = _call("fleet", "run", str(path), home=folder)
                whole, whole_cpu = time.perf_counter() - begin, _children() - cpu
    alone = statistics.median(single)
    return [
        "# A fleet",
        "",
        (
            f"Written by `make bench` (`benchmarks/run.py fleet`): {AXES} virtual axes, `identify`, stepped, "
            f"{os.cpu_count()} processors; {SINGLE} of them"
        ),
        "as single commands, half before and half after. A shared machine: compare within one run.",
        "",
        "| | fleet | single commands |",
        "| --- | --- | --- |",
        f"| axes a minute | {60 * AXES / whole:.0f} | {60 / alone:.0f} |",
        f"| ratio | **{AXES / whole * alone:.1f} ×** | 1 |",
        f"| processor seconds an axis | **{whole_cpu / AXES:.2f}** | {statistics.median(single_cpu):.2f} |",
        f"| memory of a running axis, MB (its process, unique) | {memory:.0f} | |",
        f"| ledger, an axis: granted, started, ended | {1000 * _ledger():.1f} ms | |",
    ]


def _call(*arguments: str, home: str) -> float:
    """A command in a process of its own; returns the most that a worker of it had, MB."""
    process = subprocess.Popen(
        [sys.executable, "-m", "commissioning", *arguments],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "TWORELAY_HOME": home},
    )
    most = 0.0
    over = threading.Event()

    def watch() -> None:
        nonlocal most
        while not over.wait(0.5):
            try:
                for child in psutil.Process(process.pid).children():
                    most = max(most, child.memory_full_info().uss / 1e6)
            except psutil.Error:
                continue

    thread = threading.Thread(target=watch)
    thread.start()
    code = process.wait()
    over.set()
    thread.join()
    assert code == 0, code
    return most


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _ledger() -> float:
    """Median time of the three transitions that each axis has, durable, s."""
    room = Room(1.0, 1.0, 1.0)
    with tempfile.TemporaryDirectory() as folder, Ledger(Path(folder)) as ledger:
        names = [f"a{n}" for n in range(WRITTEN)]
        run = ledger.begin("bench", Path(folder), "identify", "{}", "", names)
        times = []
        for name in names:
            begin = time.perf_counter()
            ledger.move(run, name, 1, JobState.WAITING)
            assert ledger.grant(run, name, 1, Confirmed("", "", "", room), "0x1")
            assert ledger.start(run, name, 1)
            assert ledger.end(run, name, 1, JobState.DONE, Outcome(), "")
            times.append(time.perf_counter() - begin)
    return statistics.median(times)
