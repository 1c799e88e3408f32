"""One suite for every link: in process, Modbus TCP, socketcand, slcan, python-can virtual."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.drive import Drive
from drivers.errors import AccessDenied, PreflightRefused, WriteDenied, WriteFailed
from drivers.link import axis_of, open_drive
from drivers.virtual.axes import AXES, configured
from drivers.virtual.device import Device
from drivers.virtual.firmware import Firmware
from profiles.errors import UnknownName
from profiles.procedures import Mode
from tests.conftest import Serve
from tests.raising import raises
from tests.serving import WIRES

CYCLE = 0.002


@pytest.fixture(params=["virtual", "can-virtual", *WIRES])
def drive(request: pytest.FixtureRequest) -> Iterator[Drive]:
    if request.param == "virtual":
        opened = open_drive(axis_of("virtual://bench"), cycle=CYCLE)
        yield opened
        opened.close()
    elif request.param == "can-virtual":
        from drivers.virtual.can_channel import CanChannel
        from drivers.virtual.canopen_node import CanopenNode

        name = uuid.uuid4().hex
        channel = CanChannel(CanopenNode(Device(Firmware(AXES["bench"]), "step"), 5), name)
        opened = open_drive(axis_of(f"canopen://virtual/{name}?node=5&clock=step"), cycle=CYCLE)
        yield opened
        opened.close()
        channel.close()
    else:
        serve: Serve = request.getfixturevalue("serve")
        link = serve("bench", *WIRES[request.param], "--clock", "step")[0]
        opened = open_drive(axis_of(link), cycle=CYCLE)
        yield opened
        opened.close()


def test_the_whole_life_of_a_drive(drive: Drive, tmp_path: Path) -> None:
    identity = drive.identity()
    of_its_own = configured(
        "bench", {}, tmp_path / "drive-0.json"
    )  # the memory that it is served with
    served = drive.link.startswith(("modbus", "canopen://s"))
    assert int(identity.serial, 16) == (of_its_own if served else AXES["bench"]).serial
    assert drive.read("rated_torque").si == pytest.approx(1.0)
    assert not drive.state().is_energised

    # parameters: SI in and out, read back, stored
    drive.write("coulomb_positive", drive.parameters["coulomb_positive"].checked_raw(0.0871))
    assert drive.read("coulomb_positive").si == pytest.approx(0.087)
    drive.store()
    with raises(WriteFailed, "write.range"):
        drive.write("coulomb_positive", drive.parameters["coulomb_positive"].checked_raw(5.0))
    with raises(WriteFailed, "write.protected"):
        drive.write("controlword", 15)
    with pytest.raises(UnknownName):
        drive.read("no_such_parameter")

    # watchdog armed, energy, cycle
    for name, raw in drive.preparation.watchdog().items():
        drive.write(name, raw)
    drive.enable(Mode.TORQUE)
    times = []
    for _ in range(20):
        sample = drive.exchange(0.3)
        times.append(sample.time)
        assert sample.status.enabled
        assert sample.command == pytest.approx(0.3)
    assert sample.torque == pytest.approx(0.3, abs=1e-3)
    # (0.3 - 0.1) N.m on 1e-3 kg.m2 for 38 ms after the delay of 2 ms
    assert sample.position == pytest.approx(0.5 * 200 * 0.038**2, rel=0.05)
    assert [b - a for a, b in pairwise(times)] == pytest.approx([CYCLE] * 19)
    assert 0 <= sample.time - sample.sent <= CYCLE + 1e-9

    # the stop path ends at rest, de-energised, and says so
    report = drive.stop()
    assert report.deenergised
    assert not report.failures
    at_rest = drive.read("position_actual").si
    drive.wait(0.1)
    assert drive.read("position_actual").si == at_rest

    # position mode holds where it was enabled
    drive.enable(Mode.POSITION)
    for n in range(100):
        sample = drive.exchange(at_rest + 0.001 * n)
    assert sample.position == pytest.approx(at_rest + 0.1, abs=0.03)
    drive.disable()
    assert not drive.state().is_energised

    # silence: the drive stops by itself
    drive.enable(Mode.TORQUE)
    for _ in range(5):
        drive.exchange(0.2)
    drive.wait(0.2)
    assert not drive.state().is_energised
    assert "81" in drive.state().text, "the error code of a lost master"


def test_a_drive_in_fault_is_not_enabled_and_resets_without_energy(drive: Drive) -> None:
    settings = drive.preparation.watchdog()
    drive.write("watchdog_time", settings["watchdog_time"])
    drive.write("abort_connection_option", 1)
    drive.enable(Mode.TORQUE)
    drive.exchange(0.0)
    drive.wait(0.3)
    assert drive.state().in_fault
    with raises(PreflightRefused, "preflight.fault"):
        drive.enable(Mode.TORQUE)
    drive.reset_fault()
    assert not drive.state().in_fault
    assert not drive.state().is_energised


def test_what_the_drive_refuses_comes_back_as_a_refusal(drive: Drive) -> None:
    """A refusal to be read is a matter of the link (4), one to be written to of the write (7)."""
    bus = drive._bus  # type: ignore[attr-defined]
    known = drive.profile.parameters["max_torque"].address
    where = {"index": 0x5FF0} if drive.profile.bus == "canopen" else {"register_": 0x7FF0}
    nowhere = known.model_copy(update=where)
    with pytest.raises(AccessDenied) as read:
        bus.read(nowhere)
    with pytest.raises(WriteDenied) as written:
        bus.write(nowhere, 1)
    assert (read.value.exit_code, written.value.exit_code) == (4, 7)


def test_nothing_is_stored_while_the_drive_is_enabled(drive: Drive) -> None:
    drive.enable(Mode.TORQUE)
    with raises(WriteFailed, "store.enabled"):
        drive.store()
    drive.stop()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_set_point_that_its_register_cannot_hold_is_refused_and_not_sent(
    drive: Drive, sign: int
) -> None:
    """By a scale that is wrong: 40 000 in an i16."""
    drive.enable(Mode.TORQUE)
    step = drive.parameters["torque_target"].step
    with pytest.raises(
        PreflightRefused, match=r"is -?40000 of 'torque_target' .* takes -32768…32767"
    ):
        drive.exchange(sign * 40_000 * step)
    assert drive.stop().deenergised
    with raises(PreflightRefused, "set-point.range"):
        drive.enable(Mode.TORQUE, sign * 40_000 * step)
    assert not drive.state().is_energised
