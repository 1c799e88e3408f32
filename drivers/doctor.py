"""What this machine has for talking to drives, and why a link does not work. Only reads."""

from __future__ import annotations

import contextlib
import os
import platform
import socket
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

from drivers.errors import AccessDenied, LinkError, NoAnswer
from drivers.home import home
from drivers.link import check_virtual, modbus_wire, open_can
from drivers.link_text import Link, parse
from profiles.errors import TwoRelayError
from profiles.procedures import LinkDefaults, Patience

__all__ = ["Check", "of_link", "of_machine"]

_PACKAGES = ("tworelay", "pymodbus", "python-can", "canopen", "pyserial", "numpy", "scipy")
_CAN_DEVICE = "280"  # ARPHRD_CAN, /sys/class/net/*/type
_SLOW_LATENCY = 2  # ms, of an FTDI adapter's timer
_NAPS, _SLEEP = 60, 0.002  # s
_LATE_SLEEP = 0.001  # s
_LISTEN = 0.6  # s
_SERIAL = [
    (b, p, s)
    for b in (115200, 57600, 38400, 19200, 9600)
    for p, s in (("N", 1), ("E", 1), ("N", 2))
]
_ANSWER = 0.65  # s: some slaves lose framing for half a second


@dataclass(frozen=True, slots=True)
class Check:
    """One line: `ok`, a `note`, a `warning`, or a `problem` that keeps a job from running."""

    level: Literal["ok", "note", "warning", "problem"]
    text: str


def of_machine() -> Iterator[Check]:
    """Versions, clock, ports, adapters, permissions."""
    yield from _versions()
    yield from _state_folder()
    yield from _priority()
    yield from _clock()
    yield from _serial_ports()
    yield from _can_interfaces()


def _versions() -> Iterator[Check]:
    yield Check(
        "ok", f"Python {platform.python_version()} on {platform.system()} {platform.release()}"
    )
    found = []
    for name in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    yield Check("ok", ", ".join(found))


def _state_folder() -> Iterator[Check]:
    folder = home()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        yield Check("problem", f"the state folder {folder} cannot be made: {error.strerror}")
        return
    if os.access(folder, os.W_OK):
        yield Check("ok", f"state folder {folder}")
    else:
        yield Check("problem", f"the state folder {folder} cannot be written; set TWORELAY_HOME")


def _priority() -> Iterator[Check]:
    if sys.platform != "linux":
        yield Check(
            "note", "this system has no real-time priority to give: plan with 10 ms and more"
        )
        return
    import resource

    rtprio, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if rtprio > 0 or os.geteuid() == 0:
        yield Check("ok", "real-time priority is permitted")
    else:
        yield Check(
            "note",
            "no real-time priority for this user: under load cycles come late; to permit it, add "
            "'@dialout - rtprio 80' and '@dialout - memlock unlimited' to "
            "/etc/security/limits.conf",
        )


def _clock() -> Iterator[Check]:
    late = []
    for _ in range(_NAPS):
        begin = time.perf_counter()
        time.sleep(_SLEEP)
        late.append(time.perf_counter() - begin - _SLEEP)
    middle, worst = statistics.median(late), max(late)
    told = f"{middle * 1000:.2f} ms, {worst * 1000:.1f} ms at worst"
    text = f"a sleep of {_SLEEP * 1000:g} ms is late by {told}"
    yield Check("ok" if middle < _LATE_SLEEP else "warning", text)


def _serial_ports() -> Iterator[Check]:
    from serial.tools import list_ports

    ports = [p for p in list_ports.comports() if p.hwid != "n/a"]
    if not ports:
        yield Check("note", "no serial adapter is plugged in")
    for port in ports:
        yield Check("ok", f"serial port {port.device}: {port.description}")
        if sys.platform != "win32" and not os.access(port.device, os.R_OK | os.W_OK):
            yield Check(
                "problem", f"{port.device}: this user may not use it; add the user to group dialout"
            )
        timer = latency_timer(port.device)
        if timer is not None and timer > _SLOW_LATENCY:
            yield Check(
                "warning",
                f"{port.device}: its latency timer is {timer} ms, so that every answer comes that "
                f"late; 'echo 1 | sudo tee {_timer_file(port.device)}' mends it until it is "
                "unplugged",
            )


def _timer_file(device: str) -> Path:
    return Path("/sys/bus/usb-serial/devices") / Path(device).name / "latency_timer"


def latency_timer(device: str) -> int | None:
    """Latency timer of an FTDI adapter, ms; None where there is none."""
    try:
        return int(_timer_file(device).read_text())
    except (OSError, ValueError):
        return None


def _can_interfaces() -> Iterator[Check]:
    if sys.platform != "linux" or not hasattr(socket, "AF_CAN"):
        yield Check(
            "note",
            "no SocketCAN on this system: CAN adapters by their own drivers (PCAN, Kvaser, slcan)",
        )
        return
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        yield Check("note", "this kernel has no SocketCAN: slcan and socketcand work without")
        return
    found = False
    for folder in sorted(Path("/sys/class/net").glob("*")):
        with contextlib.suppress(OSError):
            if (folder / "type").read_text().strip() != _CAN_DEVICE:
                continue
            found = True
            if (folder / "operstate").read_text().strip() == "down":
                yield Check(
                    "problem",
                    f"{folder.name} is down: sudo ip link set {folder.name} up type can bitrate "
                    "500000",
                )
            else:
                yield Check("ok", f"CAN interface {folder.name} is up")
    if not found:
        yield Check("note", "no CAN interface is there (ip link shows none of type can)")


