"""Files of a run: result, samples, profile, report."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commissioning.journal import Journal
from commissioning.runner import Recorder
from drivers.sample import Sample
from profiles.dcf import dcf
from profiles.errors import JournalError, UnknownName, UsageError
from profiles.files import contents, replace
from profiles.library import load_profile

__all__ = ["RunFolder", "Samples", "resolve"]

_COLUMNS = ("time", "position", "torque", "command", "sent", "lateness", "missed")
_UNREADABLE = (
    OSError, ValueError, KeyError, EOFError, TypeError, MemoryError, OverflowError, RuntimeError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
_LARGEST_JSON, _LARGEST_SAMPLES = 20_000_000, 500_000_000  # bytes


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
    """The folder of one run under TWORELAY_HOME, or an exported one."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def of(cls, journal: Journal, run: str) -> RunFolder:
        """Folder of the run `run`."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", run):
            raise UsageError(f"'{run}' is no run id")
        return cls(journal.folder / "runs" / run)

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
                np.savez(
                    archive,
                    allow_pickle=False,
                    phases=np.array(json.dumps(samples.phases)),
                    **samples.columns,
                )
                replace(self.path / "samples.npz", archive.getvalue())
        except OSError as error:
            raise JournalError(f"cannot write the run to {self.path}: {error}") from None

    def result(self) -> dict[str, Any]:
        """The result JSON; raises UsageError."""
        path = self.path / "run.json"
        try:
            found = json.loads(contents(path, _LARGEST_JSON))
        except FileNotFoundError:
            raise UsageError(f"{self.path} holds no run (run.json is missing)") from None
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError) as error:
            raise UsageError(f"{path}: is no JSON: {error}") from None
        if not isinstance(found, dict) or found.get("schema") != "tworelay.run/1":
            raise UsageError(f"{path}: is no result of tworelay")
        _check_result(found, path)
        return found

    def samples(self) -> Samples | None:
        """Recorded samples, or None where the run has none."""
        path = self.path / "samples.npz"
        if not path.exists():
            return None
        try:
            data = io.BytesIO(contents(path, _LARGEST_SAMPLES))
            with zipfile.ZipFile(data) as packed:
                if sum(item.file_size for item in packed.infolist()) > _LARGEST_SAMPLES:
                    raise UsageError(f"{path}: too large for samples")
                for item in packed.infolist():
                    _check_array(packed, item)
            data.seek(0)
            with np.load(data, allow_pickle=False) as archive:
                columns = {name: np.asarray(archive[name], float) for name in _COLUMNS}
                phases = [(int(n), str(text)) for n, text in json.loads(str(archive["phases"]))]
        except _UNREADABLE as error:
            raise UsageError(f"{path}: cannot be read as samples: {error}") from None
        return Samples(columns, phases)

    def profile_path(self) -> Path:
        """The profile as it was in this run."""
        return self.path / "profile.toml"

    def export(self, journal: Journal, run: str, target: Path) -> list[Path]:
        """Copy the run to `target` with its journal, samples as CSV, changes as DCF; return the files."""
        result = self.result()
        try:
            target.mkdir(parents=True, exist_ok=True)
            for path in self.path.iterdir():
                shutil.copy2(path, target / path.name)
            (target / "journal.json").write_text(json.dumps(journal.export(run), indent=1), "utf-8")
            samples = self.samples()
            if samples is not None:
                _write_csv(target / "samples.csv", samples, result)
                spans = (result["experiment"] or {}).get("spans")
                if spans:
                    _write_csv(
                        target / "oscillations.csv", samples, result, (spans[0][0], spans[-1][1])
                    )
            changes = self._dcf(journal, run)
            if changes:
                (target / "changes.dcf").write_text(changes, "utf-8")
        except OSError as error:
            raise UsageError(f"cannot export to {target}: {error}") from None
        return sorted(target.iterdir())

    def _dcf(self, journal: Journal, run: str) -> str:
        """What the run changed for good in a CANopen drive, as a DCF; '' where there is nothing."""
        if not self.profile_path().exists():
            return ""
        profile = load_profile(str(self.profile_path()))
        changed = {
            i.parameter: i.new
            for i in journal.intents(run, open_only=True)
            if i.kind != "experiment" and i.parameter in profile.parameters
        }
        if profile.bus != "canopen" or not changed:
            return ""
        node = re.search(r"[?&]node=(\d+)", journal.run(run).link)
        return dcf(profile, changed, int(node[1]) if node else profile.link.node)


def _check_array(packed: zipfile.ZipFile, item: zipfile.ZipInfo) -> None:
    """Raise ValueError where an array is said to be larger than what there is of it."""
    with packed.open(item) as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise ValueError(f"{item.filename} is no array of samples")
        shape, _, kind = np.lib.format.read_array_header_1_0(member)
    if math.prod(shape) * kind.itemsize > item.file_size:
        raise ValueError(f"{item.filename} is cut off")


_RESULT_KEYS: dict[str, type | tuple[type, ...]] = {
    "status": str, "axis": str, "units": dict, "friction": dict, "methods": dict,
    "compensation": list, "tuning": list, "quality": dict,
}  # fmt: skip
_CHANGE_KEYS: dict[str, type | tuple[type, ...]] = {
    "parameter": str, "old": (int, float), "new": (int, float), "unit": str, "why": str,
    "old_raw": int, "new_raw": int, "rounded_by": (int, float),
}  # fmt: skip


_SET_KEYS: dict[str, type | tuple[type, ...]] = {
    "rule": str, "loop": str, "source": str, "proposed": bool, "best": bool, "why_not": str,
    "parameters": list,
}  # fmt: skip
_GAIN_KEYS = {
    key: kind for key, kind in _CHANGE_KEYS.items() if key not in ("old", "old_raw", "why")
}


def _check_result(found: dict[str, Any], path: Path) -> None:
    """What the commands rely on is there and of its type; the rest is the report's to judge."""
    rows = [(found, _RESULT_KEYS)]
    if isinstance(found.get("compensation"), list):
        rows += [(item, _CHANGE_KEYS) for item in found["compensation"]]
    for item in found["tuning"] if isinstance(found.get("tuning"), list) else ():
        rows.append((item, _SET_KEYS))
        if isinstance(item, dict) and isinstance(item.get("parameters"), list):
            rows += [(change, _GAIN_KEYS) for change in item["parameters"]]
    for row, keys in rows:
        for key, kind in keys.items():
            if not isinstance(row, dict) or not isinstance(row.get(key), kind):
                raise UsageError(f"{path}: is damaged: '{key}' is missing or not what it must be")


def resolve(journal: Journal, run: str) -> tuple[str, RunFolder]:
    """RUN → its id and folder: an id, `last`, or the folder of an exported run."""
    path = Path(run)
    if _is_folder(path) and (path / "run.json").exists():
        origin = path / "journal.json"
        try:
            tree = json.loads(contents(origin, _LARGEST_JSON))
        except (OSError, ValueError, RecursionError) as error:
            raise UsageError(f"{origin}: cannot be read: {error}") from None
        return journal.adopt(tree, str(origin)), RunFolder(path)
    record = journal.run(run)
    folder = RunFolder.of(journal, record.id)
    if not folder.path.exists():
        raise UnknownName("run with files", record.id, [])
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
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        since = samples["time"] - samples["sent"][0]
        kept = slice(None) if span is None else (since >= span[0]) & (since <= span[1])
        writer.writerows(zip(*(samples[name][kept].tolist() for name in _COLUMNS), strict=True))
