"""Requests of each Modbus profile, written by hand from the drives' own documents.

Protocol data units of the Modbus Application Protocol V1.1b3: 06h address value, 10h address count
bytes values, 03h address count.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from drivers.modbus.bus import ModbusBus
from drivers.modbus.client import Client
from drivers.modbus.wires import TcpWire
from drivers.pace import WallPace
from profiles.library import builtin_names, load_profile

READ = None
FRAMES: dict[str, list[tuple[str, int | None, str]]] = {
    # Pr a.bb lies at a * 256 + 2 * bb + 1 where it takes one register
    "leadshine-el7": [
        ("torque_target", 25, "06 03 2D 00 19"),  # Pr3.22
        ("torque_target", -25, "06 03 2D FF E7"),
        ("control_mode", 2, "06 00 03 00 02"),  # Pr0.01
        ("auto_tuning", 0, "06 00 05 00 00"),  # Pr0.02
        ("torque_source", 1, "06 03 23 00 01"),  # Pr3.17
        ("max_speed", 500, "06 03 2B 01 F4"),  # Pr3.21
        ("max_torque", 100, "06 00 1B 00 64"),  # Pr0.13
        ("input_1_function", 0x83, "06 04 01 00 83"),  # Pr4.00
        ("position_control", 0x40, "06 60 02 00 40"),  # Pr8.02
        ("torque_offset", -3, "06 06 0F FF FD"),  # Pr6.07
        ("coulomb_positive", 9, "06 06 11 00 09"),  # Pr6.08
        ("coulomb_negative", -9, "06 06 13 FF F7"),  # Pr6.09
        ("control", 0x2211, "06 18 01 22 11"),
        ("position_actual", READ, "03 60 2C 00 02"),  # Pr8.44, Pr8.45
        ("operation_status", READ, "03 0B 05 00 01"),  # PrB.05
    ],
    # 256 * index + 2 * sub-index, always two registers, high word first
    "lexium-32-modbus": [
        ("controlword", 0x000F, "10 1B 02 00 02 04 00 00 00 0F"),  # 6914
        ("mode_of_operation", 4, "10 1B 06 00 02 04 00 00 00 04"),  # 6918
        ("torque_target", 250, "10 1B 20 00 02 04 00 00 00 FA"),  # 6944
        ("torque_target", -250, "10 1B 20 00 02 04 FF FF FF 06"),
        ("torque_ramp", 0, "10 06 58 00 02 04 00 00 00 00"),  # 1624
        ("access_lock", 1, "10 01 1C 00 02 04 00 00 00 01"),  # index 1, sub 14: 284
        ("own_friction", READ, "03 2F 0E 00 02"),  # 12046
        ("active_set", READ, "03 11 2E 00 02"),  # 4398
        ("modulo", READ, "03 06 70 00 02"),  # 1648
        ("velocity_denominator", READ, "03 06 42 00 02"),  # 1602
        ("velocity_numerator", READ, "03 06 44 00 02"),  # 1604
        ("swapped_for_1", READ, "03 44 A0 00 02"),  # 17568
        ("swapped_for_4", READ, "03 44 A6 00 02"),  # 17574
        ("friction", 170, "10 12 20 00 02 04 00 00 00 AA"),  # 4640
        ("friction_speed", 5, "10 11 12 00 02 04 00 00 00 05"),  # 4370
        ("max_current", 600, "10 11 18 00 02 04 00 00 02 58"),  # 4376
        ("store_command", 1, "10 04 02 00 02 04 00 00 00 01"),  # 1026
        ("statusword", READ, "03 1B 04 00 02"),  # 6916
        ("position_actual", READ, "03 1E 1A 00 02"),  # 7706
        ("torque_actual", READ, "03 1E 48 00 02"),  # 7752
    ],
    # group * 256 + 2 * number, low word first
    "delta-asda": [
        ("torque_target", 25, "10 01 18 00 01 02 00 19"),  # P1-12
        ("torque_target", -25, "10 01 18 00 01 02 FF E7"),
        ("max_speed", 100_000 - 70_000, "10 01 12 00 02 04 75 30 00 00"),  # P1-09
        ("eeprom_writes", 5, "10 02 3C 00 01 02 00 05"),  # P2-30
        ("input_source", 0xFF, "10 03 0C 00 01 02 00 FF"),  # P3-06
        ("communication_timeout", 1, "10 03 08 00 01 02 00 01"),  # P3-04
        ("communication_reaction", 1, "10 03 06 00 01 02 00 01"),  # P3-03
        ("monitor_1", 0, "10 00 22 00 01 02 00 00"),  # P0-17
        ("friction", 9, "10 01 7C 00 01 02 00 09"),  # P1-62
        ("drive_status", READ, "03 00 5C 00 01"),  # P0-46
        ("position_actual", READ, "03 00 12 00 02"),  # P0-09
    ],
    # 920-0176: register less 40001
    "applied-motion-m56s": [
        ("torque_target", 250, "10 01 10 00 02 04 00 00 00 FA"),  # 40273
        ("torque_target", -250, "10 01 10 00 02 04 FF FF FF 06"),
        ("command", 0x9F, "06 00 7C 00 9F"),  # 40125
        ("command", 0x9E, "06 00 7C 00 9E"),
        ("command", 0xE1, "06 00 7C 00 E1"),
        ("control_mode", 1, "10 01 06 00 02 04 00 00 00 01"),  # 40263
        ("protocol", READ, "03 01 20 00 02"),  # 40289
        ("max_speed", 2400, "10 01 84 00 02 04 00 00 09 60"),  # 40389
        ("status_code", READ, "03 00 02 00 02"),  # 40003
        ("position_actual", READ, "03 00 0A 00 02"),  # 40011
        ("torque_actual", READ, "03 00 1F 00 01"),  # 40032
    ],
    # P XX.YY lies at XX * 256 + YY
    "dsy-rs": [
        ("torque_target", 250, "06 06 05 00 FA"),  # P06.05
        ("torque_target", -250, "06 06 05 FF 06"),
        ("control_mode", 2, "06 00 00 00 02"),  # P00.00
        ("torque_source", 0, "06 06 00 00 00"),  # P06.00
        ("torque_selection", 0, "06 06 02 00 00"),  # P06.02
        ("max_torque", 1000, "06 06 08 03 E8"),  # P06.08
        ("max_speed", 3000, "06 06 0F 0B B8"),  # P06.15
        ("max_torque_negative", 1000, "06 06 09 03 E8"),  # P06.09
        ("max_speed_negative", 3000, "06 06 10 0B B8"),  # P06.16
        ("position_factor", READ, "03 04 07 00 02"),  # P04.07
        ("position_divisor", READ, "03 04 09 00 02"),  # P04.09
        ("eeprom_writes", 0, "06 0A 04 00 00"),  # P10.04
        ("emergency_stop", 1, "06 0B 0D 00 01"),  # P11.13
        ("fault_reset", 1, "06 0B 01 00 01"),  # P11.01
        ("position_actual", READ, "03 12 07 00 02"),  # P18.07
        ("rated_torque", READ, "03 01 05 00 01"),  # P01.05
    ],
}


class Server:
    """Notes every request, confirms writes, and answers zeros to reads."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.heard: list[str] = []
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        connection, _ = self._listener.accept()
        with connection:
            while frame := connection.recv(300):
                pdu = frame[7:]
                self.heard.append(pdu.hex(" ").upper())
                count = 2 * int.from_bytes(pdu[3:5])
                answer = bytes((3, count)) + bytes(count) if pdu[0] == 3 else pdu[:5]
                head = frame[:4] + (len(answer) + 1).to_bytes(2) + frame[6:7]
                connection.sendall(head + answer)

    def close(self) -> None:
        self._thread.join()
        self._listener.close()


