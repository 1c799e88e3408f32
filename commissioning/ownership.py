"""One owner a bus, on the whole machine."""

from __future__ import annotations

import contextlib
import hashlib
import threading
from collections.abc import Generator

from commissioning.locks import Lock, Taken, leave_word, take, word_left
from drivers.places import buses
from profiles.errors import Refused

__all__ = ["announce", "note_stop", "owned", "stopped_by"]


class _Holdings(threading.local):
    """What this thread has, so that a job may own a bus around its steps."""

    def __init__(self) -> None:
        self.locks: dict[str, Lock] = {}


_mine = _Holdings()


@contextlib.contextmanager
def owned(link: str, doing: str) -> Generator[None]:
    """The bus of a link for this thread alone; raises Refused while another one has it.

    `doing` : what it is used for, for those who are refused
    """
    with contextlib.ExitStack() as stack:
        for bus in buses(link):
            if bus in _mine.locks:
                continue
            try:
                lock = take(_name(bus), doing)
            except Taken as taken:
                raise Refused(
                    f"another tworelay has the bus of {link} ({taken.owner}): wait for it, or end "
                    "it",
                    code="refused.owned",
                    hint="'tworelay stop' works in spite of it",
                ) from None
            _mine.locks[bus] = lock
            stack.callback(_give_back, bus)
        yield


def announce(doing: str) -> None:
    """Let others know what this thread uses its buses for."""
    for lock in _mine.locks.values():
        lock.announce(doing)


def note_stop(link: str) -> None:
    """Let the owner of a bus, if it has one, know who stops a drive on it."""
    for bus in buses(link):
        leave_word(_name(bus), "tworelay stop")


def stopped_by(link: str, since: float) -> str:
    """Who has stopped a drive on the bus of a link in the last `since` s; '': nobody of ours."""
    return next(filter(None, (word_left(_name(bus), since) for bus in buses(link))), "")


def _name(bus: str) -> str:
    return hashlib.sha256(bus.encode()).hexdigest()[:20]


def _give_back(bus: str) -> None:
    _mine.locks.pop(bus).release()
