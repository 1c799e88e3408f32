"""Parameters behind a mailbox of registers: number and data in, execute, and the answer out."""

from __future__ import annotations

from time import perf_counter, sleep

from drivers.errors import AccessDenied, LinkError
from drivers.modbus.client import Client
from profiles.address import WIDTH_BITS, MailboxAddress
from profiles.procedures import Mailbox

__all__ = ["MailboxAccess"]

_READ, _WRITE_ONE, _WRITE = 3, 6, 16  # function codes
_POLL = 0.005  # s between two looks at a request under way


class MailboxAccess:
    """Reads and writes through one mailbox; one request at a time."""

    def __init__(self, client: Client, mailbox: Mailbox) -> None:
        self._client = client
        self._mailbox = mailbox

    def read(self, address: MailboxAddress) -> int:
        """Raw value; raises LinkError, AccessDenied."""
        box = self._mailbox
        self._fill(address)
        self._execute(box.read_code, address, "read")
        length = self._client.read(_READ, box.length, 1)[0]
        wanted = WIDTH_BITS[address.type] // 8
        if length != wanted:
            raise LinkError(
                f"{address} has {length} bytes in the drive, not {wanted}", code="link.length"
            )
        words = self._client.read(_READ, box.data, (length + 1) // 2)
        data = b"".join(word.to_bytes(2, "little") for word in words)[:length]
        return int.from_bytes(data, "little", signed=address.type[0] == "i")

    def write(self, address: MailboxAddress, raw: int) -> None:
        """Write a raw value; raises LinkError, AccessDenied."""
        box = self._mailbox
        length = WIDTH_BITS[address.type] // 8
        data = raw.to_bytes(length, "little", signed=address.type[0] == "i")
        words = [int.from_bytes(data[k : k + 2], "little") for k in range(0, length, 2)]
        self._fill(address)
        self._client.write(_WRITE_ONE, box.length, [length])
        self._client.write(_WRITE, box.data, words)
        self._execute(box.write_code, address, "written")

    def _fill(self, address: MailboxAddress) -> None:
        box = self._mailbox
        for register, value in ((box.pnu, address.pnu), (box.sub, address.sub), (box.elements, 1)):
            self._client.write(_WRITE_ONE, register, [value])

    def _execute(self, code: int, address: MailboxAddress, what: str) -> None:
        box = self._mailbox
        self._client.write(_WRITE_ONE, box.request, [code])
        deadline = perf_counter() + box.within
        while (status := self._client.read(_READ, box.request, 1)[0]) == code:
            if perf_counter() > deadline:
                raise LinkError(
                    f"{address}: the mailbox is busy for more than {box.within:g} s",
                    code="link.mailbox",
                )
            sleep(_POLL)
        if status != box.done_code:
            raise AccessDenied(
                f"{address} cannot be {what}: the mailbox answers {status:02X}h; has this drive "
                "the parameter, and is it in a state to take it?"
            )
