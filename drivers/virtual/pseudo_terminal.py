"""A pseudo-terminal, for virtual drives on serial lines between processes of this computer."""

from __future__ import annotations

import os
import sys

__all__ = ["pseudo_terminal"]


def pseudo_terminal() -> tuple[int, int, str]:
    """Both ends, raw, and the path of the client's; the near end does not block.

    Raises ImportError.

    The client's end stays open here, so that clients may come and go.
    """
    if sys.platform == "win32":
        raise ImportError("this system has no pseudo-terminals")
    import pty
    import tty

    near, client = pty.openpty()
    tty.setraw(client)
    os.set_blocking(near, False)
    return near, client, os.ttyname(client)
