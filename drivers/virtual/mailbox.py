"""The mailbox of a virtual drive: what lies in its registers, and what executing a request does."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Protocol

from drivers.virtual.mirror import Entry
from drivers.virtual.states import Denied
from profiles.procedures import Mailbox

__all__ = ["VirtualMailbox"]

_FAILED = 3


class Objects(Protocol):
    """Who knows the values."""

    def value(self, entry: Entry) -> float:
        """Present value; raises Denied."""

    def set(self, entry: Entry, value: float) -> None:
        """New value; raises Denied."""


class VirtualMailbox:
    """Words by register; `entries` are the parameters by number and sub-index."""

    def __init__(
        self, box: Mailbox, entries: Mapping[tuple[int, int], Entry], objects: Objects
    ) -> None:
        self._box = box
        self._entries = entries
        self._objects = objects
        self._words: dict[int, int] = {}

    @property
    def registers(self) -> frozenset[int]:
        """Registers that the mailbox is made of."""
        box = self._box
        single = (box.pnu, box.sub, box.elements, box.request, box.length)
        return frozenset((*single, *range(box.data, box.data + 4)))

    def read(self, register: int) -> int:
        """Word of one register."""
        return self._words.get(register, 0)

    def write(self, register: int, word: int) -> None:
        """A word into one register; the request is executed at once."""
        self._words[register] = word
        box = self._box
        if register != box.request:
            return
        entry = self._entries.get((self.read(box.pnu), self.read(box.sub)))
        try:
            done = entry is not None and self._execute(entry, word)
        except (Denied, struct.error):
            done = False
        self._words[box.request] = box.done_code if done else _FAILED

    def _execute(self, entry: Entry, code: int) -> bool:
        box = self._box
        layout = struct.Struct("<" + entry.code)
        if code == box.read_code and entry.access != "wo":
            value = self._objects.value(entry)
            packed = layout.pack(value if entry.code == "f" else int(value))
            self._words[box.length] = layout.size
            for n, (word,) in enumerate(struct.iter_unpack("<H", packed + bytes(layout.size % 2))):
                self._words[box.data + n] = word
            return True
        if code != box.write_code or entry.access == "ro" or self.read(box.length) != layout.size:
            return False
        words = [self.read(box.data + n) for n in range(4)]
        self._objects.set(entry, layout.unpack_from(struct.pack("<4H", *words))[0])
        return True
