"""What is known of an axis over the years: runs, drives, notes, and whether it gets worse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Literal

from commissioning.result.document import RunResult
from commissioning.result.experiment import Conditions
from commissioning.result.found import Quantity

__all__ = [
    "CHARTED",
    "HISTORY_SCHEMA",
    "INDEXED",
    "Compared",
    "ComparedParameter",
    "Comparison",
    "Drift",
    "DriveFitted",
    "IndexedRun",
    "Note",
    "Renamed",
    "Story",
    "ValueSeen",
    "computer_of",
    "conditions_of",
    "name_now",
    "names_before",
    "noted_name",
    "numbers_of",
    "own_name",
]

HISTORY_SCHEMA: Final = "tworelay.history/1"
CHARTED = "coulomb", "viscous", "inertia"
INDEXED = ("coulomb", "offset", "viscous", "inertia", "dead_time", "low_speed")


@dataclass(frozen=True, slots=True)
class IndexedRun:
    """A run, as the index of all runs has it.

    Attributes
    ----------
    number : its place in the order of the runs
    began : s since 1970, by the clock of the computer that measured it
    host : that computer; None: not known
    adopted : it was measured on another one
    version : of tworelay; None: before it was noted
    verdict : None where nothing was measured to its end
    quantities : by name, of INDEXED
    """

    run: str
    number: int
    began: float
    axis: str
    serial: str
    link: str
    adopted: bool
    host: str | None = None
    version: str | None = None
    method: str | None = None
    verdict: str | None = None
    quantities: dict[str, Quantity] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)

    @property
    def measured(self) -> bool:
        """Whether it gave numbers that can be trusted."""
        return self.verdict in ("good", "usable") and bool(self.quantities)


def numbers_of(result: RunResult) -> dict[str, Quantity]:
    """What a run measured, by name, as the index keeps it."""
    found = ((name, getattr(result.friction, name)) for name in INDEXED)
    return {name: replace(q, raw=None, raw_unit=None) for name, q in found if q is not None}


def conditions_of(result: RunResult) -> Conditions:
    """Under which conditions; of an older version, as far as it tells."""
    cycle = result.experiment.cycle if result.experiment else None
    return result.conditions or Conditions(cycle=cycle)


@dataclass(frozen=True, slots=True)
class Note:
    """What was done to an axis; the runs behind it are compared with each other only.

    Attributes
    ----------
    axis, of_host : its name, and the computer whose axis it is; None: this one's
    at : s since 1970
    who, host : by whom and where; None where the system did not tell
    number, renamed : place of the last run of this computer, and of the last renaming, when the
        note was made
    dated : its date tells its place among the runs, and not `number`
    """

    axis: str
    at: float
    text: str
    who: str | None = None
    host: str | None = None
    number: int = 0
    renamed: int = 0
    dated: bool = False
    of_host: str | None = None


@dataclass(frozen=True, slots=True)
class Renamed:
    """An axis of this computer got another name after the run of place `number`.

    `seq` : place among the renamings, from 1
    """

    old: str
    new: str
    number: int
    seq: int = 1


def computer_of(run: IndexedRun, here: str) -> str | None:
    """The computer whose axis a run is of; None: `here`, this one."""
    if not run.adopted or run.host == here:
        return None
    return run.host or "another computer"


def name_now(run: IndexedRun, renamed: Iterable[Renamed], here: str) -> str:
    """What the axis of a run is called now; those of other computers are renamed there."""
    if computer_of(run, here) is not None:
        return run.axis
    return own_name(run.axis, run.number, renamed)


def own_name(name: str, number: int, renamed: Iterable[Renamed]) -> str:
    """What the axis of a run of this computer is called now, by the run's own name and place."""
    for one in renamed:
        if one.old == name and number <= one.number:
            name = one.new
    return name


def noted_name(note: Note, renamed: Iterable[Renamed]) -> str:
    """What the axis of a note is called now."""
    name = note.axis
    for one in renamed if note.of_host is None else ():
        if one.old == name and one.seq > note.renamed:
            name = one.new
    return name


