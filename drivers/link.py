"""LINK → Drive. A link is a URL; the axis and the profile say the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, unquote, urlsplit

from drivers.drive import Bus
from drivers.home import home
from drivers.pace import Pace, StepPace, WallPace
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis, AxisLimits, Mechanics
from profiles.errors import AccessDenied, IdentityMismatch, LinkError, UsageError
from profiles.library import fitting, load_profile
from profiles.schema import Identity, LinkDefaults, Profile

if TYPE_CHECKING:
    from drivers.modbus.wires import Wire

__all__ = [
    "Link",
    "axis_of",
    "host_and_port",
    "is_simulated",
    "modbus_wire",
    "open_can",
    "open_drive",
    "open_to_stop",
    "parse",
]

SCHEMES = ("virtual", "modbus-tcp", "modbus-rtu", "modbus-rtu-tcp", "modbus-tls", "canopen")
_MODBUS_PORT, _SECURE_PORT = 502, 802
_BAUDRATE = 115200
_CONNECT_TIMEOUT = 3.0  # s

Trace = Callable[..., None]


@dataclass(frozen=True, slots=True)
class Link:
    """A parsed LINK.

    `place` is what stands between `://` and `?`, decoded; `options` what follows it.
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
        if not text.isdigit() or not low <= int(text) <= high:
            raise UsageError(f"{self.text}: {key}={text} must be a whole number {low}…{high}")
        return int(text)


def parse(text: str) -> Link:
    """Split a LINK; raises UsageError."""
    if text.startswith("modbus-rtu:") and "://" not in text:  # modbus-rtu:COM5
        head, _, tail = text.partition(":")
        return replace(parse(f"{head}:///{tail}"), text=text, place=tail.partition("?")[0])
    try:
        parts = urlsplit(text)
    except ValueError as error:
        raise UsageError(f"'{text}' is no link: {error}") from None
    if parts.scheme not in SCHEMES or "://" not in text:
        known = ", ".join(f"{scheme}://" for scheme in SCHEMES)
        raise UsageError(f"'{text}' is no link and no axis file; a link begins with {known}")
    place = text.split("://", 1)[1].split("?", 1)[0]
    if not text.isascii() or any(character.isspace() for character in text):
        raise UsageError(f"{text!r}: a link has no spaces and only ASCII (write others as %XX)")
    try:
        options = dict(
            parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        )
    except ValueError:
        raise UsageError(f"'{text}': options are written ?key=value&key=value") from None
    return Link(text, parts.scheme, place, options)


def is_simulated(text: str) -> bool:
    """Whether a LINK leads to nothing real: virtual, loopback, or a pseudo-terminal."""
    link = parse(text)
    if link.scheme == "virtual":
        return True
    if link.scheme == "modbus-rtu":
        return unquote(link.place).startswith("/dev/pts/")
    if link.scheme == "canopen":
        interface, _, channel = link.place.partition("/")
        if interface == "virtual":
            return True
        if interface == "slcan":
            return unquote(channel).startswith("/dev/pts/")
        host = channel.partition("/")[0].rpartition(":")[0] if interface == "socketcand" else ""
    else:
        host = link.place.rpartition(":")[0] or link.place
    from ipaddress import ip_address

    host = host.strip("[]")
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def axis_of(link_text: str) -> Axis:
    """The axis that a bare LINK stands for: a virtual one is known, any other is rotary."""
    link = parse(link_text)
    if link.scheme != "virtual":
        return Axis(name="axis", link=link_text)
    virtual = _virtual_axis(link)
    linear = virtual.motion == "linear"
    return Axis(
        name=virtual.name,
        link=link_text,
        profile="virtual-modbus",
        travel=virtual.travel,
        mechanics=Mechanics(
            motion=virtual.motion,
            feed=6.283185307179586 if linear else None,
            held_by="brake" if virtual.brake else "friction",
        ),
        limits=AxisLimits(),
    )


