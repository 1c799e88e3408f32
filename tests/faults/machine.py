"""The machine itself fails, in every phase of an experiment, in simulated time.

`make machine-faults`.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from commissioning.desk import Desk, Options
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.rig.armed import Failure
from commissioning.session.identify import identify
from commissioning.session.verify import Wishes, verify
from drivers.link import axis_of, open_drive
from drivers.virtual.axes import VirtualAxis
from drivers.virtual.firmware import Firmware
from drivers.virtual.plant import Plant
from drivers.virtual.states import State
from profiles.axis import Axis
from profiles.errors import TwoRelayError
from tests.faults.two_key import TWO_KEY, in_process

__all__ = ["DELAYS", "JOBS", "Fault", "Job", "Outcome", "one", "phases"]

_SECOND = 1_000_000_000  # ns
_LOOK, _LOOKS = 5_000_000, 600  # ns, after the job
_PRESSED = _SECOND // 2  # ns that a limit switch stays so
DELAYS = 0.004, 0.05, 0.3  # s after a phase has begun
_ALLOWED = {3, 5, 6}


class Fault(StrEnum):
    """What the machine or its drive does from one instant on."""

    FOLLOWING = "following error"
    OVER_TORQUE = "over-torque"
    LIMIT_SWITCH = "limit switch"
    STO = "STO"
    EMERGENCY = "EMCY (motor too hot)"
    STUCK = "stuck axis"
    RUNAWAY = "wrong sign"
    ENCODER = "encoder's direction"
    TRIPLE = "thrice the torque"
    JUMP = "encoder jump"


_BY_DRIVE = {Fault.FOLLOWING, Fault.OVER_TORQUE, Fault.LIMIT_SWITCH, Fault.STO, Fault.EMERGENCY}


@dataclass(frozen=True)
class Job:
    """What is done on which axis."""

    axis: str
    travel: float  # rad
    work: str
    profile: str = "virtual-modbus"

    def __str__(self) -> str:
        """With the drive, where it is another one."""
        return f"{self.axis}, {self.work}" + ("" if self.profile != TWO_KEY else ", two keys")


JOBS = (
    Job("bench", 3.0, "identify"),
    Job("vertical", 12.0, "identify"),
    Job("bench", 3.0, "verify"),
    Job("vertical", 12.0, "verify"),
    Job("bench", 3.0, "identify", TWO_KEY),
    Job("bench", 3.0, "verify", TWO_KEY),
)


@dataclass
class Outcome:
    """How a job ended whose machine failed.

    Attributes
    ----------
    code : exit code; None: the fault never came, for the phase was over
    reaction : from the fault to the loss of energy, s
    drop : of a load, from where the drive left operation to the lowest point after it, rad
    travel : largest distance from the start, rad
    faster : speed that was gained after the fault, rad/s
    """

    job: Job
    phase: str
    fault: Fault
    delay: float
    code: int | None = None
    reaction: float = 0.0
    drop: float = 0.0
    travel: float = 0.0
    faster: float = 0.0
    wrong: str = ""


class _FaultyPlant(Plant):
    """Mechanics whose motor pushes the wrong way, or too much, or which are stuck."""

    __slots__ = ("gain", "stuck")

    def __init__(self, healthy: Plant) -> None:
        super().__init__(healthy.parameters, healthy.position)
        self.gain, self.stuck = 1.0, False

    def advance(self, duration: float, command: float) -> None:
        """As the healthy one, with another torque or none of its motion."""
        if self.stuck:
            self.velocity, self.torque = 0.0, command
        else:
            super().advance(duration, self.gain * command)


class _Machine:
    """Every virtual drive made while it is on fails at one instant, and is watched."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self.at: float | None = None  # ns, once the phase has begun
        self.began: int | None = None  # ns, of the fault
        self.left: float | None = None  # position when the drive left operation
        self.off: int | None = None  # ns
        self.drop = self.travel = self.speed = self.fastest = 0.0
        self.firmware: Firmware | None = None
        self._start = 0.0
        self._shift = 0
        self._healthy = VirtualAxis.build, Firmware.advance, Firmware.position

    def __enter__(self) -> _Machine:
        build, advance, position = self._healthy
        machine = self

        def look(firmware: Firmware, duration: int) -> None:
            if machine.firmware is not firmware:
                machine.firmware, machine._start = firmware, firmware.plant.position
            if machine.at is not None and machine.began is None and firmware.now >= machine.at:
                # a machine at rest does not fail; its drive may, while it is being enabled
                by_drive = machine.fault in _BY_DRIVE and firmware.energised
                if by_drive or firmware.state is State.OPERATION_ENABLED:
                    machine.began = firmware.now
                    machine._fail(firmware)
            advance(firmware, duration)
            if machine.presses_switch(firmware) and firmware.state is State.OPERATION_ENABLED:
                firmware._quick_stop()
            machine._watch(firmware)

        VirtualAxis.build = lambda axis: _FaultyPlant(build(axis))  # type: ignore[method-assign, assignment, arg-type, return-value]
        Firmware.advance = look  # type: ignore[method-assign, assignment]
        Firmware.position = property(  # type: ignore[method-assign, assignment]
            lambda firmware: position.fget(firmware) + machine._shift  # type: ignore[attr-defined]
        )
        return self

    def __exit__(self, *exc: object) -> None:
        VirtualAxis.build, Firmware.advance, Firmware.position = self._healthy  # type: ignore[method-assign, misc]

    def presses_switch(self, firmware: Firmware) -> bool:
        """Whether the axis still is on its limit switch."""
        began = self.began if self.fault is Fault.LIMIT_SWITCH else None
        return began is not None and firmware.now - began < _PRESSED

    def _fail(self, firmware: Firmware) -> None:
        plant = firmware.plant
        assert isinstance(plant, _FaultyPlant)
        fault = self.fault
        codes = {Fault.FOLLOWING: 0x8611, Fault.OVER_TORQUE: 0x2310, Fault.EMERGENCY: 0x4310}
        if fault in codes:
            firmware.trip(codes[fault])
        elif fault is Fault.LIMIT_SWITCH:
            firmware._quick_stop()
        elif fault is Fault.STO:
            firmware._power_off(State.SWITCH_ON_DISABLED)
        elif fault is Fault.STUCK:
            plant.stuck = True
        elif fault is Fault.JUMP:
            self._shift = round(0.25 * firmware.axis.encoder)
        elif fault is Fault.TRIPLE:
            plant.gain = 3.0
        else:
            # as the encoder sees it, its new direction is a motor that pushes the other way
            plant.gain = -1.0
            plant.velocity *= -1.0 if fault is Fault.ENCODER else 1.0
        self.speed = self.fastest = abs(plant.velocity)

    def _watch(self, firmware: Firmware) -> None:
        at = firmware.plant.position
        self.travel = max(self.travel, abs(at - self._start))
        if self.began is None:
            return
        self.fastest = max(self.fastest, abs(firmware.plant.velocity))
        if self.left is None and firmware.state is not State.OPERATION_ENABLED:
            self.left = at
        if self.off is None and not firmware.energised:
            self.off = firmware.now
        if self.left is not None:
            self.drop = max(self.drop, self.left - at)


