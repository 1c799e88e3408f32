"""What the journal keeps of a run, typed; and JSON files of runs, which are anybody's.

Rows and files have the types and ranges that tworelay writes, or are refused with the place that is
wrong.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError

from commissioning.result.codec import first_error
from commissioning.result.history import Note
from profiles.errors import UsageError
from profiles.files import contents

__all__ = [
    "END_OF_TIME",
    "RESTORED",
    "STORED",
    "STORING",
    "TAKEN_IN",
    "UP_TO",
    "Cell",
    "Event",
    "History",
    "Intent",
    "Kind",
    "RunContext",
    "RunRecord",
    "State",
    "context_text",
    "history_of",
    "history_tree",
    "image_of",
    "intent_of",
    "json_file",
    "run_of",
]

LARGEST = 20_000_000  # bytes
END_OF_TIME = 253_402_300_800.0  # s since 1970, the year 10000
_SCHEMA = "tworelay.journal/1"
_MOST_INTENTS = 10_000
_LARGEST_NUMBER = 1e300
STORING, STORED, RESTORED = "storing", "stored", "restored and stored"
UP_TO = (
    "stored up to write "  # and the journal's last one then, behind STORING, STORED and RESTORED
)
TAKEN_IN = (
    "adopted up to write "  # likewise: what a run has until here was done by another computer
)

Kind = Literal["experiment", "compensation", "gain"]
State = Literal["intended", "verified", "restored"]
Text = Annotated[str, Field(max_length=10_000)]
Raw = Annotated[int, Field(gt=-(1 << 63), lt=1 << 63)]
Instant = Annotated[float, Field(ge=0, lt=END_OF_TIME)]
_STRICT = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class RunContext:
    """What is needed to connect again, and whose run it is.

    Attributes
    ----------
    axis : as JSON
    fraction : of the friction that was to be compensated; None: not said
    pid, started : process that made the run, as `processes.is_alive` takes them
    """

    axis: str
    fraction: float | None = None
    pid: int | None = None
    started: float | None = None


@dataclass(frozen=True, slots=True)
class RunRecord:
    """One run.

    Attributes
    ----------
    created : s since 1970, for people: the order of runs is the journal's own
    adopted : it was measured on another computer, and taken in here
    """

    id: str
    created: float
    axis: str
    link: str
    profile: str
    profile_hash: str
    serial: str
    status: str
    context: RunContext
    adopted: bool = False


@dataclass(frozen=True, slots=True)
class Intent:
    """One parameter write: raw values before and after, and how far it got."""

    seq: int
    run: str
    kind: Kind
    parameter: str
    old: int
    new: int
    state: State

    @property
    def is_open(self) -> bool:
        """Whether `restore` would undo it."""
        return self.state != "restored"

    @property
    def lasts(self) -> bool:
        """Whether it is meant to stay after the run."""
        return self.kind != "experiment"


@dataclass(frozen=True, slots=True)
class Event:
    """What happened to a run, s since 1970."""

    at: float
    text: str


@dataclass(frozen=True, slots=True)
class Cell:
    """One parameter of a drive, by all that this computer wrote to it for good; raw values.

    Attributes
    ----------
    raw, certain : in its RAM; not certain: the last write was cut off
    memory : in its non-volatile memory; None: not known
    writer : run that wrote it last
    """

    raw: int
    certain: bool
    memory: int | None
    writer: str


@dataclass(frozen=True, slots=True)
class History:
    """Everything that a journal knows of a run, of its drive now, and of its axis."""

    run: RunRecord
    intents: tuple[Intent, ...]
    events: tuple[Event, ...]
    image: Mapping[str, Cell]
    notes: tuple[Note, ...] = ()
    named: str = ""  # what the axis is called now

    def before(self) -> dict[str, int]:
        """What each parameter that the run wrote for good had before, raw."""
        found: dict[str, int] = {}
        for intent in self.intents:
            if intent.lasts:
                found.setdefault(intent.parameter, intent.old)
        return found

    def has_stored(self, values: Mapping[str, int]) -> bool:
        """Whether the drive's memory has these raw values.

        What nobody here wrote is taken for stored.
        """
        return all(
            self.image[name].memory == raw for name, raw in values.items() if name in self.image
        )


def image_of(writes: Sequence[Intent], stores: Sequence[tuple[int, str]]) -> dict[str, Cell]:
    """What a drive has, by the writes to it in their order, and its stores.

    Up to which write, what kind.

    STORING without an end was cut off, and may have happened: the memory is known where it can have
    one value only.
    """
    base: dict[str, int] = {}
    for write in writes:
        base.setdefault(write.parameter, write.old)
    ram = _after(writes, None)
    maybe = [base]
    for up_to, kind in stores:
        at = base | {name: one.new for name, one in _after(writes, up_to).items()}
        maybe = [*maybe, at] if kind == STORING else [at]
    found = {}
    for name, one in ram.items():
        values = {stored[name] for stored in maybe}
        memory = values.pop() if len(values) == 1 else None
        found[name] = Cell(one.new, one.state != "intended", memory, one.run)
    return found


def _after(writes: Sequence[Intent], up_to: int | None) -> dict[str, Intent]:
    """The last write of each parameter, of those up to `up_to`.

    Versions that did not journal what a restore wrote left settled writes only: the value is the
    one before.
    """
    groups: dict[tuple[str, str], list[Intent]] = {}
    found: dict[str, Intent] = {}
    for write in writes:
        if up_to is None or write.seq <= up_to:
            groups.setdefault((write.run, write.parameter), []).append(write)
            found[write.parameter] = write
    for name, last in found.items():
        of_it = groups[last.run, name]
        if not any(one.is_open for one in of_it) and last.new != of_it[0].old:
            found[name] = replace(last, new=of_it[0].old)
    return found


# -- what rows and files must be ------------------------------------------------------------------


def _finite(tree: Any) -> Any:
    """A tree of our own making as it is: its numbers are finite, its texts whole.

    Raises ValueError.
    """
    if isinstance(tree, dict):
        _finite([*tree, *tree.values()])
    elif isinstance(tree, list):
        for item in tree:
            _finite(item)
    elif isinstance(tree, str):
        tree.encode()
    elif isinstance(tree, int | float) and not abs(tree) < _LARGEST_NUMBER:
        raise ValueError("finite numbers only")
    return tree


@dataclass(frozen=True, slots=True)
class _Context:
    axis: Annotated[dict[str, Any], AfterValidator(_finite)] = field(default_factory=dict)
    fraction: Annotated[float, Field(ge=0, le=1)] | None = None
    pid: Annotated[int, Field(ge=0, lt=1 << 31)] | None = None
    started: Annotated[float, Field(ge=-1e300, le=1e300)] | None = None


@dataclass(frozen=True, slots=True)
class _Run:
    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    id: Text
    created: Instant
    axis: Text
    link: Text
    profile: Text
    profile_hash: Text
    serial: Text
    status: Text
    context: _Context


@dataclass(frozen=True, slots=True)
class _Intent:
    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    kind: Kind
    parameter: Text
    old: Raw
    new: Raw
    state: State


@dataclass(frozen=True, slots=True)
class _Event:
    at: Instant
    text: Text


@dataclass(frozen=True, slots=True)
class _Note:
    at: Instant
    text: Text
    who: Text | None = None
    host: Text | None = None


@dataclass(frozen=True, slots=True)
class _Journal:
    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    schema: Literal["tworelay.journal/1"]
    run: _Run
    intents: Annotated[tuple[_Intent, ...], Field(max_length=_MOST_INTENTS)]
    events: tuple[_Event, ...] = ()
    notes: tuple[_Note, ...] = ()
    named: Text = ""


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _checked(kind: type, tree: Any, origin: str) -> Any:
    try:
        return _adapter(kind).validate_json(json.dumps(tree))
    except ValidationError as error:
        raise UsageError(f"{origin}: is damaged: {first_error(error)}") from None
    except (RecursionError, TypeError, ValueError) as error:
        raise UsageError(f"{origin}: is damaged ({type(error).__name__}: {error})") from None


def _run(found: _Run, *, adopted: bool) -> RunRecord:
    context = found.context
    return RunRecord(
        found.id, found.created, found.axis, found.link, found.profile, found.profile_hash,
        found.serial,
        found.status,
        RunContext(json.dumps(context.axis), context.fraction, context.pid, context.started),
        adopted,
    )  # fmt: skip


def run_of(row: dict[str, Any], *, adopted: bool) -> RunRecord:
    """A row of the journal's runs; raises UsageError, ValueError."""
    tree = {**row, "context": json.loads(row["context"])}
    return _run(_checked(_Run, tree, f"run {row['id']}"), adopted=adopted)


