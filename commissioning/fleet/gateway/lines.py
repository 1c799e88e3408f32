"""The client's side of each gateway: a line that is opened anew when it breaks, and its news."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias, TypeVar

from commissioning.ending import tool
from commissioning.fleet.gateway.messages import (
    PROTOCOL,
    Ask,
    Axes,
    Declined,
    News,
    Piece,
    Since,
    Wire,
)
from commissioning.result.fleet_codec import json_of, of_json
from drivers.errors import LinkError, LinkLost
from profiles.errors import Refused, TwoRelayError, UsageError

__all__ = ["PATIENCE", "Far", "Heard", "Opened"]

PATIENCE = 40.0  # s without an answer, after which nothing that was offered can begin any more
_ANSWER = 5.0  # s
_AGAIN = 0.2, 2.0  # s between tries at a line: at first, at most
_REFUSED: dict[int, type[TwoRelayError]] = {2: UsageError, 4: LinkError}
T = TypeVar("T")
Opened = Callable[[str], Awaitable[Wire]]  # by the name of the gateway; raises TwoRelayError
Heard: TypeAlias = asyncio.Queue[Piece | None]  # None: the line is new, pieces may be lost


class Far:
    """One gateway, as a fleet run has it.

    Attributes
    ----------
    run : of which there is to be heard, as no other client can have it
    lost_since : s of the loop's clock, when it was last heard; None: it is there
    """

    def __init__(self, name: str, opened: Opened) -> None:
        self.name = name
        self.run = ""
        self._opened = opened
        self._line: Wire | None = None
        self._life = ""
        self._number = 0
        self._listening: dict[tuple[str, int], Heard] = {}
        self._tending: asyncio.Task[None] | None = None
        self.lost_since: float | None = None
        self._there = asyncio.Event()

    async def meet(self, ask: Ask, seconds: float = _ANSWER) -> Axes:
        """Open the line and greet; raises TwoRelayError. From then on it is kept open."""
        self._line = await self._opened(self.name)
        try:
            found = await self._said("hello", ask, Axes, seconds)
        except TwoRelayError:
            await self._drop()
            raise
        self._life = found.gateway.life
        self._there.set()
        self._tending = asyncio.create_task(self._tend())
        return found

    async def close(self) -> None:
        """Let go of it; what was started there goes on."""
        if self._tending is not None:
            self._tending.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await self._tending
        await self._drop()

    # -- asking -----------------------------------------------------------------------------------

    async def ask(self, verb: str, asked: Any, kind: type[T], seconds: float = _ANSWER) -> T:
        """Ask once; raises what it was refused with, LinkLost where it may have been heard."""
        if not self._there.is_set():
            raise LinkLost(f"gateway '{self.name}' does not answer", code="gateway.lost")
        return await self._said(verb, asked, kind, seconds)

    async def insist(self, verb: str, asked: Any, kind: type[T]) -> T:
        """Ask until there is an answer; for what may be done twice. Raises LinkLost at last."""
        loop = asyncio.get_running_loop()
        until = loop.time() + PATIENCE
        while True:
            try:
                return await self.ask(verb, asked, kind)
            except LinkLost:
                if loop.time() >= until:
                    raise
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._there.wait(), until - loop.time())
            await asyncio.sleep(_AGAIN[0])

    async def _said(self, verb: str, asked: Any, kind: type[T], seconds: float) -> T:
        if self._line is None:
            raise LinkLost(f"gateway '{self.name}' does not answer", code="gateway.lost")
        text = await self._line.call(verb, json_of(asked), seconds)
        try:
            if not text.startswith("-"):
                return of_json(text[1:], kind)
            no = of_json(text[1:], Declined)
        except ValueError as error:
            raise Refused(
                f"gateway '{self.name}' answers what is not understood here ({error})",
                code="gateway.version",
                hint="install one version on both computers",
            ) from None
        raise _REFUSED.get(no.exit_code, Refused)(no.text, code=no.code, hint=no.hint)

    # -- listening --------------------------------------------------------------------------------

    def listen(self, axis: str, attempt: int) -> Heard:
        """What is said of an axis from now on."""
        return self._listening.setdefault((axis, attempt), asyncio.Queue())

    def forget(self, axis: str, attempt: int) -> None:
        """Nothing more of it is wanted."""
        self._listening.pop((axis, attempt), None)

    async def _tend(self) -> None:
        pause = _AGAIN[0]
        while True:
            try:
                if self._line is None:
                    await self._open()
                await self._hear_news()
                pause = _AGAIN[0]
            except Exception:  # whatever it is, the line is opened anew
                await self._drop()
                await asyncio.sleep(pause)
                pause = min(2 * pause, _AGAIN[1])

    async def _open(self) -> None:
        """The line anew, and whoever listens is told that pieces may be lost."""
        self._line = await self._opened(self.name)
        found = await self._said("hello", Ask(PROTOCOL, tool().version), Axes, _ANSWER)
        if found.gateway.life != self._life:
            self._life, self._number = found.gateway.life, 0
        self.lost_since = None
        self._there.set()
        for queue in self._listening.values():
            queue.put_nowait(None)

    async def _hear_news(self) -> None:
        if not self._listening:
            await asyncio.sleep(_AGAIN[0])
            return
        asked = Since(self.run, self._life, self._number)
        news = await self._said("news", asked, News, _ANSWER)
        if news.life != self._life:
            raise LinkLost(f"gateway '{self.name}' was started anew", code="gateway.lost")
        self._number = news.number
        for piece in news.pieces:
            queue = self._listening.get((piece.axis, piece.attempt))
            if queue is not None:
                queue.put_nowait(piece)

    async def _drop(self) -> None:
        line, self._line = self._line, None
        if self._there.is_set():
            self._there.clear()
            self.lost_since = asyncio.get_running_loop().time()
        if line is not None:
            with contextlib.suppress(Exception):
                await line.close()
