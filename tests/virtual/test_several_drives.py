"""Several virtual drives on one bus: each by its own address, with one clock for all."""

from __future__ import annotations

import json
import os
import socket
import struct
from pathlib import Path

import pytest

from drivers.virtual.axes import AXES
from drivers.virtual.can_wires import CanBus
from drivers.virtual.canopen_node import CanopenNode, Frame
from drivers.virtual.device import Clock, Device
from drivers.virtual.firmware import Firmware
from tests import serving
from tests.command import in_this_process

MS = 1_000_000  # ns
TWO = ("bench?coulomb=0.1", "bench?coulomb=0.3")
pytestmark = pytest.mark.skipif(os.name == "nt", reason="serves pseudo-terminals, too")


@pytest.mark.parametrize("wire", ["modbus-tcp", "modbus-rtu", "socketcand"])
def test_each_is_measured_by_its_own_address(wire: str, tmp_path: Path) -> None:
    with serving.serve(
        *TWO, *serving.WIRES[wire], "--clock", "step", links=2, several=True
    ) as links:
        serials = set()
        for link, truth in zip(links, (0.1, 0.3), strict=True):
            out = tmp_path / "out.json"
            done = in_this_process(
                "identify", link, "--travel", "3", "--cycle", "0.004", "--yes", "--json", str(out)
            )
            assert done.returncode == 0, done.stderr
            result = json.loads(out.read_text())
            assert result["friction"]["coulomb"]["value"] == pytest.approx(truth, rel=0.05)
            serials.add(result["identity"]["serial"])
        assert len(serials) == 2


def test_a_gateway_says_that_nobody_answers() -> None:
    """Exception 0Bh, as in the Modbus Application Protocol V1.1b3, chapter 7."""
    with (
        serving.serve(*TWO, *serving.WIRES["modbus-tcp"], links=2, several=True) as links,
        socket.create_connection(("127.0.0.1", int(links[0].split(":")[2].split("?")[0]))) as line,
    ):
        line.sendall(struct.pack(">HHHBBHH", 7, 0, 6, 9, 3, 0, 1))
        assert line.recv(100) == struct.pack(">HHHBBB", 7, 0, 3, 9, 0x83, 0x0B)


def test_drives_of_one_bus_step_together() -> None:
    clock = Clock("step", MS)
    devices = [Device(Firmware(AXES["bench"]), clock) for _ in range(3)]
    bus = CanBus([CanopenNode(device, 5 + n) for n, device in enumerate(devices)])
    bus.transmit(Frame(0x000, bytes((1, 5))), None)  # two are operational,
    bus.transmit(Frame(0x000, bytes((1, 6))), None)  # and the third is not
    for _ in range(4):
        bus.transmit(Frame(0x080, b""), None)
    assert [device.firmware.now for device in devices[:2]] == [4 * MS, 4 * MS]
    bus.transmit(Frame(0x080, b""), None)
    devices[0].write("simulation_advance", 3000)
    bus.transmit(Frame(0x200, b""), None)
    assert [device.firmware.now for device in devices] == [8 * MS] * 3


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        (("bench", "bench"), "tell them apart"),
        (("bench?unit=4", "vertical?unit=4"), "both unit 4"),
        (("bench", "vertical?unit=300"), "unit=300"),
        (("bench", "vertikal"), "vertical"),
        (("bench", "vertical", "--state", "x.json"), "--state"),
    ],
)
def test_what_cannot_be_told_apart_is_said(axes: tuple[str, ...], said: str) -> None:
    done = in_this_process("virtual", "serve", *axes, "--modbus-tcp", "127.0.0.1:0")
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
