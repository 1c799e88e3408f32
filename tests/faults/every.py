"""Every transaction of the short job on every wire, broken in every way: `make faults`.

With `--long`: 1 000 transactions a wire, drawn at random, of the whole job: `make faults-long`.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from tests.faults.proxy import WIRES, Way
from tests.faults.rig import Rig, ways
from tests.faults.served import served

Case = tuple[int, Way]
Chunk = tuple[str, bool, list[Case]]

_CHUNK = 250
_DRAWN = 1000
_A_CORE = 3  # workers: a broken wire is mostly waited for


def _held(chunk: Chunk) -> tuple[str, list[Case], list[str]]:
    """What did not hold, case by case, on a drive of this worker's own."""
    wire, whole, cases = chunk
    failures: list[str] = []
    left = list(cases)
    while left:
        with (
            tempfile.TemporaryDirectory() as home,
            served(wire) as links,
            contextlib.closing(Rig(links, wire, Path(home), whole=whole)) as rig,
        ):
            while left:
                at, way = left.pop(0)
                try:
                    rig.case(at, way)
                except Exception as error:
                    text = (str(error) or type(error).__name__).splitlines()[0]
                    failures.append(f"{wire}, transaction {at}, {way}: {text}")
                    break  # to a fresh drive
    return wire, cases, failures


def _cases(wire: str, *, whole: bool) -> list[Case]:
    """Of an undisturbed job."""
    with (
        tempfile.TemporaryDirectory() as home,
        served(wire) as links,
        contextlib.closing(Rig(links, wire, Path(home), whole=whole)) as rig,
    ):
        answered, code = rig.case(None, Way.LOST_ANSWER)
    assert code == 0, "the undisturbed job failed"
    found = ways(answered)
    return random.Random(wire).sample(found, _DRAWN) if whole else found


def _chunks(cases: list[tuple[str, Case]], *, whole: bool) -> Iterator[Chunk]:
    for wire in WIRES:
        mine = [case for on, case in cases if on == wire]
        for begin in range(0, len(mine), _CHUNK):
            yield wire, whole, mine[begin : begin + _CHUNK]


def main() -> int:
    """Run all; the last line is `faults: N cases, M held`."""
    whole = "--long" in sys.argv
    step = next((int(word) for word in sys.argv[1:] if word.isdigit()), 1)
    begun = time.monotonic()
    cases = [(wire, case) for wire in WIRES for case in _cases(wire, whole=whole)[::step]]
    out = sys.stdout
    out.write(f"{len(cases)} cases on {len(WIRES)} wires, in {len(Way)} ways\n")
    chunks = list(_chunks(cases, whole=whole))
    random.Random(0).shuffle(chunks)
    failed: list[str] = []
    done: Counter[str] = Counter()
    workers = _A_CORE * (os.cpu_count() or 1)
    # its workers may have children: the served drives
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for ended in as_completed(pool.submit(_held, chunk) for chunk in chunks):
            wire, some, failures = ended.result()
            done[wire] += len(some)
            failed += failures
            out.write("".join(f"  {text}\n" for text in failures))
            seconds = time.monotonic() - begun
            left = seconds / done.total() * (len(cases) - done.total())
            out.write(f"{done.total()} of {len(cases)}, {left / 60:.1f} min left\n")
            out.flush()
    for wire in WIRES:
        broken = sum(text.startswith(f"{wire},") for text in failed)
        out.write(f"{wire}: {done[wire]} cases, {done[wire] - broken} held\n")
    out.write(f"{(time.monotonic() - begun) / 60:.1f} min\n")
    out.write(f"faults: {len(cases)} cases, {len(cases) - len(failed)} held\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
