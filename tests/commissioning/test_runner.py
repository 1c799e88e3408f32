"""The loop: what it asks and tells in each cycle, and in which order it ends."""

from __future__ import annotations

import gc
import signal
from collections.abc import Iterator
from dataclasses import replace

import pytest

from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped, Interrupted
from commissioning.experiments.plan import Plan
from commissioning.guardian import Guardian
from commissioning.interruption import Interruption
from commissioning.runner import Recorder, run
from commissioning.watching import Telling
from drivers.drive import StopReport
from drivers.errors import DriveFault, LinkLost
from drivers.link import axis_of, open_drive
from drivers.profiled import ProfiledDrive
from drivers.sample import Sample
from profiles.procedures import Mode
from tests.raising import raises

WIDE = Envelope(centre=0.0, travel=100.0, speed=500.0, torque=1.0, duration=60.0)


class Listening(Guardian):
    """A guardian that notes what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[bytes] = []
        self._line = self

    def write(self, word: bytes) -> None:
        self.heard.append(word)

    def end(self) -> None:
        return


@pytest.fixture
def drive() -> Iterator[ProfiledDrive]:
    opened = open_drive(axis_of("virtual://bench"))
    yield opened
    opened.close()


def push(torque: float = 0.05, cycles: int = 5) -> Plan[str]:
    for _ in range(cycles):
        yield torque
    return "done"


def test_each_sample_is_recorded_and_each_cycle_feeds_the_guardian(drive: ProfiledDrive) -> None:
    recorder, guardian = Recorder(), Listening()
    assert run(push(), drive, WIDE, recorder, Interruption(), guardian=guardian) == "done"
    assert [s.command for s in recorder.samples] == pytest.approx([0.05] * 5)
    assert b"".join(guardian.heard) == b"a" + b"." * 5 + b"r"


def test_a_guardian_is_told_to_rest_before_a_stop_whatever_ends_the_plan(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    guardian, said_at_stop = Listening(), []
    stop = drive.stop

    def watched(hurry: object) -> StopReport:
        said_at_stop.append(guardian.heard[-1])
        return stop()

    monkeypatch.setattr(drive, "stop", watched)
    with pytest.raises(ZeroDivisionError):
        run(failing(), drive, WIDE, Recorder(), Interruption(), guardian=guardian)
    assert said_at_stop == [b"r"]


def failing() -> Plan[None]:
    yield 0.05
    raise ZeroDivisionError


def test_a_plan_that_is_broken_off_is_closed_before_the_error_leaves(drive: ProfiledDrive) -> None:
    closed = []

    def plan() -> Plan[None]:
        try:
            while True:
                yield 0.05
        finally:
            closed.append(True)

    narrow = Envelope(centre=0.0, travel=100.0, speed=500.0, torque=0.01, duration=60.0)
    held = plan()
    with raises(EnvelopeTripped, "limit.torque-command"):
        run(held, drive, narrow, Recorder(), Interruption())
    assert closed == [True]


def test_a_signal_that_came_before_gives_no_energy(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    def enabled(*arguments: object) -> None:
        raise AssertionError("enabled in spite of it")

    monkeypatch.setattr(drive, "enable", enabled)
    interruption = Interruption()
    interruption.signal = int(signal.SIGINT)
    recorder = Recorder()
    with pytest.raises(Interrupted):
        run(push(), drive, WIDE, recorder, interruption)
    assert recorder.samples == []


def test_the_collector_rests_while_the_loop_runs_and_is_then_as_it_was(
    drive: ProfiledDrive,
) -> None:
    seen = []

    def plan() -> Plan[None]:
        yield 0.05
        seen.append(gc.isenabled())

    run(plan(), drive, WIDE, Recorder(), Interruption())
    assert gc.isenabled()
    gc.disable()
    try:
        run(plan(), drive, WIDE, Recorder(), Interruption())
        assert not gc.isenabled()
    finally:
        gc.enable()
    assert seen == [False, False]


def test_only_torques_are_held_against_the_torque_limit(drive: ProfiledDrive) -> None:
    far = Envelope(centre=0.0, travel=100.0, speed=500.0, torque=1.0, duration=60.0)
    run(push(0.0, 3), drive, far, Recorder(), Interruption(), mode=Mode.POSITION)
    small = Envelope(centre=0.0, travel=100.0, speed=500.0, torque=0.001, duration=60.0)

    def hold() -> Plan[None]:
        yield 0.002  # rad
        yield 0.002

    run(hold(), drive, small, Recorder(), Interruption(), mode=Mode.POSITION)
    with raises(EnvelopeTripped, "limit.torque-command"):
        run(hold(), drive, small, Recorder(), Interruption(), mode=Mode.TORQUE)


def test_a_drive_that_stops_by_itself_ends_the_plan_and_says_why(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange, state = drive.exchange, drive.state

    def stopped(set_point: float) -> Sample:
        sample = exchange(set_point)
        return sample._replace(status=replace(sample.status, enabled=False))

    monkeypatch.setattr(drive, "exchange", stopped)
    recorder = Recorder()
    with raises(DriveFault, "drive.left"):
        run(push(), drive, WIDE, recorder, Interruption())
    assert len(recorder.samples) == 1, "the last sample is in the record"
    with monkeypatch.context() as faulty:
        faulty.setattr(drive, "state", lambda: state()._replace(in_fault=len(recorder.samples) > 1))
        with raises(DriveFault, "drive.stopped"):
            run(push(), drive, WIDE, recorder, Interruption())
    monkeypatch.setattr(drive, "state", lambda: _raise(LinkLost("cable")))
    with raises(DriveFault, "drive.left"):
        run(push(), drive, WIDE, Recorder(), Interruption())


def _raise(error: Exception) -> str:
    raise error


def test_a_stop_that_is_not_verified_is_said_whatever_the_end(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = drive.stop

    def unverified(hurry: object) -> StopReport:
        stop()
        return StopReport(None)

    monkeypatch.setattr(drive, "stop", unverified)
    with raises(DriveFault, "stop.not-verified"):
        run(push(), drive, WIDE, Recorder(), Interruption(), leave_moving=True)
    with raises(EnvelopeTripped, "limit.duration"):
        run(long(), drive, WIDE, Recorder(), Interruption())
    with pytest.raises(ZeroDivisionError) as other:
        run(failing(), drive, WIDE, Recorder(), Interruption())
    assert other.value.args == ()


def long() -> Plan[None]:
    while True:
        yield 0.0


def test_a_plan_that_leaves_the_axis_moving_ends_with_the_stop_path(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    ways = []
    stop, disable = drive.stop, drive.disable

    def stopped(hurry: object) -> StopReport:
        ways.append("stop")
        return stop()

    def disabled() -> None:
        ways.append("disable")
        disable()

    monkeypatch.setattr(drive, "stop", stopped)
    monkeypatch.setattr(drive, "disable", disabled)
    run(push(), drive, WIDE, Recorder(), Interruption(), leave_moving=True)
    run(push(), drive, WIDE, Recorder(), Interruption())
    assert ways == ["stop", "disable"]


def test_a_phase_begins_with_the_next_sample_and_is_told(drive: ProfiledDrive) -> None:
    told: list[str] = []
    recorder = Recorder(watcher=Telling(told.append))
    recorder.phase("first")
    run(push(0.05, 3), drive, WIDE, recorder, Interruption())
    recorder.phase("second")
    assert recorder.phases == [(0, "step", "first"), (3, "step", "second")]
    assert told == ["first", "second"]
