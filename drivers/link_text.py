"""What a LINK may say: a URL of names and known options, read in one place and for every act.

Nothing in it is a path that is written to but the `state` of a virtual drive, and no name in it is
a URL or a handler of the libraries below.
"""

from __future__ import annotations

import difflib
import os
import re
from dataclasses import dataclass
from ipaddress import ip_address
from urllib.parse import parse_qsl, unquote

from profiles.errors import UsageError

__all__ = [
    "SCHEMES",
    "Link",
    "host_and_port",
    "is_loopback",
    "is_simulated",
    "is_stepped",
    "name_of",
    "parse",
]

SCHEMES = ("virtual", "modbus-tcp", "modbus-rtu", "modbus-rtu-tcp", "modbus-tls", "canopen")
_MODBUS_PORT, _SECURE_PORT = 502, 802
_LONGEST = 2000
_LONGEST_NAME = 60  # characters of a place

_NAME = re.compile(r"[A-Za-z0-9_.:/\\-]+")  # of a device or a channel
_WORD = re.compile(r"[A-Za-z0-9_-]+")  # an interface of python-can, a virtual axis
_BAUDRATE = re.compile(r"@[0-9]{1,7}$")
_HOST = r"(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+)"
_HOST_AND_PORT = re.compile(_HOST + r"(?::(?P<port>[0-9]{1,5}))?")
_SOCKETCAND = re.compile(_HOST + r":(?P<port>[0-9]{1,5})/(?P<name>[A-Za-z0-9_.-]+)")


@dataclass(frozen=True, slots=True)
class Link:
    """A parsed LINK.

    Attributes
    ----------
    text : as it was given
    scheme : what stands before `://`
    place : what follows it, as it stands there
    options : what follows `?`, percent signs decoded
    """

    text: str
    scheme: str
    place: str
    options: dict[str, str]

    def integer(self, key: str, low: int, high: int) -> int | None:
        """Option `key` as a whole number in low…high, or None."""
        text = self.options.get(key)
        if text is None:
            return None
        if not re.fullmatch(r"[0-9]{1,9}", text) or not low <= int(text) <= high:
            raise UsageError(f"{self.text}: {key}={text} must be a whole number {low}…{high}")
        return int(text)

    @property
    def is_stepping(self) -> bool:
        """Whether a served virtual drive steps its clock by the cycle."""
        return self.options.get("clock") == "step"

    @property
    def timeout(self) -> float | None:
        """Option `timeout`, s."""
        text = self.options.get("timeout")
        return None if text is None else float(text)

    @property
    def device(self) -> str:
        """Serial port of a modbus-rtu: or canopen://slcan/ link, else ''."""
        if self.scheme == "modbus-rtu":
            return unquote(self.place)
        return _BAUDRATE.sub("", self.channel) if self.interface == "slcan" else ""

    @property
    def interface(self) -> str:
        """Interface of python-can of a canopen:// link, else ''."""
        return self.place.partition("/")[0] if self.scheme == "canopen" else ""

    @property
    def channel(self) -> str:
        """Channel of that interface: a device, a name, or HOST:PORT/NAME."""
        return unquote(self.place.partition("/")[2]).rstrip("/")


def parse(text: str) -> Link:
    """Read a LINK; raises UsageError."""
    shown = f"'{text:.200}'"
    scheme, mark, rest = text.partition("://")
    if not mark and text.startswith("modbus-rtu:"):  # modbus-rtu:COM5
        scheme, mark, rest = text.partition(":")
    if scheme not in SCHEMES or not mark:
        known = ", ".join(f"{scheme}://" for scheme in SCHEMES)
        near = difflib.get_close_matches(scheme, SCHEMES, 1) if mark else []
        hint = f"; did you mean {near[0]}://?" if near else ""
        raise UsageError(f"{shown} is no link and no axis file{hint}; a link begins with {known}")
    if len(text) > _LONGEST:
        raise UsageError(f"{shown}…: a link has at most {_LONGEST} characters")
    if not text.isascii() or not text.isprintable() or " " in text or "#" in text:
        raise UsageError(
            f"{text[:200]!r}: a link has no spaces, no # and only ASCII (write others as %XX)"
        )
    place, _, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        bare = [part for part in query.split("&") if "=" not in part]
        named = f"'{bare[0]}' has no value" if bare and bare[0] else "an option is empty"
        raise UsageError(f"{shown}: {named}; options are written ?key=value&key=value") from None
    keys = [key for key, _ in pairs]
    for key in keys:
        if keys.count(key) > 1:
            raise UsageError(f"{shown}: the option '{key}' stands there twice")
    link = Link(text, scheme, place, dict(pairs))
    if any("\0" in value for value in link.options.values()) or link.options.get("state") == "":
        raise UsageError(f"{shown}: an option that names a file names one")
    _check_place(link)
    if scheme != "virtual":  # whose options are its axis'
        _check_options(link)
    return link


def host_and_port(link: Link) -> tuple[str, str]:
    """Host and port of a Modbus LINK, as they are written; without a port, the protocol's own."""
    found = _HOST_AND_PORT.fullmatch(link.place.rstrip("/"))
    if found is None or not 0 < int(found["port"] or 1) < 65536:
        raise UsageError(
            f"'{link.text}' is no link: a Modbus link is {link.scheme}://HOST:PORT?unit=N, with "
            "letters, digits, '.', '-' and '_' in HOST, or an IPv6 address in brackets"
        )
    own = _SECURE_PORT if link.scheme == "modbus-tls" else _MODBUS_PORT
    return found["host"], found["port"] or str(own)


