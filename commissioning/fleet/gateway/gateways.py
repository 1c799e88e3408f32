"""The gateways of a fleet run: met before it, asked during it, let go after it."""

from __future__ import annotations

import asyncio
import platform
import queue
import tempfile
import threading
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from commissioning.desk import Desk
from commissioning.ending import operator, tool
from commissioning.fleet.crew import Spoken, Worker
from commissioning.fleet.gateway.errands import FarWorker, FleetOf
from commissioning.fleet.gateway.lines import Far, Opened
from commissioning.fleet.gateway.messages import (
    PROTOCOL,
    Ask,
    Axes,
    Chunk,
    FarAxis,
    Going,
    Greeting,
    PutBack,
    Restore,
    Stop,
    Stopped,
    Which,
)
from commissioning.fleet.gateway.parcels import received, unpack
from commissioning.fleet.ledger import LedgerRow
from commissioning.fleet.loading import check_joined, one_bus_each
from commissioning.fleet.plan import AtGateway as Told
from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.result.fleet import FleetJob
from commissioning.session.adopt import adopt
from drivers.errors import LinkError
from drivers.home import home
from profiles.axis import Axis
from profiles.errors import Refused, TwoRelayError, UsageError

__all__ = ["Background", "Gateways", "Loop", "gateways_of"]

_MEET = 15.0  # s, for all of them together
_CALL = 300.0  # s that a call which is waited for may take
T = TypeVar("T")


class Loop(Protocol):
    """Where what concerns gateways happens, beside what waits for it."""

    def do(self, work: Coroutine[Any, Any, T]) -> T:
        """Do it, and wait for it; raises what it raises."""

    def begin(self, work: Coroutine[Any, Any, None]) -> Callable[[], object]:
        """Have it done; returns what ends it."""

    def close(self) -> None:
        """No more of it."""


