"""A job dies at each step of its journal, in every way in which programs die: `make kills`."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from commissioning.desk import Desk, Options
from commissioning.identification.tracking import TrackingError
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.rig.armed import Failure, in_a_run
from commissioning.rig.mover import Mover
from commissioning.session import verify
from commissioning.session.apply import apply
from commissioning.session.commission import prove_and_store
from commissioning.session.identify import identify
from commissioning.session.restore import restore
from drivers.link import axis_of, open_drive
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis
from profiles.errors import TwoRelayError
from tests.faults.proxy import OF_TWO_KEYS, WATCHED
from tests.faults.rig import short
from tests.faults.served import served
from tests.faults.two_key import TWO_KEY

__all__ = ["JOBS", "Death", "KillRig", "rigs"]

JOBS = ("identify", "apply", "restore", "commission")
_STEPS = {
    Journal: ("begin", "intend", "settle", "note", "finish"),
    ProfiledDrive: ("write", "store"),
}
_OPTIONS = Options(travel=5.0, max_torque=2.9, cycle=0.015, method="modulating")


class Death(StrEnum):
    """How it ends."""

    KILL = "SIGKILL"
    TERM = "SIGTERM"
    INT = "SIGINT"
    POWER = "power cut of the computer"
    BLACKOUT = "power cut of computer and drive"


_NAMES = {
    "coulomb_positive": "friction_positive", "coulomb_negative": "friction_negative",
}  # fmt: skip
_CODES = {Death.TERM: {143, 0}, Death.INT: {130, 0}}  # 0: it came after the last act


def _quiet(text: str) -> None:
    return None


def _desk(journal: Journal, interruption: Interruption) -> Desk:
    return Desk(journal, interruption, _quiet, lambda question, word: True)


class KillRig:
    """A drive, and jobs on it that die.

    Parameters
    ----------
    link : of a served drive that steps; None: the drive lives, and dies, in the job's process
    state : file of the drive's non-volatile memory
    two_keys : it is the drive with two keys
    """

    def __init__(
        self, link: str | None, state: Path, folder: Path, *, two_keys: bool = False
    ) -> None:
        self._watched = OF_TWO_KEYS if two_keys else WATCHED
        self._served = link is not None
        self._folder = folder
        self._state = state
        self.link = link or f"virtual://bench?state={state}"
        self.axis = (
            Axis(
                link=f"{link}&timeout=2",
                profile=TWO_KEY if two_keys else "virtual-modbus",
                travel=5.0,
            )
            if self._served
            else axis_of(self.link)
        )
        self.before = self._look()
        drive = open_drive(self.axis)
        drive.store()
        drive.wait(0.1)
        drive.close()
        self._memory = self._kept()
        self._measured = folder / "measured"
        with Journal(self._measured) as journal:
            desk = _desk(journal, Interruption())
            identify(self.axis, Options(travel=20.0, cycle=0.015, method="modulating"), desk)

    def _look(self) -> dict[str, int]:
        drive = open_drive(self.axis)
        try:
            drive.wait(0.2)
            assert not drive.state().is_energised, "the axis is energised"
            if drive.state().in_fault:
                drive.reset_fault()
            drive.wait(2.0)
            return {name: drive.read(name).raw for name in self._watched}
        finally:
            drive.close()

    def _kept(self) -> dict[str, int]:
        """What the drive would have after a power-off, by its firmware's names."""
        found: dict[str, int] = json.loads(self._state.read_text())
        if self._watched is OF_TWO_KEYS:  # whose parameter is coarser than the firmware's value
            del found["max_speed"]
        return found

    def steps(self, job: str) -> int:
        """How many instants a job has at which it can die."""
        with self._home(job) as home:
            status = self._fork(job, home, None, Death.KILL)
            assert os.waitstatus_to_exitcode(status) == 0, f"{job} fails undisturbed"
            count = int((home / "steps").read_text())
            self._put_right(home)
        return count

    def case(self, job: str, step: int, death: Death) -> None:
        """Die at one instant, then look at what is left, and restore."""
        with self._home(job) as home:
            code = os.waitstatus_to_exitcode(self._fork(job, home, step, death))
            expected = _CODES.get(death, {-signal.SIGKILL})
            assert code in expected, f"ended with {code}, not {expected}"
            left = home.with_name("cut") if death in (Death.POWER, Death.BLACKOUT) else home
            after = self._look()
            changed = {name for name, value in after.items() if value != self.before[name]}
            kept = self._kept()
            changed |= {
                _NAMES.get(name, name) if self._watched is OF_TWO_KEYS else name
                for name, value in kept.items()
                if value != self._memory[name]
            }
            with Journal(left) as journal:
                named = {
                    i.parameter
                    for run in journal.open_runs()
                    for i in journal.intents(run, open_only=True)
                }
                assert changed <= named, f"changed and in no journal: {changed - named}"
            self._put_right(left)
            shutil.rmtree(home.with_name("cut"), ignore_errors=True)

    def _put_right(self, home: Path) -> None:
        with Journal(home) as journal:
            for run in journal.open_runs():
                outcome = restore(run, self.axis.link, _desk(journal, Interruption()), force=False)
                assert outcome.complete, str(outcome)
            assert not journal.open_runs()
        now = self._look()
        wrong = {n: (now[n], was) for n, was in self.before.items() if now[n] != was}
        assert not wrong, f"not restored (now, before): {wrong}"
        kept = self._kept()
        wrong = {n: (kept[n], was) for n, was in self._memory.items() if kept[n] != was}
        assert not wrong, f"not restored in the drive's memory (now, before): {wrong}"

    @contextmanager
    def _home(self, job: str) -> Generator[Path]:
        """Fresh state of this computer, in which the job can begin."""
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            home = Path(folder) / "home"
            if job != "identify":  # the others begin with what it found
                shutil.copytree(self._measured, home)
            if job == "restore":
                with Journal(home) as journal:
                    apply("last", self.axis.link, _desk(journal, Interruption()), lambda rows: None)
            yield home

    def _fork(self, job: str, home: Path, step: int | None, death: Death) -> int:
        """The job in a process of its own; returns how that ended."""
        child = os.fork()
        if not child:
            code = 1
            try:
                code = self._job(job, home, step, death)
            finally:
                os._exit(code)
        return os.waitpid(child, 0)[1]

    def _job(self, job: str, home: Path, step: int | None, death: Death) -> int:
        counted = _Counted(home, step, death)
        counted.watch()
        try:
            with Journal(home) as journal, Interruption() as interruption:
                desk = _desk(journal, interruption)
                if job == "identify":
                    in_a_run(self.axis, _OPTIONS, desk, short)
                elif job == "apply":
                    apply("last", self.axis.link, desk, lambda rows: None)
                elif job == "commission":
                    _prove_nothing()
                    prove_and_store(
                        journal.run("last").id, desk, lambda rows: None, without_watchdog=False
                    )
                else:
                    restore(journal.run("last").id, self.axis.link, desk, force=False)
        except Failure as failure:
            return failure.error.exit_code
        except TwoRelayError as error:
            return error.exit_code
        (home / "steps").write_text(str(counted.count))
        return 0


