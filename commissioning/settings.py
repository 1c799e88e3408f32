"""Parameters of the drive that are written: journalled before, read back after, put back."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

from commissioning.errors import JournalError
from commissioning.journal import Intent, Journal, Kind
from drivers.drive import Drive
from drivers.errors import LinkError, WriteDenied, WriteFailed
from drivers.writing import why_not_written
from profiles.commands import SET, commands_of
from profiles.errors import TwoRelayError
from profiles.parameter import Protection

__all__ = ["Restored", "Return", "Settings", "planned", "put_back", "settle"]

_NO_MODE = 0


@dataclass
class Restored:
    """What a restore reached: parameter names, and why one failed or was left alone."""

    restored: list[str] = field(default_factory=list)
    already: list[str] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    left: dict[str, str] = field(default_factory=dict)  # as it is, and that does no harm

    @property
    def complete(self) -> bool:
        """Whether every parameter has its old value."""
        return not self.failed and not self.skipped

    def __str__(self) -> str:
        parts = []
        if self.restored:
            parts.append("restored " + _listed(self.restored))
        if self.already:
            parts.append("at their old values already " + _listed(self.already))
        every = ("skipped", self.skipped), ("failed", self.failed), ("left", self.left)
        for what, found in every:
            for why in dict.fromkeys(found.values()):
                names = [name for name in found if found[name] == why]
                parts.append(f"{what} {_listed(names)} ({why})")
        return "; ".join(parts) if parts else "nothing to restore"


class Settings:
    """Writes to one drive in one run."""

    def __init__(self, journal: Journal, run: str, drive: Drive) -> None:
        self._journal = journal
        self.run = run
        self._drive = drive

    def write(self, kind: Kind, parameter: str, new: int) -> bool:
        """Write a raw value: intent, write, read back, done. False: it had that value already."""
        old = self._drive.read(parameter).raw
        if old == new:
            return False
        refused = why_not_written(
            self._drive.parameters[parameter],
            new,
            old=old,
            kind=Protection(kind),
            is_command=parameter in SET,
        )
        if refused is not None:
            raise WriteFailed(
                refused.text, code=refused.code, hint=refused.hint, parameter=parameter
            )
        intent = self._journal.intend(self.run, kind, parameter, old, new)
        self._drive.write(parameter, new)
        self._journal.settle([intent], "verified")
        return True

    def oldest(self, parameter: str) -> int:
        """What the drive had before this run, raw."""
        intents = self._journal.intents(self.run, open_only=True)
        return next(
            (i.old for i in intents if i.parameter == parameter), self._drive.read(parameter).raw
        )

    def remember(self, parameter: str) -> None:
        """Journal a set-point as it is, to be put back after motion."""
        if parameter in SET:
            there = self._drive.read(parameter).raw
            intent = self._journal.intend(self.run, "experiment", parameter, there, there)
            self._journal.settle([intent], "verified")

    def remember_power(self) -> None:
        """Journal the registers that enabling, stopping and disabling will write, as they are."""
        for name, raws in self._drive.preparation.power().items():
            there = self._drive.read(name).raw
            for raw in raws:
                if raw != there:
                    intent = self._journal.intend(self.run, "experiment", name, there, raw)
                    self._journal.settle([intent], "verified")

    def remember_bus(self) -> None:
        """Journal what the cycle will change of the bus' own objects in the drive."""
        for name, (old, new) in self._drive.preparation.bus().items():
            self._journal.intend(self.run, "experiment", name, old, new)

    @contextmanager
    def exclusive_access(self) -> Generator[None]:
        """Other masters locked out of the drive, where it can; raises WriteFailed."""
        error: BaseException | None = None
        lock = self._drive.preparation.exclusive_access()
        try:
            for name, raw in lock.items():
                self.write("experiment", name, raw)
            yield
        except BaseException as failure:
            error = failure
            raise
        finally:
            outcome = self.restore() if lock else Restored()
            if not outcome.complete:
                text = f"other masters are still locked out of the drive: {outcome}"
                if error is None:
                    raise WriteFailed(text, code="restore.incomplete")
                if isinstance(error, TwoRelayError):
                    error.also(text)

    def restore(self) -> Restored:
        """Put back everything that was set for the experiment; never raises on the way."""
        intents = [
            i for i in self._journal.intents(self.run, open_only=True) if i.kind == "experiment"
        ]
        outcome = put_back(self._drive, intents, force=True)
        settle(self._journal, intents, outcome)
        return outcome


def settle(journal: Journal, intents: list[Intent], outcome: Restored) -> None:
    """Mark as restored what is; a journal that fails here is reported with the rest."""
    done = {*outcome.restored, *outcome.already, *outcome.left}
    settled = [intent for intent in intents if intent.parameter in done]
    try:
        journal.settle([intent.seq for intent in settled], "restored")
    except JournalError as error:
        for intent in settled:
            outcome.failed[intent.parameter] = f"it has its old value, but {error}"


