"""What comes from a unit, cut into answers: other transactions, other units and echoes are left out."""

from __future__ import annotations

import struct

__all__ = ["Incoming", "LineIncoming", "MbapIncoming", "frame_at"]

_HEADER = 7  # bytes of MBAP
_LONGEST = 254  # unit and PDU
_SAME_AS_ANSWER = 5, 6, 22  # functions whose request is its own answer
_SHORTEST = 5  # bytes of a frame with an exception


class Incoming:
    """Bytes in, bytes out that the library's decoder is given.

    Attributes
    ----------
    heard : bytes since the last request
    oddity : what is not as it is to be, and was borne with; '' so far
    """

    oddity = ""

    def __init__(self) -> None:
        self.heard = b""

    def ask(self, frame: bytes) -> None:
        """A request is sent."""
        self.heard = b""

    def stranger(self) -> int | None:
        """A unit that answered, where another one was asked; None: none did."""
        raise NotImplementedError

    def take(self, data: bytes) -> bytes:
        """What of it the decoder is given; empty: nothing yet."""
        raise NotImplementedError


class MbapIncoming(Incoming):
    """Modbus TCP: whole answers to the transaction that was asked last (Messaging on TCP/IP V1.0b, 3.1.3).

    The unit is not looked at where it says 0 or 255, which is how a device answers that has none.
    """

    def __init__(self) -> None:
        super().__init__()
        self._buffer = b""
        self._transaction, self._unit = -1, 0
        self._stranger: int | None = None

    def ask(self, frame: bytes) -> None:
        """A request is sent."""
        super().ask(frame)
        self._stranger = None
        self._transaction, _, _, self._unit = struct.unpack_from(">HHHB", frame)

    def take(self, data: bytes) -> bytes:
        """The answer, once it is whole."""
        self.heard += data
        self._buffer += data
        found = b""
        while len(self._buffer) >= _HEADER:
            transaction, protocol, length, unit = struct.unpack_from(">HHHB", self._buffer)
            if protocol or not 2 <= length <= _LONGEST:
                self._buffer = b""  # no Modbus, and nobody knows where it begins again
                break
            if len(self._buffer) < 6 + length:
                break
            frame, self._buffer = self._buffer[: 6 + length], self._buffer[6 + length :]
            if transaction != self._transaction:
                continue  # late
            if unit in (self._unit, 0, 255):
                if unit != self._unit:
                    self.oddity = f"unit {unit} answers for unit {self._unit}"
                found += frame[:6] + bytes((self._unit,)) + frame[7:]
            else:
                self._stranger = unit
        return found

    def stranger(self) -> int | None:
        """A unit that answered the last request, and was not asked."""
        return self._stranger


class LineIncoming(Incoming):
    """Modbus RTU, on a serial line or over TCP.

    A two-wire adapter that hears itself gives back each request before the answer. Whether it does is seen
    at the first request that is not its own answer.
    """

    def __init__(self) -> None:
        super().__init__()
        self._echoes: bool | None = None  # not known yet
        self._echo = b""  # that is expected
        self._held = b""
        self._unit = 0

    def ask(self, frame: bytes) -> None:
        """A request is sent."""
        super().ask(frame)
        self._unit = frame[0]
        tells = self._echoes is None and frame[1] not in _SAME_AS_ANSWER
        self._echo = frame if self._echoes or tells else b""
        self._held = b""

    def take(self, data: bytes) -> bytes:
        """What comes after the echo."""
        self.heard += data
        if not self._echo:
            return data
        self._held += data
        if len(self._held) < len(self._echo) and self._echo.startswith(self._held):
            return b""
        held, self._held = self._held, b""
        echo, self._echo = self._echo, b""
        self._echoes = held.startswith(echo)
        if not self._echoes:
            return held
        self.oddity = "the adapter hears itself (its echo is left out)"
        return held[len(echo) :]

    def stranger(self) -> int | None:
        """A unit whose frame came after the last request, and was not asked."""
        return next((unit for unit in units_in(self.heard) if unit != self._unit), None)


def units_in(data: bytes) -> list[int]:
    """Units of the whole frames in what came, in their order; what is no frame is passed over."""
    found, at = [], 0
    while at + _SHORTEST <= len(data):
        length = frame_at(data[at:])
        if length:
            found.append(data[at])
        at += length or 1
    return found


def frame_at(data: bytes) -> int:
    """Bytes of the frame with which `data` begins; 0: with none.

    By its check sum, which is 0 over a frame with its own (Serial Line V1.02, 6.2.2).
    """
    value = 0xFFFF
    for n, byte in enumerate(data, 1):
        value = _step(value, byte)
        if value == 0 and n >= _SHORTEST:
            return n
    return 0


def _step(value: int, byte: int) -> int:
    value ^= byte
    for _ in range(8):
        value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return value
