"""Which units there are behind a Modbus connection: one register is read from each.

A unit that is not there answers in one of four ways: not at all, with exception 10 or 11 of a
gateway, with exception 1 … 4 of a server that answers for every unit, or with data, likewise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from drivers.errors import AccessDenied, LinkError
from drivers.modbus.answers import ExceptionAnswer
from drivers.modbus.bus import identify
from drivers.modbus.client import Client, NoAnswer
from profiles.identity import NOBODY, Identity

__all__ = ["EVERYBODY", "HeardUnit", "is_there", "survey"]

_GATEWAY = (10, 11)  # gateway path unavailable, target failed to respond
_SUSPICIOUS, _FAR = 4, 3  # units that answer, from the first on, and from the last


@dataclass(frozen=True, slots=True)
class HeardUnit:
    """A unit that answers; its identity by FC 43/14, with empty texts where it has none."""

    number: int
    identity: Identity


EVERYBODY = HeardUnit(-1, NOBODY)  # after the others: every number answers, so it is one drive


def survey(
    client: Client, units: Iterable[int], timeout: float, tell: Callable[[int], None]
) -> Iterator[HeardUnit]:
    """Units of `units` that answer; `tell` hears each number before it is asked. Raises LinkLost.

    Where the first few all answer, and so do some far away, it is one drive that does not look at
    the number: the first stands for all.
    """
    left = list(units)
    row = 0  # of units that answered, from the first on
    for asked, number in enumerate(left.copy(), 1):
        unit = _asked(client, number, timeout, tell)
        if unit is None:
            continue
        row += 1
        yield unit
        if row == asked == _SUSPICIOUS and _are_there(client, left[asked:], timeout):
            yield EVERYBODY
            return


def _are_there(client: Client, left: list[int], timeout: float) -> bool:
    """Whether some units that nobody would give answer, too."""
    for number in left[-1 : -_FAR - 1 : -1]:
        client.turn_to(number)
        if not is_there(client, timeout):
            return False
    return len(left) >= _FAR


def _asked(
    client: Client, number: int, timeout: float, tell: Callable[[int], None]
) -> HeardUnit | None:
    tell(number)
    client.turn_to(number)
    if not is_there(client, timeout):
        return None
    try:
        found = identify(client)
    except (AccessDenied, LinkError):  # it answers to registers, and not to this
        found = NOBODY
    return HeardUnit(number, found)


def is_there(client: Client, timeout: float) -> bool:
    """Whether the unit that the client talks to answers within `timeout` s."""
    try:
        client.read(3, 0, 1, timeout)
    except ExceptionAnswer as error:
        return error.exception not in _GATEWAY
    except NoAnswer:
        return False
    return True