def open_drive(
    axis: Axis,
    *,
    cycle: float | None = None,
    trace: Trace | None = None,
    to_stop: bool = False,
) -> ProfiledDrive:
    """Connect to the drive of `axis` and check its identity against the profile.

    Parameters
    ----------
    axis : Axis
        Its `link` must be set. Without a profile, the one that fits the identity is taken.
    cycle : s, of the exchange; default: the axis', else the profile's
    trace : called with every frame
    to_stop : for `stop` alone: nothing but the identity is asked before

    Raises
    ------
    UsageError, LinkError, IdentityMismatch, PreflightRefused
    """
    if axis.link is None:
        raise UsageError(f"axis '{axis.name}' has no link: add one to its file")
    link = parse(axis.link)
    named = load_profile(axis.profile) if axis.profile else None
    if named is not None and named.bus != ("canopen" if link.scheme == "canopen" else "modbus"):
        raise UsageError(f"profile '{named.name}' is for {named.bus}, the link is {link.scheme}://")
    if named is not None:
        named = _armed_with(named, axis)
    if named is not None and to_stop:  # nothing is waited for
        impatient = named.link.model_copy(update={"patience": 0.0})
        named = named.model_copy(update={"link": impatient})
    opener = {"virtual": _open_virtual, "canopen": _open_canopen}.get(link.scheme, _open_modbus)
    bus, profile = opener(link, axis, named, cycle or axis.cycle, trace)
    try:
        return ProfiledDrive(bus, profile, axis, link.text, to_stop=to_stop)
    except AccessDenied as error:
        bus.close()
        raise LinkError(
            f"something answers on {link.text}, but not like profile '{profile.name}': {error}; are "
            "unit or node and profile right?"
        ) from None
    except BaseException:
        bus.close()
        raise


def open_to_stop(axis: Axis) -> ProfiledDrive:
    """A way to stop the drive of `axis`, whose profile is known: nothing is asked, nothing is sent yet.

    Raises UsageError, LinkError.
    """
    if axis.link is None or axis.profile is None:
        raise UsageError(f"axis '{axis.name}' has no link or no profile")
    link, profile = parse(axis.link), load_profile(axis.profile)
    cycle = axis.cycle or profile.link.cycle
    bus: Bus
    if link.scheme == "canopen":
        from drivers.canopen.bus import CanopenBus
        from drivers.canopen.wire import CanWire

        node = link.integer("node", 1, 127) or profile.link.node or 1
        wire = CanWire(open_can(link, profile), node, _timeout(link, profile))
        bus = CanopenBus(wire, profile, WallPace(cycle))
    else:
        from drivers.modbus.bus import ModbusBus
        from drivers.modbus.client import Client

        client = Client(modbus_wire(link, profile), _unit(link, profile), _timeout(link, profile))
        bus = ModbusBus(client, profile, WallPace(cycle))
    return ProfiledDrive(bus, profile, axis, link.text, to_stop=True)


def _unit(link: Link, profile: Profile | None) -> int:
    unit = link.integer("unit", 0, 255)
    if unit is not None:
        return unit
    return profile.link.unit if profile and profile.link.unit is not None else 1


def _open_virtual(
    link: Link, axis: Axis, profile: Profile | None, cycle: float | None, _trace: Trace | None
) -> tuple[Bus, Profile]:
    from drivers.virtual.device import Device
    from drivers.virtual.direct import DirectBus
    from drivers.virtual.firmware import Firmware
    from drivers.virtual.memory import Memory

    virtual = _virtual_axis(link)
    device = Device(Firmware(virtual, Memory(state_file(link))), "step")
    if cycle is not None:
        device.cycle = round(cycle * 1e9)
    profile = profile or _armed_with(load_profile("virtual-modbus"), axis)
    return DirectBus(device, profile), profile


def _virtual_axis(link: Link) -> Any:
    from drivers.virtual.axes import configured

    return configured(
        link.place.strip("/"), {k: v for k, v in link.options.items() if k != "state"}
    )


