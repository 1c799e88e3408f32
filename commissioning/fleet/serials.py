"""Which drive is on which axis: pinned beside the fleet file by the first run, then insisted on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from profiles.errors import IdentityMismatch, Refused, UsageError
from profiles.files import replace
from profiles.identity import NO_SERIAL
from profiles.plain import plain
from profiles.toml_files import parse_tree, read_text

__all__ = ["Pins", "misplaced"]

NONE = "none"  # said of such a drive in the fleet file
_HEAD = (
    "# Which drive is on which axis of {name}: written by the first run, insisted on since.\n"
    "# After a rightful exchange: tworelay fleet check {name} --accept-serial AXIS\n"
)


class Pins:
    """The serial numbers beside a fleet file; what the file itself says is above them."""

    def __init__(self, fleet: Path, *, kept: bool = True) -> None:
        """`kept` : they are read from there, and written there."""
        self._fleet = fleet
        self._kept = kept
        self.path = fleet.with_name(f"{fleet.stem}.serials.toml")
        self.known: dict[str, str] = self._read() if kept else {}

    def _read(self) -> dict[str, str]:
        if not self.path.exists():
            return {}
        tree = parse_tree(read_text(self.path), str(self.path))
        pins = tree.get("serials", {})
        if not isinstance(pins, dict) or not all(isinstance(pin, str) for pin in pins.values()):
            raise UsageError(f'{self.path}: must be [serials] with lines AXIS = "SERIAL"')
        return pins

    def pin(self, found: Mapping[str, str]) -> None:
        """Keep these from now on; raises Refused where that cannot be written."""
        import tomlkit

        new = {**self.known, **found}
        if new == self.known or not self._kept:
            return
        lines = [  # each on its own: a table of tomlkit's takes a second for a thousand
            tomlkit.dumps({name: plain(serial)}) for name, serial in sorted(new.items())
        ]
        head = _HEAD.format(name=plain(self._fleet.name))
        text = head + "[serials]\n" + "".join(lines)
        try:
            replace(self.path, text.encode())
        except OSError as error:
            raise Refused(
                f"{self.path}: cannot be written: {error.strerror}; the next run would not know "
                "which drive is on which axis",
                code="refused.pins",
                hint='make the folder writable, or write each serial = "…" into the fleet file',
            ) from None
        self.known = new


def misplaced(found: Mapping[str, str], pinned: Mapping[str, str]) -> dict[str, IdentityMismatch]:
    """Why these axes are not to be touched: their drives are others than they have to be.

    Parameters
    ----------
    found : axis → serial that its drive tells
    pinned : axis → serial that it has to be; of all axes of the fleet, asked or not
    """
    wrong: dict[str, str] = {}
    for name, serial in found.items():
        pin = pinned.get(name)
        twins = [other for other in found if found[other] == serial and other != name]
        if serial in NO_SERIAL:
            if pin is None:
                wrong[name] = (
                    f"the drive of '{name}' tells no serial number, so that it is known by its "
                    'link alone: say serial = "none" in the fleet file if that will do'
                )
            elif pin != NONE:
                wrong[name] = f"the drive of '{name}' tells no serial number, and was {pin}"
            continue
        if twins:
            wrong[name] = f"'{name}' and '{twins[0]}' are one drive: both tell serial {serial}"
        if pin in (serial, NONE):
            continue
        owners = [other for other, its in pinned.items() if its == serial and other != name]
        if owners and found.get(owners[0]) == pin and pin is not None:
            wrong[name] = f"'{name}' and '{owners[0]}' are exchanged: {serial} is on '{name}'"
        elif owners:
            wrong[name] = f"the drive of '{owners[0]}' ({serial}) is on '{name}'"
        elif pin is not None:
            wrong[name] = (
                f"the drive of '{name}' has serial {serial}, and had {pin}: if it was exchanged "
                f"rightfully, 'tworelay fleet check FLEET --accept-serial {name}'"
            )
    return {
        name: IdentityMismatch(text, code="refused.serial", axis=name)
        for name, text in wrong.items()
    }
