"""What is to be done to which axis: a fleet file that was read, with its axes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from commissioning.desk import Options
from commissioning.fleet.file import Gateway, Group, Keys, Zone
from commissioning.result.fleet import FleetJob
from drivers.link_text import is_simulated, is_stepped
from profiles.axis import Axis
from profiles.errors import TwoRelayError, UnknownName

__all__ = ["AtGateway", "Fleet", "PlannedAxis", "differences"]


@dataclass(frozen=True, slots=True)
class AtGateway:
    """What only the gateway of an axis knows.

    Attributes
    ----------
    stepping, simulated : of its drive, as on that computer
    cut_off : a run on its drive that was cut off there
    """

    stepping: bool = False
    simulated: bool = False
    cut_off: str | None = None


@dataclass(frozen=True, slots=True)
class PlannedAxis:
    """One axis of the fleet.

    Attributes
    ----------
    axis, options : what is asked of it; the axis is None where its file is broken
    bus : a name of the bus that it is on; '': one of its own, in this computer's memory
    serial : which drive it has to be, as the file says; None: as it was pinned
    broken : why it cannot be tried
    gateway : computer that has its bus; None: this one
    far : what that computer tells of it, once it has been asked
    said : of group and zone, what is said of the axis itself and not in the defaults
    """

    name: str
    axis: Axis | None
    options: Options
    group: str | None = None
    zone: str | None = None
    after: tuple[str, ...] = ()
    serial: str | None = None
    gateway: str | None = None
    twin: str | None = None
    bus: str = ""
    broken: TwoRelayError | None = None
    far: AtGateway | None = None
    said: frozenset[str] = frozenset()

    @property
    def link(self) -> str:
        """Where its drive is; '' where that is not known."""
        return (self.axis and self.axis.link) or ""

    @property
    def is_stepping(self) -> bool:
        """Whether its time is simulated."""
        if self.gateway is not None:
            return self.far is not None and self.far.stepping
        return bool(self.link) and is_stepped(self.link)

    @property
    def is_real(self) -> bool:
        """Whether something moves: its drive is neither virtual nor on loopback."""
        if self.gateway is not None:
            return self.far is not None and not self.far.simulated
        return bool(self.link) and not is_simulated(self.link)


@dataclass(frozen=True, slots=True)
class Fleet:
    """A fleet file that is in order; `rehearsed`: its drives are twins.

    `defaults` : of an axis, which the axis files of gateways are above, too. `cores`: processors of
    each gateway that has been asked. `as_read`: before that.
    """

    path: Path
    name: str
    job: FleetJob
    confirm: str
    axes: tuple[PlannedAxis, ...]
    zones: Mapping[str, Zone]
    groups: Mapping[str, Group]
    rehearsed: bool = False
    gateways: Mapping[str, Gateway] = field(default_factory=dict)
    defaults: Keys = field(default_factory=Keys)
    cores: Mapping[str, int] = field(default_factory=dict)
    as_read: Fleet | None = None

    def axis(self, name: str) -> PlannedAxis:
        """By its name; raises UnknownName."""
        for one in self.axes:
            if one.name == name:
                return one
        raise UnknownName("axis of the fleet", name, [one.name for one in self.axes])

    @property
    def definition(self) -> dict[str, Any]:
        """All that it asks for, as JSON has it: two are alike where they ask for the same."""
        axes = {}
        for one in (self.as_read or self).axes:  # the rest is the gateways' to say
            here = one.axis if one.gateway is None else None
            said = json.loads(here.model_dump_json(exclude_unset=True)) if here else {}
            options = {f.name: getattr(one.options, f.name) for f in fields(one.options)}
            others = {
                "group": one.group, "zone": one.zone, "after": list(one.after),
                "serial": one.serial, "profile_hash": _hash_of(one), "gateway": one.gateway,
            }  # fmt: skip
            merged = (*options.items(), *said.items(), *others.items())
            axes[one.name] = {k: v for k, v in merged if v not in (None, False, [], {})}
        return {
            "name": self.name, "job": self.job, "confirm": self.confirm,
            "groups": {name: one.model_dump() for name, one in self.groups.items()},
            "zones": {name: one.model_dump() for name, one in self.zones.items()},
            "axes": axes,
            "rehearsed": self.rehearsed,
            **({"gateways": self._gateways} if self._gateways else {}),
        }  # fmt: skip

    @property
    def _gateways(self) -> dict[str, Any]:
        return {name: one.model_dump() for name, one in self.gateways.items()}


def _hash_of(one: PlannedAxis) -> str | None:
    """Of a profile that is a file, which may change."""
    profile = one.axis and one.gateway is None and one.axis.profile
    if not profile or not profile.endswith(".toml"):
        return None
    try:
        return hashlib.sha256(Path(profile).read_bytes()).hexdigest()[:16]
    except OSError:
        return None


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """What two definitions differ in, one line each."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in dict.fromkeys((*old, *new)):
            inside = f"{where}.{key}".lstrip(".")
            if key not in new:
                yield f"{inside} is gone"
            elif key not in old:
                yield f"{inside} is new"
            else:
                yield from differences(old[key], new[key], inside)
    elif old != new:
        yield f"{where} is {new!r}, was {old!r}"
