"""The strict slave against the words of the Modbus specifications, request by request."""

from __future__ import annotations

import pytest

from drivers.virtual.axes import AXES
from drivers.virtual.device import Device
from drivers.virtual.firmware import Firmware
from drivers.virtual.modbus_framing import MbapFraming, RtuFraming, crc
from drivers.virtual.modbus_slave import ModbusSlave
from drivers.virtual.registers import RegisterMap


@pytest.fixture
def slave() -> ModbusSlave:
    return ModbusSlave(RegisterMap(Device(Firmware(AXES["bench"]), "step")))


CONFORMANCE = {
    # Application Protocol V1.1b3, 6.3: statusword of a drive that is switched on disabled, remote
    "read holding registers": ("03 02 00 00 01", "03 02 02 40"),
    "read input registers": ("04 02 00 00 01", "04 02 02 40"),
    "a count of 0": ("03 02 00 00 00", "83 03"),
    "a count of 126": ("03 02 00 00 7E", "83 03"),
    "a count of 65535": ("03 02 00 FF FF", "83 03"),
    "beyond the last register": ("03 FF FF 00 02", "83 02"),
    "a register that is not there": ("03 70 00 00 01", "83 02"),
    "half of a value of two registers": ("03 02 02 00 01", "83 02"),
    "a read that is too short": ("03 02 00 00", "83 03"),
    "a read that is too long": ("03 02 00 00 01 00", "83 03"),
    # 6.6, 6.12: write one, write several
    "write single register": ("06 03 10 01 F4", "06 03 10 01 F4"),
    "write to a read-only register": ("06 02 00 00 00", "86 02"),
    "write a value that is out of range": ("06 03 14 00 09", "86 03"),
    "write multiple registers": ("10 03 10 00 01 02 01 F4", "10 03 10 00 01"),
    "a byte count that is not twice the count": ("10 03 10 00 01 04 01 F4 00 00", "90 03"),
    "writes of 0 registers": ("10 03 10 00 00 00", "90 03"),
    "writes of 124 registers": ("10 03 10 00 7C F8" + " 00" * 248, "90 03"),
    "fewer words than promised": ("10 03 10 00 02 04 01 F4", "90 03"),
    # 6.16
    "mask write register": ("16 03 10 FF 0F 00 50", "16 03 10 FF 0F 00 50"),
    # 6.17
    "read and write": ("17 02 00 00 01 03 10 00 01 02 01 F4", "17 02 02 40"),
    "read and write of 126 registers": ("17 02 00 00 7E 03 10 00 01 02 01 F4", "97 03"),
    "read and write of a wrong byte count": ("17 02 00 00 01 03 10 00 01 04 01 F4", "97 03"),
    # what the drive does not have
    "function 1": ("01 00 00 00 01", "81 01"),
    "function 7": ("07", "87 01"),
    "function 8": ("08 00 00 12 34", "88 01"),
    "function 11": ("0B", "8B 01"),
    "function 17": ("11", "91 01"),
    "function 24": ("18 00 00", "98 01"),
    "function 100": ("64", "E4 01"),
    # 6.21: vendor, product, revision
    "device identification, one object": (
        "2B 0E 04 00",
        "2B 0E 04 81 00 00 01 00 08" + b"tworelay".hex(),
    ),
    "device identification, an object that is not there": ("2B 0E 04 55", "AB 02"),
    "device identification, a code that is none": ("2B 0E 09 00", "AB 03"),
    "another MEI type": ("2B 0D 01 00", "AB 01"),
}


@pytest.mark.parametrize(("request_", "answer"), CONFORMANCE.values(), ids=CONFORMANCE)
def test_a_request_is_answered_by_the_words_of_the_specification(
    slave: ModbusSlave, request_: str, answer: str
) -> None:
    assert slave.answer(bytes.fromhex(request_)).hex() == bytes.fromhex(answer).hex()


def test_a_mask_changes_the_bits_that_it_leaves(slave: ModbusSlave) -> None:
    slave.answer(bytes.fromhex("06 03 10 03 E8"))  # 1000 = 03E8h
    slave.answer(bytes.fromhex("16 03 10 FF 0F 00 50"))
    assert slave.answer(bytes.fromhex("03 03 10 00 01")).hex(" ") == "03 02 03 58"


def test_basic_identification_as_a_stream(slave: ModbusSlave) -> None:
    answer = slave.answer(bytes.fromhex("2B 0E 01 00"))
    assert answer[:7].hex(" ") == "2b 0e 01 81 00 00 03"
    assert answer[7:].startswith(b"\x00\x08tworelay\x01\x0dvirtual drive\x02\x031.0")


def echo(pdu: bytes) -> bytes:
    return pdu


@pytest.mark.parametrize("cut", range(1, 24))
def test_pipelined_requests_are_answered_one_by_one_however_they_come(cut: int) -> None:
    """Messaging on TCP/IP V1.0b, 3.1.3.

    The middle one is of another protocol, and is passed over.
    """
    stream = bytes.fromhex(
        "00 01 00 00 00 03 01 03 AA 00 02 00 09 00 03 01 03 BB 00 03 00 00 00 03 FF 03 CC"
    )
    framing = MbapFraming({1: echo})
    answers = framing.feed(stream[:cut]) + framing.feed(stream[cut:])
    assert [answer.hex() for answer in answers] == ["0001000000030103aa", "000300000003ff03cc"]
    assert not framing.is_closed


def test_another_unit_s_requests_are_none_of_ours() -> None:
    assert MbapFraming({1: echo}).feed(bytes.fromhex("00 01 00 00 00 03 02 03 AA")) == []
    frame = bytes.fromhex("02 03 00 00 00 01")
    assert RtuFraming({1: echo}).feed(frame + crc(frame).to_bytes(2, "little")) == []


@pytest.mark.parametrize("length", ["00 00", "00 01", "00 FF", "FF FF"])
def test_a_length_that_cannot_be_ends_the_connection(length: str) -> None:
    framing = MbapFraming({1: echo})
    assert framing.feed(bytes.fromhex(f"00 01 00 00 {length} 01 03 AA")) == []
    assert framing.is_closed


READ = bytes.fromhex("01 03 00 00 00 01 84 0A")  # with the check sum of the specification's example


def test_half_a_frame_does_not_swallow_the_next_one() -> None:
    framing = RtuFraming({1: echo})
    assert framing.feed(READ[:5]) == []
    assert framing.is_incomplete
    assert framing.silence() == []
    (answer,) = framing.feed(READ)
    assert crc(answer) == 0


def test_a_broken_frame_is_passed_over_up_to_the_silence() -> None:
    framing = RtuFraming({1: echo})
    assert framing.feed(READ[:-1] + b"\xff" + READ) == []
    assert framing.silence() == []
    assert len(framing.feed(READ)) == 1


def test_a_function_of_unknown_length_ends_with_silence() -> None:
    frame = bytes.fromhex("01 64 12 34")
    framing = RtuFraming({1: echo})
    assert framing.feed(frame + crc(frame).to_bytes(2, "little")) == []
    (answer,) = framing.silence()
    assert answer[:4] == frame


def test_a_broadcast_is_done_and_not_answered() -> None:
    done = []
    framing = RtuFraming({1: lambda pdu: done.append(pdu) or pdu})  # type: ignore[func-returns-value]
    frame = bytes.fromhex("00 06 03 10 01 F4")
    assert framing.feed(frame + crc(frame).to_bytes(2, "little")) == []
    assert done == [frame[1:]]
