"""Real-time priority and locked memory, where the system permits them; else nothing happens."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Generator

__all__ = ["real_time"]

_PRIORITY = 10  # of 1…99: above everything ordinary, below the kernel's own threads
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # <sys/mman.h> on Linux


@contextlib.contextmanager
def real_time(*, below: int = 0) -> Generator[bool]:
    """Run the body with SCHED_FIFO and pages that stay in memory; the value says whether it is so.

    `below`: by how much the priority is under the loop's, so that what serves the loop yields to
    it. Everything is as before afterwards. Other systems than Linux run the body as it is.
    """
    if sys.platform != "linux":
        yield False
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY - below))
    except OSError:
        yield False
        return
    locked = _lock_memory()
    try:
        yield True
    finally:
        if locked:
            ctypes.CDLL(None).munlockall()
        os.sched_setscheduler(0, policy, parameter)


def _lock_memory() -> bool:
    with contextlib.suppress(OSError, AttributeError):
        return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0)
    return False
