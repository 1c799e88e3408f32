"""How the objects of a drive are reached.

A transport carries addresses of some kinds, and has its cycles.

What a drive has – CiA 402's dictionary, a vendor's registers – and how it is reached are two
things: a profile that `extends` another may name another transport, and keeps the objects that it
carries.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from profiles.address import CanopenAddress, MailboxAddress, ModbusAddress

__all__ = ["TRANSPORTS", "CycleFunction", "Transport", "TransportName", "transport_of"]

TransportName = Literal["modbus", "canopen"]
CycleFunction = Literal["fc23", "fc16+3", "fc6+3", "pdo"]


@dataclass(frozen=True, slots=True)
class Transport:
    """One way to a drive.

    Attributes
    ----------
    addresses : kinds of addresses that it carries
    cycles : how it can exchange set-point and feedback
    schemes : of the links that lead over it
    """

    name: TransportName
    addresses: tuple[type, ...]
    cycles: frozenset[CycleFunction]
    schemes: tuple[str, ...]


TRANSPORTS: dict[TransportName, Transport] = {
    one.name: one
    for one in (
        Transport("canopen", (CanopenAddress,), frozenset({"pdo"}), ("canopen",)),
        Transport(
            "modbus",
            (ModbusAddress, MailboxAddress),
            frozenset({"fc23", "fc16+3", "fc6+3"}),
            # virtual: registers without a wire
            ("modbus-tcp", "modbus-rtu", "modbus-rtu-tcp", "modbus-tls", "virtual"),
        ),
    )
}


def transport_of(scheme: str) -> Transport:
    """The transport of a link's scheme."""
    return next(one for one in TRANSPORTS.values() if scheme in one.schemes)
