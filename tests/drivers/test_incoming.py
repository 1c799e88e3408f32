"""What of the bytes that come is an answer: echoes, other units and transactions, noise, pieces."""

from __future__ import annotations

import pytest

from drivers.modbus.incoming import LineIncoming, MbapIncoming, frame_at, units_in

READ = bytes.fromhex("01 03 00 00 00 01 84 0A")  # Serial Line V1.02, with its check sum
ANSWER = bytes.fromhex("01 03 02 12 34 B5 33")
OTHER = bytes.fromhex("02 03 02 12 34 F1 33")  # unit 2's
WRITE = bytes.fromhex("01 06 00 01 00 03 98 0B")  # which is its own answer


@pytest.mark.parametrize("noise", [b"", b"\xff\x00\x7e", b"\x01", b"\x01\x03", OTHER])
@pytest.mark.parametrize("piece", [1, 3, 100])
def test_the_answer_is_found_in_what_comes(noise: bytes, piece: int) -> None:
    line = LineIncoming()
    line.ask(READ)
    data, found = noise + ANSWER, b""
    for at in range(0, len(data), piece):
        found = found or line.take(data[at : at + piece])
    assert found == ANSWER
    assert line.oddity == ""


@pytest.mark.parametrize("piece", [1, 5, 8, 100])
def test_an_echo_is_seen_once_and_left_out_from_then_on(piece: int) -> None:
    line = LineIncoming()
    for frame, answer in ((READ, ANSWER), (WRITE, WRITE), (READ, ANSWER)):
        line.ask(frame)
        data, found = frame + answer, b""
        for at in range(0, len(data), piece):
            found = found or line.take(data[at : at + piece])
        assert found == answer
    assert "hears itself" in line.oddity


@pytest.mark.parametrize("noise", [b"\x00", b"\x01", b"\x01\x03", ANSWER])
def test_a_disturbance_before_an_echo_does_not_make_an_answer_of_it(noise: bytes) -> None:
    """A read of one register at 03xxh is `01 03 03 ..`.

    As an answer it would have a count of three bytes.
    """
    read = bytes.fromhex("01 03 03 10 00 01 84 4B")
    line = LineIncoming()
    line.ask(read)
    assert line.take(noise + read if noise != ANSWER else read) == b""
    assert line.is_echo_alone()
    assert line.take(ANSWER) == ANSWER
    line.ask(WRITE)
    assert line.take(noise[:1] + WRITE) == b"", "one of them is the echo"
    assert line.take(WRITE) == WRITE


def test_an_echo_that_begins_later_is_none_of_the_answers() -> None:
    line = LineIncoming()
    line.ask(READ)
    assert line.take(ANSWER) == ANSWER
    line.ask(READ)
    assert line.take(READ) == b""
    line.ask(WRITE)
    assert line.take(WRITE) == b""
    assert not line.is_broken()


def test_only_as_many_registers_as_were_asked_for_are_an_answer() -> None:
    line = LineIncoming()
    line.ask(READ)  # one register
    assert line.take(bytes.fromhex("01 03 04 12 34 56 78 81 07")) == b""
    assert line.take(bytes.fromhex("01 03 03 12 34 56 48 F9")) == b""
    line.ask(READ)
    assert line.take(ANSWER[:-1] + b"\x00") == b""
    assert line.is_broken(), "all of it has come"


def test_much_nonsense_costs_little_memory() -> None:
    line = LineIncoming()
    line.ask(READ)
    for _ in range(1000):
        assert line.take(b"\x01\x03\xfa" * 100) == b""
    assert len(line.heard) < 1000


def test_a_write_first_says_nothing_of_an_echo() -> None:
    line = LineIncoming()
    line.ask(WRITE)
    assert line.take(WRITE) == WRITE
    line.ask(READ)
    assert line.take(ANSWER) == ANSWER
    line.ask(WRITE)
    assert line.take(WRITE) == WRITE


def test_a_stranger_is_named() -> None:
    line = LineIncoming()
    line.ask(READ)
    assert line.take(OTHER) == b""
    assert line.stranger() == 2
    line.ask(READ)
    assert line.stranger() is None


def test_whole_answers_by_their_length_and_check_sum() -> None:
    assert frame_at(ANSWER) == len(ANSWER)
    assert frame_at(ANSWER + b"\x00\x00") == len(ANSWER)
    assert frame_at(ANSWER[:-1]) == 0
    assert frame_at(ANSWER[:-1] + b"\x00") == 0
    assert frame_at(bytes.fromhex("01 83 02 C0 F1")) == 5
    assert units_in(b"\x00" + OTHER + ANSWER + b"\x07") == [2, 1]


def adu(transaction: int, unit: int, pdu: str, protocol: int = 0) -> bytes:
    data = bytes.fromhex(pdu)
    head = transaction.to_bytes(2, "big") + protocol.to_bytes(2, "big")
    return head + (len(data) + 1).to_bytes(2, "big") + bytes((unit,)) + data


@pytest.mark.parametrize("unit", [1, 0, 255])
@pytest.mark.parametrize("cut", [0, 3, 6, 9, 12])
def test_an_answer_to_the_transaction_is_taken_whatever_a_lone_device_calls_itself(
    unit: int, cut: int
) -> None:
    tcp = MbapIncoming()
    tcp.ask(adu(7, 1, "03 00 00 00 01"))
    data = adu(6, 1, "03 02 AA AA") + adu(7, unit, "03 02 12 34")
    assert tcp.take(data[:cut]) + tcp.take(data[cut:]) == adu(7, 1, "03 02 12 34")
    assert tcp.oddity == ("" if unit == 1 else f"unit {unit} answers for unit 1")


def test_another_unit_s_answer_and_another_protocol_are_not() -> None:
    tcp = MbapIncoming()
    tcp.ask(adu(7, 1, "03 00 00 00 01"))
    assert tcp.take(adu(7, 9, "03 02 12 34")) == b""
    assert tcp.stranger() == 9
    assert tcp.take(adu(7, 1, "03 02 12 34", protocol=5)) == b""
    assert tcp.take(adu(7, 1, "03 02 12 34")) == adu(7, 1, "03 02 12 34")


def test_an_answer_that_comes_late_is_found_behind_the_echo_that_came_late_too() -> None:
    line = LineIncoming()
    line.ask(READ)
    assert line.take(READ + ANSWER) == ANSWER
    line.ask(READ)
    left, answers = line.late_in(READ[:3])
    assert answers == 0
    left, answers = line.late_in(left + READ[3:] + ANSWER[:2])
    assert answers == 0
    assert line.late_in(left + ANSWER[2:]) == (b"", 1)
    assert line.late_in(OTHER) == (b"", 0), "another unit's"
    assert line.late_in(b"\x00" + ANSWER + b"\x07") == (b"\x07", 1)


def test_what_lies_on_a_line_before_the_first_request_is_nobody_s() -> None:
    """The answer to a process that was killed."""
    assert LineIncoming().late_in(ANSWER) == (b"", 0)
