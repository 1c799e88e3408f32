"""TARGET on the command line: a link, or an axis file."""

from __future__ import annotations

import re
from difflib import get_close_matches
from pathlib import Path
from urllib.parse import quote

from drivers.link import axis_of
from profiles.axis import Axis, load_axis
from profiles.errors import ProfileError, UsageError
from profiles.toml_files import parse_tree, read_text

__all__ = ["axis_from", "is_target"]


def is_target(text: str) -> bool:
    """Whether a text is a TARGET, a LINK or an axis file, and not a RUN."""
    return "://" in text or text.startswith("modbus-rtu:") or text.endswith(".toml")


def axis_from(target: str, profile: str | None) -> Axis:
    """TARGET, a LINK or an axis file, as an axis."""
    if "://" in target or target.startswith("modbus-rtu:"):
        axis = axis_of(target)
    elif target.endswith(".toml"):
        axis = _axis_of_file(Path(target))
        if axis.link is None:
            raise UsageError(f'{target}: has no link; add link = "modbus-tcp://…"')
    else:
        raise UsageError(
            f"'{target:.80}' is no link and no axis file; "
            + (
                _meant(target)
                or "a link begins with virtual://, "
                "modbus-tcp://, modbus-rtu: or canopen://, an axis file ends with .toml"
            )
        )
    return axis.model_copy(update={"profile": profile}) if profile else axis


def _axis_of_file(path: Path) -> Axis:
    """An axis file; one that is a fleet file is told so."""
    try:
        return load_axis(path)
    except ProfileError:
        if not _is_fleet(path):
            raise
    raise UsageError(
        f"{path}: is a fleet file, and no axis file", hint=f"'tworelay fleet check {path}'"
    )


def _is_fleet(path: Path) -> bool:
    try:
        return "axes" in parse_tree(read_text(path), str(path))
    except ProfileError:
        return False


_PORT = re.compile(r"(COM\d+|/dev/\S+)", re.IGNORECASE)
_CAN = re.compile(r"(v?can\d+|slcan\d+)", re.IGNORECASE)
_HOST = re.compile(r"(\d{1,3}(?:\.\d{1,3}){3}|localhost|[\w-]+(?:\.[\w-]+)+)(?::(\d+))?")


def _meant(target: str) -> str:
    """How to write what a technician calls it: a port, an address, a CAN interface; else ''."""
    if _PORT.fullmatch(target):
        return (
            f"a drive on a serial port is 'modbus-rtu:{target}?unit=1&baudrate=19200' (Modbus), or "
            f"'canopen://slcan/{quote(target, safe='')}?node=1' (a CAN adapter with slcan)"
        )
    if _CAN.fullmatch(target):
        return f"a drive on CAN is 'canopen://socketcan/{target}?node=1', with its own node"
    found = _HOST.fullmatch(target)
    if found and Path(target).suffix != ".toml":
        port = f":{found[2]}" if found[2] else ""
        return (
            f"a drive on Ethernet is 'modbus-tcp://{found[1]}{port}?unit=1', with its own unit; "
            f"one behind a CAN gateway 'canopen://socketcand/{found[1]}/can0?node=1'"
        )
    if names := get_close_matches(target, builtin_axes(), 1):
        return f"did you mean the virtual axis 'virtual://{names[0]}'?"
    near = get_close_matches(target, [path.stem for path in Path().glob("*.toml")], 1)
    return f"did you mean the axis file '{near[0]}.toml'?" if near else ""


def builtin_axes() -> list[str]:
    """Names of the virtual axes."""
    from drivers.virtual.axes import AXES

    return list(AXES)