@pytest.fixture
def server() -> Iterator[Server]:
    found = Server()
    yield found
    found.close()


def test_every_modbus_profile_of_a_real_drive_is_here() -> None:
    profiles = map(load_profile, builtin_names())
    real = {p.name for p in profiles if p.bus == "modbus" and p.status != "virtual"}
    assert real == {*FRAMES, "festo-cmmt"}  # which is behind a mailbox: test_mailbox_frames.py


@pytest.mark.parametrize("name", FRAMES)
def test_a_profile_sends_the_requests_of_its_documents(name: str, server: Server) -> None:
    assert len(FRAMES[name]) >= 10
    profile = load_profile(name)
    client = Client(TcpWire("127.0.0.1", server.port), 1, 1.0)
    bus = ModbusBus(client, profile, WallPace(0.01))
    for parameter, raw, _ in FRAMES[name]:
        address = profile.parameters[parameter].address
        if raw is None:
            assert bus.read(address) == 0
        else:
            bus.write(address, raw)
    bus.close()
    assert server.heard == [frame for _, _, frame in FRAMES[name]]


def test_a_cycle_is_one_write_and_as_few_reads_as_the_gaps_allow(server: Server) -> None:
    client = Client(TcpWire("127.0.0.1", server.port), 1, 1.0)
    bus = ModbusBus(client, load_profile("leadshine-el7"), WallPace(0.01))
    bus.start((0,))
    assert bus.exchange((25,)).values == (0, 0, 0)
    bus.close()
    # the position, then PrB.05 to PrB.07 in one
    assert server.heard == ["06 03 2D 00 19", "03 60 2C 00 02", "03 0B 05 00 03"]
