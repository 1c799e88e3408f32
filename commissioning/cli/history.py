"""tworelay history [AXIS], and history drift, note, rename, prune, reindex."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import at_desk, check_json
from commissioning.cli.helping import HelpfulGroup
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text, written
from commissioning.cli.quantity import PER_CENT
from commissioning.cli.terminal import Screen
from profiles.axis import load_axis
from profiles.errors import UnknownName, UsageError

if TYPE_CHECKING:
    from commissioning.journal import Journal
    from commissioning.result.found import Quantity
    from commissioning.result.history import Story
    from commissioning.session.listed import Listed

__all__ = ["command"]

_DAY = 86400.0  # s
_MANY = 50  # runs: from here on indexing takes a while


class _RunsOf(HelpfulGroup):
    """A group whose own act takes an AXIS.

    A word that is no command of it is the axis of a list.
    """

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.commands:
            return list_runs.name, list_runs, args
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args or (args[0].startswith("-") and args[0] != "--help"):
            args = ["list", *args]
        return super().parse_args(ctx, args)


@click.group("history", cls=_RunsOf)
def command() -> None:
    """The runs of this computer: 'tworelay history' lists them, newest last.

    'tworelay history AXIS' has the numbers of an axis over time, the drives and notes in between,
    and its drift; as a picture with --picture F, for a spreadsheet with --csv F. All options:
    'tworelay history list --help'.
    """


@command.command("list", short_help="The runs; of AXIS, its numbers and its drift.")
@click.argument("axis", required=False)
@click.option(
    "--most", type=click.IntRange(1), default=30, show_default=True, metavar="N",
    help="Only the last N runs.",
)  # fmt: skip
@click.option("--all", "everything", is_flag=True, help="All of them.")
@click.option(
    "--gate", type=PER_CENT, default="10", show_default=True, metavar="P",
    help="Percent: a smaller change of AXIS is no alarm.",
)  # fmt: skip
@click.option("--picture", metavar="F", help="AXIS over time, as .svg, .png or .pdf.")
@click.option("--csv", "csv_target", metavar="F", help="AXIS, a line a run, '-': standard output.")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def list_runs(
    axis: str | None,
    most: int,
    everything: bool,
    gate: float,
    picture: str | None,
    csv_target: str | None,
    as_json: bool,
) -> None:
    """The runs in the order in which they came; of AXIS, what they measured, and its drift.

    AXIS is a name as in its file; NAME@COMPUTER where another computer has one of that name.
    """
    from commissioning.history.catching_up import catch_up
    from commissioning.journal import Journal
    from drivers.home import home

    for target in (picture, csv_target):
        check_json(target, "--picture" if target is picture else "--csv")
    if as_json and csv_target == "-":
        raise UsageError("--json and --csv - both want standard output: give one a file")
    if axis is not None and axis.endswith(".toml") and Path(axis).is_file():
        axis = load_axis(Path(axis)).name
    if axis is None and (picture or csv_target):
        raise UsageError("--picture and --csv are of one axis: say which, 'tworelay history AXIS'")
    with Journal(home(), reading=True) as journal:
        lacking = journal.not_indexed() if axis is not None else []
    if len(lacking) > _MANY:
        screen = Screen("-" if as_json or csv_target == "-" else None, yes=True)
        with screen.counting("indexing older runs", len(lacking)) as told:
            catch_up(lacking, told)
    with Journal(home(), reading=True) as journal:
        if axis is None:
            _all_runs(journal, None if everything else most, as_json=as_json)
        else:
            shown = None if everything else most
            _one_axis(journal, axis, shown, gate, picture, csv_target, as_json=as_json)


def _all_runs(journal: Journal, most: int | None, *, as_json: bool) -> None:
    from commissioning.session.listed import runs

    found, before = runs(journal, most)
    if as_json:
        document(json_text([_tree(one) for one in found]))
        return
    screen = Screen(None, yes=True)
    if not found:
        screen.say("no runs")
        return
    if before:
        screen.say(f"{before} older runs are not shown: --all")
    rows = []
    for one in found:
        axis_text = f"{one.axis} (adopted)" if one.adopted else one.axis
        rows.append([one.run, axis_text, one.verdict, _quantity(one.coulomb), one.drive])
    columns = ["run", "axis", "verdict", "friction", "in the drive"]
    screen.table("runs, newest last", columns, rows)


def _one_axis(
    journal: Journal,
    axis: str,
    most: int | None,
    gate: float,
    picture: str | None,
    csv_target: str | None,
    *,
    as_json: bool,
) -> None:
    """Table, picture, lines and JSON of one axis."""
    from commissioning.history.story import story_of
    from commissioning.history.telling import csv_text, drift_words
    from commissioning.result.history import Story
    from commissioning.session.listed import listed

    try:
        story = story_of(journal, axis, gate=gate)
    except UnknownName as error:
        if picture or csv_target:
            raise
        if as_json:
            document(json_text(_story_tree(Story(axis, ()), [])))
            return
        there = f"; there are: {', '.join(error.known)}" if error.known else ""
        Screen(None, yes=True).say(f"no runs of axis '{axis}'{there}")
        return
    first = 0 if most is None else max(len(story.entries) - most, 0)
    rows = [listed(journal, one.run) for one in story.entries[first:]]
    if csv_target == "-":
        document(csv_text(story))
    elif csv_target is not None:
        written(csv_text(story).encode(), csv_target, Path(csv_target), "")
    if picture is not None:
        _draw(story, picture)
    if as_json:
        document(json_text(_story_tree(story, rows)))
    if as_json or csv_target == "-":
        return
    screen = Screen(None, yes=True)
    if first:
        screen.say(f"{first} older runs are not shown: --all")
    _table(screen, story, rows, first)
    if rows:
        screen.say(f"in the drive, of the last run: {rows[-1].drive}")
    for remark in story.remarks:
        screen.say(remark)
    for found in story.drifts:
        if found.quantity == "coulomb" or found.alarm:
            screen.say(drift_words(story.axis, found))
    for text in story.drifts[0].said if story.drifts else ():
        screen.say(f"  {text}")
    for what, target in (("picture", picture), ("lines", csv_target)):
        if target is not None:
            screen.say(f"{what}: {target}")


def _table(screen: Screen, story: Story, rows: list[Listed], first: int) -> None:
    """The runs with their numbers; a line where something happened, and beneath, what."""
    from commissioning.history.telling import LABELS, day, events
    from commissioning.result.history import CHARTED

    shown = story.entries[first:]
    units = {name: q.unit for one in story.entries for name, q in one.quantities.items()}
    warm = any(one.conditions.motor_temperature is not None for one in shown)
    methods = len({one.method for one in shown if one.method}) > 1
    columns = ["run", "verdict", *(["method"] if methods else []), *(["motor °C"] if warm else [])]
    columns += [f"{LABELS[name]} in {units[name]}" if name in units else "" for name in CHARTED]
    table = []
    for one, entry in zip(rows, shown, strict=True):
        row = [f"{one.run}{' (adopted)' if one.adopted else ''}", one.verdict]
        row += [entry.method or ""] if methods else []
        at = entry.conditions.motor_temperature
        row += ["" if at is None else f"{at:.4g}"] if warm else []
        table.append([*row, *(_quantity(entry.quantities.get(name), "") for name in CHARTED)])
    happened = [(n, at, text) for n, at, text in events(story) if n >= first]
    screen.table(
        f"axis {story.axis}, newest last", columns, table,
        ends={n - first - 1 for n, _, _ in happened},
    )  # fmt: skip
    for n, at, text in happened:
        place = "before the first run" if not n else f"after {story.entries[n - 1].run}"
        screen.say(f"{day(at)}, {place}: {text}")


def _quantity(found: Quantity | None, unit: str | None = None) -> str:
    """A number with its interval; `unit`: '' where the head of its column has it."""
    from commissioning.result.words import number

    if found is None:
        return ""
    share = f" ± {100 * found.half_width:.2g} %" if found.half_width < float("inf") else ""
    return f"{number(found.value, found.unit if unit is None else unit)}{share}"


def _draw(story: Story, target: str) -> None:
    from commissioning.history.telling import drift_words, events
    from commissioning.report.trends import picture

    kind = Path(target).suffix.lower()
    if kind not in (".svg", ".png", ".pdf"):
        raise UsageError(f"--picture {target}: must end with .svg, .png or .pdf")
    said = [one for one in story.drifts if one.alarm] or list(story.drifts[:1])
    words = "; ".join(drift_words(story.axis, one) for one in said)
    happened = [(at, text) for _, at, text in events(story)]
    written(picture(story, words, happened, kind[1:]), target, Path(target), "")


def _story_tree(story: Story, rows: list[Listed]) -> dict[str, object]:
    """A story for JSON: the runs that are shown, and what all of them say."""
    from commissioning.history.telling import drift_words
    from commissioning.result.codec import tree_of
    from commissioning.result.history import HISTORY_SCHEMA
    from commissioning.result.words import iso

    entries = {one.run: one for one in story.entries}
    runs = []
    for one in rows:
        entry = entries[one.run]
        runs.append(
            {
                **_tree(one), "serial": entry.serial, "host": entry.host, "method": entry.method,
                "tworelay": entry.version, "conditions": tree_of(entry.conditions),
                "quantities": {
                    name: {"value": q.value, "low": q.low, "high": q.high, "unit": q.unit}
                    for name, q in entry.quantities.items()
                },
            }
        )  # fmt: skip
    return {
        "schema": HISTORY_SCHEMA, "axis": story.axis, "runs": runs,
        "drives": tree_of(story.drives),
        "notes": [
            {"at": iso(note.at), "who": note.who, "host": note.host, "text": note.text}
            for note in story.notes
        ],
        "drift": [
            {
                **tree_of(one), "since": iso(one.since),
                "first_seen": iso(one.first_seen),
                "points": [{**tree_of(p), "began": iso(p.began)} for p in one.points],
                "words": drift_words(story.axis, one),
            }
            for one in story.drifts
        ],
        "remarks": list(story.remarks),
    }  # fmt: skip


def _tree(one: Listed) -> dict[str, object]:
    """A row for JSON."""
    from commissioning.result.words import iso

    f = one.coulomb
    return {
        "run": one.run, "axis": one.axis, "began": iso(one.began), "verdict": one.verdict,
        "coulomb": f and {"value": f.value, "low": f.low, "high": f.high, "unit": f.unit},
        "drive": one.drive, "adopted": one.adopted,
    }  # fmt: skip


@command.command("drift", short_help="Which axes get worse.")
@click.option(
    "--gate", type=PER_CENT, default="10", show_default=True, metavar="P",
    help="Percent: a smaller change is no alarm.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@verbose
def drift(gate: float, as_json: bool) -> None:
    """Which axes get worse: a line for each that has changed, and how many have not."""
    from commissioning.history.story import all_axes, names_now
    from commissioning.history.telling import drift_words
    from commissioning.journal import Journal
    from commissioning.result.words import iso
    from drivers.home import home

    screen = Screen("-" if as_json else None, yes=True)
    with Journal(home(), reading=True) as journal:
        count = len(names_now(journal))
        with screen.counting("charting", count) as told:
            stories = all_axes(journal, gate=gate, told=told)
    found = [(one, drift) for one in stories for drift in one.drifts]
    if as_json:
        document(
            json_text(
                [
                    {
                        "axis": one.axis, "quantity": d.quantity, "state": d.state,
                        "alarm": d.alarm,
                        "change": d.change, "change_error": d.change_error,
                        "since": iso(d.since),
                        "first_seen": iso(d.first_seen),
                        "words": drift_words(one.axis, d),
                    }
                    for one, d in found
                ]
            )
        )  # fmt: skip
        return
    if not stories:
        screen.say("no runs")
        return
    worse = [(one, d) for one, d in found if d.alarm]
    for one, d in worse:
        screen.say(drift_words(one.axis, d))
    alarmed = {one.axis for one, _ in worse}
    calm = {one.axis for one, d in found if d.state in ("in control", "changed")} - alarmed
    rest = len({one.axis for one in stories} - alarmed - calm)
    screen.say(
        f"axes with an alarm: {len(alarmed)}; without: {len(calm)}; with too few runs under like "
        f"conditions to tell: {rest}"
    )


@command.command("note")
@click.argument("axis")
@click.argument("text")
@click.option("--at", metavar="DATE", help="2026-03-03, when it was done; default: now.")
@click.option("--remove", is_flag=True, help="Take the note of this TEXT back.")
@verbose
def note(axis: str, text: str, at: str | None, remove: bool) -> None:
    """Note what was done to AXIS: 'regreased', 'new belt'. Its drift is counted from then on."""
    from commissioning.history.story import add_note, remove_note
    from commissioning.history.telling import day
    from commissioning.journal import Journal
    from drivers.home import home

    screen = Screen(None, yes=True)
    with Journal(home()) as journal:
        if remove:
            screen.say(f"taken back, of {remove_note(journal, axis, text)}: {text}")
            return
        made = add_note(journal, axis, text, None if at is None else _day("--at", at))
    screen.say(f"noted for {made.axis}, {day(made.at)}: {made.text}")


@command.command("rename", short_help="An axis has another name: its history goes on.")
@click.argument("old", required=False)
@click.argument("new", required=False)
@click.option("--join", is_flag=True, help="NEW has runs already: both become one, for good.")
@click.option("--undo", is_flag=True, help="Take the last renaming back.")
@verbose
def rename(old: str | None, new: str | None, join: bool, undo: bool) -> None:
    """The axis that was called OLD is called NEW now: its history goes on."""
    from commissioning.history.story import rename as renamed
    from commissioning.journal import Journal
    from drivers.home import home

    screen = Screen(None, yes=True)
    if undo and old is not None:
        raise UsageError("--undo takes the last renaming back: it takes no names")
    with Journal(home()) as journal:
        if undo:
            back = journal.take_back_rename()
            if back is None:
                raise UsageError("no axis was renamed here")
            screen.say(f"taken back: '{back.old}' is not called '{back.new}'")
            return
        if old is None or new is None:
            raise click.UsageError("give OLD and NEW, or --undo", click.get_current_context())
        renamed(journal, old, new, join=join)
    screen.say(f"'{old}' is called '{new}' from now on; 'tworelay history rename --undo' undoes it")


@command.command("reindex")
@verbose
def reindex() -> None:
    """Make the index of all runs anew, from their own files."""
    from commissioning.errors import JournalError
    from commissioning.history.catching_up import catch_up
    from commissioning.journal import Journal
    from drivers.home import home

    screen = Screen(None, yes=True)
    with Journal(home(), reading=True) as journal:
        runs, _ = journal.last_runs(None)
    with screen.counting("indexing", len(runs)) as told:
        read = catch_up(runs, told)
    if read is None:
        raise JournalError(f"the index in {home()} cannot be written")
    left = len(runs) - read
    gone = f"; {left} have no files that can be read, and stay as they were" if left else ""
    screen.say(f"{read} runs indexed{gone}")


@command.command("prune")
@click.option(
    "--before", required=True, metavar="DATE|AGE", help="2026-01-31, or an age in days: 90d."
)
@click.option("--dry-run", is_flag=True, help="Say what would be deleted; delete nothing.")
@click.option("--yes", is_flag=True, help="Confirm in advance.")
@verbose
def prune(before: str, dry_run: bool, yes: bool) -> None:
    """Delete the files of old runs: samples, results, reports.

    What was written to which drive stays in the journal; a run with anything to restore keeps its
    files.
    """
    from commissioning.session.prune import prune as delete

    instant = _instant(before)
    screen = Screen(None, yes=yes)
    with at_desk(screen) as desk:
        found = delete(instant, desk, dry_run=dry_run)
    verb = "would be deleted" if dry_run else "deleted"
    screen.say(f"files of {len(found.runs)} run(s) {verb}, {found.size / 1e6:.1f} MB")
    for run in found.kept:
        screen.say(
            f"  kept: {run}, which has something to restore, is in progress, or lies elsewhere"
        )


def _instant(text: str) -> float:
    """A date or an age as s since 1970; raises UsageError."""
    age = re.fullmatch(r"([0-9]{1,5})d", text)
    if age is not None:
        return time.time() - int(age[1]) * _DAY
    return _day("--before", text, ", or an age in days as 90d")


def _day(option: str, text: str, other: str = "") -> float:
    """A date as s since 1970; raises UsageError."""
    try:
        return max(time.mktime(time.strptime(text, "%Y-%m-%d")), 0.0)
    except (ValueError, OverflowError):
        raise UsageError(f"{option} {text}: must be a date as 2026-01-31{other}") from None