def put_back(drive: Drive, intents: list[Intent], *, force: bool = False) -> Restored:
    """Undo `intents`, each parameter to its oldest value, as `_Back` does. The caller settles them.

    A value that is neither the old nor ours is somebody else's work: skipped, unless `force`.
    """
    outcome = Restored()
    back = _Back(drive, intents, force=force)
    dead: str | None = None
    for name in back.order:
        if dead is not None:
            outcome.failed[name] = dead
            continue
        try:
            back.put(name, outcome)
        except TwoRelayError as error:
            outcome.failed[name] = str(error)
            if isinstance(error, LinkError):
                dead = "the link is gone"
    _put_back_bus(drive, back.of_the_bus, outcome, dead)
    return outcome


class Return(NamedTuple):
    """One parameter on its way back: raw values, None: cannot be read.

    `why_not`: it is left as it is.
    """

    parameter: str
    there: int | None
    old: int
    why_not: str


def planned(drive: Drive, intents: list[Intent], *, force: bool = False) -> list[Return]:
    """What `put_back` would do; raises LinkError. The bus' own objects are not in it."""
    back = _Back(drive, intents, force=force)
    found = []
    for name in back.order:
        try:
            found.append(back.way(name))
        except LinkError:
            raise
        except TwoRelayError as error:
            found.append(Return(name, None, back.oldest[name], str(error)))
    return found


class _Back:
    """The way back: settings first, then what commands the drive, each the last first.

    What commands it is written only to a drive that says it is without energy, a set-point always
    as one that moves nothing, and nothing with a value by which the profile enables the drive.
    """

    def __init__(self, drive: Drive, intents: list[Intent], *, force: bool) -> None:
        self._drive = drive
        self._force = force
        self.oldest = {intent.parameter: intent.old for intent in reversed(intents)}
        # each value that it wrote: a drive that was without power has again what it had stored
        self._ours = {n: {i.new for i in intents if i.parameter == n} for n in self.oldest}
        self._commands = commands_of(drive.profile)
        names = dict.fromkeys(i.parameter for i in reversed(intents))
        known = [name for name in names if name in drive.parameters]
        self.order = sorted(known, key=lambda name: name in self._commands.names)
        self.of_the_bus = {n: old for n, old in self.oldest.items() if n not in drive.parameters}

    def way(self, name: str) -> Return:
        """What is to be done with one parameter; raises WriteFailed, LinkError."""
        there, old = self._drive.read(name).raw, self.oldest[name]
        known, what = self._commands, self._drive.parameters[name]
        if name in known.positions:
            old = self._drive.read("position_actual").raw
        elif name in known.set_points:
            old = 0
        why = ""
        if there == old:
            pass
        elif known.enables(name, old):
            why = f"{old} stood there before, which enables the drive: set it yourself"
        elif refused := why_not_written(what, old, is_command=name in known.restorable):
            why = f"{old} stood there before, and {refused.text}"
        elif (
            there not in self._ours[name] and not self._force and name not in SET | known.set_points
        ):
            why = (
                f"it reads {there}, neither the old {old} nor what was written: somebody "
                "changed it since; --force overwrites it"
            )
        return Return(name, there, old, why)

    def put(self, name: str, outcome: Restored) -> None:
        """One parameter; raises WriteFailed, LinkError."""
        way = self.way(name)
        if way.why_not:
            outcome.skipped[name] = way.why_not
            return
        if way.there == way.old:
            outcome.already.append(name)
            return
        if name in self._commands.names and self._drive.state().is_energised:
            raise WriteFailed("not put back while the drive is enabled", code="write.enabled")
        try:
            self._drive.write(name, way.old)
        except WriteDenied as denied:
            if name != "mode_of_operation" or way.old != _NO_MODE or denied.busy:
                raise
            outcome.left[name] = "the drive does not take 'no mode' (0) back; it has no energy"
            return
        outcome.restored.append(name)


def _put_back_bus(drive: Drive, old: dict[str, int], outcome: Restored, dead: str | None) -> None:
    """Undo what the cycle changed of the bus' own objects, all at once."""
    if not old:
        return
    try:
        if dead is not None:
            raise LinkError(dead, code="link.lost")
        done = outcome.restored if drive.preparation.put_back_bus(old) else outcome.already
        done += old
    except TwoRelayError as error:
        outcome.failed |= dict.fromkeys(old, str(error))


def _listed(names: list[str]) -> str:
    """Parameters by name; the objects of a PDO are one thing to a reader."""
    objects = [name for name in names if "h:" in name]
    named = [name for name in names if name not in objects]
    return ", ".join([*named, *(["PDO parameters"] if objects else [])])