def names_before(name: str, renamed: Iterable[Renamed]) -> list[str]:
    """All names under which there may be runs of an axis, the present one first."""
    found = [name]
    for one in reversed(list(renamed)):
        if one.new in found and one.old not in found:
            found.append(one.old)
    return found


@dataclass(frozen=True, slots=True)
class DriveFitted:
    """From which run to which an axis had a drive, by its serial number."""

    serial: str
    since_run: str
    until_run: str


@dataclass(frozen=True, slots=True)
class ValueSeen:
    """A quantity of one run of a chart, and what the chart made of it.

    Attributes
    ----------
    temperature : of the motor, °C
    ewma : of the standardised deviation; None before there is a baseline
    """

    run: str
    began: float
    value: float
    low: float | None
    high: float | None
    temperature: float | None = None
    ewma: float | None = None


@dataclass(frozen=True, slots=True)
class Drift:
    """Whether a quantity has changed, among runs under like conditions.

    Attributes
    ----------
    state : 'in control' | 'drifting' | 'changed' (fewer runs than a chart needs: outside both
        intervals) | 'not enough runs'
    points : runs that are compared, in their order
    left_out, newer : runs behind the same event under other conditions, and those of them that came
        after the last one that is compared
    why_left_out : how many for which reason, in words
    alarm : it is drifting; or it has changed, by the gate at least, and no temperature explains it
    baseline : runs that made the centre
    centre : mean of the baseline, SI
    sigma : standard deviation of one run about it, SI
    limit : of |ewma|
    change, change_error : of the level now against the centre, and half of its 95 % interval, %
    explained : what the motor's temperature explains of the change, %
    since, since_text : what began the baseline: s since 1970, and in words
    first_seen, first_run : of the alarm
    said : what cannot be told apart for want of knowledge
    """

    quantity: str
    unit: str
    state: Literal["in control", "drifting", "changed", "not enough runs"]
    points: tuple[ValueSeen, ...] = ()
    left_out: int = 0
    newer: int = 0
    why_left_out: tuple[str, ...] = ()
    alarm: bool = False
    baseline: int = 0
    centre: float | None = None
    sigma: float | None = None
    limit: float | None = None
    change: float | None = None
    change_error: float | None = None
    explained: float | None = None
    since: float | None = None
    since_text: str = ""
    first_seen: float | None = None
    first_run: str | None = None
    said: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Story:
    """The history of one axis.

    Attributes
    ----------
    entries : its runs in their order, those of other computers put in by their dates
    remarks : what else is to be told: other names, other axes of its name
    """

    axis: str
    entries: tuple[IndexedRun, ...]
    drives: tuple[DriveFitted, ...] = ()
    notes: tuple[Note, ...] = ()
    drifts: tuple[Drift, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Compared:
    """A quantity of two runs.

    Attributes
    ----------
    first, second : None where that run did not measure it
    change : of the second against the first, %; None where either is missing, or the first may be
        0
    excluded : whether the intervals exclude each other; None where one of them is not known
    """

    quantity: str
    unit: str
    first: Quantity | None
    second: Quantity | None
    change: float | None
    excluded: bool | None


@dataclass(frozen=True, slots=True)
class ComparedParameter:
    """A parameter of the drive in two runs, as the drive counts.

    Attributes
    ----------
    first_old, second_old : what the drive had before the run; None: the run did not look
    first, second : what the run proposed, or left there; None: nothing
    first_state, second_state : what became of that
    """

    parameter: str
    raw_unit: str
    first_old: int | None
    first: int | None
    first_state: str
    second_old: int | None
    second: int | None
    second_state: str

    @property
    def differs(self) -> bool:
        """Whether both runs have a value, and not the same."""
        return None not in (self.first, self.second) and self.first != self.second


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs side by side.

    Attributes
    ----------
    remarks : what else is not the same: axis, drive, method, temperature, version
    """

    first: str
    second: str
    quantities: tuple[Compared, ...]
    parameters: tuple[ComparedParameter, ...]
    remarks: tuple[str, ...] = ()
