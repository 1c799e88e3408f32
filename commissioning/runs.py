"""Files of a run: result, samples, profile, report."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from commissioning.errors import JournalError
from commissioning.journal import Journal
from commissioning.records import History, history_of, history_tree, json_file
from commissioning.result.changes import Change, Written
from commissioning.result.codec import Curves, decode, text_of
from commissioning.result.document import RunResult
from commissioning.result.endings import (
    AxisState,
    CompensationState,
    DriveState,
    Ending,
    SettingsState,
)
from commissioning.samples import LARGEST, Array, Samples, archive, write_csv
from profiles.dcf import dcf
from profiles.errors import UsageError
from profiles.files import contents, replace
from profiles.library import load_profile

__all__ = [
    "RunFolder",
    "as_of",
    "drive_state",
    "left_in_drive",
    "resolve",
    "settings_state",
]


# files of a run; of one that somebody sent no page of theirs
_FOREIGN = "run.json", "profile.toml", "samples.npz"
_FILES = *_FOREIGN, "report.html", "loci.svg", "loci.png", "loci.pdf"


class RunFolder:
    """The folder of one run under TWORELAY_HOME, or an exported one. No link in it is followed.

    `exported` : the journal that lies in an exported one
    `journal` : whose index is told what is saved
    """

    def __init__(
        self, path: Path, exported: History | None = None, journal: Journal | None = None
    ) -> None:
        self.path = path
        self.exported = exported
        self._journal = journal

    @classmethod
    def of(cls, journal: Journal, run: str) -> RunFolder:
        """Folder of the run `run`."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", run):
            raise UsageError(f"'{run}' is no run id")
        path = journal.folder / "runs" / run
        if path.is_symlink():
            raise UsageError(f"{path}: is a link, and none is followed here")
        return cls(path, journal=journal)

    def history(self, journal: Journal, run: str) -> History:
        """What the journal knows of the run.

        This computer's, or for an exported one the one beside it.
        """
        return journal.history(run) if self.exported is None else self.exported

    def save(
        self,
        result: RunResult,
        samples: Samples | None = None,
        profile: str | None = None,
        curves: Mapping[str, Array] | None = None,
    ) -> None:
        """Write what is given; curves of one kind replace those of that kind.

        Raises JournalError.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if profile is not None:
                replace(self.path / "profile.toml", profile.encode())
            if samples is None and (curves or self._old_curves()):
                samples = self._samples_or_none()
            if samples is not None:
                samples.curves = _merged(samples.curves, curves or {})
                replace(self.path / "samples.npz", archive(samples))
            replace(self.path / "run.json", text_of(result).encode())
        except OSError as error:
            raise JournalError(f"cannot write the run to {self.path}: {error}") from None
        if self._journal is not None:
            self._journal.index(self.path.name, result)

    def _old_curves(self) -> Curves:
        """What an older version has of curves in its result, which is about to be replaced."""
        with suppress(UsageError):
            return self._read(missing=True)[1]
        return {}

    def _samples_or_none(self) -> Samples:
        """What is recorded.

        A file that cannot be read is laid aside, so that what is new has a place.
        """
        try:
            return self.samples() or Samples.none()
        except UsageError:
            path = self.path / "samples.npz"
            path.replace(path.with_name("samples.damaged.npz"))
            return Samples.none()

    def _read(self, *, missing: bool = False) -> tuple[RunResult | None, Curves]:
        """The result, and what older versions had of curves in it; raises UsageError."""
        path = self.path / "run.json"
        try:
            return decode(json_file(path), str(path))
        except FileNotFoundError:
            if missing:
                return None, {}
            raise UsageError(f"{self.path} holds no run (run.json is missing)") from None

    def result(self, history: History | None = None) -> RunResult:
        """The result, and with the run's `history` what it has left in the drive.

        Raises UsageError.
        """
        found, _ = self._read()
        assert found is not None
        return found if history is None else as_of(found, history)

    def samples(self) -> Samples | None:
        """Recorded samples and curves, or None where the run has none; raises UsageError."""
        curves = {name: np.array(columns) for name, columns in self._old_curves().items()}
        path = self.path / "samples.npz"
        if not path.exists() and not path.is_symlink():
            return Samples(Samples.none().columns, [], curves) if curves else None
        return Samples.read(path, curves)

    def profile_path(self) -> Path:
        """The profile as it was in this run; raises UsageError where that is a link."""
        path = self.path / "profile.toml"
        if path.is_symlink():
            raise UsageError(f"{path}: is a link, and none is followed here")
        return path

    def export(
        self, journal: Journal, run: str, target: Path, *, tables: bool = True
    ) -> list[Path]:
        """Copy the run to `target` with its journal; `tables`: samples as CSV, changes as DCF.

        Return the files.
        """
        history = self.history(journal, run)
        result = self.result(history)
        try:
            target.mkdir(parents=True, exist_ok=True)
            for name in _FOREIGN if self.exported is not None else _FILES:
                path = self.path / name
                if path.exists() or path.is_symlink():
                    replace(target / name, contents(path, LARGEST, links=False))
            replace(target / "journal.json", json.dumps(history_tree(history), indent=1).encode())
            samples = self.samples() if tables else None
            if samples is not None and len(samples):
                watched = result.experiment
                analysed = watched.analysed if watched else ()
                write_csv(target / "samples.csv", samples, result.units, analysed=analysed)
                if watched and watched.cycles:
                    begin, end = watched.cycles[0].begin, watched.cycles[-1].end
                    if analysed:
                        begin, end = min(begin, analysed[0][0]), max(end, analysed[-1][1])
                    begin -= watched.cycles[0].period  # commands before it act in it, too
                    write_csv(
                        target / "oscillations.csv", samples, result.units, (begin, end), analysed
                    )
            changes = self._dcf(history) if tables else ""
            if changes:
                replace(target / "changes.dcf", changes.encode())
        except OSError as error:
            why = error.strerror or error
            raise UsageError(f"cannot export to {target}: {why}") from None
        return sorted(target.iterdir())

    def _dcf(self, history: History) -> str:
        """What the run changed for good in a CANopen drive, as a DCF; '' where there is nothing."""
        if not self.profile_path().exists():
            return ""
        profile = load_profile(str(self.profile_path()), lenient=True)
        changed = {
            intent.parameter: intent.new
            for intent in history.intents
            if intent.lasts and intent.is_open and intent.parameter in profile.parameters
        }
        if profile.bus != "canopen" or not changed:
            return ""
        node = re.search(r"[?&]node=([0-9]{1,3})(?:&|$)", history.run.link)
        return dcf(profile, changed, int(node[1]) if node else profile.link.node)


# -- what a run has left in its drive -------------------------------------------------------------


def left_in_drive(result: RunResult, history: History) -> tuple[Written, ...]:
    """What the run changed and is in the drive, by the journal.

    Of what that does not know by the result.
    """
    before, changes = history.before(), {c.parameter: c for c in _changes(result)}
    kinds = {intent.parameter: intent.kind for intent in history.intents if intent.lasts}
    left = {one.parameter: one for one in result.written if one.parameter not in history.image}
    for name, old in before.items():
        cell, change = history.image.get(name), changes.get(name)
        goal = None if change is None else change.new_raw
        if cell is None or (cell.raw == old and cell.certain):
            continue
        if cell.writer != history.run.id and cell.raw != goal:
            continue
        left[name] = Written(
            name, "gain" if kinds[name] == "gain" else "compensation", cell.raw,
            change.new if change is not None and cell.raw == goal else None,
            change.unit if change else "", cell.certain,
        )  # fmt: skip
    if before and not any(i.is_open for i in history.intents if i.lasts):
        return tuple(one for one in left.values() if one.parameter in before)
    return tuple(left.values())


def _changes(result: RunResult) -> tuple[Change, ...]:
    return result.compensation + tuple(c for one in result.tuning for c in one.parameters)


def drive_state(result: RunResult, history: History) -> DriveState:
    """Whose compensation is in the drive, by what the run wrote and what was written since."""
    mine = {i.parameter for i in history.intents if i.kind == "compensation"}
    before = {name: raw for name, raw in history.before().items() if name in mine}
    cells = {name: history.image[name] for name in before if name in history.image}
    if not cells:
        ours = any(one.kind == "compensation" for one in result.written)
        return DriveState(CompensationState.OF_RUN, None) if ours else DriveState()
    stored: bool | None = all(cell.memory == cell.raw for cell in cells.values())
    if any(cell.memory is None for cell in cells.values()):
        stored = None
    if not all(cell.certain for cell in cells.values()):
        return DriveState(CompensationState.NOT_KNOWN, stored)
    if all(cell.raw == before[name] for name, cell in cells.items()):
        return DriveState(CompensationState.AS_FOUND, None if stored else False)
    goal = {change.parameter: change.new_raw for change in result.compensation}
    if all(cell.raw == goal.get(name) for name, cell in cells.items()):
        return DriveState(CompensationState.OF_RUN, stored)
    if any(cell.writer == history.run.id for cell in cells.values()):
        return DriveState(CompensationState.PARTLY, stored)
    return DriveState(CompensationState.OF_OTHER)


def settings_state(history: History) -> SettingsState:
    """Whether the settings of the experiment are back."""
    names = tuple(dict.fromkeys(i.parameter for i in history.intents if i.is_open and not i.lasts))
    return SettingsState("not put back" if names else "put back", names)


def as_of(result: RunResult, history: History) -> RunResult:
    """A result that was read, with what its journal says of the drive since."""
    result = dataclasses.replace(result, written=left_in_drive(result, history))
    ending = result.ending
    if ending is None:
        if result.tool is not None or history.run.status == "running":
            return result  # cut off, or under way
        ending = Ending(AxisState.NOT_RECORDED)
    ending = dataclasses.replace(
        ending, settings=settings_state(history), drive=drive_state(result, history)
    )
    return dataclasses.replace(result, ending=ending)


# -- samples --------------------------------------------------------------------------------------


def _merged(before: Mapping[str, Array], new: Mapping[str, Array]) -> dict[str, Array]:
    kinds = {name.split(".")[0] for name in new}
    return {n: c for n, c in before.items() if n.split(".")[0] not in kinds} | dict(new)


def resolve(journal: Journal, run: str) -> tuple[str, RunFolder]:
    """RUN → its id and folder, to be read: an id, `last`, or the folder of an exported run."""
    path = Path(run)
    if _is_folder(path) and (path / "run.json").exists():
        origin = path / "journal.json"
        try:
            history = history_of(json_file(origin), str(origin))
        except FileNotFoundError:
            raise UsageError(f"{path} holds no exported run (journal.json is missing)") from None
        return history.run.id, RunFolder(path, history)
    record = journal.run(run)
    folder = RunFolder.of(journal, record.id)
    if not folder.path.exists():
        raise UsageError(
            f"run {record.id} has no files here: they were deleted, or it was cut off before it "
            "wrote any"
        )
    return record.id, folder


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False
