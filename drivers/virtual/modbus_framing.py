"""How Modbus requests are cut out of what comes.

By MBAP on TCP, by length and check sum on a serial line.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

__all__ = ["Framing", "MbapFraming", "RtuFraming", "crc"]

_HEADER = 7  # bytes of MBAP
_LONGEST_PDU = 253
_LONGEST_FRAME = 256
_BROADCAST = 0
_OF_THE_DEVICE = 0, 255  # units that a device with an address of its own goes by
_NO_TARGET = 11  # exception code of a gateway: nobody there answers
_BY_FUNCTION = {
    1: 8,
    2: 8,
    3: 8,
    4: 8,
    5: 8,
    6: 8,
    7: 4,
    8: 8,
    11: 4,
    12: 4,
    17: 4,
    22: 10,
    24: 6,
    43: 7,
}
_COUNTED = {15: 6, 16: 6, 23: 10}  # functions whose byte at that place says how many follow

Answer = Callable[[bytes], bytes]  # request PDU in, response PDU out; empty: nothing is said


class Framing:
    """Bytes in, bytes out; one a connection.

    Attributes
    ----------
    is_closed : what comes cannot be cut any more, and the connection is to end
    is_incomplete : a part of a request waits for its rest
    """

    is_closed = False

    def __init__(self, answers: Mapping[int, Answer]) -> None:
        """`answers` : what answers, by its unit."""
        self._answers = answers
        self._buffer = b""

    @property
    def is_incomplete(self) -> bool:
        """Whether a part of a request waits for its rest."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[bytes]:
        """The answers to what is complete, one each."""
        raise NotImplementedError

    def silence(self) -> list[bytes]:
        """Nothing more has come for a while."""
        return []

    def due(self, answer: bytes) -> list[tuple[float, bytes]]:
        """When which part of an answer goes out, s from now."""
        return [(0.0, answer)]


class MbapFraming(Framing):
    """Modbus TCP: transaction, protocol, length, unit (Messaging on TCP/IP V1.0b, 3.1.3).

    A device of its own goes by the units 0 and 255, too, and answers as it was called. Several are
    behind a gateway, which says so where none of them is meant (4.4.2, Application Protocol 7).
    """

    def feed(self, data: bytes) -> list[bytes]:
        """The answers to what is complete, one each; another protocol's are passed over."""
        self._buffer += data
        answers: list[bytes] = []
        while len(self._buffer) >= _HEADER:
            transaction, protocol, length, unit = struct.unpack_from(">HHHB", self._buffer)
            if not 2 <= length <= _LONGEST_PDU + 1:
                self.is_closed = True  # nobody knows where the next one begins
                return answers
            if len(self._buffer) < 6 + length:
                break
            pdu, self._buffer = self._buffer[_HEADER : 6 + length], self._buffer[6 + length :]
            if protocol:
                continue
            response = self._answered(unit, pdu)
            if response:
                answers.append(
                    struct.pack(">HHHB", transaction, 0, len(response) + 1, unit) + response
                )
        return answers

    def _answered(self, unit: int, pdu: bytes) -> bytes:
        answer = self._answers.get(unit)
        if answer is None and len(self._answers) > 1:
            return bytes((pdu[0] | 0x80, _NO_TARGET))
        if answer is None and unit in _OF_THE_DEVICE:
            (answer,) = self._answers.values()
        return b"" if answer is None else answer(pdu)


class RtuFraming(Framing):
    """Modbus RTU: unit, PDU, check sum; a frame ends with its last byte, or with silence.

    What is broken is passed over up to the next silence (Serial Line V1.02, 2.5.1).
    """

    def __init__(self, answers: Mapping[int, Answer]) -> None:
        super().__init__(answers)
        self._is_broken = False

    def feed(self, data: bytes) -> list[bytes]:
        """The answers to what is complete, one each."""
        if self._is_broken:
            return []
        self._buffer += data
        answers: list[bytes] = []
        while (length := self._length()) and len(self._buffer) >= length:
            frame, self._buffer = self._buffer[:length], self._buffer[length:]
            if crc(frame):
                self._buffer, self._is_broken = b"", True
                return answers
            answers += self._take(frame)
        if len(self._buffer) > _LONGEST_FRAME:
            self._buffer, self._is_broken = b"", True
        return answers

    @property
    def is_incomplete(self) -> bool:
        """Whether a part of a request waits for its rest, or a silence."""
        return bool(self._buffer) or self._is_broken

    def silence(self) -> list[bytes]:
        """A frame of a function whose length nobody knows is complete; half a frame is none."""
        frame, self._buffer, self._is_broken = self._buffer, b"", False
        if len(frame) < 4 or self._length_of(frame) or crc(frame):
            return []
        return self._take(frame)

    def _take(self, frame: bytes) -> list[bytes]:
        unit, pdu = frame[0], frame[1:-2]
        if unit == _BROADCAST:
            for answer in self._answers.values():
                answer(pdu)
            return []
        response = self._answers[unit](pdu) if unit in self._answers else b""
        if not response:
            return []
        head = bytes((unit,)) + response
        return [head + crc(head).to_bytes(2, "little")]

    def _length(self) -> int:
        return self._length_of(self._buffer)

    @staticmethod
    def _length_of(frame: bytes) -> int:
        """Bytes of a request that begins so; 0: not known, or not yet."""
        if len(frame) < 2:
            return 0
        at = _COUNTED.get(frame[1])
        if at is not None:
            return at + 3 + frame[at] if len(frame) > at else 0
        return _BY_FUNCTION.get(frame[1], 0)


def crc(data: bytes) -> int:
    """Check sum of Modbus RTU (Serial Line V1.02, 6.2.2).

    0 over a frame with its own, low byte first.
    """
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return value