def state_file(link: Link) -> Path:
    """Non-volatile memory of a virtual link: its `state`, else one a name and option set."""
    if "state" in link.options:
        return Path(link.options["state"])
    virtual = _virtual_axis(link)
    return home() / "virtual" / f"{virtual.name}-{virtual.serial:08x}.json"


def _open_modbus(
    link: Link, axis: Axis, profile: Profile | None, cycle: float | None, trace: Trace | None
) -> tuple[Bus, Profile]:
    from drivers.modbus.bus import ModbusBus, identify
    from drivers.modbus.client import Client

    wire = modbus_wire(link, profile)
    client = Client(wire, _unit(link, profile), _timeout(link, profile), trace)
    try:
        patience = (profile.link if profile else LinkDefaults()).patience
        chosen = _armed_with(_agree(identify(client, patience), "modbus", profile), axis)
        return ModbusBus(client, chosen, _pace(link, cycle or chosen.link.cycle)), chosen
    except BaseException:
        client.close()
        raise


def host_and_port(link: Link) -> tuple[str, str]:
    """Of a Modbus LINK over TCP, as they are written; without a port, the protocol's own."""
    host, colon, port = link.place.rstrip("/").rpartition(":")
    if not colon:
        return port, str(_SECURE_PORT if link.scheme == "modbus-tls" else _MODBUS_PORT)
    return host, port


def modbus_wire(link: Link, profile: Profile | None) -> Wire:
    """Where a Modbus LINK leads; raises UsageError."""
    from drivers.modbus.wires import RtuLine, TcpWire, Tls

    common = {"unit", "timeout", "clock"}
    stepping = link.options.get("clock") == "step"  # then no line is there that wants silence
    gap = profile.link.silence if profile and not stepping else 0.0
    if link.scheme == "modbus-rtu":
        _only(link, common | {"baudrate", "parity", "stopbits"})
        defaults = profile.link if profile else None
        parity = link.options.get("parity") or (defaults and defaults.parity) or "N"
        port = unquote(link.place)
        if not port.strip("/") or parity not in ("N", "E", "O"):
            raise UsageError(
                f"{link.text}: a serial link is modbus-rtu:///dev/ttyUSB0?baudrate=115200&parity=N&unit=1 "
                "or modbus-rtu:COM5?…, parity N, E or O"
            )
        baudrate = link.integer("baudrate", 1200, 4_000_000) or (defaults and defaults.baudrate)
        stopbits = link.integer("stopbits", 1, 2) or (defaults and defaults.stopbits)
        return RtuLine(port, baudrate or _BAUDRATE, parity, stopbits or 1, gap, stepping)
    secure = link.scheme == "modbus-tls"
    _only(link, common | ({"ca", "cert", "key"} if secure else set()))
    host, port = host_and_port(link)
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise UsageError(f"{link.text}: a Modbus link is {link.scheme}://HOST:PORT?unit=N")
    tls = None
    if secure:
        files = {
            key: Path(link.options[key]) for key in ("ca", "cert", "key") if key in link.options
        }
        if "ca" not in files or ("key" in files and "cert" not in files):
            raise UsageError(
                f"{link.text}: TLS needs ca=FILE, the authority that signed the drive's certificate, and "
                "cert=FILE&key=FILE where the drive asks for ours"
            )
        tls = Tls(files["ca"], files.get("cert"), files.get("key"))
    return TcpWire(host.strip("[]"), int(port), link.scheme == "modbus-rtu-tcp", tls, gap)


def _open_canopen(
    link: Link, axis: Axis, profile: Profile | None, cycle: float | None, trace: Trace | None
) -> tuple[Bus, Profile]:
    node = link.integer("node", 1, 127) or (profile.link.node if profile else None)
    if node is None:
        raise UsageError(
            f"{link.text}: a CANopen link is canopen://INTERFACE/CHANNEL?node=N, for example "
            "canopen://socketcan/can0?node=5"
        )
    from drivers.canopen.bus import CanopenBus, identify
    from drivers.canopen.wire import CanWire

    timeout = _timeout(link, profile)
    awaits_sync = link.options.get("sync") == "bus"
    wire = CanWire(open_can(link, profile), node, timeout, trace, awaits_sync=awaits_sync)
    try:
        chosen = _armed_with(_agree(identify(wire), "canopen", profile), axis)
        return CanopenBus(wire, chosen, _pace(link, cycle or chosen.link.cycle)), chosen
    except BaseException:
        wire.close()
        raise


