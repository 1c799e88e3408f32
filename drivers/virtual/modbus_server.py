"""The virtual drive on Modbus, TCP or RTU frames: pymodbus' server around the register map."""

from __future__ import annotations

import logging

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.pdu.device import ModbusDeviceIdentification
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.virtual.firmware import Denied, Reason
from drivers.virtual.registers import RegisterMap

__all__ = ["start_modbus_tcp"]


class _Connection(ServerRequestHandler):
    """A client that does not read its answers is not listened to until it does: no buffer grows."""

    def pause_writing(self) -> None:
        """More than asyncio's mark waits to be read."""
        if self.transport is not None:
            self.transport.pause_reading()  # type: ignore[attr-defined]

    def resume_writing(self) -> None:
        """It reads again."""
        if self.transport is not None:
            self.transport.resume_reading()  # type: ignore[attr-defined]


class _Server(ModbusTcpServer):
    """pymodbus' server with connections of ours, which end at once."""

    def callback_new_connection(self) -> ServerRequestHandler:
        """A connection of ours."""
        return _Connection(self, self.trace_packet, self.trace_pdu, self.trace_connect)  # type: ignore[no-untyped-call]

    def let_go(self) -> None:
        """End every connection, whether or not its client has read all, and listen no more."""
        for connection in list(self.active_connections.values()):
            if connection.transport is not None:
                connection.transport.abort()  # type: ignore[attr-defined]
        self.close()


logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

_CODES = {
    Reason.NO_OBJECT: ExcCodes.ILLEGAL_ADDRESS,
    Reason.READ_ONLY: ExcCodes.ILLEGAL_ADDRESS,
    Reason.RANGE: ExcCodes.ILLEGAL_VALUE,
    Reason.STATE: ExcCodes.DEVICE_BUSY,
}
_WRITE_SINGLE = 6
_UNIT_IN_MBAP = 6


async def start_modbus_tcp(
    registers: RegisterMap, host: str, port: int, unit: int, *, rtu: bool = False
) -> tuple[_Server, int]:
    """Listen on host:port (0: any free one); return the server and the port it has.

    `rtu`: frames as on a serial line. A frame for another unit is not for this drive: it is silent.
    """
    ours = {unit} if rtu else {unit, 0, 255}  # a device of its own on TCP goes by those, too
    at = 0 if rtu else _UNIT_IN_MBAP

    def silent_for_others(sending: bool, data: bytes) -> bytes:
        """The server refuses a unit that it does not have; a drive on a line says nothing at all."""
        return b"" if sending and len(data) > at and data[at] not in ours else data

    known = registers.layout.functions

    async def access(
        function: int,
        start: int,
        address: int,
        count: int,
        memory: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        if function not in known:
            return ExcCodes.ILLEGAL_FUNCTION
        try:
            if values is not None:
                registers.write(address, [int(word) for word in values])
            elif function != _WRITE_SINGLE:  # whose answer echoes what was written
                memory[address - start : address - start + count] = registers.read(address, count)
        except Denied as error:
            return _CODES[error.reason]
        return None

    names = ("VendorName", "ProductCode", "MajorMinorRevision")
    identity = ModbusDeviceIdentification(  # type: ignore[no-untyped-call]
        info_name=dict(zip(names, registers.layout.identity, strict=True))
    )
    first, end = registers.layout.span
    memory = SimData(first, values=[0] * (end - first), datatype=DataType.REGISTERS)
    server = _Server(
        SimDevice(unit, simdata=[memory], action=access),
        framer=FramerType.RTU if rtu else FramerType.SOCKET,
        identity=identity,
        address=(host, port),
        ignore_missing_devices=True,
        trace_packet=silent_for_others,
    )
    await server.serve_forever(background=True)
    listener = server.transport
    sockets = getattr(listener, "sockets", None)
    return server, int(sockets[0].getsockname()[1]) if sockets else port
