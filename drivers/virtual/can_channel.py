"""The virtual drive on python-can's `virtual` interface, for one process."""

from __future__ import annotations

import threading

import can

from drivers.virtual.canopen_node import CanopenNode, Frame

__all__ = ["CanChannel"]


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
