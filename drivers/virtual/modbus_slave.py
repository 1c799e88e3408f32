"""The virtual drive's answers on Modbus (Modbus Application Protocol V1.1b3): PDU in, PDU out."""

from __future__ import annotations

import struct
from collections.abc import Callable

from drivers.virtual.registers import RegisterMap
from drivers.virtual.states import DenialReason, Denied

__all__ = ["READ_IDENTIFICATION", "ModbusSlave", "Refusal"]

_READ, _READ_INPUT, _WRITE_ONE, _WRITE, _MASK, _READ_WRITE = 3, 4, 6, 16, 22, 23
READ_IDENTIFICATION = 43
_MEI_TYPE = 14
_CONFORMITY = 0x81  # basic identification, as a stream and one by one
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _BUSY = 1, 2, 3, 6
_MOST_READ, _MOST_WRITTEN, _MOST_BOTH = 125, 123, 121  # registers (6.3, 6.12, 6.17)
_REASONS = {
    DenialReason.NO_OBJECT: _ILLEGAL_ADDRESS, DenialReason.READ_ONLY: _ILLEGAL_ADDRESS,
    DenialReason.RANGE: _ILLEGAL_VALUE, DenialReason.STATE: _BUSY,
}  # fmt: skip


class Refusal(Exception):
    """An exception response, with its code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class ModbusSlave:
    """Requests to one drive; it has the functions of its registers' layout, and no others."""

    def __init__(self, registers: RegisterMap) -> None:
        self._registers = registers
        self._known: dict[int, Callable[[bytes], bytes]] = {
            _READ: self._read, _READ_INPUT: self._read, _WRITE_ONE: self._write_one,
            _WRITE: self._write, _MASK: self._mask, _READ_WRITE: self._read_write,
            READ_IDENTIFICATION: self._identify,
        }  # fmt: skip

    def answer(self, pdu: bytes) -> bytes:
        """The response to a request; never empty."""
        function = pdu[0]
        try:
            if function not in self._registers.layout.functions:
                raise Refusal(_ILLEGAL_FUNCTION)
            return bytes((function,)) + self._known[function](pdu[1:])
        except Refusal as refusal:
            return bytes((function | 0x80, refusal.code))
        except struct.error:  # too short, or too long, to be a request of this function
            return bytes((function | 0x80, _ILLEGAL_VALUE))
        except Denied as denied:
            return bytes((function | 0x80, _REASONS[denied.reason]))

    def _read(self, data: bytes) -> bytes:
        return self._block(*struct.unpack(">HH", data))

    def _block(self, start: int, count: int) -> bytes:
        if not 1 <= count <= _MOST_READ:
            raise Refusal(_ILLEGAL_VALUE)
        if start + count > 0x10000:
            raise Refusal(_ILLEGAL_ADDRESS)
        words = self._registers.read(start, count)
        return struct.pack(f">B{count}H", 2 * count, *words)

    def _write_one(self, data: bytes) -> bytes:
        start, word = struct.unpack(">HH", data)
        self._registers.write(start, [word])
        return data

    def _write(self, data: bytes) -> bytes:
        self._take(data, _MOST_WRITTEN)
        return data[:4]

    def _take(self, data: bytes, most: int) -> None:
        """Start, count, bytes, words."""
        start, count, size = struct.unpack(">HHB", data[:5])
        if not 1 <= count <= most or size != 2 * count:
            raise Refusal(_ILLEGAL_VALUE)
        words = struct.unpack(f">{count}H", data[5:])
        if start + count > 0x10000:
            raise Refusal(_ILLEGAL_ADDRESS)
        self._registers.write(start, list(words))

    def _mask(self, data: bytes) -> bytes:
        start, keep, put = struct.unpack(">HHH", data)
        (word,) = self._registers.read(start, 1)
        self._registers.write(start, [(word & keep) | (put & ~keep & 0xFFFF)])
        return data

    def _read_write(self, data: bytes) -> bytes:
        start, count = struct.unpack(">HH", data[:4])
        if not 1 <= count <= _MOST_READ:
            raise Refusal(_ILLEGAL_VALUE)
        self._take(data[4:], _MOST_BOTH)
        return self._block(start, count)

    def _identify(self, data: bytes) -> bytes:
        """Function 43/14 (6.21): vendor, product, revision."""
        mei, code, first = struct.unpack(">BBB", data)
        if mei != _MEI_TYPE:
            raise Refusal(_ILLEGAL_FUNCTION)
        texts = [text.encode("ascii", "replace") for text in self._registers.layout.identity]
        if code == 4:
            if first >= len(texts):
                raise Refusal(_ILLEGAL_ADDRESS)
            wanted = {first: texts[first]}
        elif code in (1, 2, 3):
            begin = first if first < len(texts) else 0
            wanted = dict(list(enumerate(texts))[begin:])
        else:
            raise Refusal(_ILLEGAL_VALUE)
        head = bytes((_MEI_TYPE, code, _CONFORMITY, 0, 0, len(wanted)))
        return head + b"".join(bytes((at, len(text))) + text for at, text in wanted.items())
