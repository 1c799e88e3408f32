"""SDO block upload, the server's side (CiA 301, 7.2.4.3.13 to 15).

Many bytes with few confirmations.
"""

from __future__ import annotations

from binascii import crc_hqx

__all__ = ["BlockUpload"]

_SEGMENT = 7  # bytes
_LAST = 0x80


class BlockUpload:
    """One transfer of `data`, in blocks of `size` segments of 7 bytes."""

    def __init__(self, data: bytes, size: int) -> None:
        self._data = data
        self._size = size
        self._at = 0  # bytes that were confirmed
        self._sent = 0  # segments of the block that is on its way
        self.ended = False

    def block(self) -> list[bytes]:
        """The next block of segments: sequence number, 7 bytes."""
        segments = []
        for number in range(1, self._size + 1):
            begin = self._at + (number - 1) * _SEGMENT
            last = begin + _SEGMENT >= len(self._data)
            part = self._data[begin : begin + _SEGMENT].ljust(_SEGMENT, b"\0")
            segments.append(bytes((number | (_LAST if last else 0),)) + part)
            if last:
                break
        self._sent = len(segments)
        return segments

    def confirmed(self, number: int, size: int) -> list[bytes]:
        """What comes after `number` segments have arrived; the end once all have."""
        self._at = min(len(self._data), self._at + min(number, self._sent) * _SEGMENT)
        self._size = size
        if self._at < len(self._data):
            return self.block()
        self.ended = True
        unused = -len(self._data) % _SEGMENT
        return [bytes((0xC1 | unused << 2,)) + crc_hqx(self._data, 0).to_bytes(2, "little")]
