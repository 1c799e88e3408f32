"""Which units there are behind a Modbus connection: one register is read from each.

A unit that is not there answers in one of four ways: not at all, with exception 10 or 11 of a gateway, with
exception 1 … 4 of a server that answers for every unit, or with data, likewise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from drivers.modbus.bus import identify
from drivers.modbus.client import Client, ExceptionAnswer, NoAnswer
from profiles.errors import LinkError
from profiles.schema import Identity

__all__ = ["Unit", "is_there", "survey"]

_GATEWAY = (10, 11)  # gateway path unavailable, target failed to respond


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit that answers; its identity by FC 43/14, with empty texts where it has none."""

    number: int
    identity: Identity


def survey(
    client: Client, units: Iterable[int], timeout: float, tell: Callable[[int], None]
) -> Iterator[Unit]:
    """Units of `units` that answer; `tell` hears each number before it is asked. Raises LinkLost."""
    for number in units:
        tell(number)
        client.turn_to(number)
        if not is_there(client, timeout):
            continue
        try:
            found = identify(client)
        except LinkError:  # it answers to registers, and not to this
            found = Identity(vendor="", product="", revision="", serial="")
        yield Unit(number, found)


def is_there(client: Client, timeout: float) -> bool:
    """Whether the unit that the client talks to answers within `timeout` s."""
    try:
        client.read(3, 0, 1, timeout)
    except ExceptionAnswer as error:
        return error.code not in _GATEWAY
    except NoAnswer:
        return False
    return True
