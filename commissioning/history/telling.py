"""A history in words, and for a spreadsheet."""

from __future__ import annotations

import csv
import io
from dataclasses import astuple, fields
from datetime import datetime
from itertools import pairwise

from commissioning.history.drift import BASELINE, FIRST, is_behind
from commissioning.result.experiment import Conditions
from commissioning.result.history import INDEXED, Drift, IndexedRun, Note, Story
from commissioning.result.words import iso, percent
from profiles.plain import harmless_cell

__all__ = ["LABELS", "csv_text", "day", "drift_words", "events"]

LABELS = {"coulomb": "friction", "viscous": "viscous friction", "inertia": "inertia"}
_CONDITIONS = tuple(one.name for one in fields(Conditions))


def day(instant: float) -> str:
    """A date as people write it, in the zone of this computer."""
    at = datetime.fromtimestamp(instant).astimezone()
    return f"{at.day} {at:%B %Y}"


def drift_words(axis: str, found: Drift) -> str:
    """What a chart says, in the words of maintenance."""
    of = f"{LABELS.get(found.quantity, found.quantity)} of {axis}"
    since, count = _since(found), len(found.points)
    out = f"; left out: {', '.join(found.why_left_out)}" if found.why_left_out else ""
    if found.newer:
        out += f" ({found.newer} of them newer, the last that is compared of "
        out += f"{day(found.points[-1].began)})"
    if not count:
        return f"{of}: no run {since}"
    if found.state == "not enough runs":
        if count == 1:
            alone = "" if found.since_text == FIRST else f" {since}"
            return f"{of}: one run{alone}, nothing to compare it with{out}"
        return (
            f"{of}: no change that can be told, by {count} runs {since} (a chart needs more than "
            f"{BASELINE}){out}"
        )
    change = f"{percent(found.change or 0)} ± {found.change_error:.2g} %"
    warm = ""
    if found.explained is not None and abs(found.explained) >= 1:
        warm = f"; the temperature explains {percent(found.explained)}"
    if found.state == "changed":
        small = "" if found.alarm else ", which is no alarm"
        return (
            f"{of}: {change} {since}, seen on {day(found.first_seen or 0)}: the last that is "
            f"compared is outside both intervals{small}; {count} runs are too few for a chart"
            f"{out}{warm}"
        )
    if found.state == "in control":
        return (
            f"{of}: in control, {change} {since}, by {count} runs under like conditions{out}{warm}"
        )
    return f"{of}: {change} {since}, seen first on {day(found.first_seen or 0)}{out}{warm}"


def _since(found: Drift) -> str:
    """Since when, and what."""
    if found.since is None:
        return ""
    when = day(found.since)
    if found.since_text == FIRST:
        return f"since {when}"
    joint = "of" if found.since_text.startswith("the note") else "on"
    return f"since {found.since_text} {joint} {when}"


def events(story: Story) -> list[tuple[int, float, str]]:
    """What happened between the runs: before which of the story's runs, when, and what."""
    found: list[tuple[int, float, str]] = []
    entries = story.entries
    for number, (before, after) in enumerate(pairwise(entries), 1):
        if before.serial != after.serial:
            text = f"drive exchanged: {before.serial or 'none'} → {after.serial or 'none'}"
            found.append((number, after.began, text))
    for note in story.notes:
        who = f" ({note.who})" if note.who else ""
        found.append((_place(entries, note), note.at, f"note: {note.text}{who}"))
    return sorted(found, key=lambda one: one[0])


def _place(entries: tuple[IndexedRun, ...], note: Note) -> int:
    """Before which run a note stands."""
    for number, one in enumerate(entries):
        if is_behind(one, note):
            return number
    return len(entries)


def csv_text(story: Story) -> str:
    """A line a run, a note and an exchange of drives, in order; SI units, which the head has."""
    units = {n: q.unit for one in story.entries for n, q in one.quantities.items()}
    head = ["kind", "at", "axis", "run", "host", "serial", "tworelay", "method", "verdict"]
    for name in INDEXED:
        unit = f" [{units[name]}]" if name in units else ""
        head += [f"{name}{unit}", f"{name}_low{unit}", f"{name}_high{unit}"]
    head += [*_CONDITIONS, "text"]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    happened = events(story)
    for number, one in enumerate((*story.entries, None)):
        for _, at, text in (event for event in happened if event[0] == number):
            kind = "note" if text.startswith("note") else "drive"
            row = [kind, iso(at) or "", story.axis, *[""] * (len(head) - 4), text]
            writer.writerow([harmless_cell(cell) for cell in row])
        if one is not None:
            writer.writerow([harmless_cell(cell) for cell in _row(one)])
    return stream.getvalue()


def _row(one: IndexedRun) -> list[str]:
    row = [
        "run", iso(one.began) or "", one.axis, one.run, one.host or "", one.serial,
        one.version or "", one.method or "", one.verdict or "",
    ]  # fmt: skip
    for name in INDEXED:
        found = one.quantities.get(name)
        values = (found.value, found.low, found.high) if found else (None,) * 3
        row += ["" if value is None else f"{value:.9g}" for value in values]
    seen = ("" if value is None else f"{value:.9g}" for value in astuple(one.conditions))
    return [*row, *seen, ""]