def name_of(link: Link) -> str:
    """What people call the drive of a LINK that no axis file names.

    Its place, and who it is there.
    """
    if link.scheme == "virtual":
        return link.place.strip("/")
    if link.scheme == "canopen":
        channel = link.channel
        if link.interface == "slcan":
            channel = _BAUDRATE.sub("", channel)
        place, who = channel, link.options.get("node", "1")
    elif link.device:
        place, who = link.device, link.options.get("unit", "1")
    else:
        host, port = host_and_port(link)
        own = port in (str(_MODBUS_PORT), str(_SECURE_PORT))
        place, who = host if own else f"{host}:{port}", link.options.get("unit", "1")
    place = re.sub(r"^(/dev/|\\\\\.\\)(serial/by-id/|serial/by-path/)?", "", place)
    return f"{re.sub(r'[^A-Za-z0-9._-]+', '-', place).strip('-')[-_LONGEST_NAME:]}-{who}"


def _check_place(link: Link) -> None:
    """A place is of names; raises UsageError."""
    if link.scheme in ("modbus-tcp", "modbus-rtu-tcp", "modbus-tls"):
        host_and_port(link)
    elif link.scheme == "modbus-rtu":
        if not link.device.strip("/") or not _is_name(link.device):
            raise UsageError(
                f"{link.text}: a serial link is "
                "modbus-rtu:///dev/ttyUSB0?baudrate=115200&parity=N&unit=1 or modbus-rtu:COM5?…; "
                f"{_NAMES}"
            )
    elif link.scheme == "canopen":
        found = _SOCKETCAND.fullmatch(link.channel)
        is_socketcand = link.interface == "socketcand"
        channel = link.channel
        if link.interface == "slcan":  # python-can: PORT@BAUDRATE
            channel = _BAUDRATE.sub("", channel)
        if not _WORD.fullmatch(link.interface) or not (is_socketcand or _is_name(channel)):
            raise UsageError(
                f"{link.text}: a CANopen link is canopen://INTERFACE/CHANNEL?node=N, for example "
                f"canopen://socketcan/can0?node=5; {_NAMES}"
            )
        if is_socketcand and not (found and 0 < int(found["port"]) < 65536):
            raise UsageError(
                f"{link.text}: a socketcand link is canopen://socketcand/HOST:PORT/CHANNEL?node=N; "
                "an interface of this machine is canopen://socketcan/can0?node=N (socketcan, "
                "without d)"
            )
    elif not _WORD.fullmatch(link.place.strip("/")):
        raise UsageError(
            f"{link.text}: a virtual drive is virtual://AXIS ('tworelay virtual list')"
        )


def _is_name(text: str) -> bool:
    """Whether it is a name of the system's, and no URL that a library would open."""
    return _NAME.fullmatch(text) is not None and "://" not in text


_NAMES = "a device or channel is a name of letters, digits and _ . : / \\ -"
_OPTIONS = {
    "modbus-tcp": {"unit", "timeout", "clock"},
    "modbus-rtu-tcp": {"unit", "timeout", "clock"},
    "modbus-tls": {"unit", "timeout", "clock", "ca", "cert", "key"},
    "modbus-rtu": {"unit", "timeout", "clock", "baudrate", "parity", "stopbits"},
    "canopen": {"node", "timeout", "clock", "bitrate", "sync"},
}
_WHOLE = {
    "unit": (0, 255), "node": (1, 127), "baudrate": (1200, 4_000_000), "stopbits": (1, 2),
    "bitrate": (10_000, 1_000_000),
}  # fmt: skip


def _check_options(link: Link) -> None:
    """Known ones, and each in its range; raises UsageError."""
    options, known = link.options, _OPTIONS[link.scheme]
    for key in options:
        if key not in known:
            raise UsageError(
                f"{link.text}: no option '{key}'; there are: {', '.join(sorted(known))}"
            )
        if key in _WHOLE:
            link.integer(key, *_WHOLE[key])
    if options.get("clock", "wall") not in ("wall", "step"):
        raise UsageError(f"{link.text}: clock is wall or step")
    if options.get("parity", "N") not in ("N", "E", "O"):
        raise UsageError(f"{link.text}: parity is N, E or O")
    sync = options.get("sync", "own")
    if sync not in ("own", "bus") or ("sync" in options and link.is_stepping):
        raise UsageError(
            f"{link.text}: sync is own (tworelay produces SYNC) or bus (another device does), and "
            "goes without clock=step"
        )
    try:
        seconds = float(options.get("timeout", "1"))
    except ValueError:
        seconds = -1.0
    if not 0 < seconds <= 60:
        raise UsageError(
            f"{link.text}: timeout={options['timeout']} must be more than 0 and at most 60 s"
        )


def is_simulated(text: str) -> bool:
    """Whether a LINK leads to nothing real: virtual, loopback, or a pseudo-terminal."""
    link = parse(text)
    if link.scheme == "virtual" or link.interface == "virtual":
        return True
    if link.device:
        return _is_pseudo_terminal(link.device)
    if link.scheme != "canopen":
        return is_loopback(host_and_port(link)[0])
    found = _SOCKETCAND.fullmatch(link.channel) if link.interface == "socketcand" else None
    return found is not None and is_loopback(found["host"])


def is_stepped(text: str) -> bool:
    """Whether the time of what a LINK leads to is simulated."""
    link = parse(text)
    return link.scheme == "virtual" or (link.is_stepping and is_simulated(text))


def _is_pseudo_terminal(device: str) -> bool:
    """Whatever leads to it: the file itself is looked at."""
    return re.fullmatch(r"/dev/pts/\d+", os.path.realpath(device)) is not None


def is_loopback(host: str) -> bool:
    """Whether a host is this computer, as it is written."""
    try:
        return host == "localhost" or ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
