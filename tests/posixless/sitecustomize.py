"""Every Python process with this folder in its path is on something like Windows.

`sys.platform` says so, and
what only POSIX has is gone. Libraries are imported before, since they are as they are.
"""

# ruff: noqa: F401

import asyncio
import ctypes
import ctypes.wintypes
import fcntl
import importlib
import multiprocessing.connection
import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

GONE = {
    os: (
        "set_blocking", "sched_getscheduler", "sched_setscheduler", "sched_getparam", "sched_param",
        "SCHED_FIFO", "fork", "forkpty", "openpty", "ttyname", "geteuid", "getuid", "getgid",
        "getpgid",
        "killpg", "setsid", "mkfifo", "O_NOFOLLOW", "getloadavg", "sched_yield", "nice",
        "getpriority",
        "uname", "chown",
    ),
    signal: (
        "SIGHUP", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGSTOP", "SIGCONT", "setitimer", "alarm",
        "pause",
        "pthread_kill", "sigwait",
    ),
}  # fmt: skip


def _locking(descriptor: int, mode: int, count: int) -> None:
    """As msvcrt's: whole, and without waiting."""
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


class _Kernel:
    """Mutexes as kernel32's: a second one of a name is no error, and says that it was there."""

    class _Call:
        restype: object = None
        argtypes: object = None

        def __init__(self, action: Callable[..., int]) -> None:
            self._action = action

        def __call__(self, *arguments: Any) -> int:
            return self._action(*arguments)

    last_error = 0

    def __init__(self, name: str, *, use_last_error: bool) -> None:
        self.CreateMutexW = self._Call(self._create)
        self.CloseHandle = self._Call(self._close)
        self._open: dict[int, socket.socket] = {}

    def _create(self, attributes: None, owner: bool, name: str) -> int:
        mutex = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        _Kernel.last_error = 0
        try:
            mutex.bind(f"\0{name}")
        except OSError:
            _Kernel.last_error = 183
        self._open[mutex.fileno()] = mutex
        return mutex.fileno()

    def _close(self, handle: int) -> int:
        self._open.pop(handle).close()
        return 1


LIBRARIES = (
    "click", "rich.console", "rich.progress", "platformdirs", "psutil", "pydantic", "tomlkit",
    "jinja2",
    "serial", "serial.tools.list_ports", "can.interfaces.slcan", "can.interfaces.socketcand",
    "canopen",
    "pymodbus.client", "pymodbus.server", "numpy", "scipy.optimize", "scipy.interpolate",
    "scipy.sparse.linalg", "matplotlib.backends.backend_svg", "matplotlib.figure",
)  # fmt: skip


def _leave() -> None:
    for library in LIBRARIES:
        importlib.import_module(library)
    if sys.version_info >= (3, 12):
        os_names = tuple(
            name for name in GONE[os] if name != "set_blocking"
        )  # Windows has it by then
    else:
        os_names = GONE[os]
    for module, names in {**GONE, os: os_names}.items():
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    for name in ("fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"):
        sys.modules[name] = None  # type: ignore[assignment]
    windows = types.ModuleType("msvcrt")
    windows.LK_NBLCK = 2  # type: ignore[attr-defined]
    windows.locking = _locking  # type: ignore[attr-defined]
    sys.modules["msvcrt"] = windows
    ctypes.WinDLL = _Kernel  # type: ignore[attr-defined, misc]
    ctypes.get_last_error = lambda: _Kernel.last_error  # type: ignore[attr-defined]
    subprocess.CREATE_NEW_PROCESS_GROUP = 0  # type: ignore[attr-defined]
    sys.platform = "win32"


if os.environ.get("TWORELAY_POSIXLESS"):
    _leave()
