"""A gateway as a process: one a home, until it is told to end."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import signal
from collections.abc import Callable
from pathlib import Path

from commissioning.errors import Interrupted
from commissioning.fleet.crew import Crew
from commissioning.fleet.gateway.folder import AxisFolder
from commissioning.fleet.gateway.keys import EXTRA, context, the_one
from commissioning.fleet.gateway.station import Station
from commissioning.interruption import Interruption
from commissioning.locks import Lock, Taken, take
from drivers.home import home
from drivers.link_text import is_loopback
from profiles.errors import Refused, UsageError

__all__ = ["run_gateway"]

_LOOK = 0.1  # s
_TO_FETCH = 10.0  # s
Tell = Callable[[str], None]
Hire = Callable[[Path], Crew]


def run_gateway(
    address: tuple[str, int], axes: Path, keys: Path, name: str | None, tell: Tell,
    interruption: Interruption, hire: Hire = Crew,
) -> None:  # fmt: skip
    """Serve the axes of a folder until a signal comes; what moves then ends its job first.

    Raises UsageError, Refused, LinkError. `hire` : the crew, whose folder it gets.
    """
    try:
        from commissioning.fleet.gateway import engine
    except ImportError:
        raise UsageError(EXTRA) from None
    folder = AxisFolder(axes)
    name, files = the_one(keys, "gateway", name)
    tls = context(files, "gateway")
    lock = _only_one(name)
    own = home() / "gateway"
    own.mkdir(parents=True, exist_ok=True)
    crew = hire(own)

    async def serving() -> None:
        ended = asyncio.Event()
        watching: list[asyncio.Task[None]] = []

        def ready(station: Station, port: int) -> None:
            count = len(folder.files())
            tell(
                f"gateway '{name}' listens on {address[0]}:{port}; {count} axis files in {axes}; "
                f"its ledger and runs: {home()}; Ctrl-C ends it"
            )
            if not is_loopback(address[0]):
                tell(f"whoever reaches {address[0]} and has a client's key can move these axes")
            for line in folder.faults():
                tell(line)
            watching.append(asyncio.create_task(_until_told(station, interruption, tell, ended)))

        await engine.serve(
            lambda on_news: Station(name, folder, home(), crew, on_news=on_news, tell=tell),
            address, tls, ready, ended,
        )  # fmt: skip

    try:
        with contextlib.suppress(Interrupted), interruption.deferred():  # that is how it ends
            asyncio.run(serving())
            crew.close(lambda: interruption.count)
    finally:
        lock.release()
    tell(f"gateway '{name}' has ended")


def _only_one(name: str) -> Lock:
    """Of a home: its ledger has one gateway; raises Refused."""
    mark = hashlib.sha256(str(home().resolve()).encode()).hexdigest()[:20]
    try:
        return take(f"gateway-{mark}", f"gateway {name}")
    except Taken as taken:
        raise Refused(
            f"a gateway with the home {home()} is running already ({taken.owner})",
            code="run.in-progress",
        ) from None


async def _until_told(
    station: Station, interruption: Interruption, tell: Tell, ended: asyncio.Event
) -> None:
    """Until a signal comes, and nothing moves any more."""
    while not interruption.count:
        await asyncio.sleep(_LOOK)
    station.is_closing = True
    heeded = 1
    if interruption.signal == signal.SIGTERM:
        heeded = 0
    elif station.moving:
        moving = ", ".join(station.moving)
        tell(f"{moving}: finished first, and nothing more starts; once more stops it")
    while station.moving:
        if interruption.count > heeded:
            heeded = interruption.count
            tell(f"{', '.join(station.moving)}: stopped")
            station.interrupt()
        await asyncio.sleep(_LOOK)
    until = asyncio.get_running_loop().time() + _TO_FETCH
    while station.is_awaited and asyncio.get_running_loop().time() < until:
        await asyncio.sleep(_LOOK)  # a client hears how it ended, and fetches what was measured
    ended.set()
