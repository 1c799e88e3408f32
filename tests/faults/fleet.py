"""A fleet run breaks at each transition of its ledger, in every way: `make fleet-faults`.

Runner and workers are forked from a warm process; virtual drives write down by themselves each job
in which they were enabled, in a file that no power cut takes back.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from commissioning.cli import main as command_line
from commissioning.errors import JournalError
from commissioning.fleet import crew, worker
from commissioning.fleet.ledger import Ledger
from commissioning.fleet.view import by_the_ledger
from commissioning.journal import Journal
from commissioning.processes import is_alive
from commissioning.result.fleet import FAILED, JobState
from drivers.virtual.firmware import Firmware
from drivers.virtual.states import State

if TYPE_CHECKING:
    from tests.faults.fleet_bus import BusCase

__all__ = ["Case", "Death", "Rig", "cases", "main"]

NAMES = "abc"
_POOL = 4  # workers that a runner has ready
_PATIENCE = 30.0  # s
_WORKER_STEPS = 5  # before and after it starts, enabled, before and after it ends
_NOT_STARTED = JobState.PLANNED, JobState.WAITING, JobState.GRANTED, JobState.REVOKED


class Death(StrEnum):
    """What happens at an instant."""

    RUNNER = "the runner is killed"
    WORKER = "a worker is killed"
    BOTH = "runner and workers are killed"
    POWER = "power cut of the computer"
    DISK = "the disk is full"
    INT = "Ctrl-C"
    TWICE = "Ctrl-C twice"


class Case(NamedTuple):
    """Where and how a run breaks.

    Attributes
    ----------
    who : the runner, or the worker of an axis
    step : instant in that process: each transaction has one before and one after
    """

    who: str
    step: int
    death: Death
    at_once: int

    def __str__(self) -> str:
        return f"{self.who} at {self.step}, {self.at_once} at once: {self.death}"


# -- processes without a start-up -----------------------------------------------------------------


class _Forked:
    """What `processes.start` gives, of a process that was forked."""

    def __init__(self, pid: int, stdin: int, stdout: int) -> None:
        self.pid = pid
        self.stdin, self.stdout = os.fdopen(stdin, "wb"), os.fdopen(stdout, "rb")
        self._code: int | None = None

    def wait(self, timeout: float | None = None) -> int:
        while self._code is None:
            with contextlib.suppress(ChildProcessError):
                self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
                break
            self._code = 0
        return self._code

    def poll(self) -> int | None:
        if self._code is None:
            with contextlib.suppress(ChildProcessError):
                pid, status = os.waitpid(self.pid, os.WNOHANG)
                if not pid:
                    return None
                self._code = os.waitstatus_to_exitcode(status)
        return self._code or 0

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        os.kill(self.pid, signal.SIGKILL)


def _pool(folder: Path) -> Iterator[_Forked]:
    """Workers that wait for their first order, forked before there are threads."""
    made: list[_Forked] = []
    for _ in range(_POOL):
        orders, reports = os.pipe(), os.pipe()
        pid = os.fork()
        if not pid:
            os.setsid()
            for one in made:
                one.stdin.close()
            os.dup2(orders[0], 0)
            os.dup2(reports[1], 1)
            log = os.open(folder / "workers.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(log, 2)
            for end in (*orders, *reports, log):
                os.close(end)
            sys.stdin, sys.stderr = open(0), open(2, "w")  # noqa: SIM115
            code = 1
            try:
                code = worker.main()
            finally:
                os._exit(code)
        os.close(orders[0])
        os.close(reports[1])
        made.append(_Forked(pid, orders[1], reports[0]))
    with (folder / "pids").open("a") as file:
        file.writelines(f"{one.pid}\n" for one in made)
    return iter(made)


# -- breaking -------------------------------------------------------------------------------------


class _Breaking:
    """Counts the instants of this process, and does what a case wants at one of them."""

    def __init__(self, rig: Rig, case: Case | None) -> None:
        self._rig, self._case = rig, case
        self._role, self.count = "runner", 0
        self._full = False

    def watch(self) -> None:
        original, breaking = Ledger._change, self
        start, serve = Ledger.start, worker._serve

        @contextlib.contextmanager
        def change(ledger: Ledger) -> Generator[Any]:
            breaking.instant()
            if breaking._full:
                raise JournalError("database or disk is full")
            with original(ledger) as db:
                yield db
            breaking.instant()

        def serving(order: Any, mouth: Any) -> None:
            breaking._role, breaking.count = f"look {order.name}", 0
            if order.act == "job":
                breaking._role = order.name
            serve(order, mouth)

        Ledger._change = change  # type: ignore[method-assign, assignment]
        worker._serve = serving
        assert start is Ledger.start
        self._watch_drives()

    def _watch_drives(self) -> None:
        """A drive writes down that it was enabled, once a connection."""
        enable, breaking = Firmware._operate, self
        enabled: set[int] = set()

        def operate(drive: Firmware) -> None:
            enable(drive)
            if drive.state is State.OPERATION_ENABLED and id(drive) not in enabled:
                enabled.add(id(drive))
                breaking._rig.write_down(drive.axis.seed)
                breaking.instant()

        Firmware._operate = operate  # type: ignore[method-assign, assignment]

    def instant(self) -> None:
        self.count += 1
        case = self._case
        if case is None or self._role != case.who or self.count - 1 != case.step:
            return
        try:
            os.close(os.open(self._rig.home / "fired", os.O_CREAT | os.O_EXCL))
        except OSError:
            return  # it has happened, in another process
        self._do(case.death)

    def _do(self, death: Death) -> None:
        runner = int((self._rig.home / "runner").read_text())
        workers = [int(line) for line in (self._rig.home / "pids").read_text().split()]
        mine = os.getpid()
        if death is Death.DISK:
            self._full = True
            return
        if death in (Death.INT, Death.TWICE):
            os.kill(runner, signal.SIGINT)
            if death is Death.TWICE:
                time.sleep(0.05)
                os.kill(runner, signal.SIGINT)
            return
        if death is Death.POWER:
            for pid in (*workers, runner):  # nobody writes while the plug is pulled
                if pid != mine:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGSTOP)
            self._rig.cut()
        victims = {
            Death.RUNNER: [runner], Death.WORKER: workers,
            Death.BOTH: [runner, *workers], Death.POWER: [runner, *workers],
        }[death]  # fmt: skip
        for pid in sorted(victims, key=lambda pid: pid == mine):  # itself last
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


class Rig:
    """A fleet of three virtual axes, the first two in one group, and what became of it."""

    def __init__(self, folder: Path, at_once: int) -> None:
        self.folder, self.at_once = folder, at_once
        self.home = folder / "home"
        self.left = self.home
        self._moves = folder / "moves"
        self.file = folder / "line.toml"
        lines = ['job = "identify"', 'confirm = "yes"', "[groups.g]", "[defaults]"]
        lines += ['method = "modulating"']
        for n, name in enumerate(NAMES, 1):
            state = folder / f"{name}.json"
            lines += ["[[axes]]", f'name = "{name}"']
            lines += [f'link = "virtual://bench?seed={n}&state={state}"']
            lines += ['group = "g"'] if name in "ab" else []
        self.file.write_text("\n".join(lines) + "\n")

    def write_down(self, seed: int) -> None:
        """By the drive itself: it is enabled in this job."""
        line = os.open(self._moves, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(line, f"{NAMES[seed - 1]}\n".encode())
        os.close(line)

    def moved(self) -> Counter[str]:
        """In how many jobs each axis was enabled."""
        return Counter(self._moves.read_text().split() if self._moves.exists() else [])

    def cut(self) -> None:
        """What the disk holds after a power cut: all that was synchronised, and torn noise."""
        left = self.folder / "cut"
        shutil.copytree(self.home, left, ignore=shutil.ignore_patterns("*-shm"))
        log = left / "journal.sqlite-wal"
        if log.exists():
            with log.open("ab") as file:
                file.write(random.Random(1).randbytes(1500))

    def call(self, *arguments: str, case: Case | None = None) -> tuple[int, int]:
        """A command in a process of its own: its exit code, and its instants as a runner."""
        self.left.mkdir(exist_ok=True)
        pid = os.fork()
        if not pid:
            code = 1
            try:
                code = self._command(arguments, case)
            finally:
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        self._wait_for_workers()
        counted = self.left / "counted"
        return code, int(counted.read_text()) if counted.exists() else 0

    def _command(self, arguments: tuple[str, ...], case: Case | None) -> int:
        os.environ["TWORELAY_HOME"] = str(self.left)
        os.environ.pop("CI", None)
        (self.left / "runner").write_text(str(os.getpid()))
        log = os.open(self.folder / "said", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(log, 1), os.dup2(log, 2), os.dup2(nothing, 0)
        sys.stdout, sys.stderr = open(1, "w"), open(2, "w")  # noqa: SIM115
        breaking = _Breaking(self, case)
        breaking.watch()
        pool = _pool(self.left)
        crew.start = lambda *_arguments, **_streams: next(pool)  # type: ignore[assignment, attr-defined]
        sys.argv = ["tworelay", "fleet", *arguments]
        code = 0
        try:
            command_line()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        (self.left / "counted").write_text(str(breaking.count))
        for one in pool:
            one.stdin.close()
        return code

    def _wait_for_workers(self) -> None:
        """Until all that it had have ended: they finish what they move."""
        file = self.left / "pids"
        if not file.exists():
            return
        until = time.monotonic() + _PATIENCE
        for pid in map(int, file.read_text().split()):
            while is_alive(pid):
                assert time.monotonic() < until, f"worker {pid} never ends"
                time.sleep(0.005)
        file.unlink()

    def states(self) -> dict[str, JobState]:
        """Where each axis is, by the ledger."""
        with Ledger(self.left, reading=True) as ledger:
            run = ledger.record("last").id
            return {one.name: one.state for one in by_the_ledger(ledger, run, None).axes}

    def started(self) -> Counter[str]:
        """How many attempts at each axis were started, by the ledger."""
        with Ledger(self.left, reading=True) as ledger:
            run = ledger.record("last").id
            events = ledger.events(run)
        return Counter(axis for _, axis, _, text in events if text == "started")


def held(rig: Rig, case: Case) -> None:
    """Break it, then see that all is accounted for, once, and that it comes to its end."""
    options = ("--at-once", str(case.at_once))
    rig.call("run", str(rig.file), *options, case=case)
    if case.death is Death.POWER and (rig.folder / "cut").exists():
        rig.left = rig.folder / "cut"
        for name in ("fired", "pids", "runner"):
            (rig.left / name).unlink(missing_ok=True)
    if not _was_begun(rig):
        assert not rig.moved(), "moved without a ledger"
        rig.call("run", str(rig.file), *options)
    states, moved = rig.states(), rig.moved()
    for name in NAMES:
        assert moved[name] <= 1, f"'{name}' moved {moved[name]} times: {states}"
        if moved[name]:
            assert states[name] not in _NOT_STARTED, f"'{name}' moved, and is {states[name]}"
    code, _ = rig.call("run", str(rig.file), "--resume", *options)
    states, moved = rig.states(), rig.moved()
    in_the_way = any(states[name] in FAILED for name in "ab")
    for name in NAMES:
        assert moved[name] <= 1, f"resumed: '{name}' moved {moved[name]} times: {states}"
        waits = states[name] is JobState.BLOCKED and name in "ab" and in_the_way
        fine = states[name] is JobState.DONE or states[name] in FAILED or waits
        assert fine, f"resumed: '{name}' is {states[name]}"
    assert code == (0 if set(states.values()) == {JobState.DONE} else 9) or (
        code == 3 and case.death is not Death.DISK
    ), f"resume ends with {code}: {states}"
    _put_right(rig, options)


def _was_begun(rig: Rig) -> bool:
    try:
        rig.states()
    except Exception:
        return False
    return True


def _put_right(rig: Rig, options: Sequence[str]) -> None:
    """What was cut off is put back, what failed is done again, and then all is done."""
    code, _ = rig.call("restore", "--yes")
    assert code == 0, f"restore ends with {code}"
    with Journal(rig.left, reading=True) as journal:
        assert not journal.open_runs(), "the journal is open"
    if any(state in FAILED for state in rig.states().values()):
        code, _ = rig.call("run", str(rig.file), "--again", "failed", *options)
        assert code in (0, 9), f"--again ends with {code}"
    if any(state is not JobState.DONE for state in rig.states().values()):
        rig.call("run", str(rig.file), "--resume", *options)
    states, moved, started = rig.states(), rig.moved(), rig.started()
    assert set(states.values()) == {JobState.DONE}, f"at last: {states}"
    for name in NAMES:
        assert 1 <= moved[name] <= started[name], (
            f"'{name}' moved {moved[name]} times in {started[name]} attempts"
        )


def instants(at_once: int) -> int:
    """How many a runner has that nothing disturbs."""
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder), at_once)
        code, count = rig.call("run", str(rig.file), "--at-once", str(at_once))
        assert code == 0, (rig.folder / "said").read_text()
        assert rig.moved() == Counter(NAMES)
        assert rig.started() == Counter(NAMES)
    return count


def cases() -> list[Case]:
    """Every instant of runner and workers, every death, one and two at once."""
    found = []
    for at_once in (1, 2):
        places = [("runner", step) for step in range(instants(at_once))]
        places += list(itertools.product(NAMES, range(_WORKER_STEPS)))
        found += [
            Case(who, step, death, at_once)
            for (who, step), death in itertools.product(places, Death)
        ]
    return found


def tried(chosen: Iterable[Case | BusCase], tell: Callable[[str], None]) -> tuple[int, int]:
    """Try these; returns how many there were, and how many held."""
    from tests.faults.fleet_bus import BusCase, held_on_a_bus

    count = failed = 0
    for case in chosen:
        count += 1
        with tempfile.TemporaryDirectory() as folder:
            try:
                if isinstance(case, BusCase):
                    held_on_a_bus(Path(folder), case)
                else:
                    held(Rig(Path(folder), case.at_once), case)
            except AssertionError as error:
                failed += 1
                tell(f"  {case}: {error}")
                if os.environ.get("FLEET_FAULTS_SAID"):
                    tell((Path(folder) / "said").read_text())
    return count, count - failed


def main() -> int:
    """`fleet [PART/PARTS]`: the last line is `fleet faults: N cases, M held`.

    As many at once as there are processors.
    """
    from tests.faults.fleet_bus import bus_cases

    words = [word.split("/") for word in sys.argv[1:] if "/" in word]
    part, parts = map(int, words[0]) if words else (1, 1)
    begun, jobs = time.monotonic(), os.cpu_count() or 1
    chosen = [*cases(), *bus_cases()][part - 1 :: parts]
    ends = [_in_a_process(chosen[n::jobs]) for n in range(jobs)]
    count = good = 0
    for end in ends:
        with os.fdopen(end) as lines:
            for line in lines:
                if line.startswith("="):
                    count, good = count + int(line.split()[1]), good + int(line.split()[2])
                else:
                    sys.stdout.write(line)
                    sys.stdout.flush()
    sys.stdout.write(f"{(time.monotonic() - begun) / 60:.1f} min\n")
    sys.stdout.write(f"fleet faults: {count} cases, {good} held\n")
    return 0 if count == good == len(chosen) else 1


def _in_a_process(chosen: Sequence[Case | BusCase]) -> int:
    """Where what is said of these cases comes from; its last line is `= tried held`."""
    reader, writer = os.pipe()
    if not os.fork():
        with os.fdopen(writer, "w") as out:

            def tell(text: str) -> None:
                out.write(text + "\n")
                out.flush()

            tell("= {} {}".format(*tried(chosen, tell)))
        os._exit(0)
    os.close(writer)
    return reader


if __name__ == "__main__":
    sys.exit(main())
