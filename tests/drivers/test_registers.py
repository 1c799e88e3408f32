"""Register codec against values printed in manuals and counted by hand."""

from __future__ import annotations

import pytest

from drivers.modbus.registers import decode, encode
from profiles.address import ModbusAddress


def address(kind: str, order: str = "high-first") -> ModbusAddress:
    return ModbusAddress.model_validate({"register": 0, "type": kind, "word_order": order})


@pytest.mark.parametrize(
    ("kind", "order", "raw", "words"),
    [
        ("u32", "high-first", 200, [0x0000, 0x00C8]),  # Lexium 32: 4614 = 0000h, 4615 = 00C8h
        ("u32", "low-first", 200, [0x00C8, 0x0000]),
        ("i32", "high-first", -2, [0xFFFF, 0xFFFE]),
        ("i32", "low-first", 0x12345678, [0x5678, 0x1234]),
        ("i16", "high-first", -1, [0xFFFF]),
        ("u16", "high-first", 65535, [0xFFFF]),
        ("i8", "high-first", -3, [0xFFFD]),
        ("i64", "low-first", 1, [1, 0, 0, 0]),
    ],
)
def test_encode_and_decode(kind: str, order: str, raw: int, words: list[int]) -> None:
    assert encode(address(kind, order), raw) == words
    assert decode(address(kind, order), words) == raw


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        encode(address("i16"), 40000)


def test_bits_of_a_register_are_a_value_of_their_own() -> None:
    low = ModbusAddress.model_validate({"register": 0, "type": "u16", "bits": 0x0001})
    high = ModbusAddress.model_validate({"register": 0, "type": "u16", "bits": 0x0F00})
    assert decode(low, [0x0A01]) == 1
    assert decode(high, [0x0A01]) == 0x0A
    assert encode(high, 0x0A) == [0x0A00]
    assert high.raw_range == (0, 15)
    with pytest.raises(ValueError, match="does not fit"):
        encode(low, 2)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"type": "u32", "write_function": 6}, "writes one register; u32 takes 2"),
        ({"type": "u32", "bits": 1}, "only of one register"),
        ({"type": "u16", "write_function": 22}, "say which"),
    ],
)
def test_an_address_that_cannot_be_written_so_is_refused(
    keys: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        ModbusAddress.model_validate({"register": 0, **keys})
