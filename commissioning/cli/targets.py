"""TARGET on the command line: a link, or an axis file."""

from __future__ import annotations

from pathlib import Path

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
            f"'{target:.80}' is no link and no axis file; a link begins with virtual://, "
            "modbus-tcp://, modbus-rtu: or canopen://, an axis file ends with .toml"
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