class Background:
    """A loop in a thread of its own."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def do(self, work: Coroutine[Any, Any, T]) -> T:
        """Do it there, and wait for it here."""
        future: Future[T] = asyncio.run_coroutine_threadsafe(work, self._loop)
        return future.result(_CALL)

    def begin(self, work: Coroutine[Any, Any, None]) -> Callable[[], object]:
        """Have it done there."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).cancel

    def close(self) -> None:
        """End the loop, and its thread."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_MEET)


class Gateways:
    """Lines to the gateways of a fleet file."""

    def __init__(self, fleet: Fleet, opened: Opened, loop: Loop) -> None:
        self._fleet = fleet
        self._loop = loop
        below = fleet.defaults.model_dump_json(exclude_unset=True)
        self._whose = FleetOf(
            "", below, str(fleet.path.resolve()), operator() or "", platform.node()
        )
        self._ask = Ask(PROTOCOL, tool().version, below)
        named = sorted({one.gateway for one in fleet.axes if one.gateway is not None})
        self._far = {name: Far(name, opened) for name in named}
        self._met: dict[str, Axes | TwoRelayError] = {}

    def meet(self) -> Mapping[str, Greeting | TwoRelayError]:
        """Greet each; what they tell, or why they cannot be had. Nothing is started by that."""

        async def one(far: Far) -> Axes | TwoRelayError:
            names = tuple(one.name for one in self._fleet.axes if one.gateway == far.name)
            try:
                async with asyncio.timeout(_MEET):
                    return await far.meet(replace(self._ask, axes=names))
            except TwoRelayError as error:
                return error
            except TimeoutError:
                text = f"gateway '{far.name}' has not answered in {_MEET:.0f} s"
                return LinkError(text, code="gateway.lost")

        async def all_of_them() -> list[Axes | TwoRelayError]:
            return await asyncio.gather(*(one(far) for far in self._far.values()))

        self._met = dict(zip(self._far, self._loop.do(all_of_them()), strict=True))
        return {
            name: found.gateway if isinstance(found, Axes) else found
            for name, found in self._met.items()
        }

    def joined(self) -> Fleet:
        """The fleet with what the gateways have told of their axes; raises UsageError."""
        told = {
            (name, one.name): one
            for name, found in self._met.items() if isinstance(found, Axes) for one in found.axes
        }  # fmt: skip
        axes = [
            one if one.gateway is None else self._described(one, told.get((one.gateway, one.name)))
            for one in self._fleet.axes
        ]
        places = [(one.gateway or "", told.get((one.gateway or "", one.name))) for one in axes]
        buses = one_bus_each(
            [{f"{at}/{bus}" for bus in found.buses} if found else () for at, found in places]
        )
        axes = [
            replace(one, bus=bus) if one.gateway is not None and bus else one
            for one, bus in zip(axes, buses, strict=True)
        ]
        cores = {
            name: found.gateway.cores
            for name, found in self._met.items() if isinstance(found, Axes)
        }  # fmt: skip
        fleet = replace(self._fleet, axes=tuple(axes), cores=cores)
        check_joined(fleet)
        return fleet

    def _described(self, one: PlannedAxis, told: FarAxis | None) -> PlannedAxis:
        met = self._met.get(one.gateway or "")
        if isinstance(met, TwoRelayError):
            return replace(one, broken=met)
        if told is None or told.error is not None:
            text = told.error.text if told and told.error else "it is not told of"
            return replace(one, broken=UsageError(f"gateway '{one.gateway}': {text}"))
        axis = Axis.model_validate_json(told.axis)
        for key in ("group", "zone"):
            mine, its = getattr(one, key), getattr(axis, key)
            if mine and its and mine != its:
                text = f"{key} of '{one.name}' is '{mine}' here, and '{its}' on '{one.gateway}'"
                return replace(one, broken=UsageError(text))
        far = Told(told.stepping, told.simulated, told.cut_off)
        return replace(one, axis=axis, far=far)

    # -- during a run -----------------------------------------------------------------------------

    def use(self, key: str) -> None:
        """They are for this fleet run from now on, by a name that no other client can have."""
        self._whose = replace(self._whose, run=key)
        for far in self._far.values():
            far.run = key

    def worker(self, gateway: str, heard: queue.SimpleQueue[Spoken | None]) -> Worker:
        """Whoever acts on a gateway."""
        return FarWorker(self._far[gateway], self._whose, heard, self._loop.begin, self._take_in)

    async def _take_in(self, far: Far, run: str) -> str:
        """Fetch a run, and adopt it unasked; its id here."""

        async def ask(chunk: Chunk) -> Chunk:
            return await far.insist("fetch", chunk, Chunk)

        data = await received(run, ask)
        return await asyncio.to_thread(_adopted, data)

    def settle(self, gateway: str, key: str, row: LedgerRow, job: FleetJob) -> Going:
        """How an attempt stands there; not started: it never will be. Raises TwoRelayError."""
        far = self._there(gateway)
        return self._loop.do(far.ask("settle", Which(key, row.axis, row.attempt, job), Going))

    def stop(self, gateway: str, key: str) -> Stopped:
        """Have all stopped that runs there for a fleet run; raises TwoRelayError."""
        return self._loop.do(self._there(gateway).ask("stop", Stop(key), Stopped))

    def restore(self, gateway: str, asked: Restore) -> PutBack:
        """Have settings put back there, or shown; raises TwoRelayError."""
        return self._loop.do(self._there(gateway).ask("restore", asked, PutBack, _CALL))

    def take_in(self, gateway: str, run: str) -> str:
        """Fetch a run; its id here. Raises TwoRelayError."""
        return self._loop.do(self._take_in(self._there(gateway), run))

    def _there(self, gateway: str) -> Far:
        met = self._met.get(gateway)
        if isinstance(met, TwoRelayError):
            raise met
        if met is None:
            raise Refused(f"gateway '{gateway}' is in the fleet file no more", code="gateway.gone")
        return self._far[gateway]

    def close(self) -> None:
        """Let go of all; what was started there goes on."""

        async def all_of_them() -> None:
            await asyncio.gather(*(far.close() for far in self._far.values()))

        self._loop.do(all_of_them())
        self._loop.close()


def gateways_of(fleet: Fleet) -> Gateways | None:
    """The lines of a fleet run, if any of its axes is behind a gateway; raises UsageError."""
    if all(one.gateway is None for one in fleet.axes):
        return None
    from commissioning.fleet.gateway.addresses import opener

    return Gateways(fleet, opener(fleet), Background())


def _adopted(data: bytes) -> str:
    with (
        tempfile.TemporaryDirectory() as folder,
        Interruption() as interruption,
        Journal(home()) as journal,
    ):
        unpack(data, Path(folder))
        desk = Desk(journal, interruption, lambda _: None, lambda _question, _word: True)
        return adopt(Path(folder), None, desk, lambda _: None, just_ended=True)