# -- a link ---------------------------------------------------------------------------------------


def of_link(text: str, tell: Callable[[str], None]) -> Iterator[Check]:
    """Why a LINK works or not; raises UsageError. `tell` hears what takes long."""
    link = parse(text)
    if link.scheme == "virtual":
        check_virtual(link)
        yield Check("ok", "virtual:// is in this process: nothing to be wrong with")
    elif link.scheme == "canopen":
        yield from _of_canopen(link, tell)
    else:
        yield from _of_modbus(link, tell)


def _of_canopen(link: Link, tell: Callable[[str], None]) -> Iterator[Check]:
    """Channel, bit rate, node, heartbeat: the four questions behind 'no SDO response'."""
    from drivers.canopen.survey import ask, listen, survey

    try:
        bus = open_can(link)
    except LinkError as error:
        yield Check("problem", f"channel: {error}")
        return
    wanted = link.integer("node", 1, 127)
    try:
        yield Check("ok", "channel: the adapter opens")
        tell("listening")
        traffic = listen(bus, _LISTEN)
        tell("asking every node")
        try:
            nodes = survey(bus, 0.2)
            if wanted is not None and wanted not in [n.number for n in nodes if n.identity]:
                tell(f"asking node {wanted} as a job does")
                with contextlib.suppress(NoAnswer, AccessDenied):
                    nodes.append(ask(bus, wanted, LinkDefaults().service_timeout, Patience().boot))
        except LinkError as error:
            yield Check(
                "problem",
                f"bit rate: {error}; nobody acknowledges: is the bit rate right, the bus "
                "terminated (60 Ω between CAN_H and CAN_L), the drive on?",
            )
            return
    finally:
        bus.shutdown()
    if traffic.errors:
        yield Check(
            "problem",
            f"bit rate: {traffic.errors} error frames within {_LISTEN:g} s: {traffic.trouble}",
        )
    elif traffic.frames or nodes:
        yield Check("ok", f"bit rate: {traffic.frames} frames heard within {_LISTEN:g} s, none bad")
    else:
        yield Check(
            "problem",
            "bit rate: nothing is heard and nobody answers: drive on? cable in? bit rate as set in "
            "the drive? another channel of the adapter?",
        )
    numbers = [node.number for node in nodes if node.identity is not None]
    if wanted is not None and wanted in numbers:
        yield Check("ok", f"node: {wanted} answers")
    elif wanted is not None:
        there = f"nodes {', '.join(map(str, numbers))} do" if numbers else "no other does"
        yield Check("problem", f"node: {wanted} does not answer to SDO; {there}")
    else:
        yield Check("ok" if numbers else "problem", f"node: {len(numbers)} answer: {numbers}")
    beating = traffic.heartbeats | {n.number for n in nodes if n.identity is None}
    if wanted in beating and wanted not in numbers:
        yield Check(
            "warning",
            f"heartbeat: node {wanted} beats, but answers no SDO: stopped, or busy starting",
        )
    elif beating:
        yield Check("ok", f"heartbeat: of {sorted(beating)}")
    else:
        yield Check(
            "note", "heartbeat: none is heard (many drives are delivered with it switched off)"
        )


def _of_modbus(link: Link, tell: Callable[[str], None]) -> Iterator[Check]:
    from drivers.modbus.client import Client
    from drivers.modbus.survey import EVERYBODY, is_there, survey
    from drivers.modbus.wires import RtuLine

    wire = modbus_wire(link, None)
    wanted = link.integer("unit", 0, 255)
    number = 1 if wanted is None else wanted
    try:
        client = Client(wire, number, 1.0)
    except TwoRelayError as error:
        yield Check("problem", f"connection: {error}")
        return
    try:
        yield Check("ok", f"connection: {wire} opens")
        if isinstance(wire, RtuLine) and (timer := latency_timer(wire.port) or 0) > _SLOW_LATENCY:
            yield Check(
                "warning", f"latency timer of {wire.port} is {timer} ms: every answer is that late"
            )
        if is_there(client, _ANSWER):
            yield Check("ok", f"unit: {number} answers")
            return
        yield Check("problem", f"unit: {number} does not answer within {_ANSWER:g} s")
        tell("asking units 1 to 10")
        others = [
            u.number
            for u in survey(client, range(1, 11), _ANSWER, lambda n: None)
            if u is not EVERYBODY
        ]
    finally:
        client.close()
    if others:
        yield Check("note", f"unit: these answer: {others}")
        return
    if not isinstance(wire, RtuLine):
        yield Check(
            "problem", "unit: none of 1 to 10 answers; is it a Modbus port, and Modbus switched on?"
        )
        return
    for baudrate, parity, stopbits in _SERIAL:
        line = replace(wire, baudrate=baudrate, parity=parity, stopbits=stopbits)
        tell(f"trying {line}")
        try:
            client = Client(line, number, 1.0)
        except LinkError:  # an adapter that cannot be set so
            continue
        try:
            if is_there(client, _ANSWER):
                setting = f"baudrate={baudrate}&parity={parity}&stopbits={stopbits}"
                yield Check("note", f"line: unit {number} answers with {setting}")
                return
        finally:
            client.close()
    yield Check(
        "problem",
        "line: no usual setting gets an answer: A and B swapped? termination? RS-485 and not "
        "RS-232? drive on, and its own port enabled?",
    )