def intent_of(row: dict[str, Any]) -> Intent:
    """A row of the journal's intents; raises UsageError."""
    run, seq = str(row["run"]), int(row["seq"])
    found: _Intent = _checked(_Intent, {**row, "run": run}, f"run {run}")
    return Intent(seq, run, found.kind, found.parameter, found.old, found.new, found.state)


def context_text(context: RunContext) -> str:
    """A context as the journal keeps it."""
    tree = {**asdict(context), "axis": json.loads(context.axis)}
    return json.dumps({key: value for key, value in tree.items() if value is not None})


# -- the journal of an exported run ---------------------------------------------------------------


def history_of(tree: Any, origin: str) -> History:
    """The journal of an exported run; raises UsageError."""
    if not isinstance(tree, dict) or tree.get("schema") != _SCHEMA:
        raise UsageError(f"{origin}: is no exported run (its schema is none of ours)")
    try:
        found: _Journal = _checked(_Journal, tree, origin)
    except UsageError as error:
        raise UsageError(f"{error}; so it is no exported run that can be read") from None
    run = found.run.id
    intents = tuple(
        Intent(seq, run, i.kind, i.parameter, i.old, i.new, i.state)
        for seq, i in enumerate(found.intents)
    )
    events = tuple(Event(e.at, e.text) for e in found.events)
    told = [e.text for e in events if e.text in (STORING, STORED, RESTORED)]
    stores = [(len(intents), text) for text in told[-2:]]
    image = image_of([i for i in intents if i.lasts], stores)
    notes = tuple(Note(found.run.axis, n.at, n.text, n.who, n.host) for n in found.notes)
    run_record = _run(found.run, adopted=True)
    return History(run_record, intents, events, image, notes, found.named or run_record.axis)


def history_tree(history: History) -> dict[str, Any]:
    """A history as a tree for JSON."""
    run = {**asdict(history.run), "context": json.loads(context_text(history.run.context))}
    del run["adopted"]
    return {
        "schema": _SCHEMA,
        "run": run,
        "intents": [
            {name: getattr(i, name) for name in ("kind", "parameter", "old", "new", "state")}
            for i in history.intents
        ],
        "events": [asdict(event) for event in history.events],
        "notes": [
            {name: getattr(note, name) for name in ("at", "text", "who", "host")}
            for note in history.notes
        ],
        "named": history.named,
    }


# -- files ----------------------------------------------------------------------------------------


def json_file(path: Path) -> Any:
    """What a JSON file of ours holds; raises FileNotFoundError, UsageError."""
    try:
        return json.loads(contents(path, LARGEST, links=False), parse_constant=_no_constant)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is no JSON: {error}") from None


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")
