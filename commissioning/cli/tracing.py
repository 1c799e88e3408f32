"""Every frame to a file, for a support case: candump text, or a pcap of Modbus TCP."""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, BinaryIO

from commissioning.cli.output import say
from drivers.link import Trace
from profiles.errors import UsageError

__all__ = ["tracer"]


_PCAP_HEADER = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)  # raw IP
_CLIENT, _SERVER = (b"\x7f\x00\x00\x01", 49152), (b"\x7f\x00\x00\x02", 502)


@contextlib.contextmanager
def tracer(target: str | None, link: str | None) -> Generator[Trace | None]:
    """A function for the drivers to call with every frame, or None."""
    if target is None or link is None:
        yield None
        return
    if link.startswith("virtual:"):
        raise UsageError("--trace: virtual:// is in this process and has no frames; serve the axis")
    canopen = link.startswith("canopen:")
    try:
        file = Path(target).open("wb")  # noqa: SIM115 - closed below, errors of the job are its own
    except OSError as error:
        raise UsageError(f"--trace {target}: cannot be written: {error.strerror}") from None
    try:
        if not canopen:
            file.write(_PCAP_HEADER)
        yield _harmless(_candump(file) if canopen else _pcap(file))
    finally:
        try:
            file.close()
        except OSError as error:
            say(f"tworelay: --trace {target}: is not whole: {error.strerror}", err=True)


def _harmless(write: Trace) -> Trace:
    """A trace that cannot be written ends the trace, not the job."""
    broken = False

    def guarded(*frame: Any) -> None:
        nonlocal broken
        if not broken:
            try:
                write(*frame)
            except OSError:
                broken = True

    return guarded


def _candump(file: BinaryIO) -> Trace:
    def write(_sending: bool, cob_id: int, data: bytes | None) -> None:
        """A line as `candump -L` writes it, which Wireshark reads.

        Without data it is a remote frame.
        """
        said = "R" if data is None else data.hex().upper()
        file.write(f"({time.time():.6f}) can0 {cob_id:03X}#{said}\n".encode())

    return write


def _pcap(file: BinaryIO) -> Trace:
    """TCP segments with right sequence numbers; check sums are left out (0)."""
    sequence = {True: 1, False: 1}

    def write(sending: bool, data: bytes) -> None:
        (source, sport), (target, tport) = (_CLIENT, _SERVER) if sending else (_SERVER, _CLIENT)
        tcp = struct.pack(
            ">HHIIBBHHH",
            sport,
            tport,
            sequence[sending],
            sequence[not sending],
            0x50,
            0x18,
            8192,
            0,
            0,
        )
        length = 20 + len(tcp) + len(data)
        ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, length, 0, 0, 64, 6, 0, source, target)
        now = time.time()
        seconds = int(now)
        header = struct.pack("<IIII", seconds, int((now - seconds) * 1e6), length, length)
        file.write(header + ip + tcp + data)
        sequence[sending] += len(data)

    return write
