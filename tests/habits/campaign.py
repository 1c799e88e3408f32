"""make habits: every habit on every link.

Ends with "habits: N cases, S survived, R refused by name, 0 else".

python -m tests.habits.campaign [LINK …]: only these of socketcand, slcan, modbus-tcp, modbus-rtu,
modbus-rtu-tcp, virtual. One link takes about a minute on two cores.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.habits.cases import CASES, bus_of, played

__all__ = ["main"]

_WIRES = ("socketcand", "slcan", "modbus-tcp", "modbus-rtu-tcp", "modbus-rtu", "virtual")
_LONGEST = 120.0  # s a command


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "commissioning", *arguments],
        capture_output=True, text=True, timeout=_LONGEST, check=False,
    )  # fmt: skip


def _play(work: tuple[str, int]) -> tuple[str, str, str]:
    wire, number = work
    case = CASES[bus_of(wire)][number]
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TWORELAY_HOME"] = str(Path(folder) / "home")
        try:
            return wire, case.name, played(case, wire, _run, Path(folder))
        except (AssertionError, subprocess.TimeoutExpired) as error:
            return wire, case.name, f"{type(error).__name__}: {error}"


def main(wires: list[str]) -> int:
    """Exit code: 0 where every case went as it is to."""
    unknown = [wire for wire in wires if wire not in _WIRES]
    if unknown:
        sys.stderr.write(f"no link named {unknown[0]}; there are: {', '.join(_WIRES)}\n")
        return 2
    work = [
        (wire, number) for wire in wires or _WIRES for number in range(len(CASES[bus_of(wire)]))
    ]
    found: Counter[str] = Counter()
    with ProcessPoolExecutor(os.cpu_count()) as pool, contextlib.suppress(KeyboardInterrupt):
        for wire, name, what in pool.map(_play, work):
            found[what if what in ("survived", "refused by name") else "else"] += 1
            sys.stdout.write(f"{wire:<15} {name:<60} {what}\n")
            sys.stdout.flush()
    sys.stdout.write(
        f"habits: {len(work)} cases, {found['survived']} survived, "
        f"{found['refused by name']} refused by name, {found['else']} else\n"
    )
    return 1 if found["else"] or sum(found.values()) != len(work) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
