"""Buses that are not there: a Modbus gateway with its units, and a CAN bus with its nodes."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can


@contextmanager
def gateway(answers: dict[int, str], otherwise: str) -> Iterator[int]:
    """A Modbus TCP gateway: units with 'data', 'exception', 'silence'.

    The others answer `otherwise`.
    """
    listener = socket.create_server(("127.0.0.1", 0))

    def answer(unit: int, pdu: bytes) -> bytes:
        kind = answers.get(unit, otherwise)
        if kind == "silence":
            return b""
        if kind == "gateway":
            return bytes((pdu[0] | 0x80, 11))
        if pdu[0] == 0x2B:
            return bytes((0xAB, 1))
        return bytes((3, 2, 0, 7)) if kind == "data" else bytes((0x83, 2))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            while data := connection.recv(300):
                while data:
                    transaction, _, length, unit = struct.unpack_from(">HHHB", data)
                    pdu, data = data[7 : 6 + length], data[6 + length :]
                    if reply := answer(unit, pdu):
                        head = struct.pack(">HHHB", transaction, 0, len(reply) + 1, unit)
                        connection.sendall(head + reply)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        thread.join()
        listener.close()


class Nodes:
    """CANopen nodes that answer uploads of 1000h and 1018h; others give a heartbeat only."""

    def __init__(self, channel: str, drives: set[int], beating: set[int]) -> None:
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.drives, self.beating = drives, beating
        self.written: list[bytes] = []
        self._end = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        for node in self.beating:
            self._send(0x700 + node, bytes((5,)))
        while not self._end:
            message = self.bus.recv(0.05)
            if message is None:
                for node in self.beating:
                    self._send(0x700 + node, bytes((5,)))
                continue
            node, data = message.arbitration_id - 0x600, bytes(message.data)
            if data[:1] != b"\x40":
                self.written.append(data)
            if node in self.drives:
                self._answer(node, *struct.unpack_from("<HB", data, 1))

    def _answer(self, node: int, index: int, sub: int) -> None:
        values = {0x1000: 0x00020192, 0x6502: 0x0208 if node % 2 else 0x65}
        value = values.get(index, node * 16 + sub if index == 0x1018 else None)
        if value is None:
            self._send(0x580 + node, struct.pack("<BHBI", 0x80, index, sub, 0x06020000))
        else:
            self._send(0x580 + node, struct.pack("<BHBI", 0x43, index, sub, value))

    def _send(self, cob_id: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def close(self) -> None:
        self._end = True
        self._thread.join()
        self.bus.shutdown()
