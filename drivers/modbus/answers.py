"""What a Modbus unit answers, and what its silence means."""

from __future__ import annotations

from typing import Any, NamedTuple

from drivers.errors import AccessDenied
from drivers.modbus.incoming import Incoming
from drivers.modbus.transports import (
    ModbusPDU,
)

__all__ = [
    "ACKNOWLEDGE",
    "EXCEPTIONS",
    "NO_TARGET",
    "ExceptionAnswer",
    "Kind",
    "is_about",
    "silence_text",
]


# Modbus Application Protocol V1.1b3, section 7
EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    5: "acknowledge",
    6: "server device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}


ACKNOWLEDGE, NO_TARGET = 5, 11
_BUSY = ACKNOWLEDGE, 6, 10, NO_TARGET  # of a drive, and of a gateway that cannot reach it for now
_SHORT = 0.1  # s: a cycle's patience, and no service's


class Kind(NamedTuple):
    """What tells an answer from another one on a line: function, and registers in it (0: none)."""

    function: int
    registers: int


class ExceptionAnswer(AccessDenied):
    """The unit, or a gateway before it, answers with an `exception`, a code of the standard."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message, busy=code in _BUSY)
        self.exception = code


def silence_text(where: str, unit: int, incoming: Incoming, patience: float) -> str:
    """What came instead of an answer."""
    within = f"within {patience * 1000:g} ms"
    stranger = incoming.stranger()
    if stranger is not None:
        return (
            f"{where} does not answer {within}, but unit {stranger} answers for unit {unit}: "
            "which is the drive's number? ('tworelay scan' finds it)"
        )
    if not incoming.heard:
        return f"{where} does not answer {within}"
    if incoming.is_echo_alone():
        return (
            f"{where} does not answer {within}: all that comes is what was sent, from an adapter "
            "that hears itself; is the drive on, A and B not swapped, baud rate, parity and unit "
            "right?"
        )
    if patience < _SHORT:
        return (
            f"{where} has not answered whole {within} ({len(incoming.heard)} bytes came): is the "
            "link slower than that? ('tworelay latency' measures it)"
        )
    return (
        f"{where} answers, but not to what was asked ({len(incoming.heard)} bytes {within}): is it "
        "a Modbus port, and the unit right? ('tworelay doctor' and 'tworelay scan' look)"
    )


def is_about(answer: ModbusPDU, asked: dict[str, Any]) -> bool:
    """Whether the answer to a write names what was written: register, value, masks, how many."""
    if "count" in asked or "address" not in asked or answer.isError():
        return True
    told: dict[str, Any] = {"address": answer.address}
    wanted = {"address": asked["address"]}
    if "value" in asked:
        told["value"], wanted["value"] = list(answer.registers), [asked["value"]]
    elif "values" in asked:
        told["count"], wanted["count"] = answer.count, len(asked["values"])
    else:
        for mask in ("and_mask", "or_mask"):
            told[mask], wanted[mask] = getattr(answer, mask), asked[mask]
    return told == wanted