def _work(job: Job, home: Path, tell: Callable[[str], None]) -> None:
    link = f"virtual://{job.axis}?state={home / 'drive.json'}"
    options = Options(travel=job.travel, cycle=0.002, method="modulating")
    with Journal(home) as journal:
        desk = Desk(journal, Interruption(), tell, lambda question, word: True)
        if job.work == "identify":
            axis = axis_of(link).model_copy(update={"profile": job.profile})
            identify(axis, options, desk)
        else:
            _is_the_drive_of(axis_of(link).model_copy(update={"profile": job.profile}), home)
            verify("last", link, desk, Wishes())


def _is_the_drive_of(axis: Axis, home: Path) -> None:
    """A copy of a memory is another drive: the runs are said to be of it."""
    drive = open_drive(axis, cycle=0.002)
    serial = drive.identity().serial
    drive.close()
    with contextlib.closing(sqlite3.connect(home / "journal.sqlite")) as db:
        db.execute("UPDATE runs SET serial=?", (serial,))
        db.commit()


def _prepared(job: Job, home: Path) -> None:
    """A measured axis, where the job needs one."""
    if job.work == "verify" and not home.exists():
        _work(replace(job, work="identify"), home, lambda text: None)


def phases(job: Job, folder: Path) -> list[str]:
    """What a healthy job tells, as far as an axis moves after it; each once."""
    found: list[str] = []
    home = _measured(job, folder)
    _prepared(job, home)
    fresh = Path(tempfile.mkdtemp(dir=folder)) / "healthy"
    _work(job, fresh if job.work == "identify" else _copy(home, folder), found.append)
    words = [_first_word(text) for text in found]
    told = ("drive", "stop path proved", "reversal error", "stored", "profile")
    return [w for w in dict.fromkeys(words) if not w.strip().startswith(told)]


def _measured(job: Job, folder: Path) -> Path:
    """State of a job that has measured its axis."""
    return folder / f"healthy-{job.axis}-{Path(job.profile).stem}"


def _first_word(text: str) -> str:
    """What names a phase, without its numbers."""
    return text.partition(":")[0].partition(" at ±")[0]


def _copy(home: Path, folder: Path) -> Path:
    target = Path(tempfile.mkdtemp(dir=folder)) / "home"
    shutil.copytree(home, target)
    return target


