"""One owner a drive: a lock that the system gives back when its process ends, however it ends."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import IO
from urllib.parse import unquote

from drivers.link import Link, parse
from profiles.errors import Refused

__all__ = ["owned"]

_BEHIND = 100  # bytes: what is locked on Windows, so that the owner's number before it can be read


@contextlib.contextmanager
def owned(link_text: str) -> Generator[None]:
    """The drive on a link for this process alone; raises Refused while another one has it."""
    link = parse(link_text)
    if link.scheme == "virtual":  # it lives in this process
        yield
        return
    folder = Path(tempfile.gettempdir()) / "tworelay-locks"
    name = hashlib.sha256(_place(link).encode()).hexdigest()
    try:
        folder.mkdir(mode=0o777, exist_ok=True)
        descriptor = os.open(
            folder / name, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666
        )
    except OSError as error:
        raise Refused(
            f"no lock can be made in {folder} ({error.strerror}): without it two programs could move one "
            "axis; remove the folder, or set TMPDIR to one that can be written"
        ) from None
    with os.fdopen(descriptor, "r+", encoding="ascii", errors="replace") as file:
        if not _take(file):
            owner = file.read().strip() or "unknown"
            raise Refused(
                f"another tworelay (process {owner}) has the drive on {link.text}: wait for it, or end it; "
                "'tworelay stop' works in spite of it"
            )
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


def _place(link: Link) -> str:
    """What two links to one drive have in common."""
    address = link.options.get("unit") or link.options.get("node") or ""
    place = unquote(link.place).rstrip("/")
    if link.scheme == "modbus-rtu" or place.startswith("slcan/"):
        head, _, port = (
            place.rpartition("slcan/") if place.startswith("slcan/") else ("", "", place)
        )
        return f"{head}{Path(port).resolve()}"  # the whole port: it has one owner
    return f"{link.scheme} {place} {address}"


def _take(file: IO[str]) -> bool:
    """Lock an open file, without waiting; the system unlocks it when the process is gone."""
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(_BEHIND)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        file.seek(0)
    return True
