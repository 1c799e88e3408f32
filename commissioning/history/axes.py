"""Which runs are of which axis: one may be renamed, and two computers have one of a name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from commissioning.result.history import IndexedRun, computer_of
from profiles.identity import NO_SERIAL

__all__ = ["SameAxis", "chosen", "groups", "in_order"]


@dataclass(frozen=True, slots=True)
class SameAxis:
    """Runs of one axis.

    `hosts`: other computers on which it was measured. `is_ours`: it was measured on this one.
    """

    entries: tuple[IndexedRun, ...]
    hosts: frozenset[str]
    is_ours: bool


def groups(entries: Sequence[IndexedRun], here: str) -> list[SameAxis]:
    """The axes of one name, by their computers; runs on one drive are of one axis.

    `here` : name of this computer
    """
    by_origin: dict[str, list[IndexedRun]] = {}
    for one in entries:
        by_origin.setdefault(computer_of(one, here) or "", []).append(one)
    found: list[tuple[set[str], list[IndexedRun]]] = []
    for origin, those in by_origin.items():
        origins, mine = {origin}, list(those)
        serials = _serials(mine)
        for other in [one for one in found if serials & _serials(one[1])]:
            found.remove(other)
            origins |= other[0]
            mine += other[1]
        found.append((origins, mine))
    made = [
        SameAxis(tuple(in_order(those)), frozenset(origins - {""}), "" in origins)
        for origins, those in found
    ]
    return sorted(made, key=lambda one: (one.is_ours, one.entries[-1].number), reverse=True)


def chosen(of_name: Sequence[SameAxis], host: str | None) -> SameAxis | None:
    """The axis that is meant: this computer's, or that of `host`."""
    if host is not None:
        return next((one for one in of_name if host in one.hosts), None)
    return of_name[0] if of_name else None


def in_order(entries: Iterable[IndexedRun]) -> list[IndexedRun]:
    """Runs as they came; those of another computer are put in by their dates."""
    ours = sorted((one for one in entries if not one.adopted), key=lambda one: one.number)
    theirs = sorted((one for one in entries if one.adopted), key=lambda one: one.began)
    found: list[IndexedRun] = []
    for one in ours:
        while theirs and theirs[0].began <= one.began:
            found.append(theirs.pop(0))
        found.append(one)
    return found + theirs


def _serials(entries: Iterable[IndexedRun]) -> set[str]:
    return {one.serial for one in entries} - set(NO_SERIAL)
