"""Every transaction of the short job, broken in every way: `make faults`."""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.faults.proxy import Way
from tests.faults.rig import Rig
from tests.faults.served import served

Case = tuple[int, Way]


def _held(cases: list[Case]) -> list[str]:
    """What did not hold, case by case, on a drive of this worker's own."""
    failures = []
    with (
        tempfile.TemporaryDirectory() as home,
        served("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step") as link,
    ):
        rig = Rig(link, Path(home))
        for at, way in cases:
            try:
                rig.case(at, way)
            except Exception as error:
                text = (str(error) or type(error).__name__).splitlines()[0]
                failures.append(f"transaction {at}, {way}: {text}")
                rig = Rig(link, Path(tempfile.mkdtemp(dir=home)))
    return failures


def _chunks(cases: list[Case], size: int) -> Iterator[list[Case]]:
    for begin in range(0, len(cases), size):
        yield cases[begin : begin + size]


def main() -> int:
    """Run all; the last line is `faults: N cases, M held`."""
    step = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    with (
        tempfile.TemporaryDirectory() as home,
        served("bench", "--modbus-tcp", "127.0.0.1:0", "--clock", "step") as link,
    ):
        count, _ = Rig(link, Path(home)).case(None, Way.LOST_ANSWER)
    cases = [(at, way) for at in range(0, count, step) for way in Way]
    out = sys.stdout
    out.write(f"{count} transactions, {len(Way)} ways: {len(cases)} cases\n")
    failures: list[str] = []
    done = 0
    with multiprocessing.get_context("spawn").Pool() as pool:
        for found in pool.imap_unordered(_held, _chunks(cases, 50)):
            done += 50
            failures += found
            out.write("".join(f"  {text}\n" for text in found))
            out.write(f"{min(done, len(cases))} of {len(cases)}\n")
            out.flush()
    out.write(f"faults: {len(cases)} cases, {len(cases) - len(failures)} held\n")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
