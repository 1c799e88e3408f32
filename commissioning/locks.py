r"""Locks of the whole machine by name, which the system gives back when their process ends.

Abstract sockets on Linux, `Global\` mutexes on Windows; elsewhere files that every user can take.
"""

from __future__ import annotations

import contextlib
import getpass
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from drivers.home import home
from profiles.errors import Refused

__all__ = ["Lock", "Owner", "Taken", "leave_word", "take", "word_left"]


class Owner(NamedTuple):
    """Who has a lock; None and '' where the system does not tell."""

    process: int | None
    user: str
    doing: str
    since: float | None  # s, by the clock

    def __str__(self) -> str:
        parts = [f"process {self.process or 'unknown'}"]
        parts += [f"user {self.user}"] if self.user else []
        parts += [self.doing] if self.doing else []
        if self.since is not None:
            parts.append(f"since {time.strftime('%H:%M:%S', time.localtime(self.since))}")
        return ", ".join(parts)


class Lock(Protocol):
    """A lock that this process has."""

    def announce(self, doing: str) -> None:
        """Let others know what it is held for."""

    def release(self) -> None:
        """Give it back."""


class Taken(Exception):
    """Somebody else has the lock."""

    def __init__(self, owner: Owner) -> None:
        super().__init__(str(owner))
        self.owner = owner


def take(name: str, doing: str) -> Lock:
    """The lock `name` for this process; raises Taken, Refused."""
    kind: Callable[[str, str], Lock]
    if sys.platform == "linux":
        kind = SocketLock
    elif sys.platform == "win32":
        kind = Mutex
    else:
        kind = FileLock
    return kind(name, doing)


def _note(since: float, doing: str) -> str:
    """What an owner writes of itself."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError, ImportError):
        user = ""
    return "\t".join((str(os.getpid()), user, f"{since:.0f}", " ".join(doing.split())))


def _noted(file: Path) -> Owner:
    """What an owner wrote of itself; unknown where it cannot be read, or is no such note."""
    try:
        process, user, since, doing = file.read_text("utf-8", "replace").split("\t")
        return Owner(int(process), user, doing, float(since))
    except (OSError, ValueError):
        return Owner(None, "", "", None)


def leave_word(name: str, doing: str) -> None:
    """Note what this process does to what `name` locks; nothing hangs on it."""
    with contextlib.suppress(OSError):
        file = home() / "words" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(_note(time.time(), doing), "utf-8")


def word_left(name: str, within: float) -> str:
    """Who left word within so many s, and of what; '': nobody."""
    owner = _noted(home() / "words" / name)
    age = time.time() - owner.since if owner.since is not None else -1.0
    return str(owner) if -1.0 < age <= within else ""  # noted in whole seconds


if sys.platform == "linux":
    import pwd
    import socket

    _LONGEST = 40  # characters of what an owner does, in the name of a socket

    class SocketLock:
        """A socket in the abstract namespace.

        A second one's name says whose it is, since when, what for.
        """

        def __init__(self, name: str, doing: str) -> None:
            self._name, self._since = f"tworelay.{name}", time.time()
            self._lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try:
                self._lock.bind(f"\0{self._name}")
            except OSError:
                self._lock.close()
                raise Taken(_owner_of(self._name)) from None
            self._told: socket.socket | None = None
            self.announce(doing)

        def announce(self, doing: str) -> None:
            """Say it in the name of a socket, which every user can list."""
            told = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            said = re.sub(r"[^\w. -]+", "-", doing, flags=re.ASCII)[:_LONGEST]
            with contextlib.suppress(OSError):  # it is only for those who are refused
                told.bind(f"\0{self._name}.{os.getpid()}.{os.geteuid()}.{self._since:.0f}.{said}")
            if self._told is not None:
                self._told.close()
            self._told = told

        def release(self) -> None:
            """Close both."""
            self._lock.close()
            if self._told is not None:
                self._told.close()

    def _owner_of(name: str) -> Owner:
        """What the owner of a socket says of itself."""
        try:
            names = Path("/proc/net/unix").read_text("utf-8", "replace")
        except OSError:
            names = ""
        found = re.search(rf"@{re.escape(name)}\.(\d+)\.(\d+)\.(\d+)\.(.*)", names)
        if found is None:
            return Owner(None, "", "", None)
        user = found[2]
        with contextlib.suppress(KeyError):
            user = pwd.getpwuid(int(user)).pw_name
        return Owner(int(found[1]), user, found[4], float(found[3]))


if sys.platform == "win32":
    import ctypes
    from ctypes import wintypes

    _ALREADY_EXISTS = 183

    class Mutex:
        """A mutex of all sessions; a file beside it says who has it."""

        def __init__(self, name: str, doing: str) -> None:
            self._since = time.time()
            folder = Path(os.environ.get("PROGRAMDATA", tempfile.gettempdir())) / "tworelay"
            self._file = folder / name
            kernel = ctypes.WinDLL("kernel32", use_last_error=True)
            kernel.CreateMutexW.restype = wintypes.HANDLE
            kernel.CreateMutexW.argtypes = (wintypes.LPVOID, wintypes.BOOL, wintypes.LPCWSTR)
            kernel.CloseHandle.argtypes = (wintypes.HANDLE,)
            self._close = kernel.CloseHandle
            self._handle = kernel.CreateMutexW(None, False, f"Global\\tworelay-{name}")
            if not self._handle:  # another user's, which cannot even be opened
                raise Taken(_noted(self._file))
            if ctypes.get_last_error() == _ALREADY_EXISTS:
                self.release()
                raise Taken(_noted(self._file))
            self.announce(doing)

        def announce(self, doing: str) -> None:
            """Write it beside, where that can be done."""
            with contextlib.suppress(OSError):
                self._file.parent.mkdir(exist_ok=True)
                self._file.write_text(_note(self._since, doing), "utf-8")

        def release(self) -> None:
            """Close it: nobody else has it open."""
            self._close(self._handle)


if sys.platform != "win32":
    import fcntl

    _FOLDER = Path("/tmp/tworelay-locks")  # noqa: S108  the same for every user, whatever TMPDIR says

    class FileLock:
        """A file that is locked, in a folder that every user can write to."""

        def __init__(self, name: str, doing: str) -> None:
            self._since = time.time()
            folder, file = _FOLDER, _FOLDER / name
            try:
                folder.mkdir(exist_ok=True)
                with contextlib.suppress(PermissionError):  # another user's, who has done the same
                    folder.chmod(0o1777)
                descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
                with contextlib.suppress(PermissionError):
                    file.chmod(0o666)
            except PermissionError:
                raise Taken(_noted(file)) from None  # it cannot be asked, so it is held
            except OSError as error:
                raise Refused(
                    f"no lock can be made in {folder} ({error.strerror}): without it two programs "
                    "could move one axis",
                    code="refused.lock",
                    hint="remove what is there, or make it writable",
                ) from None
            self._file = os.fdopen(descriptor, "r+", encoding="utf-8", errors="replace")
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                self._file.close()
                raise Taken(_noted(file)) from None
            self.announce(doing)

        def announce(self, doing: str) -> None:
            """Write it into the file."""
            self._file.seek(0)
            self._file.truncate()
            self._file.write(_note(self._since, doing))
            self._file.flush()

        def release(self) -> None:
            """Unlock it; the file stays for the next one."""
            self._file.seek(0)
            self._file.truncate()
            self._file.close()
