"""Processes of this computer: whether one is alive, and how ours are started."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypedDict

__all__ = ["boot", "clock", "is_alive", "processors", "start", "this_process"]

_SAME = 2.0  # s; a number that was given again is further off
_LARGEST = 2**31


class Process(TypedDict):
    """What `is_alive` knows a process by."""

    pid: int
    started: float


def this_process() -> Process:
    """What the present process is known by."""
    return {"pid": os.getpid(), "started": _started(os.getpid())}


def boot() -> str:
    """What tells this start of the computer from others, in which numbers of processes recur."""
    import psutil

    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return f"{psutil.boot_time():.0f}"


def clock() -> float:
    """Seconds of a clock that nobody sets, and that goes on while the computer sleeps."""
    gettime: Callable[[int], float] | None = getattr(time, "clock_gettime", None)
    awake_or_not: int | None = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if gettime is None or awake_or_not is None else gettime(awake_or_not)


def processors() -> int:
    """How many this process may run on."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return found or 1


def _started(pid: int) -> float:
    """When a process started, s: since the computer did, where the system counts so.

    Else by the clock.
    """
    import psutil

    since = (
        psutil.boot_time() if sys.platform == "linux" else 0.0
    )  # both follow a clock that is set
    return float(psutil.Process(pid).create_time() - since)


def is_alive(pid: object, started: object = None) -> bool:
    """Whether the process `pid` of this computer runs, and is the one that `started` then."""
    if not isinstance(pid, int) or not 0 < pid < _LARGEST:
        return False
    import psutil

    try:
        if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return False
        return not isinstance(started, float) or abs(_started(pid) - started) < _SAME
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True  # another user's


def start(module: str, *arguments: str, **streams: Any) -> subprocess.Popen[Any]:
    """A module of ours in a process of its own, which a Ctrl-C in our terminal does not reach.

    Neither the working directory nor the script's is looked into for modules.
    """
    own = Path(__file__).resolve().parent
    command = [sys.executable, "-P", str(own / "child.py"), str(own.parent), module, *arguments]
    if sys.platform == "win32":
        return subprocess.Popen(  # noqa: S603
            command, creationflags=subprocess.CREATE_NEW_PROCESS_GROUP, **streams
        )
    return subprocess.Popen(command, start_new_session=True, **streams)  # noqa: S603
