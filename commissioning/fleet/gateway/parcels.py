"""Runs on their way from a gateway to its client: packed there, unpacked and taken in here."""

from __future__ import annotations

import base64
import io
import tempfile
import threading
import zipfile
import zlib
from collections.abc import Awaitable, Callable
from pathlib import Path

from commissioning.fleet.gateway.messages import Chunk
from commissioning.journal import Journal
from commissioning.runs import resolve
from profiles.errors import UsageError

__all__ = ["Parcels", "received", "unpack"]

_CHUNK = 512 * 1024  # bytes
_MOST = 512 * 1024 * 1024  # bytes of a parcel, and of what is in it
_FILES = 64
_KEPT = 4  # parcels that are read from


class Parcels:
    """The runs of a home, each packed when it is asked for."""

    def __init__(self, home: Path) -> None:
        self._home = home
        self._packed: dict[str, bytes] = {}
        self._lock = threading.Lock()

    def chunk(self, asked: Chunk) -> Chunk:
        """The bytes from `begin` on; raises UsageError where there is no such run."""
        with self._lock:
            packed = self._packed.get(asked.run)
            if packed is None or asked.begin == 0:
                packed = self._pack(asked.run)
                self._packed[asked.run] = packed
                while len(self._packed) > _KEPT:
                    del self._packed[next(iter(self._packed))]
            if asked.begin + _CHUNK >= len(packed):
                self._packed.pop(asked.run, None)
        part = packed[asked.begin : asked.begin + _CHUNK]
        return Chunk(asked.run, asked.begin, len(packed), base64.b64encode(part).decode())

    def _pack(self, run: str) -> bytes:
        stream = io.BytesIO()
        with (
            tempfile.TemporaryDirectory() as folder,
            Journal(self._home, reading=True) as journal,
            zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            known, source = resolve(journal, journal.run(run).id)
            for path in source.export(journal, known, Path(folder), tables=False):
                archive.write(path, path.name)
        return stream.getvalue()


async def received(run: str, ask: Callable[[Chunk], Awaitable[Chunk]]) -> bytes:
    """A parcel, chunk by chunk; raises UsageError where it is none."""
    data = bytearray()
    while True:
        chunk = await ask(Chunk(run, len(data)))
        try:
            part = base64.b64decode(chunk.data)
        except ValueError:
            raise UsageError(f"run {run}: what the gateway sends is no run") from None
        data += part
        if chunk.total > _MOST or len(data) > chunk.total or (not part and chunk.total):
            raise UsageError(f"run {run}: what the gateway sends is no run")
        if len(data) >= chunk.total:
            return bytes(data)


def unpack(data: bytes, folder: Path) -> None:
    """The files of a parcel: no folders, no links, no more than a run can have."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if len(members) > _FILES or sum(one.file_size for one in members) > _MOST:
                raise UsageError("what the gateway sends is too much for a run")
            for one in members:
                name = Path(one.filename).name
                if name != one.filename or "\\" in name or one.is_dir():
                    raise UsageError(f"what the gateway sends has a file '{one.filename:.80}'")
                (folder / name).write_bytes(archive.read(one))
    except (zipfile.BadZipFile, RuntimeError, EOFError, ValueError, zlib.error) as error:
        raise UsageError(f"what the gateway sends is no run: {error}") from None
