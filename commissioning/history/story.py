"""The history of an axis, put together."""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from dataclasses import replace

from commissioning.ending import operator
from commissioning.history.axes import NO_SERIAL, SameAxis, chosen, groups, names_of, of_names
from commissioning.history.catching_up import catch_up, said_by_run
from commissioning.history.drift import GATE, drift
from commissioning.journal import Journal
from commissioning.result.history import DriveFitted, IndexedRun, Note, Story
from profiles.axis import axis_name
from profiles.errors import UnknownName, UsageError

__all__ = ["CHARTED", "add_note", "all_axes", "rename", "story_of"]

CHARTED = "coulomb", "viscous", "inertia"
_LONGEST_NOTE = 1000  # characters


def story_of(journal: Journal, asked: str, *, gate: float = GATE) -> Story:
    """The history of the axis that is called so, or NAME@COMPUTER; raises UnknownName.

    `gate` : change below which there is no alarm, %
    """
    known, renamed = journal.axes(), journal.renamed()
    name, host = asked, None
    if asked not in known and asked not in renamed and "@" in asked:
        name, _, host = asked.rpartition("@")
    names = names_of(name, known, renamed)
    now = names[0]
    entries = of_names(_entries(journal, names), names, renamed)
    here = platform.node()
    of_name = groups(entries, here)
    group = chosen(of_name, host)
    if group is None:
        others = sorted(h for one in of_name for h in one.hosts)
        raise UnknownName("axis", asked, [f"{name}@{h}" for h in others] or list(known))
    notes = tuple(note for note in journal.notes(names) if _is_of(note, group, here))
    found = (drift(group.entries, notes, quantity, gate=gate) for quantity in CHARTED)
    drifts = tuple(one for one in found if one is not None)
    remarks = [f"'{name}' is called '{now}' now"] if now != name else []
    remarks += [f"it was called '{old}' before" for old in names[1:] if old in known]
    remarks += _others(of_name, group, now) + _same_drive(journal, group, names)
    return Story(now, group.entries, _drives(group.entries), notes, drifts, tuple(remarks))


def all_axes(journal: Journal, *, gate: float = GATE) -> list[Story]:
    """The history of each axis, by name."""
    known, renamed = journal.axes(), journal.renamed()
    names = dict.fromkeys(names_of(name, known, renamed)[0] for name in known)
    return [story_of(journal, name, gate=gate) for name in names]


def _entries(journal: Journal, names: Sequence[str]) -> list[IndexedRun]:
    """Runs of these names; what the index lacks is put in, or read from the runs."""
    entries, lacking = journal.entries(names)
    if not lacking:
        return entries
    if catch_up(lacking):
        with Journal(journal.folder, reading=True) as again:
            entries, lacking = again.entries(names)
    without = set(lacking)
    return [said_by_run(journal, one) if one.run in without else one for one in entries]


def _is_of(note: Note, group: SameAxis, here: str) -> bool:
    """Whether a note is on this axis, and not on another of its name."""
    made_here = note.host in (None, here)
    return (made_here and group.is_ours) or note.host in group.hosts


def _drives(entries: Sequence[IndexedRun]) -> tuple[DriveFitted, ...]:
    found: list[DriveFitted] = []
    for one in entries:
        if found and found[-1].serial == one.serial:
            found[-1] = replace(found[-1], until_run=one.run)
        else:
            found.append(DriveFitted(one.serial, one.run, one.run))
    return tuple(found)


def _others(of_name: Sequence[SameAxis], group: SameAxis, name: str) -> list[str]:
    remarks = []
    for other in of_name:
        if other is group:
            continue
        where = "this computer" if other.is_ours else ", ".join(sorted(other.hosts))
        asked = name if other.is_ours else f"{name}@{min(other.hosts)}"
        remarks.append(
            f"another axis of this name was measured on {where}: {len(other.entries)} run(s), "
            f"drive {other.entries[-1].serial or 'without a serial number'}: "
            f"'tworelay history {asked}'"
        )
    return remarks


def _same_drive(journal: Journal, group: SameAxis, names: Sequence[str]) -> list[str]:
    """Other names under which the drive of the last run was measured."""
    serial = group.entries[-1].serial
    if serial in NO_SERIAL:
        return []
    others = [one for one in journal.names_of_drives([serial]).get(serial, []) if one not in names]
    return [
        f"its drive {serial} was measured as axis '{other}', too: if that is this axis, 'tworelay "
        f'history rename "{other}" "{names[0]}"\' puts them together'
        for other in others[-1:]
    ]


# -- what people add ------------------------------------------------------------------------------


def add_note(journal: Journal, axis: str, text: str, at: float | None) -> Note:
    """Note what was done to an axis, now or at a time, s since 1970; raises UsageError."""
    text = " ".join(text.split())
    if not text or len(text) > _LONGEST_NOTE or not text.isprintable():
        raise UsageError(f"a note has 1 to {_LONGEST_NOTE} printable characters")
    known, renamed = journal.axes(), journal.renamed()
    names = names_of(axis, known, renamed)
    if not any(name in known for name in names):
        raise UnknownName("axis with runs", axis, list(known))
    number = journal.last_number() if at is None else None
    moment = time.time() if at is None else at
    note = Note(names[0], moment, text, operator(), platform.node() or None, number)
    journal.note_on(note)
    return note


def rename(journal: Journal, old: str, new: str) -> None:
    """The axis that was called `old` is called `new`; raises UsageError, UnknownName."""
    known, renamed = journal.axes(), journal.renamed()
    if old not in known:
        raise UnknownName("axis with runs", old, list(known))
    if names_of(old, known, renamed)[0] == new:
        raise UsageError(f"'{old}' is called '{new}' already")
    try:
        journal.rename(old, axis_name(new))
    except ValueError as error:
        raise UsageError(f"the new name '{new:.100}' {error}") from None
