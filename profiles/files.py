"""Files that anybody may have written, and files of ours that others may be reading."""

from __future__ import annotations

import errno
import os
import secrets
import stat
import sys
import time
from pathlib import Path

__all__ = ["contents", "replace"]

_WINDOWS = sys.platform == "win32"
_TRIES, _PAUSE = 100, 0.02  # s: until whoever reads a file on Windows has done


def contents(path: Path, most: int, *, links: bool = True) -> bytes:
    """What a file of at most `most` bytes holds.

    Raises OSError, also for what is no file or is larger.

    Devices and pipes, which have no size and no end, are refused before they are opened, and
    without `links` what leads elsewhere, too.
    """
    if not links and path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link, and none is followed here")
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no file")
    flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
    flags |= 0 if links else getattr(os, "O_NOFOLLOW", 0)
    with open(os.open(path, flags), "rb") as file:  # noqa: PTH123 - what was looked at is what is opened
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is no file")
        size = found.st_size
        if size > most:
            raise OSError(errno.EFBIG, f"it is larger than {most} bytes")
        return file.read(size)


def replace(path: Path, content: bytes) -> None:
    """Write a file so that it holds the old content or the new one, whenever the power fails.

    Raises OSError. On Windows nobody's file can be replaced while somebody reads it: that is waited
    for.
    """
    fresh = path.with_name(f".{path.name[:100]}.{secrets.token_hex(8)}.new")
    try:
        with fresh.open("xb") as file:  # x: a name that is there already leads elsewhere
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        _rename(fresh, path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise
    if not _WINDOWS:  # the new name is to last as well
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _rename(fresh: Path, path: Path) -> None:
    for left in reversed(range(_TRIES)):
        try:
            fresh.replace(path)
            return
        except PermissionError:
            if not _WINDOWS or not left:
                raise
            time.sleep(_PAUSE)