def one(job: Job, phase: str, fault: Fault, delay: float, folder: Path) -> Outcome:
    """One job whose machine fails `delay` s after the beginning of a phase."""
    outcome = Outcome(job, phase, fault, delay)
    measured = _measured(job, folder)
    _prepared(job, measured)
    home = _copy(measured, folder) if job.work == "verify" else Path(tempfile.mkdtemp(dir=folder))
    with _Machine(fault) as machine:

        def told(text: str) -> None:
            firmware = machine.firmware
            if machine.at is None and _first_word(text) == phase:
                machine.at = (firmware.now if firmware else 0) + delay * _SECOND

        code, text = 0, ""
        try:
            _work(job, home, told)
        except (Failure, TwoRelayError) as error:
            cause = error.error if isinstance(error, Failure) else error
            code, text = cause.exit_code, str(cause)
        firmware = machine.firmware
        assert firmware is not None
        for _ in range(_LOOKS):
            firmware.advance(_LOOK)
        outcome.travel = machine.travel / job.travel
        outcome.drop = machine.drop
        outcome.faster = machine.fastest - machine.speed
        if machine.began is None:
            return outcome
        outcome.code = code
        outcome.reaction = ((machine.off or firmware.now) - machine.began) / _SECOND
        wrong = []
        # a position loop makes good what its torque is too much
        unseen = fault is Fault.TRIPLE and (job.work == "verify" or phase == "holding torque")
        if code not in _ALLOWED and not unseen:
            wrong.append(f"exit {code}: {text}")
        if len(text.splitlines()) > 1:
            wrong.append("more than one line")
        # no stop holds an axis whose motor pushes the wrong way
        if outcome.travel > 1 and fault not in (Fault.RUNAWAY, Fault.ENCODER):
            wrong.append(f"{100 * outcome.travel:.0f} % of the travel")
        if firmware.energised:
            wrong.append("energised")
        if abs(firmware.plant.velocity) > 0:
            wrong.append("not at rest")
        values = firmware.values
    wrong += _left_behind(job, home, values)
    outcome.wrong = "; ".join(wrong)
    return outcome


def _left_behind(job: Job, home: Path, values: dict[str, int]) -> list[str]:
    """Settings that are neither as in a fresh drive nor in the journal."""
    drive = open_drive(axis_of(f"virtual://{job.axis}?state={home / 'drive.json'}"))
    device: Any = drive
    fresh = device._bus._firmware.values
    drive.close()
    names: tuple[str, ...] = (
        "max_torque",
        "max_speed",
        "watchdog_time",
        "mode",
        "torque_target",
        "quick_stop_option",
    )
    if job.profile == TWO_KEY:  # its mode is a register of its own, its speed limit whole rpm
        names = tuple(name for name in names if name != "mode")
        values = values | {"max_speed": round(values["max_speed"] / 10)}
        fresh = fresh | {"max_speed": round(fresh["max_speed"] / 10)}
    changed = [name for name in names if values[name] != fresh[name]]
    with Journal(home) as journal:
        runs = journal.open_runs()
        named = {i.parameter for run in runs for i in journal.intents(run, open_only=True)}
    return [f"{name} left behind" for name in changed if name not in named]


def main() -> int:
    """Every fault in every phase; the last line is `machine faults: N cases, M held`."""
    every = next((int(word) for word in sys.argv[1:]), 1)  # take one case in so many
    out = sys.stdout
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as name, in_process():
        folder = Path(name)
        for job in JOBS:
            found = phases(job, folder)
            cases = [(p, f, d) for p in found for f in Fault for d in DELAYS][::every]
            for phase, fault, delay in cases:
                outcome = one(job, phase, fault, delay, folder)
                if outcome.code is None:
                    continue
                outcomes.append(outcome)
                if outcome.wrong:
                    out.write(f"  {job}, {phase} + {delay:g} s, {fault}: {outcome.wrong}\n")
            out.write(f"{job}: {len(found)} phases\n")
            out.flush()
    out.write(
        "fault: cases, held, slowest reaction s, most of the travel %, largest drop rad, speed "
        "gained rad/s\n"
    )
    for fault in Fault:
        mine = [o for o in outcomes if o.fault is fault]
        if not mine:
            continue
        drop = max((o.drop for o in mine if o.job.axis == "vertical"), default=0.0)
        out.write(
            f"{fault}: {len(mine)}, {sum(not o.wrong for o in mine)}, "
            f"{max(o.reaction for o in mine):.3f}, "
            f"{100 * max(o.travel for o in mine):.0f}, {drop:.3f}, "
            f"{max(o.faster for o in mine):.1f}\n"
        )
    held = sum(not o.wrong for o in outcomes)
    out.write(f"machine faults: {len(outcomes)} cases, {held} held\n")
    return 0 if held == len(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
