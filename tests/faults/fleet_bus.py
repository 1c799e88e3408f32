"""A bus that dies under a fleet run, and two fleets that want one bus: `make fleet-faults`, too."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import sys
import time
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

from commissioning.cli import main as command_line
from commissioning.result.fleet import FAILED, JobState
from drivers.virtual.firmware import Firmware
from drivers.virtual.states import State
from tests.faults.fleet import Rig

__all__ = ["BusCase", "bus_cases", "held_on_a_bus"]


class BusCase(NamedTuple):
    """The gateway dies when a drive behind it is enabled for the so-many-th time.

    Or another fleet wants it so many milliseconds later.
    """

    what: str
    after: int

    def __str__(self) -> str:
        return f"{self.what}, {self.after}"


def bus_cases() -> list[BusCase]:
    """All of them."""
    dies = [BusCase(f"the gateway dies under {name}", n) for name, n in
            itertools.product("ab", (1, 2, 3, 4, 5))]  # fmt: skip
    return dies + [BusCase("two fleets", after) for after in range(0, 800, 80)]


class _Gateway:
    """Two drives behind one gateway, in a process that can be killed."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._port = 0
        self._pid = 0
        self.links: list[str] = []

    def start(self, *, dies_under: str = "", at: int = 0) -> None:
        """Serve, on the port that it had; die when that drive is enabled for the `at`-th time."""
        reader, writer = os.pipe()
        self._pid = os.fork()
        if not self._pid:
            os.dup2(writer, 1)
            code = 1
            try:
                code = self._serve(dies_under, at)
            finally:
                os._exit(code)
        os.close(writer)
        with os.fdopen(reader) as lines:
            self.links = [lines.readline().strip() for _ in range(2)]
        assert all(self.links), "the gateway did not start"
        self._port = int(self.links[0].split(":")[2].split("?")[0])

    def _serve(self, dies_under: str, at: int) -> int:
        rig, enable = self._rig, Firmware._operate
        count = {"a": 0, "b": 0}

        def operate(drive: Firmware) -> None:
            enable(drive)
            if drive.state is State.OPERATION_ENABLED:
                name = "ab"[drive.axis.seed - 1]
                count[name] += 1
                if count[name] == 1:
                    rig.write_down(drive.axis.seed)
                if name == dies_under and count[name] == at:
                    os.kill(os.getpid(), signal.SIGKILL)

        Firmware._operate = operate  # type: ignore[method-assign, assignment]
        sys.stdout = open(1, "w")  # noqa: SIM115
        axes = [
            f"bench?seed={n}&state={rig.folder / f'{name}.json'}"
            for n, name in ((1, "a"), (2, "b"))
        ]
        sys.argv = ["tworelay", "virtual", "serve", *axes, "--modbus-tcp",
                    f"127.0.0.1:{self._port}", "--clock", "step"]  # fmt: skip
        try:
            command_line()
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    def stop(self) -> None:
        """It need not be there any more."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(self._pid, 0)


class BusRig(Rig):
    """The first two axes of a rig behind one gateway; they are in no group."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, 2)
        self.gateway = _Gateway(self)

    def write_files(self) -> list[Path]:
        """The fleet of all three, and one of the second behind the gateway alone."""
        head = 'job = "identify"\nconfirm = "yes"\n[defaults]\nmethod = "modulating"\n'
        head += "travel = 3.0\ncycle = 0.004\n"
        axis = '[[axes]]\nname = "{}"\nlink = "{}"\n'
        links = zip("ab", self.gateway.links, strict=True)
        a, b = (axis.format(name, link) for name, link in links)
        c = axis.format("c", f"virtual://bench?seed=3&state={self.folder / 'c.json'}")
        other = self.folder / "other.toml"
        self.file.write_text(head + a + b + c)
        other.write_text(head + b)
        return [self.file, other]


@contextlib.contextmanager
def bus_rig(folder: Path, case: BusCase) -> Generator[BusRig]:
    """A rig whose gateway runs, and ends."""
    rig = BusRig(folder)
    dies = case.what.startswith("the gateway")
    rig.gateway.start(dies_under=case.what[-1] if dies else "", at=case.after)
    try:
        yield rig
    finally:
        rig.gateway.stop()


def held_on_a_bus(folder: Path, case: BusCase) -> None:
    """All is accounted for, and comes to its end on a bus that lives."""
    with bus_rig(folder, case) as rig:
        if case.what == "two fleets":
            _two_fleets(rig, case.after / 1000)
        else:
            _dead_bus(rig, case.what[-1])


def _dead_bus(rig: BusRig, victim: str) -> None:
    rig.write_files()
    code, _ = rig.call("run", str(rig.file))
    states, moved = rig.states(), rig.moved()
    assert code == 9, f"ends with {code}"
    assert states[victim] in FAILED, f"'{victim}' is {states[victim]}"
    assert states["c"] is JobState.DONE, f"'c' is {states['c']}"
    assert max(moved.values()) == 1, dict(moved)
    rig.gateway.stop()
    rig.gateway.start()
    _until_done(rig)


def _two_fleets(rig: BusRig, after: float) -> None:
    """Each of a user of its own, on one computer."""
    first, second = rig.write_files()
    (rig.folder / "other").mkdir()
    other = Rig(rig.folder / "other", 2)
    pid = os.fork()
    if not pid:
        time.sleep(after)
        code = 1
        try:
            code, _ = other.call("run", str(second))
        finally:
            os._exit(code)
    codes = [rig.call("run", str(first))[0], os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])]
    assert set(codes) <= {0, 3, 9}, codes
    states = [*rig.states().items(), *other.states().items()]
    done = [name for name, state in states if state is JobState.DONE]
    refused = [name for name, state in states if state is JobState.REFUSED]
    assert len(done) + len(refused) == len(states), states
    for name, count in rig.moved().items():
        assert count <= done.count(name), f"'{name}' moved {count} times: {states}"


def _until_done(rig: BusRig) -> None:
    code, _ = rig.call("restore", "--yes")
    assert code == 0, f"restore ends with {code}"
    rig.call("run", str(rig.file), "--again", "failed")
    if any(state is not JobState.DONE for state in rig.states().values()):
        rig.call("run", str(rig.file), "--resume")
    states, moved, started = rig.states(), rig.moved(), rig.started()
    assert set(states.values()) == {JobState.DONE}, f"at last: {states}"
    for name, count in moved.items():
        assert count <= started[name], f"'{name}' moved {count} times, {started[name]} attempts"
