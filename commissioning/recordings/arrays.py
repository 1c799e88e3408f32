"""Recordings that are arrays: .mat of every version, .npz and .npy. Nothing in them is executed."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from commissioning.recordings.table import MOST_CELLS, Array, Table, unit_in
from profiles.errors import UsageError

__all__ = ["table_of_mat", "table_of_npy", "table_of_npz"]

_NUMBERS = {  # classes of a .mat
    "double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64",
    "logical",
}  # fmt: skip
_WIDEST = 64  # columns of a matrix
_MOST_SETS = 200  # of an HDF5 file
_DEEPEST = 4  # structs within structs
_INFLATED = 24_000_000  # bytes of a struct's own: as many as 200 MB of numbers come from
_UNREADABLE = (
    OSError, MemoryError, ValueError, EOFError, KeyError, SyntaxError, NotImplementedError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_AT = (0, 512)


def table_of_mat(path: Path, data: bytes) -> Table:
    """A .mat of version 4 to 7.3; raises UsageError."""
    if any(data[at : at + len(_HDF5)] == _HDF5 for at in _HDF5_AT):
        return _gathered(path, _of_hdf5(path, data))
    import scipy.io

    try:
        shapes = scipy.io.whosmat(io.BytesIO(data))  # type: ignore[arg-type]
        inflated = _inflated(data)
        # a small compressed file may hold a large array, and a struct anything
        small = [
            name
            for n, (name, shape, kind) in enumerate(shapes)
            if (kind in _NUMBERS and math.prod(shape) <= MOST_CELLS)
            or (kind == "struct" and n < len(inflated) and inflated[n] <= _INFLATED)
        ]
        file: Any = io.BytesIO(data)
        found = scipy.io.loadmat(file, variable_names=small, squeeze_me=True)
    except Exception as error:  # the reader has no error class of its own
        raise UsageError(
            f"{path}: cannot be read as .mat ({error}); save it again, or as CSV"
        ) from None
    named = {name: value for name, value in found.items() if not name.startswith("__")}
    return _gathered(path, _leaves(named))


def _inflated(data: bytes) -> list[int]:
    """Bytes of each variable of a version 5 file, or more than one may have; [] of version 4."""
    found: list[int] = []
    if len(data) < 136 or data[124:128] in (b"\0\0\0\0",):
        return found
    order = "<" if data[126:128] == b"IM" else ">"
    at = 128
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        body = data[at + 8 : at + 8 + size]
        found.append(_size_of(body) if kind == 15 else size)
        at += 8 + size if kind == 15 else 8 + -(-size // 8) * 8
    return found


def _size_of(body: bytes) -> int:
    """What a compressed part comes to, as far as one has to know."""
    unpacked = zlib.decompressobj()
    return len(unpacked.decompress(body, _INFLATED + 1))


def _leaves(tree: dict[str, Any], prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Arrays of numbers by their names, those within structs as 'struct.field'."""
    for name, value in tree.items():
        full = f"{prefix}{name}"
        kind = getattr(value, "dtype", None)
        if kind is not None and kind.names and depth < _DEEPEST:
            flat = np.asarray(value, dtype=kind).ravel()
            if flat.size == 1:
                fields = {field: flat[0][field] for field in kind.names}
                yield from _leaves(fields, f"{full}.", depth + 1)
        elif isinstance(value, dict) and depth < _DEEPEST:
            yield from _leaves(value, f"{full}.", depth + 1)
        else:
            yield full, value


def _of_hdf5(path: Path, data: bytes) -> Iterator[tuple[str, Any]]:
    """Data sets of numbers that lie in the file itself."""
    hdf5: Any = import_module("h5py")
    names: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, hdf5.Dataset) or name.startswith("#"):
            return
        is_elsewhere = item.is_virtual or item.external
        if is_elsewhere or item.dtype.kind not in "fiu" or item.size is None:
            return
        taken = sum(value.size for _, value in names)
        if taken + item.size <= MOST_CELLS and len(names) < _MOST_SETS:
            names.append((name.replace("/", "."), np.asarray(item[()]).T))

    try:
        with hdf5.File(io.BytesIO(data), "r") as file:
            file.visititems(visit)
    except Exception as error:  # of any kind, and in the C library's words
        raise UsageError(
            f"{path}: cannot be read as .mat 7.3 ({type(error).__name__}); save it as version 7, "
            "or as CSV"
        ) from None
    yield from names


def table_of_npz(path: Path, data: bytes) -> Table:
    """A .npz; raises UsageError."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(item.file_size for item in packed.infolist()) > 8 * MOST_CELLS:
                raise UsageError(f"{path}: more than {MOST_CELLS} numbers; cut the recording")
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
    except _UNREADABLE as error:
        raise UsageError(f"{path}: cannot be read as .npz ({error})") from None
    return _gathered(path, _leaves(found))


def table_of_npy(path: Path, data: bytes) -> Table:
    """A .npy: a matrix, or fields by name; raises UsageError."""
    try:
        found = np.load(io.BytesIO(data), allow_pickle=False)
    except _UNREADABLE as error:
        raise UsageError(f"{path}: cannot be read as .npy ({error})") from None
    if not isinstance(found, np.ndarray):
        raise UsageError(f"{path}: cannot be read as .npy (is it a .npz?)")
    if found.dtype.names:
        return _gathered(path, ((name, found[name]) for name in found.dtype.names))
    return _gathered(path, (("", found),))


def _gathered(path: Path, leaves: Iterator[tuple[str, Any]] | Any) -> Table:
    """Vectors as columns, matrices column by column, single numbers as scalars."""
    columns: dict[str, Array] = {}
    scalars: dict[str, float] = {}
    for name, value in leaves:
        if not isinstance(value, np.ndarray | np.generic | float | int):
            continue
        array = np.squeeze(np.asarray(value))
        if array.dtype.kind not in "fiub" or array.size > MOST_CELLS:
            continue
        if array.size == 1:
            scalars[name] = float(array.ravel()[0])
        elif array.ndim == 1:
            columns[name or "1"] = array.astype(float)
        elif array.ndim == 2 and min(array.shape) <= _WIDEST:
            tall = array if array.shape[0] >= array.shape[1] else array.T
            for n in range(tall.shape[1]):
                columns[f"{name}({n + 1})" if name else str(n + 1)] = tall[:, n].astype(float)
    if not columns:
        raise UsageError(f"{path}: holds no vector of numbers")
    units = {name: unit for name in columns if (unit := unit_in(name))}
    return Table(path, columns, units, scalars)
