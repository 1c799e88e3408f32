"""Samples of a run as columns: made of what was recorded, kept as samples.npz, written as CSV."""

from __future__ import annotations

import csv
import io
import json
import math
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from commissioning.result.found import Units
from commissioning.runner import Phase, Recorder
from drivers.sample import Sample
from profiles.errors import UsageError
from profiles.files import contents, replace

__all__ = ["LARGEST", "Array", "Samples", "archive", "write_csv"]

Array = NDArray[np.float64]

_COLUMNS = ("time", "position", "torque", "command", "sent", "lateness", "missed")
_UNREADABLE = (
    OSError, ValueError, KeyError, EOFError, TypeError, MemoryError, OverflowError, RuntimeError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
LARGEST = 500_000_000  # bytes
_CURVE = "curve."
# what was a detail in runs of 0.1.0, which kept no kind of a phase
_DETAILS_OF_0_1 = "staging", "relay test 2, ", "stop path", "a dozen periods"


class Samples:
    """Recorded samples as columns, the phases of the run, and curves that pictures of it need.

    Each column is an (n,) array in the unit of Sample; time counts from the first sample. A curve
    is (k, n): `verify.<step>` time, command, error; `step.<loop>.<rule>.<source>` time, position.
    """

    def __init__(
        self,
        columns: dict[str, Array],
        phases: list[Phase],
        curves: dict[str, Array] | None = None,
    ) -> None:
        self.columns = columns
        self.phases = phases
        self.curves = curves or {}

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __getattr__(self, name: str) -> Array:
        if name not in _COLUMNS:
            raise AttributeError(name)
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.time)

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

    @classmethod
    def none(cls) -> Samples:
        """Samples of a run without a record."""
        return cls.of(Recorder())

    @classmethod
    def read(cls, path: Path, curves: dict[str, Array]) -> Samples:
        """Those of a samples.npz, which anybody may have written, and `curves` of an older run.

        Raises UsageError.
        """
        try:
            data = io.BytesIO(contents(path, LARGEST, links=False))
            with zipfile.ZipFile(data) as packed:
                if sum(item.file_size for item in packed.infolist()) > LARGEST:
                    raise UsageError(f"{path}: too large for samples")
                for item in packed.infolist():
                    _check_array(packed, item)
            data.seek(0)
            with np.load(data, allow_pickle=False) as archive:
                columns = {name: np.asarray(archive[name], float) for name in _COLUMNS}
                phases = [
                    _phase(int(at), str(text), *kind)
                    for at, text, *kind in json.loads(str(archive["phases"]))
                    if int(at) >= 0
                ]
                curves |= {
                    name.removeprefix(_CURVE): np.asarray(archive[name], float)
                    for name in archive.files
                    if name.startswith(_CURVE)
                }
            _check_columns(columns)
            _check_curves(curves)
        except _UNREADABLE as error:
            raise UsageError(f"{path}: cannot be read as samples: {error}") from None
        return cls(columns, phases, curves)


def archive(samples: Samples) -> bytes:
    """The bytes of a samples.npz."""
    file = io.BytesIO()
    phases = np.array(json.dumps([(p.at, p.text, p.kind) for p in samples.phases]))
    curves = {_CURVE + name: curve for name, curve in samples.curves.items()}
    np.savez(file, allow_pickle=False, phases=phases, **samples.columns, **curves)
    return file.getvalue()


def _check_curves(curves: dict[str, Array]) -> None:
    """Raise ValueError where they are no rows of finite numbers."""
    for name, curve in curves.items():
        if curve.ndim != 2 or not np.all(np.isfinite(curve)):
            raise ValueError(f"'{name}' is no curve")


def _check_columns(columns: dict[str, Array]) -> None:
    """Raise ValueError for columns of different lengths, and for values that are no numbers."""
    if len({column.shape for column in columns.values()}) != 1 or columns["time"].ndim != 1:
        raise ValueError("its columns are not of one length")
    for name in ("time", "position", "sent"):
        if not np.all(np.isfinite(columns[name])):
            raise ValueError(f"'{name}' holds what is no finite number")


def _phase(at: int, text: str, kind: str | None = None) -> Phase:
    """A phase as samples.npz has it."""
    if kind is None:
        kind = "detail" if text.startswith(_DETAILS_OF_0_1) else "step"
    return Phase(at, "detail" if kind == "detail" else "step", text)


def _check_array(packed: zipfile.ZipFile, item: zipfile.ZipInfo) -> None:
    """Raise ValueError where an array is said to be larger than what there is of it."""
    with packed.open(item) as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise ValueError(f"{item.filename} is no array of samples")
        shape, _, kind = np.lib.format.read_array_header_1_0(member)
    if math.prod(shape) * kind.itemsize > item.file_size:
        raise ValueError(f"{item.filename} is cut off")


def write_csv(
    path: Path,
    samples: Samples,
    units: Units,
    span: tuple[float, float] | None = None,
    analysed: Sequence[tuple[float, float]] = (),
) -> None:
    """All samples, or those between two instants (s) of the run.

    `analysed` : what the numbers are of, s; a column says it, so that `analyze` reads the same
    """
    linear = units.position == "m"
    position, effort = ("m", "N") if linear else ("rad", "Nm")
    kind = "force" if linear else "torque"
    header = [
        "time_s", f"position_{position}", f"{kind}_{effort}", f"command_{effort}", "sent_s",
        "lateness_s", "missed_cycles",
    ]  # fmt: skip
    since = samples.time - (samples.sent[0] if len(samples) else 0.0)
    columns = [samples[name] for name in _COLUMNS]
    if analysed:
        header.append("analysed")
        inside = [(since >= begin) & (since <= end) for begin, end in analysed]
        columns.append(np.any(inside, axis=0).astype(int))
    file = io.StringIO(newline="")
    writer = csv.writer(file)
    writer.writerow(header)
    kept = slice(None) if span is None else (since >= span[0]) & (since <= span[1])
    writer.writerows(zip(*(column[kept].tolist() for column in columns), strict=True))
    replace(path, file.getvalue().encode())
