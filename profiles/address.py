"""Where a value is in a drive, and in what type: CANopen, Modbus, and a mailbox of registers."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from profiles.strict import Strict

__all__ = [
    "FLOAT",
    "WIDTH_BITS",
    "Address",
    "CanopenAddress",
    "Integer",
    "MailboxAddress",
    "ModbusAddress",
    "kind_of_address",
    "type_range",
]

Integer = Literal["i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64"]


FLOAT = "f32"  # IEEE 754; its raw value is the whole number that has the same 32 bits


WIDTH_BITS: dict[str, int] = {
    "i8": 8, "u8": 8, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "u64": 64, FLOAT: 32,
}  # fmt: skip


class CanopenAddress(Strict):
    """An entry of the CANopen object dictionary (CiA 301)."""

    index: Annotated[int, Field(ge=0x1000, le=0xFFFF)]
    sub: Annotated[int, Field(ge=0, le=0xFF)] = 0
    type: Integer | Literal["f32"]

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        return type_range(self.type)

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub:02X}"


class MailboxAddress(Strict):
    """A parameter behind the profile's mailbox of registers, by its number (PNU) and sub-index."""

    pnu: Annotated[int, Field(ge=0, le=0xFFFF)]
    sub: Annotated[int, Field(ge=0, le=0xFFFF)] = 0
    type: Integer | Literal["f32"]

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        return type_range(self.type)

    def __str__(self) -> str:
        return f"PNU {self.pnu}:{self.sub}"


class ModbusAddress(Strict):
    """Holding registers, counted from 0 as on the wire.

    `word_order` says which word of a wider value lies at the lower address. Where only some bits of
    a register are the parameter, `bits` is their mask, and the raw value is what stands in them;
    they are written by FC 22, or else read, changed and written back.
    """

    register_: Annotated[int, Field(ge=0, le=0xFFFF, alias="register")]
    type: Integer | Literal["f32"]
    word_order: Literal["high-first", "low-first"] = "high-first"
    read_function: Literal[3, 4] = 3
    write_function: Literal[6, 16, 22] = 16
    bits: Annotated[int, Field(ge=1, le=0xFFFF)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.count > 1 and self.write_function == 6:
            raise ValueError(
                f"write_function 6 writes one register; {self.type} takes {self.count}"
            )
        if self.bits is not None and self.type != "u16":
            raise ValueError("bits: only of one register of type u16")
        if (self.bits is None) and self.write_function == 22:
            raise ValueError("write_function 22 writes bits: say which")
        return self

    @property
    def count(self) -> int:
        """Number of 16-bit registers that the value takes."""
        return max(1, WIDTH_BITS[self.type] // 16)

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        if self.bits is None:
            return type_range(self.type)
        return 0, self.bits // (self.bits & -self.bits)

    def __str__(self) -> str:
        where = f"register {self.register_:04X}h"
        return where if self.bits is None else f"{where} bits {self.bits:04X}h"


Address = CanopenAddress | ModbusAddress | MailboxAddress


def kind_of_address(value: Any) -> str:
    """With an index it is an object, with a pnu behind a mailbox, else a register."""
    for key, kind in (("index", "canopen"), ("pnu", "mailbox")):
        there = value.get(key) if isinstance(value, dict) else getattr(value, key, None)
        if there is not None and not callable(there):
            return kind
    return "modbus"


_LARGEST_F32 = 3.4028234663852886e38


def type_range(name: str) -> tuple[int, int]:
    """Smallest and largest raw value of a scalar type by its name."""
    bits = WIDTH_BITS[name]
    return (0, 2**bits - 1) if name[0] in "uf" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
