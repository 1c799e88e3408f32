"""SDO frames of each CANopen profile,
written by hand from CiA 301 and the drives' own documents."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Iterator
from typing import Any

import can
import pytest

from drivers.canopen.bus import CanopenBus
from drivers.canopen.wire import CanWire
from drivers.pace import WallPace
from profiles.library import builtin_names, load_profile

# CiA 301 7.2.4.3: 2Fh one byte, 2Bh two, 23h four; index and value with the low byte first
STANDARD = [
    ("controlword", 0x0006, "2B 40 60 00 06 00 00 00"),
    ("controlword", 0x000F, "2B 40 60 00 0F 00 00 00"),
    ("mode_of_operation", 10, "2F 60 60 00 0A 00 00 00"),
    ("torque_target", 250, "2B 71 60 00 FA 00 00 00"),
    ("torque_target", -250, "2B 71 60 00 06 FF 00 00"),
    ("position_target", -2, "23 7A 60 00 FE FF FF FF"),
    ("max_speed", 3000, "23 80 60 00 B8 0B 00 00"),
    ("store_command", 0x65766173, "23 10 10 01 73 61 76 65"),
]
REACTIONS = [
    ("watchdog_time", 0x7F0032, "23 16 10 01 32 00 7F 00"),  # node 127, 50 ms
    ("abort_connection_option", 3, "2B 07 60 00 03 00 00 00"),
    ("quick_stop_option", 2, "2B 5A 60 00 02 00 00 00"),
]
TORQUE_LIMIT = [("max_torque", 1000, "2B 72 60 00 E8 03 00 00")]
CURRENT_LIMIT = [("max_current", 1000, "2B 73 60 00 E8 03 00 00")]
FRAMES: dict[str, list[tuple[str, int, str]]] = {
    "cia402": [*STANDARD, *REACTIONS, *TORQUE_LIMIT, ("torque_offset", -5,
    "2B B2 60 00 FB FF 00 00")],
    # Elmo Gold DCF: 6087h up to 10 000 000
    "elmo-gold": [
        *STANDARD, *REACTIONS, *TORQUE_LIMIT,
        ("torque_slope", 10_000_000, "23 87 60 00 80 96 98 00"),
    ],
    # EPOS4 EDS: no 6072h; output current limit 3001h:02, U32 in mA
    "maxon-epos4": [*STANDARD, *REACTIONS, ("max_torque", 15000, "23 01 30 02 98 3A 00 00")],
    # Everest XCR EDS: 6072h U16, 6087h U32, no 1016h, 6007h, 605Ah
    "ingenia-everest": [
        *STANDARD, *TORQUE_LIMIT, ("torque_slope", 10000, "23 87 60 00 10 27 00 00"),
        ("torque_offset", -5, "23 B2 60 00 FB FF FF FF"),  # 60B2h is I32 here
    ],
    # AKD parameter guide: IL.FRICTION 3422h, IL.OFFSET 3423h, both sub 0; its torque limit is 6073h
    "kollmorgen-akd": [
        *STANDARD, *REACTIONS, *CURRENT_LIMIT,
        ("friction", 170, "23 22 34 00 AA 00 00 00"),
        ("current_offset", -50, "23 23 34 00 CE FF FF FF"),
    ],
    # AX2000 ASCII reference: ISTFR 36A4h, VSTFR 36A5h, T 360Eh, OPMODE 35B4h, IPEAK 356Eh, IPEAKN
    # 356Fh; objects above 3500h have their value behind sub-index 1, and I32 weighted by 1000
    "beckhoff-ax2000": [
        *STANDARD[:2], STANDARD[-1], ("controlword", 0x0080, "2B 40 60 00 80 00 00 00"),
        ("mode_of_operation", 2, "2F B4 35 01 02 00 00 00"),
        ("torque_target", 1500, "23 0E 36 01 DC 05 00 00"),
        ("torque_target", -1500, "23 0E 36 01 24 FA FF FF"),
        ("peak_current", 4000, "23 6E 35 01 A0 0F 00 00"),
        ("negative_peak_current", -4000, "23 6F 35 01 60 F0 FF FF"),
        ("friction_current", 1500, "23 A4 36 01 DC 05 00 00"),
        ("friction_speed", 230_000, "23 A5 36 01 70 82 03 00"),
    ],
    # S300/S700 CANopen manual: 6071h, 6073h, life guarding 100Ch x 100Dh, and the same two objects
    "kollmorgen-s300": [
        *STANDARD[:5], *STANDARD[-2:], *CURRENT_LIMIT,
        ("guard_time", 20, "2B 0C 10 00 14 00 00 00"),
        ("life_factor", 3, "2F 0D 10 00 03 00 00 00"),
        ("friction_current", 1500, "23 A4 36 01 DC 05 00 00"),
        ("friction_speed", 230_000, "23 A5 36 01 70 82 03 00"),
    ],
    # C5-E object descriptions: the set-point is 0 before 'save', 6087h U32, 60B2h I16
    "nanotec-c5e": [
        *STANDARD, *REACTIONS, *TORQUE_LIMIT, ("torque_target", 0, "2B 71 60 00 00 00 00 00"),
        ("torque_slope", 100_000, "23 87 60 00 A0 86 01 00"),
        ("torque_offset", -5, "2B B2 60 00 FB FF 00 00"),
    ],
    # Lexium 32: index 3000h + I, sub S; CTRL1_Kfric I 18 S 16, CTRL_SpdFric I 17 S 9, PAReeprSave I
    # 4 S 1
    "lexium-32": [
        *STANDARD[:-2], *REACTIONS,
        ("friction", 170, "2B 12 30 10 AA 00 00 00"),
        ("friction_speed", 5, "2B 11 30 09 05 00 00 00"),
        ("max_current", 600, "2B 11 30 0C 58 02 00 00"),
        ("torque_ramp", 0, "2B 06 30 2C 00 00 00 00"),
        ("eeprom_save", 1, "2B 04 30 01 01 00 00 00"),
    ],
}  # fmt: skip


class Server:
    """A node that notes every SDO request and confirms each download."""

    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.heard: list[str] = []
        self._end = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._end:
            message = self.bus.recv(0.05)
            if message is not None and message.arbitration_id == 0x605:
                data = bytes(message.data)
                self.heard.append(data.hex(" ").upper())
                answer = can.Message(
                    arbitration_id=0x585, data=b"\x60" + data[1:4] + bytes(4), is_extended_id=False
                )
                self.bus.send(answer)

    def close(self) -> None:
        self._end = True
        self._thread.join()
        self.bus.shutdown()


@pytest.fixture
def node() -> Iterator[tuple[Any, Server]]:
    channel = uuid.uuid4().hex
    server = Server(channel)
    bus = can.Bus(interface="virtual", channel=channel)
    yield bus, server
    bus.shutdown()
    server.close()


def test_every_canopen_profile_of_a_real_drive_is_here() -> None:
    profiles = map(load_profile, builtin_names())
    assert {p.name for p in profiles if p.bus == "canopen" and p.status != "virtual"} == {*FRAMES}


@pytest.mark.parametrize("name", FRAMES)
def test_a_profile_writes_the_frames_of_its_documents(name: str, node: tuple[Any, Server]) -> None:
    assert len(FRAMES[name]) >= 10
    bus, server = node
    profile = load_profile(name)
    canopen = CanopenBus(CanWire(bus, 5, 1.0), profile, WallPace(0.01))
    for parameter, raw, _ in FRAMES[name]:
        canopen.write(profile.parameters[parameter].address, raw)
    assert server.heard == [frame for _, _, frame in FRAMES[name]]
