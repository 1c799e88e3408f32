"""Raw values against 16-bit registers, with the word order said for each parameter."""

from __future__ import annotations

import struct

from profiles.address import ModbusAddress

__all__ = ["decode", "encode"]

_CODE = {
    "i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I", "i64": "q", "u64": "Q",
    "f32": "I",
}  # fmt: skip


def encode(address: ModbusAddress, raw: int) -> list[int]:
    """Registers for `raw`, lowest address first; raises ValueError out of the type's range.

    Of a parameter that is some bits of a register: those bits, the others zero.
    """
    if address.bits is not None:
        low, high = address.raw_range
        if not low <= raw <= high:
            raise ValueError(f"{raw} does not fit {address}")
        return [raw * (address.bits & -address.bits)]
    code = _CODE[address.type]
    if address.type in ("i8", "u8"):
        code = "h" if code == "b" else "H"
    try:
        packed = struct.pack(f">{code}", raw)
    except struct.error:
        raise ValueError(f"{raw} does not fit type {address.type}") from None
    words = list(struct.unpack(f">{len(packed) // 2}H", packed))
    return words if address.word_order == "high-first" else words[::-1]


def decode(address: ModbusAddress, words: list[int]) -> int:
    """Raw value of registers, lowest address first."""
    if address.bits is not None:
        return (words[0] & address.bits) // (address.bits & -address.bits)
    ordered = words if address.word_order == "high-first" else words[::-1]
    code = _CODE[address.type]
    if address.type in ("i8", "u8"):
        code = "h" if code == "b" else "H"
    packed = struct.pack(f">{len(ordered)}H", *ordered)
    value: int = struct.unpack(f">{code}", packed)[0]
    return value
