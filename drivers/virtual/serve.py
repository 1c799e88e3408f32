"""Serve virtual drives to other processes."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

from drivers.realtime import real_time
from drivers.virtual.device import ClockKind
from drivers.virtual.served import BusOfDrives, Opened, opened
from profiles.errors import UsageError
from profiles.plain import plain

__all__ = ["serve"]

_TROUBLE = {
    errno.EADDRINUSE: "another program listens there; port 0 is any free one",
    errno.EADDRNOTAVAIL: "the address is not one of this machine",
    errno.EACCES: "this user may not listen there: take a port above 1023",
}
_COMPLAINTS = 20  # lines, at most
_POLL = 0.002  # s: how often timers of the drives run while nobody talks to them
_ASKED = 0.5  # s, between two looks at whether it is to end
_IDLE = 0.1  # s, where none runs by itself


Announce = Callable[[int, str], None]  # number of a drive, from 0 over all buses, and a LINK to it


def serve(
    buses: Sequence[BusOfDrives],
    kind: ClockKind,
    announce: Announce,
    until: Callable[[], bool] = lambda: False,
) -> int:
    """Serve until SIGINT or SIGTERM, and return which; `announce` gets one ready LINK at a time.

    `until` : asked now and then; it ends as by SIGTERM where that is so.

    In real time it has the loop's kind of priority, one below, where that is permitted.
    """
    urgent = real_time(below=1) if kind == "wall" else contextlib.nullcontext()
    try:
        with urgent:
            return asyncio.run(_serve(buses, kind, announce, until))
    except KeyboardInterrupt:
        return int(signal.SIGINT)


async def _serve(
    buses: Sequence[BusOfDrives],
    kind: ClockKind,
    announce: Announce,
    until: Callable[[], bool],
) -> int:
    end = asyncio.Event()
    loop = asyncio.get_running_loop()
    received = int(signal.SIGINT)

    def stop(number: int) -> None:
        nonlocal received
        received = number
        loop.set_exception_handler(lambda _loop, _context: None)  # what ends now need not complain
        end.set()

    loop.set_exception_handler(_Complaints())
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows: KeyboardInterrupt does it
            loop.add_signal_handler(number, stop, int(number))
    async with contextlib.AsyncExitStack() as stack:
        served = [await _opened(bus, kind, stack) for bus in buses]
        for drive, links in enumerate(links for one in served for links in one.links):
            for link in links:
                announce(drive, link)
        asked = loop.time()
        has_timers = kind == "wall" or any(bus.habits.values for bus in buses)
        while not end.is_set():
            if loop.time() > asked + _ASKED:
                asked = loop.time()
                if until():
                    return int(signal.SIGTERM)
            for one in served:
                one.poll()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(end.wait(), _POLL if has_timers else _IDLE)
    return received


async def _opened(bus: BusOfDrives, kind: ClockKind, stack: contextlib.AsyncExitStack) -> Opened:
    """Raises UsageError where it cannot listen."""
    try:
        return await opened(bus, kind, stack)
    except OSError as error:
        ends = bus.endpoints
        places = filter(None, (ends.modbus_tcp, ends.modbus_rtu_tcp, ends.socketcand))
        where = " or ".join(f"{host}:{port}" for host, port in places)
        raise UsageError(
            f"cannot serve on {where}: {_TROUBLE.get(error.errno or 0) or error.strerror or error}"
        ) from None


class _Complaints:
    """One line for each kind of trouble with a client, and not a traceback for each client."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def __call__(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        text = f"{context['message']} ({error})" if error is not None else str(context["message"])
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            text = (
                "no more clients can be served: this process has as many open files as it may have"
            )
        if text not in self._told and len(self._told) < _COMPLAINTS:
            self._told.add(text)
            sys.stderr.write(f"tworelay: {plain(text)}\n")
            sys.stderr.flush()
