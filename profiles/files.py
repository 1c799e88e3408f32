"""Files that anybody may have written: read whole, and never more of them than is sensible."""

from __future__ import annotations

import errno
import os
from pathlib import Path

__all__ = ["contents"]


def contents(path: Path, most: int) -> bytes:
    """What a file of at most `most` bytes holds; raises OSError, also for what is no file or is larger.

    Devices and pipes, which have no size and no end, are refused before they are opened.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no file")
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"it is larger than {most} bytes")
        return file.read(size)
