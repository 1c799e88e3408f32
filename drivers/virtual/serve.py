"""Serve a virtual drive to other processes."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from drivers.realtime import real_time
from drivers.virtual.axes import VirtualAxis
from drivers.virtual.device import Clock, Device
from drivers.virtual.firmware import Firmware
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.memory import Memory
from profiles.errors import UsageError
from profiles.plain import plain
from profiles.schema import Profile

if TYPE_CHECKING:
    from drivers.virtual.registers import RegisterMap

__all__ = ["Endpoints", "serve"]

_TROUBLE = {
    errno.EADDRINUSE: "another program listens there; port 0 is any free one",
    errno.EADDRNOTAVAIL: "the address is not one of this machine",
    errno.EACCES: "this user may not listen there: take a port above 1023",
}
_COMPLAINTS = 20  # lines, at most
_POLL = 0.002  # s: how often timers of the drive run while nobody talks to it
_IDLE = 0.1  # s, where none runs by itself
NODE = 5
UNIT = 1
BITRATE, BAUDRATE = 500_000, 115_200


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Where to serve: (host, port) or None; port 0 is any free one."""

    modbus_tcp: tuple[str, int] | None = None
    modbus_rtu_tcp: tuple[str, int] | None = None
    modbus_rtu_pty: bool = False
    socketcand: tuple[str, int] | None = None
    slcan_pty: bool = False
    twin_of: Profile | None = None  # of another drive, on its own bus
    habits: Habits = NONE


def serve(
    axis: VirtualAxis,
    memory: Memory,
    endpoints: Endpoints,
    clock: Clock,
    announce: Callable[[str], None],
) -> int:
    """Serve until SIGINT or SIGTERM, and return which; `announce` gets one ready LINK at a time.

    In real time it has the loop's kind of priority, one below, where that is permitted.
    """
    urgent = real_time(below=1) if clock == "wall" else contextlib.nullcontext()
    try:
        with urgent:
            return asyncio.run(_serve(axis, memory, endpoints, clock, announce))
    except KeyboardInterrupt:
        return int(signal.SIGINT)


async def _serve(
    axis: VirtualAxis,
    memory: Memory,
    endpoints: Endpoints,
    clock: Clock,
    announce: Callable[[str], None],
) -> int:
    device = Device(Firmware(axis, memory), clock)
    suffix = "&clock=step" if clock == "step" else ""
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

    def registers() -> RegisterMap:
        from drivers.virtual.habitual_slave import bent
        from drivers.virtual.registers import OWN, RegisterMap
        from drivers.virtual.twin import modbus_twin

        twin_of = endpoints.twin_of
        habits = endpoints.habits.for_bus("modbus")
        if twin_of is None:
            return RegisterMap(device, bent(OWN, habits), habits=habits)
        return modbus_twin(twin_of, device, habits)

    async with contextlib.AsyncExitStack() as stack:
        poll: Callable[[], None] = device.catch_up
        try:
            if endpoints.modbus_tcp is not None:
                place = endpoints.modbus_tcp
                announce(await _modbus(stack, registers(), place, endpoints.habits) + suffix)
            if endpoints.modbus_rtu_tcp is not None:
                place = endpoints.modbus_rtu_tcp
                habits = endpoints.habits
                announce(await _modbus(stack, registers(), place, habits, rtu=True) + suffix)
            if endpoints.modbus_rtu_pty:
                of = endpoints.twin_of
                baudrate = (of and of.link.baudrate) or BAUDRATE
                announce(_serial(stack, registers(), endpoints.habits, baudrate) + suffix)
            if endpoints.socketcand is not None or endpoints.slcan_pty:
                poll, links = await _canopen(stack, device, endpoints)
                for link in links:
                    announce(link + suffix)
        except OSError as error:
            asked = (endpoints.modbus_tcp, endpoints.modbus_rtu_tcp, endpoints.socketcand)
            places = [p for p in asked if p is not None]
            where = " or ".join(f"{host}:{port}" for host, port in places)
            raise UsageError(
                f"cannot serve on {where}: "
                f"{_TROUBLE.get(error.errno or 0) or error.strerror or error}"
            ) from None
        has_timers = clock == "wall" or bool(endpoints.habits.values)
        while not end.is_set():
            poll()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(end.wait(), _POLL if has_timers else _IDLE)
    return received


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


async def _modbus(
    stack: contextlib.AsyncExitStack,
    registers: RegisterMap,
    place: tuple[str, int],
    habits: Habits,
    *,
    rtu: bool = False,
) -> str:
    from drivers.virtual.habitual_slave import framings
    from drivers.virtual.modbus_server import ModbusServer

    server = ModbusServer(framings(registers, UNIT, habits, rtu=rtu))
    stack.callback(server.let_go)
    port = await server.start(*place)
    scheme = "modbus-rtu-tcp" if rtu else "modbus-tcp"
    return f"{scheme}://{_host(place[0])}:{port}?unit={UNIT}"


def _serial(
    stack: contextlib.AsyncExitStack, registers: RegisterMap, habits: Habits, baudrate: int
) -> str:
    from drivers.virtual.habitual_slave import framings
    from drivers.virtual.modbus_server import SerialLine

    try:
        line = SerialLine(framings(registers, UNIT, habits, rtu=True)())
    except ImportError:
        raise UsageError("this system has no pseudo-terminals: use --modbus-rtu-tcp") from None
    stack.callback(line.close)
    return f"modbus-rtu://{line.path}?baudrate={baudrate}&unit={UNIT}"


async def _canopen(
    stack: contextlib.AsyncExitStack, device: Device, endpoints: Endpoints
) -> tuple[Callable[[], None], list[str]]:
    from drivers.virtual.can_wires import CanBus, SlcanPty, SocketcandServer
    from drivers.virtual.canopen_node import CanopenNode
    from drivers.virtual.dictionary import OWN
    from drivers.virtual.habitual_node import HabitualNode
    from drivers.virtual.twin import twin

    dictionary = OWN if endpoints.twin_of is None else twin(endpoints.twin_of, device.firmware.axis)
    habits = endpoints.habits
    bus = CanBus(
        HabitualNode(device, NODE, dictionary, habits.for_bus("canopen"))
        if habits.values
        else CanopenNode(device, NODE, dictionary)
    )
    links: list[str] = []
    if endpoints.socketcand is not None:
        server = SocketcandServer(bus)
        port = await server.start(*endpoints.socketcand)
        stack.push_async_callback(server.close)
        links.append(
            f"canopen://socketcand/{_host(endpoints.socketcand[0])}:{port}/can0?node={NODE}"
        )
    if endpoints.slcan_pty:
        try:
            line = SlcanPty(bus)
        except ImportError:
            raise UsageError("this system has no pseudo-terminals: use --socketcand") from None
        stack.callback(line.close)
        links.append(f"canopen://slcan/{quote(line.path, safe='')}?node={NODE}&bitrate={BITRATE}")
    return bus.poll, links


def _host(host: str) -> str:
    return f"[{host}]" if ":" in host else host
