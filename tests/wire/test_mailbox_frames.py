"""The mailbox of a Festo CMMT, request by request as its vendor's driver writes them."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from drivers.errors import AccessDenied, LinkError
from drivers.modbus.bus import ModbusBus
from drivers.modbus.client import Client
from drivers.modbus.wires import TcpWire
from drivers.pace import WallPace
from profiles.errors import TwoRelayError
from profiles.library import load_profile

PROFILE = load_profile("festo-cmmt")
DONE, FAILED, BUSY = 0x10, 0x03, None


class Drive:
    """Registers 500 to 513.

    What is executed ends with `status`, and leaves `length` bytes of `data`.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.heard: list[str] = []
        self.status: int | None = DONE
        self.length = 4
        self.data = [0, 0]
        self._request = 0
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _read(self, register: int, count: int) -> list[int]:
        if register == 503:
            return [self._request if self.status is None else self.status]
        return [self.length] if register == 504 else self.data[:count]

    def _run(self) -> None:
        connection, _ = self._listener.accept()
        with connection:
            while frame := connection.recv(300):
                pdu = frame[7:]
                self.heard.append(pdu.hex(" ").upper())
                register = int.from_bytes(pdu[1:3])
                if pdu[0] == 6 and register == 503:
                    self._request = int.from_bytes(pdu[3:5])
                answer = pdu[:5]
                if pdu[0] == 3:
                    words = self._read(register, int.from_bytes(pdu[3:5]))
                    answer = bytes((3, 2 * len(words))) + b"".join(w.to_bytes(2) for w in words)
                connection.sendall(frame[:4] + (len(answer) + 1).to_bytes(2) + frame[6:7] + answer)

    def close(self) -> None:
        self._thread.join()
        self._listener.close()


@pytest.fixture
def link() -> Iterator[tuple[Drive, ModbusBus]]:
    drive = Drive()
    bus = ModbusBus(Client(TcpWire("127.0.0.1", drive.port), 0, 1.0), PROFILE, WallPace(0.01))
    yield drive, bus
    bus.close()
    drive.close()


def test_a_number_is_read_low_word_first(link: tuple[Drive, ModbusBus]) -> None:
    drive, bus = link
    drive.data = [0x999A, 0x3E19]  # 0.15 as IEEE 754: 3E19999Ah
    parameter = PROFILE.parameters["kinetic_friction"]
    assert parameter.number(bus.read(parameter.address)) == pytest.approx(0.15)
    assert drive.heard == [
        "06 01 F4 33 2F",  # 500: PNU 13103
        "06 01 F5 00 00",  # 501: sub-index
        "06 01 F6 00 01",  # 502: one element
        "06 01 F7 00 01",  # 503: read
        "03 01 F7 00 01",
        "03 01 F8 00 01",  # 504: bytes
        "03 01 FE 00 02",  # 510: data
    ]


def test_a_number_is_written_low_word_first(link: tuple[Drive, ModbusBus]) -> None:
    drive, bus = link
    parameter = PROFILE.parameters["friction_torque_2"]
    bus.write(parameter.address, parameter.nearest_raw(0.15))
    assert drive.heard == [
        "06 01 F4 2B F8",  # 500: PNU 11256
        "06 01 F5 00 01",  # 501: second point
        "06 01 F6 00 01",
        "06 01 F8 00 04",  # 504: four bytes
        "10 01 FE 00 02 04 99 9A 3E 19",  # 510
        "06 01 F7 00 02",  # 503: write
        "03 01 F7 00 01",
    ]


@pytest.mark.parametrize(
    ("name", "pnu", "length", "words"),
    [
        ("statusword", "00 02", 2, [0x0004]), ("constant_torque", "2B F3", 4, [0, 0xBF80]),
        ("friction_points", "2B F9", 4, [2, 0]), ("friction_velocity_1", "2B F7", 4, [0, 0x3F00]),
        ("static_friction", "33 2B", 4, [0, 0]), ("friction_output", "2B F5", 4, [0, 0]),
    ],
)  # fmt: skip
def test_each_parameter_is_asked_by_its_number(
    link: tuple[Drive, ModbusBus], name: str, pnu: str, length: int, words: list[int]
) -> None:
    drive, bus = link
    drive.length, drive.data = length, words
    parameter = PROFILE.parameters[name]
    number = parameter.number(bus.read(parameter.address))
    assert drive.heard[0] == f"06 01 F4 {pnu}"
    expected = {
        "statusword": 4,
        "constant_torque": -1.0,
        "friction_points": 2,
        "friction_velocity_1": 0.5,
    }
    assert number == expected.get(name, 0)


@pytest.mark.parametrize(
    ("status", "length", "error", "words"),
    [
        (FAILED, 4, AccessDenied, "PNU 13103:0 cannot be read: the mailbox answers 03h"),
        (BUSY, 4, LinkError, "PNU 13103:0: the mailbox is busy for more than 1 s"),
        (DONE, 2, LinkError, "PNU 13103:0 has 2 bytes in the drive, not 4"),
    ],
)
def test_a_mailbox_that_does_not_deliver_is_said_to(
    link: tuple[Drive, ModbusBus],
    status: int | None,
    length: int,
    error: type[TwoRelayError],
    words: str,
) -> None:
    drive, bus = link
    drive.status, drive.length = status, length
    with pytest.raises(error) as caught:
        bus.read(PROFILE.parameters["kinetic_friction"].address)
    assert words in str(caught.value)


def test_numbers_have_bounds_and_bits() -> None:
    parameter = PROFILE.parameters["friction_torque_1"]
    assert parameter.nearest_raw(1.0) == 0x3F800000
    assert parameter.allows(0x3F800000)
    assert not parameter.allows(parameter.nearest_raw(-0.5))
    assert not parameter.allows(parameter.nearest_raw(2000.0))
    assert not parameter.allows(0x7FC00000)  # not a number
