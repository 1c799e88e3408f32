"""What is on a bus: nodes or units, who they say they are, and which profile fits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.link import modbus_wire, open_can
from drivers.link_text import Link, parse
from profiles.errors import UsageError
from profiles.identity import Identity
from profiles.library import builtin_names, load_profile

__all__ = ["Heard", "scan"]

_TORQUE_BITS = 1 << 3 | 1 << 9  # of 6502h: torque, cyclic torque
_TIMEOUT = {
    "modbus-tcp": 0.3,
    "modbus-tls": 0.3,
    "modbus-rtu": 0.65,
    "modbus-rtu-tcp": 0.65,
    "canopen": 0.2,
}


@dataclass(frozen=True, slots=True)
class Heard:
    """One node or unit.

    Attributes
    ----------
    address : node or unit number
    link : LINK to it
    identity : what it says of itself; None where it answers nothing but a heartbeat
    profiles : built-in profiles that are for it
    note : what else there is to say
    """

    address: int
    link: str
    identity: Identity | None
    profiles: tuple[str, ...]
    note: str


def scan(
    text: str,
    units: Iterable[int],
    timeout: float | None,
    tell: Callable[[int], None],
) -> list[Heard]:
    """Look at a bus by a LINK without a node or unit; raises UsageError, LinkError.

    `units` are asked one after the other on Modbus; on CANopen all nodes are asked at once. `tell`
    hears each unit before it is asked. `timeout`: s for one of them.
    """
    link = parse(text)
    if link.scheme == "virtual":
        raise UsageError("scan: virtual:// is in this process; serve the axis to scan it")
    patience = timeout or _TIMEOUT[link.scheme]
    if link.scheme == "canopen":
        return _canopen(link, patience)
    return _modbus(link, units, patience, tell)


def _canopen(link: Link, timeout: float) -> list[Heard]:
    from drivers.canopen.survey import survey

    bus = open_can(link)
    try:
        nodes = survey(bus, timeout)
    finally:
        bus.shutdown()
    found = []
    for node in nodes:
        note = ""
        if node.identity is None:
            note = "heartbeat only: it answers no SDO"
        elif not node.is_drive:
            note = f"no drive by its device type (profile {node.device})"
        elif node.modes is not None and not node.modes & _TORQUE_BITS:
            note = f"no torque mode: 6502h is 0x{node.modes:X}"
        found.append(
            Heard(
                node.number, _with(link, "node", node.number), node.identity,
                _fitting(node.identity, "canopen"), note,
            )
        )  # fmt: skip
    return found


def _modbus(
    link: Link, units: Iterable[int], timeout: float, tell: Callable[[int], None]
) -> list[Heard]:
    from drivers.modbus.client import Client
    from drivers.modbus.survey import EVERYBODY, survey

    client = Client(modbus_wire(link, None), 0, max(timeout, 1.0))
    try:
        there = list(survey(client, units, timeout, tell))
    finally:
        client.close()
    same = EVERYBODY in there
    if same:
        there = there[:1]
    note = "answers to every unit number: it is one drive" if same else ""
    return [
        Heard(
            unit.number, _with(link, "unit", unit.number),
            unit.identity if unit.identity.vendor or unit.identity.product else None,
            _fitting(unit.identity, "modbus"),
            note or ("" if unit.identity.vendor else "does not say who it is (no FC 43/14)"),
        )
        for unit in there
    ]  # fmt: skip


def _with(link: Link, key: str, number: int) -> str:
    """The LINK with a node or unit in it."""
    base, _, query = link.text.partition("?")
    kept = [part for part in query.split("&") if part and not part.startswith(f"{key}=")]
    return f"{base}?{'&'.join([f'{key}={number}', *kept])}"


def _fitting(identity: Identity | None, bus: str) -> tuple[str, ...]:
    if identity is None:
        return ()
    profiles = [load_profile(name) for name in builtin_names()]
    return tuple(
        p.name
        for p in profiles
        if p.bus == bus and not p.identity.empty and p.identity.accepts(identity)
    )
