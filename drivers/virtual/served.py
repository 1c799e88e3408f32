"""Virtual drives on one bus: which, where, and the wires that lead to them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING
from urllib.parse import quote

from drivers.virtual.axes import VirtualAxis
from drivers.virtual.device import Clock, ClockKind, Device
from drivers.virtual.firmware import SECOND, Firmware
from drivers.virtual.habits import NONE, Habits
from drivers.virtual.memory import Memory
from profiles.errors import UsageError
from profiles.schema import Profile

if TYPE_CHECKING:
    from drivers.virtual.can_wires import CanBus
    from drivers.virtual.canopen_node import CanopenNode
    from drivers.virtual.registers import RegisterMap

__all__ = ["BusOfDrives", "Endpoints", "Place", "ServedDrive", "opened"]

FIRST_UNIT, FIRST_NODE = 1, 5
BITRATE, BAUDRATE = 500_000, 115_200

Place = tuple[str, int]  # host and port; 0 is any free one


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Where a bus can be reached."""

    modbus_tcp: Place | None = None
    modbus_rtu_tcp: Place | None = None
    modbus_rtu_pty: bool = False
    socketcand: Place | None = None
    slcan_pty: bool = False

    @property
    def count(self) -> int:
        """How many wires there are."""
        return sum(map(bool, (self.modbus_tcp, self.modbus_rtu_tcp, self.modbus_rtu_pty))) + sum(
            map(bool, (self.socketcand, self.slcan_pty))
        )

    @property
    def is_modbus(self) -> bool:
        """Whether there is a Modbus wire."""
        return bool(self.modbus_tcp or self.modbus_rtu_tcp or self.modbus_rtu_pty)

    @property
    def is_canopen(self) -> bool:
        """Whether there is a CANopen wire."""
        return bool(self.socketcand or self.slcan_pty)


@dataclass(frozen=True, slots=True)
class ServedDrive:
    """One drive of a bus.

    Attributes
    ----------
    unit, node : what it is called there; each bus takes the one that it knows
    twin_of : whose objects or registers it has; None: its own
    """

    axis: VirtualAxis
    memory: Memory
    unit: int = FIRST_UNIT
    node: int = FIRST_NODE
    twin_of: Profile | None = None


@dataclass(frozen=True, slots=True)
class BusOfDrives:
    """Drives that share wires, and a clock."""

    drives: Sequence[ServedDrive]
    endpoints: Endpoints
    habits: Habits = NONE


@dataclass(frozen=True, slots=True)
class Opened:
    """A bus that is served.

    Attributes
    ----------
    links : of each drive, in their order
    poll : lets its timers run
    """

    links: Sequence[Sequence[str]]
    poll: Callable[[], None]


async def opened(bus: BusOfDrives, kind: ClockKind, stack: contextlib.AsyncExitStack) -> Opened:
    """Serve a bus until `stack` is closed; raises OSError, UsageError."""
    cycle = round(bus.drives[0].axis.cycle * SECOND)
    clock = Clock(kind, cycle)
    devices = [Device(Firmware(one.axis, one.memory), clock) for one in bus.drives]
    suffix = "&clock=step" if kind == "step" else ""
    links: list[list[str]] = [[] for _ in bus.drives]

    def lead(text: str, key: str) -> None:
        """A LINK to each drive, by its unit or node."""
        for one, found in zip(bus.drives, links, strict=True):
            found.append(text.replace("{}", f"{key}={getattr(one, key)}") + suffix)

    def poll() -> None:
        for device in devices:
            device.catch_up()

    ends = bus.endpoints
    for place, is_rtu in ((ends.modbus_tcp, False), (ends.modbus_rtu_tcp, True)):
        if place is not None:
            port = await _modbus(stack, _units(bus, devices), bus.habits, place, rtu=is_rtu)
            scheme = "modbus-rtu-tcp" if is_rtu else "modbus-tcp"
            lead(f"{scheme}://{_host(place[0])}:{port}?{{}}", "unit")
    if ends.modbus_rtu_pty:
        first = bus.drives[0].twin_of
        baudrate = (first and first.link.baudrate) or BAUDRATE
        path = _serial(stack, _units(bus, devices), bus.habits)
        lead(f"modbus-rtu://{path}?baudrate={baudrate}&{{}}", "unit")
    if ends.is_canopen:
        can = _can(bus, devices)
        poll = can.poll
        if ends.socketcand is not None:
            port = await _socketcand(stack, can, ends.socketcand)
            lead(f"canopen://socketcand/{_host(ends.socketcand[0])}:{port}/can0?{{}}", "node")
        if ends.slcan_pty:
            path = quote(_slcan(stack, can), safe="")
            lead(f"canopen://slcan/{path}?{{}}&bitrate={BITRATE}", "node")
    return Opened(links, poll)


