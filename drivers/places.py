"""Which bus a LINK leads to, whatever it is called: what two programs must not use at once."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import stat
import sys
from ipaddress import ip_address
from pathlib import Path

from drivers.link_text import host_and_port, parse
from profiles.errors import UsageError

__all__ = ["buses", "same_place"]

_WINDOWS_PORT = re.compile(r"(?:\\\\\.\\)?(com\d+)", re.IGNORECASE)


def buses(text: str) -> tuple[str, ...]:
    """Names of the bus of a LINK, which two links to one bus share at least one of; none for virtual://.

    A host has as many as addresses: Modbus TCP in all its kinds is one bus on one host and port.
    """
    link = parse(text)
    if link.scheme == "virtual":  # it lives in this process
        return ()
    if link.device:
        return (_serial(link.device),)
    if link.scheme != "canopen":
        return _at(*host_and_port(link))
    if link.interface == "socketcand":
        place, _, channel = link.channel.partition("/")
        host, _, port = place.rpartition(":")
        return tuple(f"{name} {channel}" for name in _at(host, port))
    mine = f" {os.getpid()}" if link.interface == "virtual" else ""  # python-can's: one process
    return (f"can {link.interface} {link.channel}{mine}",)


def same_place(one: str, other: str) -> bool:
    """Whether two LINKs lead to one drive, however they are spelled: bus, and unit or node."""
    if one == other:
        return True
    try:
        first, second = parse(one), parse(other)
    except UsageError:
        return False
    if "virtual" in (first.scheme, second.scheme):
        return False
    whom = [
        link.integer("unit", 0, 255) or link.integer("node", 1, 127) for link in (first, second)
    ]
    if None not in whom and whom[0] != whom[1]:  # without one, it is the profile's
        return False
    if (first.scheme, first.place) == (second.scheme, second.place):
        return True
    return bool(set(buses(one)) & set(buses(other)))


def _serial(port: str) -> str:
    """A serial port by its device, whatever file leads to it."""
    windows = _WINDOWS_PORT.fullmatch(port.strip("/"))
    if windows is not None:
        return f"serial {windows[1].upper()}"
    if sys.platform != "win32":
        with contextlib.suppress(OSError):  # not there, yet
            found = Path(port).stat()
            if stat.S_ISCHR(found.st_mode):
                return f"serial {os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
    return f"serial {Path(port).resolve()}"


def _at(host: str, port: str) -> tuple[str, ...]:
    """A port of a host by each of its addresses; by its name where it has none."""
    bare, port = host.strip("[]").rstrip(".").lower(), port.lstrip("0")
    try:
        found = {
            str(info[4][0]) for info in socket.getaddrinfo(bare, None, type=socket.SOCK_STREAM)
        }
    except (OSError, UnicodeError):
        return (f"tcp {bare} {port}",)
    return tuple(sorted(f"tcp {_plain(address)} {port}" for address in found))


def _plain(address: str) -> str:
    """One name of an address; this computer, asked by 'any', is loopback."""
    known = ip_address(address)
    known = getattr(known, "ipv4_mapped", None) or known
    if known.is_unspecified:
        return "127.0.0.1" if known.version == 4 else "::1"
    return str(known)
