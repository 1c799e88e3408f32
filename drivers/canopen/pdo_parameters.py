"""PDO parameters in a node.

Read, written by the rules (CiA 301, 7.5.2.35 to 38), put back as they were.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection

from drivers.canopen.pdo import MAPPING, OFF, Objects, Pdo, agree, name_of, size_of
from drivers.canopen.wire import CanWire
from drivers.errors import AccessDenied, PreflightRefused, WriteDenied, WriteFailed
from drivers.patience import patiently

__all__ = ["PRE_OPERATIONAL", "PdoParameters"]

PRE_OPERATIONAL = 0x80  # NMT command: some nodes take PDO parameters there only


class PdoParameters:
    """The PDO parameters of one node; one that is busy is asked again for `patience` s.

    `written` : index and sub-index of what a job sets by SDO, and no PDO may carry beside
    """

    def __init__(
        self, wire: CanWire, patience: float, written: Collection[tuple[int, int]]
    ) -> None:
        self._wire = wire
        self._patience = patience
        self._written = written

    def map(self, pdo: Pdo, wanted: Objects) -> None:
        """Have a PDO as it is wanted; raises WriteDenied."""
        self._configure(pdo.communication, wanted)
        self._check_mapping(pdo)

    def keep_its_mapping(self, pdo: Pdo, there: Objects, denied: WriteDenied) -> None:
        """Make do with the mapping that the drive has.

        Raises PreflightRefused, saying what it lacks.
        """
        communication = pdo.communication
        for objects in ({**there, (communication, 2): pdo.transmission}, there):
            with contextlib.suppress(AccessDenied):
                self._configure(communication, objects)
                break
        kept = self.there(communication)
        if kept[communication, 2] != pdo.transmission:  # it may take that, and not its COB-ID
            with contextlib.suppress(AccessDenied):
                self.download((communication, 2), pdo.transmission)
                kept = self.there(communication)
        wrong = []
        if missing := pdo.missing_in(kept):
            wrong.append(f"it lacks {' '.join(missing)}")
        foreign = [at for at in pdo.foreign_in(kept) if at in self._written]
        if foreign and pdo.is_ours:
            names = " ".join(name_of(at) for at in foreign)
            wrong.append(f"it carries {names}, which the job sets by itself")
        if odd := pdo.odd_in(kept):
            wrong.append(f"it has an entry of {odd} bits, which is none of 8, 16, 32 or 64")
        if kept[communication, 1] & OFF:
            wrong.append("it is switched off")
        if kept[communication, 2] != pdo.transmission and not pdo.is_ours:
            wrong.append(f"its transmission type is {kept[communication, 2]}, and not 1")
        if wrong:
            raise PreflightRefused(
                f"PDO {communication:04X}h, {pdo.mapping:04X}h cannot be set up ({denied}), and as "
                f"it is {' and '.join(wrong)}: map it with the drive's own software, or write a "
                "profile whose [cycle] says rpdo, tpdo, out and in as the drive has them",
                code="pdo.refused",
            ) from None
        pdo.adopt(kept, self._uploaded if pdo.is_ours else None)

    def put_back(self, communication: int, objects: Objects) -> bool:
        """Write back what was there. False: it was as before. Raises AccessDenied, WriteFailed."""
        mapping = communication + MAPPING
        unused = {
            at: raw
            for at, raw in objects.items()
            if at[0] == mapping and at[1] > objects[mapping, 0]
        }
        used = {at: raw for at, raw in objects.items() if at not in unused}
        there = self.there(communication)
        lies = {at: raw for at, raw in unused.items() if self.number(*at) != raw}
        if there == used and not lies:
            return False
        self._wire.nmt(PRE_OPERATIONAL)
        self._configure(communication, used, lies)
        there = self.there(communication)
        if not agree(there, used):
            wrong = [name_of(at) for at, raw in used.items() if there.get(at) != raw]
            raise WriteFailed(f"the drive did not take {', '.join(wrong)} back", code="write.bus")
        return True

    def there(self, communication: int) -> Objects:
        """Parameters of a PDO as the drive has them; entries only as far as they count."""
        mapping = communication + MAPPING
        there = {(communication, sub): self.number(communication, sub) for sub in (1, 2)}
        count = there[mapping, 0] = self.number(mapping, 0)
        for sub in range(1, count + 1):
            there[mapping, sub] = self.number(mapping, sub)
        return there

    def beyond(self, pdo: Pdo, there: Objects) -> Objects:
        """Entries of a mapping that do not count, where ours will lie and they can be read."""
        mapping, found = pdo.communication + MAPPING, Objects()
        for sub in range(there[mapping, 0] + 1, len(pdo.entries) + 1):
            with contextlib.suppress(AccessDenied):
                found[mapping, sub] = self.number(mapping, sub)
        return found

    def number(self, index: int, sub: int) -> int:
        """A communication object; raises AccessDenied, LinkError."""
        return int.from_bytes(self._upload(index, sub)[: size_of((index, sub))], "little")

    def _upload(self, index: int, sub: int) -> bytes:
        wire = self._wire
        return patiently(lambda: wire.upload(index, sub), self._patience, wire.let_pass)

    def download(self, at: tuple[int, int], raw: int) -> None:
        """Write one; raises WriteDenied, LinkError."""
        data = raw.to_bytes(size_of(at), "little")
        wire = self._wire
        patiently(lambda: wire.download(*at, data), self._patience, wire.let_pass)

    def _uploaded(self, index: int, sub: int) -> int:
        return int.from_bytes(self._upload(index, sub), "little")

    def _configure(
        self,
        communication: int,
        objects: Objects,
        unused: Objects | None = None,
    ) -> None:
        """Write the parameters of one PDO in the order of CiA 301, 7.5.2.36: off, entries, on.

        Entries that lie there as they shall are not written: some drives refuse that. Of `unused`
        ones, which do not count, what the drive does not take stays: it has no effect.
        """
        mapping = communication + MAPPING
        number = objects[communication, 1]

        def entries(of: Objects) -> Objects:
            return {at: raw for at, raw in of.items() if at[0] == mapping and at[1]}

        count, wanted = objects[mapping, 0], entries(objects)
        is_so = self.number(mapping, 0) == count and all(
            self._lies(at) == raw for at, raw in wanted.items()
        )
        if is_so and not unused and self.number(communication, 1) == number:
            with contextlib.suppress(AccessDenied):  # some take it only while the PDO is off
                self.download((communication, 2), objects[communication, 2])
                return
        self.download((communication, 1), number | OFF)
        self.download((communication, 2), objects[communication, 2])
        if unused or not is_so:
            self.download((mapping, 0), 0)
            for at, raw in wanted.items():
                if self._lies(at) != raw:
                    self.download(at, raw)
            for at, raw in (unused or {}).items():
                with contextlib.suppress(AccessDenied):
                    self.download(at, raw)
            self.download((mapping, 0), count)
        self.download((communication, 1), number)

    def _check_mapping(self, pdo: Pdo) -> None:
        mapping = pdo.communication + MAPPING
        found = [self.number(mapping, sub + 1) for sub in range(len(pdo.entries))]
        if found != pdo.entries:
            raise WriteDenied(
                f"the drive did not take the mapping of {mapping:04X}h: it reads "
                + ", ".join(f"{entry:08X}h" for entry in found)
            )

    def _lies(self, at: tuple[int, int]) -> int | None:
        """An entry of a mapping, also one that does not count; None where it cannot be read."""
        try:
            return self.number(*at)
        except AccessDenied:
            return None