# -- Modbus ---------------------------------------------------------------------------------------


def _units(bus: BusOfDrives, devices: Sequence[Device]) -> dict[int, RegisterMap]:
    """The registers of each drive by its unit."""
    from drivers.virtual.habitual_slave import bent
    from drivers.virtual.registers import OWN, RegisterMap
    from drivers.virtual.twin import modbus_twin

    habits = bus.habits.for_bus("modbus")
    units: dict[int, RegisterMap] = {}
    for one, device in zip(bus.drives, devices, strict=True):
        if one.twin_of is None:
            units[one.unit] = RegisterMap(device, bent(OWN, habits), habits=habits)
        else:
            units[one.unit] = modbus_twin(one.twin_of, device, habits)
    return units


async def _modbus(
    stack: contextlib.AsyncExitStack,
    units: Mapping[int, RegisterMap],
    habits: Habits,
    place: Place,
    *,
    rtu: bool,
) -> int:
    from drivers.virtual.habitual_slave import framings
    from drivers.virtual.modbus_server import ModbusServer

    server = ModbusServer(framings(units, habits, rtu=rtu))
    stack.callback(server.let_go)
    return await server.start(*place)


def _serial(
    stack: contextlib.AsyncExitStack, units: Mapping[int, RegisterMap], habits: Habits
) -> str:
    from drivers.virtual.habitual_slave import framings
    from drivers.virtual.modbus_server import SerialLine

    try:
        line = SerialLine(framings(units, habits, rtu=True)())
    except ImportError:
        raise UsageError("this system has no pseudo-terminals: use --modbus-rtu-tcp") from None
    stack.callback(line.close)
    return line.path


# -- CANopen --------------------------------------------------------------------------------------


def _can(bus: BusOfDrives, devices: Sequence[Device]) -> CanBus:
    from drivers.virtual.can_wires import CanBus

    node = partial(_node, habits=bus.habits)
    return CanBus([node(one, device) for one, device in zip(bus.drives, devices, strict=True)])


def _node(one: ServedDrive, device: Device, habits: Habits) -> CanopenNode:
    from drivers.virtual.canopen_node import CanopenNode
    from drivers.virtual.dictionary import OWN
    from drivers.virtual.habitual_node import HabitualNode
    from drivers.virtual.twin import habits_of_twin, twin

    dictionary = OWN
    if one.twin_of is not None:
        dictionary = twin(one.twin_of, one.axis)
        habits = habits_of_twin(one.twin_of, habits)
    if habits.values:
        return HabitualNode(device, one.node, dictionary, habits.for_bus("canopen"))
    return CanopenNode(device, one.node, dictionary)


async def _socketcand(stack: contextlib.AsyncExitStack, can: CanBus, place: Place) -> int:
    from drivers.virtual.can_wires import SocketcandServer

    server = SocketcandServer(can)
    port = await server.start(*place)
    stack.push_async_callback(server.close)
    return port


def _slcan(stack: contextlib.AsyncExitStack, can: CanBus) -> str:
    from drivers.virtual.can_wires import SlcanPty

    try:
        line = SlcanPty(can)
    except ImportError:
        raise UsageError("this system has no pseudo-terminals: use --socketcand") from None
    stack.callback(line.close)
    return line.path


def _host(host: str) -> str:
    return f"[{host}]" if ":" in host else host
