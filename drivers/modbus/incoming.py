"""What comes from a unit, cut into answers.

Other transactions, other units and echoes are left out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

__all__ = ["Incoming", "LineIncoming", "MbapIncoming", "answer_length", "frame_at", "units_in"]

_HEADER = 7  # bytes of MBAP
_LONGEST = 254  # unit and PDU
_SAME_AS_ANSWER = 5, 6, 22  # functions whose request is its own answer
_MOST_HELD = 600  # bytes: an echo and an answer, and some noise
_SHORTEST = 5  # bytes of a frame with an exception
_COUNTED = 1, 2, 3, 4, 23  # functions whose answer says at its third byte how many follow
_IDENTIFICATION = 43
_FIXED = {5: 8, 6: 8, 15: 8, 16: 8, 22: 10}


class Incoming:
    """Bytes in, bytes out that the library's decoder is given.

    Attributes
    ----------
    heard : bytes since the last request
    rest : bytes that came with the answer, after it
    oddity : what is not as it is to be, and was borne with; '' so far
    """

    oddity = ""

    def __init__(self) -> None:
        self.heard = self.rest = b""

    def ask(self, frame: bytes) -> None:
        """A request is sent."""
        self.heard = self.rest = b""

    def stranger(self) -> int | None:
        """A unit that answered, where another one was asked; None: none did."""
        raise NotImplementedError

    def late_in(self, data: bytes) -> tuple[bytes, int]:
        """What is left of bytes that came later, and how many answers were in them."""
        return data, 0

    def is_broken(self) -> bool:
        """Whether an answer has come in its whole length, and is not sound."""
        return False

    def is_echo_alone(self) -> bool:
        """Whether what came is what was sent, and nothing else."""
        return False

    def take(self, data: bytes) -> bytes:
        """What of it the decoder is given; empty: nothing yet."""
        raise NotImplementedError


class MbapIncoming(Incoming):
    """Modbus TCP: whole answers to the last transaction (Messaging on TCP/IP V1.0b, 3.1.3).

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
        self.heard = (self.heard + data)[-_MOST_HELD:]
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
    """Modbus RTU, on a serial line or over TCP: whole answers to what was asked.

    A two-wire adapter that hears itself gives back each request before the answer. It is known by
    the first request that comes back and cannot be an answer; from then on, what equals the request
    once is its echo. Noise, other units' frames and other functions' are passed over.
    """

    def __init__(self) -> None:
        super().__init__()
        self._echoes = False
        self._request = b""
        self._echo_is_due = False
        self._held = b""

    def ask(self, frame: bytes) -> None:
        """A request is sent."""
        super().ask(frame)
        self._request = frame
        self._echo_is_due = self._echoes or frame[1] not in _SAME_AS_ANSWER
        self._held = b""

    def take(self, data: bytes) -> bytes:
        """The answer, once it is whole."""
        self.heard = (self.heard + data)[-_MOST_HELD:]
        self._held = (self._held + data)[-_MOST_HELD:]
        if self._echo_is_due and (at := self._held.find(self._request)) >= 0:
            self._held = self._held[at + len(self._request) :]
            self._echo_is_due, self._echoes = False, True
            self.oddity = "the adapter hears itself (its echo is left out)"
        if self._echo_is_due and self._request[1] in _SAME_AS_ANSWER:
            return b""  # an echo cannot be told from the answer that follows it
        for at in self._candidates():
            if length := frame_at(self._held[at:]):
                answer, self.rest = self._held[at : at + length], self._held[at + length :]
                return answer
        return b""

    def _candidates(self) -> Iterator[int]:
        """Where an answer to the request may begin."""
        held, unit, function = self._held, self._request[0], self._request[1]
        at = held.find(unit)
        while 0 <= at < len(held) - 2:
            told = held[at + 1]
            fits = function not in _COUNTED or held[at + 2] == 2 * self._registers()
            if told == function | 0x80 or (told == function and fits):
                yield at
            at = held.find(unit, at + 1)

    def _registers(self) -> int:
        return int.from_bytes(self._request[4:6], "big")

    def is_broken(self) -> bool:
        """Whether an answer has come in its whole length, and is not sound."""
        return any(
            0 < answer_length(self._held[at:]) <= len(self._held) - at for at in self._candidates()
        )

    def is_echo_alone(self) -> bool:
        """Whether what came is what was sent, and nothing else."""
        return self._echoes and not self._held

    def late_in(self, data: bytes) -> tuple[bytes, int]:
        """What is left of late bytes, and how many of our unit's answers were in them."""
        if self._echo_is_due and self._echoes and (at := data.find(self._request)) >= 0:
            data, self._echo_is_due = data[at + len(self._request) :], False
        frames = _frames_in(data)
        left = sum(frames[-1]) if frames else 0
        ours = self._request[:1]  # nobody's, before the first request
        answers = sum(data[at : at + 1] == ours for at, _ in frames)
        return data[left:][-_MOST_HELD:], answers

    def stranger(self) -> int | None:
        """A unit whose frame came after the last request, and was not asked."""
        return next((unit for unit in units_in(self.heard) if unit != self._request[0]), None)


def units_in(data: bytes) -> list[int]:
    """Units of the whole answers in what came, in their order; what is none is passed over."""
    return [data[at] for at, _ in _frames_in(data)]


def _frames_in(data: bytes) -> list[tuple[int, int]]:
    """Where the whole answers in what came begin, and how many bytes each has."""
    found, at = [], 0
    while at + _SHORTEST <= len(data):
        length = frame_at(data[at:])
        if length:
            found.append((at, length))
        at += length or 1
    return found


def frame_at(data: bytes) -> int:
    """Bytes of the answer with which `data` begins; 0: with none that is whole and sound.

    Its check sum is 0 over a frame with its own (Serial Line V1.02, 6.2.2).
    """
    length = answer_length(data)
    if not _SHORTEST <= length <= len(data):
        return 0
    value = 0xFFFF
    for byte in data[:length]:
        value = value >> 8 ^ _TABLE[(value ^ byte) & 0xFF]
    return 0 if value else length


def answer_length(data: bytes) -> int:
    """Bytes of an answer that begins so (Application Protocol V1.1b3, 6).

    0: not known, or not yet.
    """
    if len(data) < _SHORTEST:
        return 0
    function = data[1]
    if function & 0x80:
        return _SHORTEST
    if function in _COUNTED:
        return _SHORTEST + data[2]
    if function != _IDENTIFICATION:
        return _FIXED.get(function, 0)
    at = 8  # unit, function, MEI type, code, conformity, more, next, number of objects
    for _ in range(data[7] if len(data) > 7 else 0):
        if at + 1 >= len(data):
            return 0
        at += 2 + data[at + 1]
    return at + 2


def _entry(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_TABLE = [_entry(byte) for byte in range(256)]