def _prove_nothing() -> None:
    """A proof without motion, in which every step is better than the one before."""
    errors = itertools.count(10.0, -1.0)

    def followed(rig: Any, path: Any, fraction: float, raw: dict[str, int]) -> Any:
        error = TrackingError(next(errors), 0.0, 0.0, hunts=False)
        return verify._Step(fraction, raw, error, np.zeros((3, 0)))

    verify._followed = followed
    Mover.prove_watchdog = lambda job, rest: None  # type: ignore[method-assign, assignment]


class _Counted:
    """Counts the instants before and after each step, and dies at one of them."""

    def __init__(self, home: Path, at: int | None, death: Death) -> None:
        self.count = 0
        self._home, self._at, self._death = home, at, death

    def watch(self) -> None:
        """From now on."""
        for kind, names in _STEPS.items():
            for name in names:
                setattr(kind, name, self._watched(getattr(kind, name)))

    def _watched(self, original: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any, **keywords: Any) -> Any:
            call = lambda: original(*arguments, **keywords)  # noqa: E731
            self._instant(call)
            result = call()
            self._instant(lambda: None)
            return result

        return step

    def _instant(self, under_way: Callable[[], Any]) -> None:
        self.count += 1
        if self.count - 1 != self._at:
            return
        if self._death is Death.TERM:
            os.kill(os.getpid(), signal.SIGTERM)
        elif self._death is Death.INT:
            os.kill(os.getpid(), signal.SIGINT)
        else:
            if self._death is not Death.KILL:
                _cut(self._home, under_way)
            os.kill(os.getpid(), signal.SIGKILL)


def _cut(home: Path, under_way: Callable[[], Any]) -> None:
    """What a disk holds after a power cut.

    All that was synchronised, and half of what was under way.
    """
    left = home.with_name("cut")
    shutil.copytree(home, left, ignore=shutil.ignore_patterns("*-shm"))
    name = "journal.sqlite-wal"
    before = (left / name).read_bytes()
    under_way()
    after = (home / name).read_bytes()
    padded = before.ljust(len(after), b"\0")
    changed = [n for n, (a, b) in enumerate(zip(padded, after, strict=False)) if a != b]
    if changed:
        begin, middle = changed[0], (changed[0] + changed[-1]) // 2
        (left / name).write_bytes(padded[:begin] + after[begin:middle])


@contextmanager
def rigs(folder: Path) -> Generator[dict[tuple[str, Death], KillRig]]:
    """The rig for each drive and death: a served drive, or one that dies with the computer."""
    states = [folder / f"{name}.json" for name in ("served", "own", "keys")]
    with served("modbus-tcp", states[0]) as links, served("two-key", states[2]) as keys:
        outlives = KillRig(links[0], states[0], folder / "served")
        dies = KillRig(None, states[1], folder / "own")
        found = {
            ("CiA 402", death): dies if death is Death.BLACKOUT else outlives for death in Death
        }
        procedure = KillRig(keys[0], states[2], folder / "keys", two_keys=True)
        found |= {("two keys", death): procedure for death in Death if death is not Death.BLACKOUT}
        yield found


def main() -> int:
    """Every step of every job, every death; the last line is `kills: N cases, M held`."""
    every = next((int(word) for word in sys.argv[1:]), 1)  # take one step in so many
    begun, out = time.monotonic(), sys.stdout
    done: Counter[str] = Counter()
    failed: list[str] = []
    with tempfile.TemporaryDirectory() as home, rigs(Path(home)) as found:
        for job in JOBS:
            for (drive, death), rig in found.items():
                steps = range(rig.steps(job))[::every]
                for step in steps:
                    done[death] += 1
                    try:
                        rig.case(job, step, death)
                    except AssertionError as error:
                        failed.append(f"{job}, {drive}, step {step}, {death}: {error}")
                        out.write(f"  {failed[-1]}\n")
                out.write(f"{job}, {drive}, {death}: {len(steps)} steps\n")
                out.flush()
    for death in Death:
        broken = sum(f", {death}: " in text for text in failed)
        out.write(f"{death}: {done[death]} cases, {done[death] - broken} held\n")
    out.write(f"{(time.monotonic() - begun) / 60:.1f} min\n")
    out.write(f"kills: {done.total()} cases, {done.total() - len(failed)} held\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
