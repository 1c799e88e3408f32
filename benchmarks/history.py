"""What 20 000 runs cost whoever asks for the last ones: `python benchmarks/run.py history`."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from commissioning.journal import Journal
from commissioning.result.document import RunResult
from commissioning.result.found import Quantity
from commissioning.runs import RunFolder, resolve

ROOT = Path(__file__).parent.parent
RUNS, AXES, WITH_FILES, TURNS = 20_000, 40, 200, 9


def filled(home: Path, result: RunResult, runs: int) -> None:
    """A home with so many runs of AXES axes, the last ones with files, without waiting for the disk."""
    with Journal(home) as journal:
        journal._db.execute("PRAGMA synchronous=OFF")
        record = journal.history("last").run
        for number in range(runs):
            axis = f"axis-{number % AXES}"
            run = journal.begin(
                axis=axis, link=record.link, profile=record.profile,
                profile_hash=record.profile_hash, serial=f"0x{number % AXES:08X}",
                context=record.context,
            )  # fmt: skip
            for _ in range(4):
                seq = journal.intend(run, "experiment", "max_torque", 1, 2)
                journal.settle([seq], "restored")
            value = 0.1 * (1 + 0.01 * ((7 * number) % 13 - 6) / 6)
            friction = replace(
                result.friction, coulomb=Quantity(value, 0.99 * value, 1.01 * value, "N.m")
            )
            mine = replace(result, run=run, axis=axis, friction=friction)
            if number >= runs - WITH_FILES:
                RunFolder.of(journal, run).save(mine)
            else:
                journal.index(run, mine)
            journal.finish(run, "completed")


def history() -> list[str]:
    """`history` and `last` in a home with none, one and 20 000 runs, in turn."""
    with tempfile.TemporaryDirectory() as folder:
        none, one, many = (Path(folder) / name for name in ("none", "one", "many"))
        none.mkdir()
        for home in (one, many):
            _call(home, "identify", "virtual://bench", "--yes")
        with Journal(many, reading=True) as journal:
            result = resolve(journal, "last")[1].result()
        filled(many, result, RUNS)
        asked = {
            "`history`": (("history",), none), "`history axis-7`": (("history", "axis-7"), none),
            "`compare last last`": (("compare", "last", "last"), one),
            "`history drift`": (("history", "drift"), none),
        }  # fmt: skip
        rows = []
        for name, (words, few) in asked.items():
            short, long = _in_turn(words, few, many)
            rows.append(f"| {name} | {short:.2f} | {long:.2f} | **{long - short:+.2f}** |")
        size = (many / "journal.sqlite").stat().st_size / 1e6
    return [
        "# A long history",
        "",
        f"Written by `make bench` (`benchmarks/run.py history`): {RUNS} runs of {AXES} axes, a journal of",
        f"{size:.0f} MB; medians of {TURNS} whole processes in turn, s. `compare` needs a run: one there.",
        "",
        "| | no runs | 20 000 runs | more |",
        "| --- | --- | --- | --- |",
        *rows,
    ]


def _in_turn(words: tuple[str, ...], few: Path, many: Path) -> tuple[float, float]:
    short: list[float] = []
    long: list[float] = []
    for _ in range(TURNS):
        for home, times in ((few, short), (many, long)):
            begin = time.perf_counter()
            _call(home, *words)
            times.append(time.perf_counter() - begin)
    return statistics.median(short), statistics.median(long)


def _call(home: Path, *words: str) -> None:
    subprocess.run(
        [sys.executable, "-m", "commissioning", *words], cwd=ROOT, check=True, capture_output=True,
        env={**os.environ, "TWORELAY_HOME": str(home)},
    )  # fmt: skip
