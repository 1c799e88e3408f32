"""Who hears all that is said to a twin, by the names of its profile, and can answer for it.

It stands between what comes off the bus and the values of the drive, so it knows what the drive
understood, and not what its master meant.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from drivers.virtual.aborts import DENIALS, Abort
from drivers.virtual.device import Device
from drivers.virtual.dictionary import Dictionary
from drivers.virtual.habits import Habits
from drivers.virtual.habitual_node import HabitualNode
from drivers.virtual.mirror import Entry, Mirror
from drivers.virtual.states import DenialReason, Denied

__all__ = ["Utterance", "Witness", "WitnessedNode"]


_OF_THE_DRIVE = 0x2000  # from here on; before, of its communication (CiA 301, 7.4.1)


class Utterance(NamedTuple):
    """One access, as the drive understood it.

    Attributes
    ----------
    name : of the parameter; '1400h:01' for objects of the bus that the profile does not name
    raw : number that was written, or that was answered
    time : of the drive's clock, s
    """

    act: Literal["read", "write"]
    name: str
    raw: float
    time: float


@dataclass
class Witness:
    """What was said, in its order.

    Attributes
    ----------
    forced : what the drive says of itself whatever is so, by name
    deaf : writes that it does not hear, name and raw value
    busy : what it has no time for, by name
    functions : Modbus functions that were asked for
    """

    said: list[Utterance] = field(default_factory=list)
    forced: dict[str, int] = field(default_factory=dict)
    deaf: set[tuple[str, int]] = field(default_factory=set)
    busy: set[str] = field(default_factory=set)
    functions: set[int] = field(default_factory=set)
    now: Callable[[], float] = lambda: 0.0

    def note(self, act: Literal["read", "write"], name: str, raw: float) -> None:
        """One more."""
        self.said.append(Utterance(act, name, raw, self.now()))

    def around(self, mirror: Mirror) -> Mirror:
        """The values of a drive, listened to."""
        return _Listened(mirror, self)


class _Listened(Mirror):
    """A mirror and its witness."""

    def __init__(self, mirror: Mirror, witness: Witness) -> None:
        self._mirror = mirror
        self._witness = witness

    def value(self, entry: Entry) -> float:
        """Object value; raises Denied."""
        if entry.name in self._witness.busy:
            raise Denied(DenialReason.STATE)
        forced = self._witness.forced
        value = forced[entry.name] if entry.name in forced else self._mirror.value(entry)
        self._witness.note("read", entry.name, value)
        return value

    def set(self, entry: Entry, value: float) -> None:
        """Write an object value; raises Denied."""
        self._witness.note("write", entry.name, value)
        if entry.name in self._witness.busy:
            raise Denied(DenialReason.STATE)
        if (entry.name, value) not in self._witness.deaf:
            self._mirror.set(entry, value)


class WitnessedNode(HabitualNode):
    """A node whose communication objects are listened to as well.

    `names` : of those that its profile has, by index and sub-index
    """

    def __init__(
        self,
        device: Device,
        node_id: int,
        dictionary: Dictionary,
        habits: Habits,
        witness: Witness,
        names: Mapping[tuple[int, int], str],
    ) -> None:
        self._witness = witness
        self._names = names
        super().__init__(device, node_id, dictionary, habits, witness.around)

    def _write(self, index: int, sub: int, data: bytes, *, sized: bool) -> None:
        if index < _OF_THE_DRIVE or (index, sub) not in self._dictionary.objects:
            self._note("write", index, sub, data)
            if self._names.get((index, sub)) in self._witness.busy:
                raise Abort(DENIALS[DenialReason.STATE])
        super()._write(index, sub, data, sized=sized)

    def _read(self, index: int, sub: int) -> bytes:
        data = super()._read(index, sub)
        if index < _OF_THE_DRIVE or (index, sub) not in self._dictionary.objects:
            self._note("read", index, sub, data)
        return data

    def _note(self, act: Literal["read", "write"], index: int, sub: int, data: bytes) -> None:
        if len(data) in (1, 2, 4):
            name = self._names.get((index, sub), f"{index:04X}h:{sub:02X}")
            raw = struct.unpack({1: "<B", 2: "<H", 4: "<I"}[len(data)], data)[0]
            self._witness.note(act, name, raw)
