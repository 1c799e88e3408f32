"""What a message is on each wire: where it ends, and how it is broken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

__all__ = ["Framing", "ModbusRtu", "ModbusTcp", "Slcan", "Socketcand"]

_SDO, _SYNC = 0x600, 0x080


class Framing(Protocol):
    """Messages of a wire."""

    def split(self, stream: bytes, *, from_host: bool) -> tuple[list[bytes], bytes]:
        """Whole messages, and what has begun."""

    def counts(self, message: bytes) -> bool:
        """Whether a message of the host commands or asks the drive anything."""

    def is_answered(self, message: bytes) -> bool:
        """Whether the drive answers to it."""

    def truncated(self, message: bytes) -> bytes:
        """The message without its last bytes."""

    def corrupted(self, message: bytes) -> bytes:
        """The message with an error that the wire itself does not hide."""


class ModbusTcp:
    """Length in bytes 4 and 5."""

    def split(self, stream: bytes, *, from_host: bool) -> tuple[list[bytes], bytes]:
        """Whole frames, and what has begun."""
        found = []
        while len(stream) >= 6 and len(stream) >= (end := 6 + int.from_bytes(stream[4:6])):
            found.append(stream[:end])
            stream = stream[end:]
        return found, stream

    def counts(self, message: bytes) -> bool:
        """Every request."""
        return True

    def is_answered(self, message: bytes) -> bool:
        """Every one is."""
        return True

    def truncated(self, message: bytes) -> bytes:
        """Two bytes are missing."""
        return message[:-2]

    def corrupted(self, message: bytes) -> bytes:
        """Another function code: TCP lets no bit errors through, a broken gateway does anything."""
        return message[:7] + bytes((message[7] ^ 0x20,)) + message[8:]


class ModbusRtu(ModbusTcp):
    """Length by function code (Modbus application protocol V1.1b3, chapter 6)."""

    def split(self, stream: bytes, *, from_host: bool) -> tuple[list[bytes], bytes]:
        """Whole frames, and what has begun."""
        found = []
        length = _rtu_request if from_host else _rtu_answer
        while stream and (end := length(stream)) is not None and len(stream) >= end:
            found.append(stream[:end])
            stream = stream[end:]
        return found, stream

    def corrupted(self, message: bytes) -> bytes:
        """A flipped bit, which the CRC shows."""
        return message[:2] + bytes((message[2] ^ 0x10,)) + message[3:]


def _rtu_request(stream: bytes) -> int | None:
    if len(stream) < 2:
        return None
    function = stream[1]
    if function == 43:
        return 7
    if function not in (16, 23):
        return 8
    at = 6 if function == 16 else 10  # of the byte count
    return at + 3 + stream[at] if len(stream) > at else None


def _rtu_answer(stream: bytes) -> int | None:
    if len(stream) < 3:
        return None
    function = stream[1]
    if function & 0x80:
        return 5
    if function in (3, 4, 23):
        return 5 + stream[2]
    if function != 43:
        return 8
    end = 8
    for _ in range(stream[7] if len(stream) > 7 else 0):
        if len(stream) < end + 2:
            return None
        end += 2 + stream[end + 1]
    return end + 2 if len(stream) > 8 else None


@dataclass
class _Can:
    """Frames of a CAN adapter: SDO and SYNC are answered, everything else of the host is not."""

    end: bytes

    def split(self, stream: bytes, *, from_host: bool) -> tuple[list[bytes], bytes]:
        """Whole messages, and what has begun."""
        *found, rest = stream.split(self.end)
        return [message + self.end for message in found], rest

    def counts(self, message: bytes) -> bool:
        """Every frame; not what is for the adapter."""
        return self.cob_id(message) is not None

    def is_answered(self, message: bytes) -> bool:
        """SDO by SDO, SYNC by the TPDO."""
        cob_id = self.cob_id(message)
        return cob_id is not None and (cob_id == _SYNC or cob_id & 0x780 == _SDO)

    def cob_id(self, message: bytes) -> int | None:
        """Of a frame that the host sends."""
        raise NotImplementedError


class Slcan(_Can):
    """Lines of the Lawicel protocol."""

    def __init__(self) -> None:
        super().__init__(b"\r")

    def cob_id(self, message: bytes) -> int | None:
        """tIIILDD…"""
        return int(message[1:4], 16) if message[:1] == b"t" else None

    def truncated(self, message: bytes) -> bytes:
        """Two digits are missing."""
        return message[:-3] + b"\r"

    def corrupted(self, message: bytes) -> bytes:
        """A digit that is none."""
        return message[:6] + b"Z" + message[7:]


class Socketcand(_Can):
    """< words > of the socketcand protocol."""

    def __init__(self) -> None:
        super().__init__(b">")

    def cob_id(self, message: bytes) -> int | None:
        """< send III L DD DD … >"""
        words = message.split()
        return int(words[2], 16) if words[1:2] == [b"send"] else None

    def truncated(self, message: bytes) -> bytes:
        """The end is missing."""
        return message[:-4]

    def corrupted(self, message: bytes) -> bytes:
        """A digit that is none."""
        at = message.rstrip(b"> ").rfind(b" ") + 1
        return message[:at] + b"Z" + message[at + 1 :]
