"""The stop path when everything else fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from commissioning.envelope import Envelope
from commissioning.errors import EnvelopeTripped, Interrupted, MeasurementRejected
from commissioning.experiments.plan import Plan
from commissioning.interruption import Interruption
from commissioning.runner import Recorder, run
from drivers.errors import LinkLost
from drivers.link import axis_of, open_drive
from drivers.profiled import ProfiledDrive
from drivers.virtual.device import Device
from drivers.virtual.firmware import Firmware
from drivers.virtual.states import State
from profiles.library import load_profile
from profiles.procedures import Mode
from tests.raising import raises

WIDE = Envelope(centre=0.0, travel=100.0, speed=500.0, torque=1.0, duration=60.0)


@pytest.fixture
def drive() -> Iterator[ProfiledDrive]:
    opened = open_drive(axis_of("virtual://bench"))
    yield opened
    opened.close()


def firmware_of(drive: ProfiledDrive) -> Firmware:
    device: Device = drive._bus.device  # type: ignore[attr-defined]
    return device.firmware


def push(end: Callable[[int], None] = lambda n: None) -> Plan[int]:
    """0.3 N.m for 50 cycles; `end` may raise."""
    for n in range(50):
        yield 0.3
        end(n)
    return 50


def fail(error: BaseException) -> Callable[[int], None]:
    def at(n: int) -> None:
        if n == 20:
            raise error

    return at


@pytest.mark.parametrize(
    "error",
    [
        MeasurementRejected("x"),
        LinkLost("x"),
        OSError("disk full"),
        ZeroDivisionError(),
        KeyboardInterrupt(),
    ],
)
def test_whatever_ends_an_experiment_the_axis_is_at_rest(
    drive: ProfiledDrive, error: BaseException
) -> None:
    with pytest.raises(type(error)):
        run(push(fail(error)), drive, WIDE, Recorder(), Interruption())
    firmware = firmware_of(drive)
    assert not firmware.energised
    assert firmware.plant.velocity == 0.0


def test_a_good_end_disables_too(drive: ProfiledDrive) -> None:
    assert run(push(), drive, WIDE, Recorder(), Interruption()) == 50
    assert not firmware_of(drive).energised


def test_the_envelope_stops_the_axis(drive: ProfiledDrive) -> None:
    narrow = Envelope(centre=0.0, travel=0.05, speed=500.0, torque=1.0, duration=60.0)
    with raises(EnvelopeTripped, "limit.travel"):
        run(push(), drive, narrow, Recorder(), Interruption())
    assert not firmware_of(drive).energised


def test_a_signal_stops_the_axis_within_a_cycle_of_being_seen(drive: ProfiledDrive) -> None:
    interruption, recorder = Interruption(), Recorder()

    def press(n: int) -> None:
        if n == 20:
            interruption.signal = 2

    with pytest.raises(Interrupted):
        run(push(press), drive, WIDE, recorder, interruption)
    assert len(recorder.samples) == 22
    assert not firmware_of(drive).energised


def test_what_the_first_interruption_says_is_not_hidden_by_a_clean_up() -> None:
    interruption = Interruption()
    interruption.signal = 2

    def job() -> None:
        try:
            with interruption.deferred():
                interruption.check()
        except Interrupted as error:
            with interruption.deferred():
                error.also("max_torque is not back")
            raise

    with pytest.raises(Interrupted, match="max_torque is not back"):
        job()


def test_a_signal_while_deferred_is_raised_at_its_end() -> None:
    interruption = Interruption()
    with pytest.raises(Interrupted), interruption.deferred():
        interruption.signal = 2


def test_a_step_of_the_stop_that_raises_anything_does_not_keep_the_others_back(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive.enable(Mode.TORQUE)
    drive.exchange(0.3)
    bus: Any = drive._bus
    original, count = bus.post, 0

    def flaky(address: object, raw: int) -> None:
        nonlocal count
        count += 1
        if count == 1:
            raise OSError("disk full")
        original(address, raw)

    monkeypatch.setattr(bus, "post", flaky)
    report = drive.stop()
    assert report.deenergised
    assert report.failures == ("disk full",)


def test_a_dead_drive_is_not_said_to_be_at_rest(
    drive: ProfiledDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive.enable(Mode.TORQUE)
    bus: Any = drive._bus

    def dead(*arguments: object) -> None:
        raise LinkLost("cable")

    for verb in ("post", "read", "wait"):
        monkeypatch.setattr(bus, verb, dead)
    report = drive.stop()
    assert report.deenergised is None
    assert "NOT verified" in str(report)
    monkeypatch.undo()


def test_a_second_signal_takes_the_energy_away_without_waiting(drive: ProfiledDrive) -> None:
    drive.enable(Mode.TORQUE)
    for _ in range(30):
        drive.exchange(0.3)
    before = firmware_of(drive).now
    assert drive.stop(lambda: True).deenergised
    assert firmware_of(drive).now == before, "no time passed"
    assert firmware_of(drive).state is State.SWITCH_ON_DISABLED


def test_on_canopen_no_frame_of_a_stop_enables_the_drive() -> None:
    from drivers.canopen.bus import CanopenBus
    from drivers.pace import StepPace

    class Wire:
        """Takes frames and answers nothing."""

        node, patience, is_sized = 5, 0.1, True

        def __init__(self) -> None:
            self.frames: list[tuple[int, bytes]] = []
            self.refused_posts: list[tuple[int, int]] = []

        def send(self, cob_id: int, data: bytes) -> None:
            self.frames.append((cob_id, data))

        def post_download(self, index: int, sub: int, data: bytes) -> None:
            self.frames.append((0x600, index.to_bytes(2, "little") + data))

        def upload(self, index: int, sub: int) -> bytes:
            return (1000).to_bytes(4, "little")

        def download(self, index: int, sub: int, data: bytes) -> None:
            return

        def drain(self) -> None:
            return

        def let_pass(self) -> float:
            return 0.05

    wire = Wire()
    profile = load_profile("virtual-canopen")
    bus = CanopenBus(wire, profile, StepPace(0.002))  # type: ignore[arg-type]
    axis = axis_of("virtual://bench")
    opened = ProfiledDrive(bus, profile, axis, "canopen://x/y?node=5")
    bus._running = True
    bus._rpdo.cob_id = 0x205
    bus._idle = opened._frame(0)
    opened.stop()
    controlwords = [data[:2] for cob_id, data in wire.frames if cob_id == 0x205]
    controlwords += [data[2:] for cob_id, data in wire.frames if data[:2] == b"\x40\x60"]
    assert controlwords
    assert b"\x0f\x00" not in controlwords
