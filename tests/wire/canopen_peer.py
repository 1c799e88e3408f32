"""The other end of a CANopen wire, which says what it is told to."""

from __future__ import annotations

from collections.abc import Callable

import can

from drivers.canopen.wire import CanWire

__all__ = ["NODE", "Answer", "Frame", "Peer", "scripted", "wire"]

Frame = tuple[int, str]


Answer = Callable[[int, bytes], list[Frame]]


NODE = 5


SHORT = {0x6040, 0x6041, 0x6071, 0x6077}  # of two bytes


class Peer:
    """A CAN adapter whose bus answers by a function; everything sent is noted."""

    def __init__(self, answer: Answer) -> None:
        self.sent: list[Frame] = []
        self._answer = answer
        self.waiting: list[can.Message] = []
        self.changes: dict[str, tuple[int, int]] = {}  # as the bus told them before its cycle

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        data = bytes(message.data)
        self.sent.append((message.arbitration_id, data.hex(" ").upper()))
        for cob_id, text in self._answer(message.arbitration_id, data):
            self.say(cob_id, text)

    def say(self, cob_id: int, text: str, *, error: bool = False) -> None:
        self.waiting.append(
            can.Message(
                arbitration_id=cob_id, data=bytes.fromhex(text), is_extended_id=False,
                is_error_frame=error,
            )
        )  # fmt: skip

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.waiting.pop(0) if self.waiting else None

    def shutdown(self) -> None:
        pass


def wire(
    answer: Answer, timeout: float = 0.05, *, awaits_sync: bool = False
) -> tuple[CanWire, Peer]:
    peer = Peer(answer)
    return CanWire(peer, NODE, timeout, awaits_sync=awaits_sync), peer  # type: ignore[arg-type]


def scripted(*answers: str | list[Frame]) -> Answer:
    """The answers to the SDO requests, one after the other."""
    left = list(answers)

    def answer(cob_id: int, data: bytes) -> list[Frame]:
        found = left.pop(0) if left else []
        return [(0x585, found)] if isinstance(found, str) else found

    return answer
