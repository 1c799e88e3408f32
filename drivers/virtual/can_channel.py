"""The virtual drive as a CAN bus within one process.

On python-can's `virtual` interface, or without any.
"""

from __future__ import annotations

import threading
from collections import deque

import can

from drivers.virtual.canopen_node import CanopenNode, Frame

__all__ = ["CanChannel", "LocalCan"]


class LocalCan(can.BusABC):
    """An adapter whose bus is a node: it hears each frame at once, and has answered then.

    Attributes
    ----------
    sent : identifiers of the frames that the master has sent
    """

    def __init__(self, node: CanopenNode) -> None:
        super().__init__(channel="local")
        self._node = node
        self._coming: deque[Frame] = deque(node.boot())
        self.sent: set[int] = set()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """One frame onto the bus."""
        self.sent.add(msg.arbitration_id)
        remote = msg.is_remote_frame
        self._coming += self._node.receive(msg.arbitration_id, bytes(msg.data), remote=remote)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; None: there is none, and nothing comes by itself."""
        if not self._coming:
            self._coming += self._node.poll()
        if not self._coming:
            return None
        frame = self._coming.popleft()
        return can.Message(arbitration_id=frame.cob_id, data=frame.data, is_extended_id=False)


class CanChannel:
    """Serves a node on the channel `name` from a thread of its own, until closed."""

    def __init__(self, node: CanopenNode, name: str) -> None:
        self._node = node
        self._bus = can.Bus(interface="virtual", channel=name)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"can-{name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            message = self._bus.recv(0.002)
            if message is not None:
                cob_id, remote = message.arbitration_id, message.is_remote_frame
                self._send(self._node.receive(cob_id, bytes(message.data), remote=remote))
            self._send(self._node.poll())

    def _send(self, frames: list[Frame]) -> None:
        for frame in frames:
            self._bus.send(
                can.Message(arbitration_id=frame.cob_id, data=frame.data, is_extended_id=False)
            )

    def close(self) -> None:
        """End the thread and leave the channel."""
        self._end.set()
        self._thread.join()
        self._bus.shutdown()
