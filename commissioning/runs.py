"""Files of a run: result, samples, profile, report."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.journal import Journal, RunRecord
from commissioning.runner import Recorder
from commissioning.stored import checked_journal, checked_result, json_file
from drivers.sample import Sample
from profiles.dcf import dcf
from profiles.errors import JournalError, UsageError
from profiles.files import contents, replace
from profiles.library import load_profile

__all__ = ["RunFolder", "Samples", "resolve"]

_COLUMNS = ("time", "position", "torque", "command", "sent", "lateness", "missed")
_UNREADABLE = (
    OSError, ValueError, KeyError, EOFError, TypeError, MemoryError, OverflowError, RuntimeError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
# files of a run; of one that somebody sent no page of theirs
_FOREIGN = "run.json", "profile.toml", "samples.npz"
_FILES = *_FOREIGN, "report.html", "loci.svg", "loci.png", "loci.pdf"
_LARGEST_SAMPLES = 500_000_000  # bytes


class Samples:
    """Recorded samples as columns, and the phases of the run.

    Each column is an (n,) array in the unit of Sample; time counts from the first sample.
    """

    def __init__(
        self, columns: dict[str, NDArray[np.float64]], phases: list[tuple[int, str]]
    ) -> None:
        self.columns = columns
        self.phases = phases

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["time"])

    @classmethod
    def of(cls, recorder: Recorder) -> Samples:
        """Columns of what was recorded."""
        fields = list(zip(*recorder.samples, strict=True)) or [()] * len(Sample._fields)
        columns = {name: np.array(fields[Sample._fields.index(name)], float) for name in _COLUMNS}
        if recorder.samples:
            begin = recorder.samples[0].sent
            columns["time"] -= begin
            columns["sent"] -= begin
        return cls(columns, list(recorder.phases))


class RunFolder:
    """The folder of one run under TWORELAY_HOME, or an exported one. No link in it is followed.

    `exported` : the journal that lies in an exported one
    """

    def __init__(self, path: Path, exported: dict[str, Any] | None = None) -> None:
        self.path = path
        self.exported = exported

    @classmethod
    def of(cls, journal: Journal, run: str) -> RunFolder:
        """Folder of the run `run`."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", run):
            raise UsageError(f"'{run}' is no run id")
        path = journal.folder / "runs" / run
        if path.is_symlink():
            raise UsageError(f"{path}: is a link, and none is followed here")
        return cls(path)

    def history(self, journal: Journal, run: str) -> dict[str, Any]:
        """What the journal knows of the run: this computer's, or for an exported one the one beside it."""
        return journal.export(run) if self.exported is None else self.exported

    def record(self, journal: Journal, run: str) -> RunRecord:
        """The run's row of the journal, likewise."""
        if self.exported is None:
            return journal.run(run)
        return RunRecord.exported(self.exported["run"])

    def save(self, result: dict[str, Any], samples: Samples | None, profile: str | None) -> None:
        """Write what is given; raises JournalError."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if profile is not None:
                replace(self.path / "profile.toml", profile.encode())
            text = json.dumps(result, indent=1, allow_nan=False)
            replace(self.path / "run.json", text.encode())
            if samples is not None:
                archive = io.BytesIO()
                phases = np.array(json.dumps(samples.phases))
                np.savez(archive, allow_pickle=False, phases=phases, **samples.columns)
                replace(self.path / "samples.npz", archive.getvalue())
        except OSError as error:
            raise JournalError(f"cannot write the run to {self.path}: {error}") from None

    def result(self) -> dict[str, Any]:
        """The result JSON; raises UsageError."""
        path = self.path / "run.json"
        try:
            return checked_result(json_file(path), str(path))
        except FileNotFoundError:
            raise UsageError(f"{self.path} holds no run (run.json is missing)") from None

    def samples(self) -> Samples | None:
        """Recorded samples, or None where the run has none."""
        path = self.path / "samples.npz"
        if not path.exists() and not path.is_symlink():
            return None
        try:
            data = io.BytesIO(contents(path, _LARGEST_SAMPLES, links=False))
            with zipfile.ZipFile(data) as packed:
                if sum(item.file_size for item in packed.infolist()) > _LARGEST_SAMPLES:
                    raise UsageError(f"{path}: too large for samples")
                for item in packed.infolist():
                    _check_array(packed, item)
            data.seek(0)
            with np.load(data, allow_pickle=False) as archive:
                columns = {name: np.asarray(archive[name], float) for name in _COLUMNS}
                phases = [
                    (int(n), str(text))
                    for n, text in json.loads(str(archive["phases"]))
                    if int(n) >= 0
                ]
            _check_columns(columns)
        except _UNREADABLE as error:
            raise UsageError(f"{path}: cannot be read as samples: {error}") from None
        return Samples(columns, phases)

    def profile_path(self) -> Path:
        """The profile as it was in this run; raises UsageError where that is a link."""
        path = self.path / "profile.toml"
        if path.is_symlink():
            raise UsageError(f"{path}: is a link, and none is followed here")
        return path

    def export(self, journal: Journal, run: str, target: Path) -> list[Path]:
        """Copy the run to `target` with its journal, samples as CSV, changes as DCF; return the files."""
        result = self.result()
        try:
            target.mkdir(parents=True, exist_ok=True)
            for name in _FOREIGN if self.exported is not None else _FILES:
                path = self.path / name
                if path.exists() or path.is_symlink():
                    replace(target / name, contents(path, _LARGEST_SAMPLES, links=False))
            history = self.history(journal, run)
            replace(target / "journal.json", json.dumps(history, indent=1).encode())
            samples = self.samples()
            if samples is not None:
                _write_csv(target / "samples.csv", samples, result)
                spans = (result["experiment"] or {}).get("spans")
                if spans:
                    _write_csv(
                        target / "oscillations.csv", samples, result, (spans[0][0], spans[-1][1])
                    )
            changes = self._dcf(history)
            if changes:
                replace(target / "changes.dcf", changes.encode())
        except OSError as error:
            why = error.strerror or error
            raise UsageError(f"cannot export to {target}: {why}") from None
        return sorted(target.iterdir())

    def _dcf(self, history: dict[str, Any]) -> str:
        """What the run changed for good in a CANopen drive, as a DCF; '' where there is nothing."""
        if not self.profile_path().exists():
            return ""
        profile = load_profile(str(self.profile_path()), lenient=True)
        changed = {
            intent["parameter"]: intent["new"]
            for intent in history["intents"]
            if intent["kind"] != "experiment"
            and intent["state"] != "restored"
            and intent["parameter"] in profile.parameters
        }
        if profile.bus != "canopen" or not changed:
            return ""
        node = re.search(r"[?&]node=([0-9]{1,3})(?:&|$)", history["run"]["link"])
        return dcf(profile, changed, int(node[1]) if node else profile.link.node)


def _check_columns(columns: dict[str, NDArray[np.float64]]) -> None:
    """Raise ValueError where they are no columns of one length, or an instant or a position is no number."""
    if len({column.shape for column in columns.values()}) != 1 or columns["time"].ndim != 1:
        raise ValueError("its columns are not of one length")
    for name in ("time", "position", "sent"):
        if not np.all(np.isfinite(columns[name])):
            raise ValueError(f"'{name}' holds what is no finite number")


def _check_array(packed: zipfile.ZipFile, item: zipfile.ZipInfo) -> None:
    """Raise ValueError where an array is said to be larger than what there is of it."""
    with packed.open(item) as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise ValueError(f"{item.filename} is no array of samples")
        shape, _, kind = np.lib.format.read_array_header_1_0(member)
    if math.prod(shape) * kind.itemsize > item.file_size:
        raise ValueError(f"{item.filename} is cut off")


def resolve(journal: Journal, run: str) -> tuple[str, RunFolder]:
    """RUN → its id and folder, to be read: an id, `last`, or the folder of an exported run."""
    path = Path(run)
    if _is_folder(path) and (path / "run.json").exists():
        origin = path / "journal.json"
        try:
            tree = checked_journal(json_file(origin), str(origin))
        except FileNotFoundError:
            raise UsageError(f"{path} holds no exported run (journal.json is missing)") from None
        return tree["run"]["id"], RunFolder(path, tree)
    record = journal.run(run)
    folder = RunFolder.of(journal, record.id)
    if not folder.path.exists():
        raise UsageError(
            f"run {record.id} has no files here: they were deleted, or it was cut off before it wrote any"
        )
    return record.id, folder


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def _write_csv(
    path: Path, samples: Samples, result: dict[str, Any], span: tuple[float, float] | None = None
) -> None:
    """All samples, or those between two instants (s) of the run: what `analyze` reads best."""
    linear = result.get("units", {}).get("position") == "m"
    position, effort = ("m", "N") if linear else ("rad", "Nm")
    kind = "force" if linear else "torque"
    header = [
        "time_s", f"position_{position}", f"{kind}_{effort}", f"command_{effort}", "sent_s",
        "lateness_s", "missed_cycles",
    ]  # fmt: skip
    file = io.StringIO(newline="")
    writer = csv.writer(file)
    writer.writerow(header)
    since = samples["time"] - (samples["sent"][0] if len(samples) else 0.0)
    kept = slice(None) if span is None else (since >= span[0]) & (since <= span[1])
    writer.writerows(zip(*(samples[name][kept].tolist() for name in _COLUMNS), strict=True))
    replace(path, file.getvalue().encode())
