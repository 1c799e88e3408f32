"""Processes of this computer: whether one is alive, and how ours are started."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

__all__ = ["is_alive", "start", "this_process"]

_SAME = 2.0  # s: a clock may be set a little; a number that was given again is further off
_LARGEST = 2**31


def this_process() -> dict[str, Any]:
    """What `is_alive` knows this process by."""
    import psutil

    return {"pid": os.getpid(), "started": psutil.Process().create_time()}


def is_alive(pid: object, started: object = None) -> bool:
    """Whether the process `pid` of this computer runs, and is the one that `started` then, s."""
    if not isinstance(pid, int) or not 0 < pid < _LARGEST:
        return False
    import psutil

    try:
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return False
        return not isinstance(started, float) or abs(process.create_time() - started) < _SAME
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True  # another user's


def start(module: str, *arguments: str, **streams: Any) -> subprocess.Popen[Any]:
    """A module of ours in a process of its own, which a Ctrl-C in our terminal does not reach."""
    command = [sys.executable, "-m", module, *arguments]
    if sys.platform == "win32":
        return subprocess.Popen(  # noqa: S603
            command, creationflags=subprocess.CREATE_NEW_PROCESS_GROUP, **streams
        )
    return subprocess.Popen(command, start_new_session=True, **streams)  # noqa: S603
