"""What a drive says of itself, and a write whose answer is lost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivers.errors import AccessDenied, LinkError, NoAnswer, WriteFailed
from drivers.link import open_drive
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis
from profiles.procedures import Mode
from tests.raising import raises


@pytest.fixture
def drive() -> Iterator[ProfiledDrive]:
    opened = open_drive(Axis(link="virtual://bench"))
    yield opened
    opened.close()


def failing(drive: ProfiledDrive, name: str, errors: list[Exception]) -> None:
    """Reads of a parameter that fail, one after the other."""
    bus: Any = drive._bus
    address, read = drive.profile.parameters[name].address, bus.read

    def broken(at: object) -> int:
        if at == address and errors:
            raise errors.pop(0)
        found: int = read(at)
        return found

    bus.read = broken


def test_one_look_tells_everything(drive: ProfiledDrive) -> None:
    said = drive.state()
    assert (said.is_energised, said.in_fault, said.fault) == (False, False, "no fault")
    assert said.text == "switch on disabled"
    drive.enable(Mode.TORQUE)
    assert drive.state().is_energised
    drive.disable()


@pytest.mark.parametrize("error", [NoAnswer("lost"), AccessDenied("busy", busy=True)])
def test_a_drive_with_energy_is_asked_nothing_but_its_state(
    drive: ProfiledDrive, error: Exception
) -> None:
    """It may have to be stopped: nothing is waited for."""
    drive.enable(Mode.TORQUE)
    errors = [error] * 10
    failing(drive, "error_code", errors)
    assert drive.state().is_energised
    assert len(errors) == 10, "the code was not asked for"
    drive.disable()


@pytest.mark.parametrize("error", [NoAnswer("lost"), AccessDenied("busy", busy=True)])
def test_an_error_code_that_is_not_told_hides_no_state(
    drive: ProfiledDrive, error: Exception
) -> None:
    errors = [error] * 10
    failing(drive, "error_code", errors)
    said = drive.state()
    assert (said.is_energised, said.code) == (False, None)
    assert "its error code could not be read" in said.text
    assert len(errors) == 9, "asked once, and not waited for"
    assert (drive.state().code, len(errors)) == (None, 8)
    errors.clear()
    assert drive.state().code == 0


@pytest.mark.parametrize("arrives", [True, False])
def test_a_setting_whose_answer_is_lost_is_looked_at_and_sent_once_more(
    drive: ProfiledDrive, arrives: bool
) -> None:
    bus: Any = drive._bus
    write, sent = bus.write, []

    def lossy(at: object, raw: int) -> None:
        sent.append(raw)
        if len(sent) > 1 or arrives:
            write(at, raw)
        if len(sent) == 1:
            raise NoAnswer("lost")

    bus.write = lossy
    drive.write("max_torque", 700)
    assert drive.read("max_torque").raw == 700
    assert sent == [700] * (1 if arrives else 2)


def test_a_setting_that_is_lost_twice_ends_the_job(drive: ProfiledDrive) -> None:
    bus: Any = drive._bus

    def lost(at: object, raw: int) -> None:
        raise NoAnswer("lost")

    bus.write = lost
    with pytest.raises(LinkError):
        drive.write("max_torque", 700)


def test_a_set_point_without_energy_is_sent_once_more(drive: ProfiledDrive) -> None:
    """It rests the axis: a gateway that lost it must not end the way back."""
    bus: Any = drive._bus
    write, sent = bus.write, []

    def lossy(at: object, raw: int) -> None:
        sent.append(raw)
        if len(sent) == 1:
            raise NoAnswer("lost")
        write(at, raw)

    bus.write = lossy
    drive.write("torque_target", 5)
    assert sent == [5, 5]
    assert drive.read("torque_target").raw == 5


def test_a_set_point_is_not_put_back_while_there_is_energy(drive: ProfiledDrive) -> None:
    drive.enable(Mode.TORQUE)
    with raises(WriteFailed, "write.enabled"):
        drive.write("torque_target", 5)
    drive.disable()