def stored_eds(text: str) -> bytes:
    """The EDS that a CANopen drive carries in object 1021h; raises LinkError, AccessDenied, UsageError."""
    from drivers.canopen.wire import CanWire

    link = parse(text)
    node = link.integer("node", 1, 127)
    if link.scheme != "canopen" or node is None:
        raise UsageError(f"{text}: must be the link of a CANopen drive, with its node")
    wire = CanWire(open_can(link), node, _timeout(link, None))
    try:
        return wire.upload_large(0x1021, 0)
    except AccessDenied as error:
        raise UsageError(
            f"the drive carries no EDS ({error}); get the file from its maker, for --eds"
        ) from None
    finally:
        wire.close()


def open_can(link: Link, profile: Profile | None = None) -> Any:
    """The CAN adapter that a LINK names, as python-can has it; raises UsageError, LinkError."""
    _only(link, {"node", "bitrate", "timeout", "clock", "sync"})
    if link.options.get("sync", "own") not in ("own", "bus") or (
        "sync" in link.options and link.options.get("clock") == "step"
    ):
        raise UsageError(
            f"{link.text}: sync is own (tworelay produces SYNC) or bus (another device does), and "
            "goes without clock=step"
        )
    interface, slash, channel = link.place.partition("/")
    if not slash or not channel:
        raise UsageError(
            f"{link.text}: a CANopen link is canopen://INTERFACE/CHANNEL?node=N, for example "
            "canopen://socketcan/can0?node=5"
        )
    from drivers.canopen.wire import open_bus

    bitrate = link.integer("bitrate", 10_000, 1_000_000)
    if bitrate is None:
        bitrate = profile.link.bitrate if profile and profile.link.bitrate else 500_000
    return open_bus(interface, unquote(channel), bitrate, _timeout(link, profile))


def _armed_with(profile: Profile, axis: Axis) -> Profile:
    """The profile with the time-out that the axis wants for the drive's watchdog."""
    if axis.limits.watchdog is None:
        return profile
    watchdog = profile.watchdog.model_copy(update={"timeout": axis.limits.watchdog})
    return profile.model_copy(update={"watchdog": watchdog})


def _only(link: Link, known: set[str]) -> None:
    for key in link.options:
        if key not in known:
            raise UsageError(
                f"{link.text}: no option '{key}'; there are: {', '.join(sorted(known))}"
            )
    if link.options.get("clock", "wall") not in ("wall", "step"):
        raise UsageError(f"{link.text}: clock is wall or step")


def _timeout(link: Link, profile: Profile | None) -> float:
    text = link.options.get("timeout")
    if text is None:
        return profile.link.service_timeout if profile else _CONNECT_TIMEOUT / 3
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= 60:
        raise UsageError(f"{link.text}: timeout={text} must be 0…60 s")
    return value


def _pace(link: Link, cycle: float) -> Pace:
    return StepPace(cycle) if link.options.get("clock") == "step" else WallPace(cycle)


def _agree(identity: Identity, bus: str, named: Profile | None) -> Profile:
    """The named profile if the drive is what it is for, else the one that fits."""
    if named is None:
        return fitting(identity, bus)
    if not named.identity.accepts(identity):
        raise IdentityMismatch(
            f"the drive is {identity}, but profile '{named.name}' is for vendor "
            f"{named.identity.vendor or 'any'}, product {named.identity.product or 'any'}"
            + (
                f", revision {' or '.join(named.identity.revisions)}"
                if named.identity.revisions
                else ""
            )
        )
    return named
