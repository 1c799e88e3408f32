"""What the virtual drive does by itself when it cannot stop its axis (docs/virtual-drive.md)."""

from __future__ import annotations

import pytest

from drivers.virtual.axes import configured
from drivers.virtual.firmware import Firmware
from drivers.virtual.plant import Plant
from drivers.virtual.states import State

MS = 1_000_000  # ns


def enabled(axis: str) -> Firmware:
    drive = Firmware(configured(axis, {}))
    drive.write("mode", 10)
    for word in (0x06, 0x07, 0x0F):
        drive.write("controlword", word)
    drive.advance(60 * MS)  # a brake opens within 50 ms
    assert drive.state is State.OPERATION_ENABLED
    return drive


@pytest.mark.parametrize("again", [0x00, 0x02, 0x06])
def test_the_brake_closes_50_ms_after_the_energy_has_gone_whatever_is_commanded_then(
    again: int,
) -> None:
    drive = enabled("vertical")
    drive.write("controlword", 0x00)
    drive.advance(20 * MS)
    drive.write("controlword", again)
    drive.advance(29 * MS)
    assert not drive.plant.locked
    drive.advance(2 * MS)
    assert drive.plant.locked


def test_a_stop_that_does_not_come_to_an_end_ends_after_a_second() -> None:
    drive = enabled("bench")
    drive.plant = _Loaded(drive.plant.parameters)
    drive.plant.velocity = 5.0
    drive.write("controlword", 0x02)
    drive.advance(990 * MS)
    assert drive.energised
    drive.advance(20 * MS)
    assert not drive.energised


def test_a_fault_stays_the_fault_although_the_master_falls_silent_during_its_reaction() -> None:
    """CiA 402: 'fault reaction active' is left for 'fault' alone."""
    drive = enabled("vertical")
    drive.write("abort_connection_option", 3)
    drive.write("watchdog_time", 10)
    drive.feed_watchdog()
    drive.trip(0x8611)
    drive.advance(500 * MS)
    assert drive.state is State.FAULT
    assert drive.error_code == 0x8611


class _Loaded(Plant):
    """Something drives the axis on, whatever the motor does."""

    __slots__ = ()

    def advance(self, duration: float, command: float) -> None:
        self.velocity = 5.0
        self.position += duration * self.velocity


def test_overspeed_takes_the_energy_at_once() -> None:
    drive = enabled("bench")
    drive.plant.velocity = 1.6 * drive.axis.speed
    drive.advance(1 * MS)
    assert drive.state is State.FAULT
    assert not drive.energised
    assert drive.error_code == 0x8400
