"""The gateways of a fleet run: met before it, asked during it, let go after it."""

from __future__ import annotations

import asyncio
import platform
import queue
import secrets
import tempfile
import threading
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from commissioning.desk import Desk, Options
from commissioning.ending import operator, tool
from commissioning.fleet.crew import Spoken, Worker
from commissioning.fleet.file import Gateway
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
from commissioning.fleet.loading import check_joined, one_bus_each, place_in
from commissioning.fleet.plan import AtGateway as Told
from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.fleet.rows import FleetRecord, LedgerRow
from commissioning.interruption import Interruption
from commissioning.journal import Journal
from commissioning.result.changes import Written
from commissioning.result.fleet import FleetJob
from commissioning.session.adopt import adopt
from drivers.errors import LinkError
from drivers.home import home
from profiles.axis import Axis
from profiles.errors import Refused, TwoRelayError, UsageError

__all__ = ["Background", "Gateways", "Loop", "fleet_of", "gateways_by", "gateways_of"]

_MEET = 15.0  # s, for all of them together
_OF_THE_FLEET = {"group", "zone", "gateway", "twin"}  # of its defaults, and no matter of gateways
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
        try:
            return future.result(2 * _CALL)
        except TimeoutError:
            future.cancel()
            raise LinkError("a gateway does not answer", code="gateway.lost") from None

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
        below = fleet.defaults.model_dump_json(exclude_unset=True, exclude=_OF_THE_FLEET)
        self._whose = FleetOf(
            "", below, str(fleet.path.resolve()), operator() or "", platform.node()
        )
        self._ask = Ask(PROTOCOL, tool().version, below)
        named = sorted({one.gateway for one in fleet.axes if one.gateway is not None})
        self._far = {name: Far(name, opened) for name in named}
        self._met: dict[str, Axes | TwoRelayError] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Of the gateways."""
        return tuple(self._far)

    def meet(self) -> Mapping[str, Greeting | TwoRelayError]:
        """Greet each; what they tell, or why they cannot be had. Nothing is started by that."""

        async def one(far: Far) -> Axes | TwoRelayError:
            axes = [one for one in self._fleet.axes if one.gateway == far.name]
            names = tuple(one.name for one in axes if one.name != one.gateway)
            try:
                async with asyncio.timeout(_MEET):
                    return await far.meet(replace(self._ask, axes=names), _MEET)
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
        fleet = replace(self._fleet, axes=tuple(axes), cores=cores, as_read=self._fleet)
        check_joined(fleet)
        return fleet

    def _described(self, one: PlannedAxis, told: FarAxis | None) -> PlannedAxis:
        met = self._met.get(one.gateway or "")
        if isinstance(met, TwoRelayError):
            return replace(one, broken=met)
        if told is None or told.error is not None:
            text = told.error.text if told and told.error else "it is not told of"
            return replace(one, broken=UsageError(f"gateway '{one.gateway}': {text}"))
        try:
            axis = Axis.model_validate_json(told.axis)
            group, zone = self._place(one, axis)
        except TwoRelayError as error:
            return replace(one, broken=error)
        except ValueError as error:
            text = f"gateway '{one.gateway}' tells of '{one.name}' what is not understood: {error}"
            return replace(one, broken=Refused(text, code="gateway.version"))
        far = Told(told.stepping, told.simulated, told.cut_off)
        return replace(one, axis=axis, far=far, group=group, zone=zone)

    def _place(self, one: PlannedAxis, axis: Axis) -> tuple[str | None, str | None]:
        """Group and zone: as said of the axis here, else in its file, else in the defaults."""
        found: dict[str, str | None] = {}
        for key in ("group", "zone"):
            mine, its = getattr(one, key), getattr(axis, key)
            if mine and its and mine != its and key in one.said:
                raise UsageError(
                    f"{key} of '{one.name}' is '{mine}' here, and '{its}' on '{one.gateway}'"
                )
            found[key] = mine if key in one.said else its or mine
        where = f"{self._fleet.path}: '{one.name}', by its file on '{one.gateway}'"
        return place_in(self._fleet, where, found["group"], found["zone"])

    # -- during a run -----------------------------------------------------------------------------

    def use(self, key: str) -> None:
        """They are for this fleet run from now on, by a name that no other client can have."""
        self._whose = replace(self._whose, run=key)
        for far in self._far.values():
            far.run = key

    def worker(self, gateway: str, heard: queue.SimpleQueue[Spoken | None]) -> Worker:
        """Whoever acts on a gateway."""
        return FarWorker(self._far[gateway], self._whose, heard, self._loop.begin, self._take_in)

    async def _take_in(self, far: Far, run: str, written: tuple[Written, ...]) -> str:
        """Fetch a run, and adopt it unasked; its id here. `written`: what it has in its drive."""

        async def ask(chunk: Chunk) -> Chunk:
            return await far.insist("fetch", chunk, Chunk)

        data = await received(run, ask)
        return await asyncio.to_thread(_adopted, data, written)

    def settle(self, gateway: str, key: str, row: LedgerRow, job: FleetJob) -> Going:
        """How an attempt stands there; not started: it never will be. Raises TwoRelayError."""
        far = self._there(gateway)
        return self._loop.do(far.ask("settle", Which(key, row.axis, row.attempt, job), Going))

    def stop_all(self, key: str) -> Mapping[str, tuple[str, ...] | TwoRelayError]:
        """Have all stopped that runs for a fleet run, on each as soon as it is there."""
        stop = Stop(key, secrets.token_hex(8))

        async def one(far: Far) -> tuple[str, ...] | TwoRelayError:
            try:
                async with asyncio.timeout(_MEET):
                    if self._met.get(far.name) is None:
                        self._met[far.name] = await far.meet(replace(self._ask, axes=()))
                    return (await far.ask("stop", stop, Stopped)).axes
            except TwoRelayError as error:
                self._met.setdefault(far.name, error)
                return error
            except TimeoutError:
                return LinkError(f"no answer in {_MEET:.0f} s", code="gateway.lost")

        async def all_of_them() -> list[tuple[str, ...] | TwoRelayError]:
            return await asyncio.gather(*(one(far) for far in self._far.values()))

        return dict(zip(self._far, self._loop.do(all_of_them()), strict=True))

    def restore(self, gateway: str, asked: Restore) -> PutBack:
        """Have settings put back there, or shown; raises TwoRelayError."""
        return self._loop.do(self._there(gateway).ask("restore", asked, PutBack, _CALL))

    def take_in(self, gateway: str, run: str, written: tuple[Written, ...]) -> str:
        """Fetch a run, which has `written` so much; its id here. Raises TwoRelayError."""
        return self._loop.do(self._take_in(self._there(gateway), run, written))

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


def gateways_by(record: FleetRecord) -> Gateways:
    """Those of a fleet run as its file was when it began, whatever that says now.

    Raises UsageError.
    """
    from commissioning.fleet.gateway.addresses import opener

    fleet = fleet_of(record)
    return Gateways(fleet, opener(fleet), Background())


def fleet_of(record: FleetRecord) -> Fleet:
    """What is left of a fleet file in the ledger: its gateways, an axis of each to name it."""
    gateways = {name: Gateway.model_validate(dict(one)) for name, one in record.gateways.items()}
    axes = tuple(PlannedAxis(name, None, Options(), gateway=name) for name in gateways)
    return Fleet(
        Path(record.file), record.name, record.job, "each", axes, {}, {}, gateways=gateways
    )


def gateways_of(fleet: Fleet) -> Gateways | None:
    """The lines of a fleet run, if any of its axes is behind a gateway; raises UsageError."""
    if all(one.gateway is None for one in fleet.axes):
        return None
    from commissioning.fleet.gateway.addresses import opener

    return Gateways(fleet, opener(fleet), Background())


def _adopted(data: bytes, written: tuple[Written, ...]) -> str:
    with (
        tempfile.TemporaryDirectory() as folder,
        Interruption() as interruption,
        Journal(home()) as journal,
    ):
        unpack(data, Path(folder))
        desk = Desk(journal, interruption, lambda _: None, lambda _question, _word: True)
        return adopt(Path(folder), None, desk, lambda _: None, written=written)
