"""LINK → Drive. The axis and the profile say what the link does not."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.bus import Bus
from drivers.errors import AccessDenied, LinkError
from drivers.home import home
from drivers.link_text import Link, host_and_port, is_simulated, name_of, parse
from drivers.optional import as_it_is
from drivers.pace import Pace, StepPace, WallPace
from drivers.patience import when_up
from drivers.profiled import ProfiledDrive
from profiles.axis import Axis, AxisLimits, Mechanics
from profiles.errors import IdentityMismatch, Refused, UsageError
from profiles.identity import NOBODY, Identity
from profiles.library import fitting, load_profile
from profiles.procedures import LinkDefaults, Patience
from profiles.schema import Profile
from profiles.transports import transport_of

if TYPE_CHECKING:
    from drivers.modbus.wires import Wire

__all__ = [
    "Link",
    "Trace",
    "agreed",
    "axis_of",
    "check_files_of_others",
    "check_virtual",
    "host_and_port",
    "is_simulated",
    "modbus_wire",
    "open_can",
    "open_drive",
    "open_to_stop",
    "parse",
]

_BAUDRATE = 115200
_CONNECT_TIMEOUT = 3.0  # s

Trace = Callable[..., None]


def axis_of(link_text: str) -> Axis:
    """The axis that a bare LINK stands for: a virtual one is known, others are rotary."""
    link = parse(link_text)
    if link.scheme != "virtual":
        return Axis(name=name_of(link), link=link_text)
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
    lenient: bool = False,
) -> ProfiledDrive:
    """Connect to the drive of `axis` and check its identity against the profile.

    Parameters
    ----------
    axis : Axis
        Its `link` must be set. Without a profile, the one that fits the identity is taken.
    cycle : s, of the exchange; default: the axis', else the profile's
    trace : called with every frame
    to_stop : for `stop` alone: nothing but the identity is asked before
    lenient : for `restore`: the profile lies in a run, and may be one that would be refused today

    Raises
    ------
    UsageError, LinkError, IdentityMismatch, PreflightRefused
    """
    if axis.link is None:
        raise UsageError(f"axis '{axis.name}' has no link: add one to its file")
    link = parse(axis.link)
    named = load_profile(axis.profile, lenient=lenient or to_stop) if axis.profile else None
    if named is not None and named.bus != transport_of(link.scheme).name:
        raise UsageError(f"profile '{named.name}' is for {named.bus}, the link is {link.scheme}://")
    if named is not None:
        named = _armed_with(named, axis)
    if named is not None and to_stop:  # nothing is waited for
        impatient = named.link.model_copy(update={"patience": 0.0})
        named = named.model_copy(update={"link": impatient})
    openers: dict[str, Callable[..., tuple[Bus, Profile]]] = {
        "virtual": _open_virtual,
        "canopen": partial(_open_canopen, to_stop=to_stop),
    }
    opener = openers.get(link.scheme, partial(_open_modbus, to_stop=to_stop))
    bus, profile = opener(link, axis, named, cycle or axis.cycle, trace)
    try:
        return ProfiledDrive(bus, profile, axis, link.text, to_stop=to_stop)
    except AccessDenied as error:
        bus.close()
        raise LinkError(
            f"something answers on {link.text}, but not like profile '{profile.name}': {error}",
            code="link.profile",
            hint="are unit or node and profile right?",
        ) from None
    except BaseException:
        bus.close()
        raise


def open_to_stop(axis: Axis) -> ProfiledDrive:
    """A way to stop the drive of `axis`, whose profile is known.

    Nothing is asked, nothing is sent yet.

    Raises UsageError, LinkError.
    """
    if axis.link is None or axis.profile is None:
        raise UsageError(f"axis '{axis.name}' has no link or no profile")
    link, profile = parse(axis.link), load_profile(axis.profile, lenient=True)
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

        client = Client(
            modbus_wire(link, profile),
            _unit(link, profile),
            _timeout(link, profile),
            longest_answer=profile.link.longest_answer,
        )
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

    virtual, habits = _virtual_axis(link), _habits(link)
    device = Device(Firmware(virtual, Memory.at(state_file(link))), "step")
    if cycle is not None:
        device.cycle = round(cycle * 1e9)
    profile = profile or _armed_with(load_profile("virtual-modbus"), axis)
    return DirectBus(device, profile, habits), profile


def _virtual_axis(link: Link) -> Any:
    from drivers.virtual.axes import configured

    options = {k: v for k, v in link.options.items() if k not in ("state", "habit")}
    return configured(link.place.strip("/"), options, link.options.get("state"))


def _habits(link: Link) -> Any:
    from drivers.virtual.habits import habits_of

    return habits_of(filter(None, link.options.get("habit", "").split(","))).for_bus("virtual")


def check_virtual(link: Link) -> None:
    """Raise UsageError, UnknownName where a virtual link names what is not there."""
    _virtual_axis(link)
    _habits(link)


def state_file(link: Link) -> Path:
    """Non-volatile memory of a virtual link: its `state`, else one a name and option set."""
    named = link.options.get("state")
    if named is not None:
        return Path(named)
    virtual = _virtual_axis(link)
    return home() / "virtual" / f"{virtual.name}-{virtual.serial:08x}.json"


def check_files_of_others(text: str, *keys: str) -> None:
    """Raise Refused where a LINK that another computer wrote names a file outside TWORELAY_HOME.

    `keys` : options to look at, by default all that name a file
    """
    options = parse(text).options
    for key in keys or ("state", "ca", "cert", "key"):
        named = options.get(key)
        if named is not None and not Path(named).resolve().is_relative_to(home().resolve()):
            raise Refused(
                f"{text}: its {key} is a file outside {home()}, and the link was written "
                "elsewhere: give one of yours with --link",
                code="link.file",
            )


def _open_modbus(
    link: Link,
    axis: Axis,
    profile: Profile | None,
    cycle: float | None,
    trace: Trace | None,
    *,
    to_stop: bool,
) -> tuple[Bus, Profile]:
    from drivers.modbus.bus import ModbusBus, answers, identify
    from drivers.modbus.client import Client

    wire, timeout = modbus_wire(link, profile), _timeout(link, profile)
    defaults = profile.link if profile else LinkDefaults()
    client = Client(wire, _unit(link, profile), timeout, trace, defaults.longest_answer)
    try:
        asks = profile is None or profile.identity.asked
        patience, boot = _borne(profile, to_stop=to_stop)
        who: Callable[[], Identity] = partial(identify, client, patience)
        if asks or not to_stop:
            identity = when_up(who if asks else partial(answers, client), boot, timeout)
        else:
            identity = NOBODY
        if to_stop and profile is not None and identity == NOBODY:
            chosen = profile  # whatever it is, it is to be stopped
        else:
            chosen = _armed_with(agreed(identity, "modbus", profile), axis)
        return ModbusBus(client, chosen, _pace(link, cycle or chosen.link.cycle)), chosen
    except BaseException:
        client.close()
        raise


def modbus_wire(link: Link, profile: Profile | None) -> Wire:
    """Where a Modbus LINK leads; raises UsageError."""
    from drivers.modbus.wires import RtuLine, TcpWire, Tls

    gap = profile.link.silence if profile and not link.is_stepping else 0.0  # a line wants silence
    if link.scheme == "modbus-rtu":
        defaults = profile.link if profile else LinkDefaults()
        return RtuLine(
            link.device,
            link.integer("baudrate", 1200, 4_000_000) or defaults.baudrate or _BAUDRATE,
            link.options.get("parity") or defaults.parity or "N",
            link.integer("stopbits", 1, 2) or defaults.stopbits or 1,
            gap,
            link.is_stepping,
        )
    host, port = host_and_port(link)
    tls = None
    if link.scheme == "modbus-tls":
        files = {
            key: Path(link.options[key]) for key in ("ca", "cert", "key") if key in link.options
        }
        if "ca" not in files or ("key" in files and "cert" not in files):
            raise UsageError(
                f"{link.text}: TLS needs ca=FILE, the authority that signed the drive's "
                "certificate, and cert=FILE&key=FILE where the drive asks for ours"
            )
        tls = Tls(files["ca"], files.get("cert"), files.get("key"))
    return TcpWire(host.strip("[]"), int(port), link.scheme == "modbus-rtu-tcp", tls, gap)


def _open_canopen(
    link: Link,
    axis: Axis,
    profile: Profile | None,
    cycle: float | None,
    trace: Trace | None,
    *,
    to_stop: bool,
) -> tuple[Bus, Profile]:
    node = link.integer("node", 1, 127) or (profile.link.node if profile else None)
    if node is None:
        raise UsageError(
            f"{link.text}: a CANopen link is canopen://INTERFACE/CHANNEL?node=N, for example "
            "canopen://socketcan/can0?node=5"
        )
    from drivers.canopen.bus import NAMELESS, CanopenBus, identify
    from drivers.canopen.wire import CanWire

    timeout = _timeout(link, profile)
    awaits_sync = link.options.get("sync") == "bus"
    wire = CanWire(open_can(link, profile), node, timeout, trace, awaits_sync=awaits_sync)
    try:
        patience, boot = _borne(profile, to_stop=to_stop)
        identity = when_up(lambda: identify(wire, patience), boot, timeout)
        if to_stop and profile is not None and identity == NAMELESS:
            chosen = profile  # it is busy, or has none: whatever it is, it is to be stopped
        else:
            chosen = _armed_with(agreed(identity, "canopen", profile), axis)
        lacking: tuple[str, ...] = ()
        if not to_stop:  # which asks nothing before it stops
            chosen, lacking = as_it_is(
                chosen,
                lambda at: wire.has(at.index, at.sub, patience),  # type: ignore[union-attr]
                can_guard=wire.can_guard,
            )
        pace = _pace(link, cycle or chosen.link.cycle)
        bus = CanopenBus(wire, chosen, pace, lacking)
        wire.restarted = False  # from here on a boot-up message says that all is lost
        return bus, chosen
    except BaseException:
        wire.close()
        raise


def stored_eds(text: str) -> bytes:
    """The EDS that a CANopen drive carries in object 1021h.

    Raises LinkError, AccessDenied, UsageError.
    """
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
    from drivers.canopen.adapters import open_bus

    bitrate = link.integer("bitrate", 10_000, 1_000_000)
    if bitrate is None:
        bitrate = profile.link.bitrate if profile and profile.link.bitrate else 500_000
    return open_bus(link.interface, link.channel, bitrate, _timeout(link, profile))


def _borne(profile: Profile | None, *, to_stop: bool) -> tuple[float, float]:
    """How long a drive may be busy, and boot, s; a stop asks once."""
    if to_stop:
        return 0.0, 0.0
    link = profile.link if profile else LinkDefaults()
    return link.patience, (profile.patience if profile else Patience()).boot


def _armed_with(profile: Profile, axis: Axis) -> Profile:
    """The profile with the time-out that the axis wants for the drive's watchdog."""
    if axis.limits.watchdog is None:
        return profile
    watchdog = profile.watchdog.model_copy(update={"timeout": axis.limits.watchdog})
    return profile.model_copy(update={"watchdog": watchdog})


def _timeout(link: Link, profile: Profile | None) -> float:
    if link.timeout is not None:
        return link.timeout
    return profile.link.service_timeout if profile else _CONNECT_TIMEOUT / 3


def _pace(link: Link, cycle: float) -> Pace:
    return StepPace(cycle) if link.is_stepping else WallPace(cycle)


def agreed(identity: Identity, bus: str, named: Profile | None) -> Profile:
    """The named profile if the drive is what it is for, else the one that fits.

    Raises IdentityMismatch.
    """
    if named is None:
        return fitting(identity, bus)
    if not named.identity.accepts(identity):
        told = "does not say who it is" if identity == NOBODY else f"is {identity}"
        raise IdentityMismatch(
            f"the drive {told}, but profile '{named.name}' is for vendor "
            f"{named.identity.vendor or 'any'}, product {named.identity.product or 'any'}"
            + (
                f", revision {' or '.join(named.identity.revisions)}"
                if named.identity.revisions
                else ""
            )
        )
    return named
