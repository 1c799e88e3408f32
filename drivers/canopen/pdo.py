"""Process data objects of a node.

What they carry, and how they are set up (CiA 301, 7.5.2.35 to 38).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping

from profiles.address import WIDTH_BITS, CanopenAddress
from profiles.errors import ProfileError, UsageError

__all__ = [
    "HEARTBEAT_PRODUCER",
    "MAPPING",
    "OFF",
    "Objects",
    "Pdo",
    "agree",
    "code_of",
    "complete",
    "name_of",
    "objects_of",
    "size_of",
]

OFF = 1 << 31  # of a COB-ID: the PDO does not exist
MAPPING = 0x200  # from a PDO's communication parameters to its mapping
_OBJECT = re.compile(r"([0-9A-F]{4})h:([0-9A-F]{2})")
HEARTBEAT_PRODUCER = 0x1017, 0
_FLAGS = 3 << 29  # no RTR, 29-bit frame: the drive's own
_DUMMIES = range(1, 0x20)  # indices of data types: room that nobody uses
_BYTES = 8
_FIRST_SENT = 0x1800  # communication parameters from here on are of what the node sends
_SIGNED, _UNSIGNED = {1: "b", 2: "h", 4: "i", 8: "q"}, {1: "B", 2: "H", 4: "I", 8: "Q"}

Objects = dict[tuple[int, int], int]  # raw values by index and sub-index


def code_of(address: CanopenAddress, width: int | None = None) -> str:
    """Code for `struct` of an object, of so many bytes where they are not the profile's."""
    codes = _SIGNED if address.type.startswith("i") else _UNSIGNED
    return codes[width or WIDTH_BITS[address.type] // 8]


class Pdo:
    """A PDO and what it is to carry.

    Attributes
    ----------
    entries : what its mapping shall be, index, sub-index and bits each
    cob_id : once it is known
    pack : raw values of the cycle into its data
    unpack : the other way
    size : bytes
    """

    pack: Callable[[tuple[int, ...]], bytes]
    unpack: Callable[[bytes], tuple[int, ...]]

    def __init__(
        self, communication: int, transmission: int, default_id: int, mapped: list[CanopenAddress]
    ) -> None:
        self.communication = communication
        self.mapping = communication + MAPPING
        self.transmission = transmission
        self.default_id = default_id
        self.mapped = mapped
        self.cob_id = 0
        self.entries: list[int] = []
        self.size = 0
        self.lay_out({})

    def lay_out(self, widths: Mapping[CanopenAddress, int]) -> None:
        """What it carries, in the profile's order.

        `widths`: bytes of objects, where the drive has others.

        Raises ProfileError where that is too much.
        """
        codes = [code_of(at, widths.get(at)) for at in self.mapped]
        layout = struct.Struct("<" + "".join(codes))
        if layout.size > _BYTES:
            names = " ".join(
                f"{at.index:04X}h:{struct.calcsize(code)}"
                for at, code in zip(self.mapped, codes, strict=True)
            )
            raise ProfileError(
                f"[cycle] takes {layout.size} bytes as the drive has them ({names}), and a PDO has "
                f"{_BYTES}: leave one out in a profile of your own"
            )
        self.entries = [
            at.index << 16 | at.sub << 8 | 8 * struct.calcsize(code)
            for at, code in zip(self.mapped, codes, strict=True)
        ]
        self.size = layout.size
        self.pack = lambda values: layout.pack(*values)
        self.unpack = layout.unpack_from

    @property
    def is_ours(self) -> bool:
        """Whether it is one that we send, and the node receives (RPDO)."""
        return self.communication < _FIRST_SENT

    def missing_in(self, there: Objects) -> list[str]:
        """What the mapping that is there does not carry of what it is to."""
        carried = {slot >> 8 for slot in self._slots(there)}
        return [f"{at.index:04X}h" for at in self.mapped if at.index << 8 | at.sub not in carried]

    def foreign_in(self, there: Objects) -> list[tuple[int, int]]:
        """Index and sub-index of what it carries and is not to."""
        ours = {at.index << 8 | at.sub for at in self.mapped}
        slots = [slot >> 8 for slot in self._slots(there)]
        return [(at >> 8, at & 0xFF) for at in slots if at not in ours and at >> 8 not in _DUMMIES]

    def odd_in(self, there: Objects) -> int:
        """Bits of an entry that has no whole type; 0: all have."""
        widths = [slot & 0xFF for slot in self._slots(there)]
        return next((bits for bits in widths if bits not in (8, 16, 32, 64)), 0)

    def adopt(self, there: Objects, value: Callable[[int, int], int] | None) -> None:
        """Carry what the mapping that is there carries, in its order.

        `value` gives the raw value of an object that is not ours: it is sent as it is; None:
        nothing is sent.
        """
        places = {at.index << 8 | at.sub: n for n, at in enumerate(self.mapped)}
        codes, order = "<", list[int]()
        others: list[int] = []
        for slot in self._slots(there):
            multiplexer, width = slot >> 8, (slot & 0xFF) // 8
            n = places.get(multiplexer)
            if n is None:
                index, sub = multiplexer >> 8, multiplexer & 0xFF
                codes += _UNSIGNED[width]
                order.append(len(places) + len(others))
                told = 0 if value is None or index in _DUMMIES else value(index, sub)
                others.append(told & (1 << 8 * width) - 1)
            else:
                codes += code_of(self.mapped[n], width)
                order.append(n)
        layout, rest = struct.Struct(codes), tuple(others)
        back = [order.index(n) for n in range(len(places))]
        self.entries = self._slots(there)
        self.size = layout.size

        def pack(values: tuple[int, ...]) -> bytes:
            every = (*values, *rest)
            return layout.pack(*(every[n] for n in order))

        def unpack(data: bytes) -> tuple[int, ...]:
            every = layout.unpack_from(data)
            return tuple(every[n] for n in back)

        self.pack, self.unpack = pack, unpack

    def _slots(self, there: Objects) -> list[int]:
        return [there[self.mapping, n + 1] for n in range(there[self.mapping, 0])]

    def wanted(self, there: Objects) -> Objects:
        """Its parameters, with the COB-ID that the drive has for it, where it has one."""
        number = there[self.communication, 1]
        self.cob_id = number & 0x7FF or self.default_id
        return {
            (self.communication, 1): number & _FLAGS | self.cob_id,
            (self.communication, 2): self.transmission,
            (self.mapping, 0): len(self.entries),
            **{(self.mapping, n): entry for n, entry in enumerate(self.entries, 1)},
        }


def agree(there: Objects, wanted: Objects) -> bool:
    """Whether a drive has a PDO as it is wanted; flags that are not ours do not count."""
    return there.keys() == wanted.keys() and all(
        there[at] == raw or (at[1] == 1 and not at[0] & MAPPING and not (there[at] | raw) & OFF)
        for at, raw in wanted.items()
    )


def size_of(at: tuple[int, int]) -> int:
    """Bytes of an object (CiA 301, 7.5.2)."""
    index, sub = at
    if at == HEARTBEAT_PRODUCER:
        return 2
    if sub == 0 or (sub == 2 and not index & MAPPING):
        return 1  # number of entries, transmission type
    return 4


def complete(communication: int, objects: Objects) -> None:
    """Raise UsageError where the journal does not hold all of a PDO."""
    mapping = communication + MAPPING
    wanted = [(communication, 1), (communication, 2), (mapping, 0)]
    wanted += [(mapping, sub) for sub in range(1, objects.get((mapping, 0), 0) + 1)]
    for at in wanted:
        if at not in objects:
            raise UsageError(f"the journal holds only a part of a PDO: {name_of(at)} is missing")


def name_of(at: tuple[int, int]) -> str:
    """An object as people write it."""
    return f"{at[0]:04X}h:{at[1]:02X}"


def objects_of(old: Mapping[str, int], ours: set[int]) -> Objects:
    """Values by (index, sub) of objects that a journal names, which anybody may have written.

    `ours` : communication parameters of the PDOs that may be among them. Raises UsageError.
    """
    found: Objects = {}
    for name, raw in old.items():
        match = _OBJECT.fullmatch(name)
        at = (int(match[1], 16), int(match[2], 16)) if match is not None else (0, 0)
        if not (at == HEARTBEAT_PRODUCER or at[0] & ~MAPPING in ours):
            raise UsageError(f"'{name}' is no parameter of the profile, and none of its PDOs")
        if not 0 <= raw < 1 << 8 * size_of(at):
            raise UsageError(f"{name}: {raw} does not fit into {size_of(at)} bytes")
        found[at] = raw
    return found
