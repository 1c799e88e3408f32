"""Virtual twins of the axes of a fleet, on wires and buses like those of its file, on loopback."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.journal import Journal
from commissioning.session.twin import endpoints_like, measured_twin
from drivers.home import home
from drivers.link_text import parse
from drivers.virtual.axes import VirtualAxis, configured
from drivers.virtual.memory import Memory
from drivers.virtual.served import FIRST_NODE, BusOfDrives, ServedDrive
from profiles.axis import Axis
from profiles.errors import TwoRelayError, UsageError
from profiles.library import load_profile
from profiles.transports import transport_of

__all__ = ["Twins", "on_twins", "twins_of"]

_HEAVY = 0.1, 2e-3, 1e-3  # Coulomb and viscous friction, inertia, of the rated torque


@dataclass(frozen=True, slots=True)
class Twins:
    """Buses to be served, and which axis the drives of each are, in the order of the links."""

    buses: Sequence[BusOfDrives]
    names: Sequence[str]


def twins_of(fleet: Fleet, folder: Path) -> Twins:
    """Twins of all axes that are on a bus; `folder`: of their memories. Raises UsageError.

    Axes on virtual:// are virtual already, and are left as they are.
    """
    by_bus: dict[str, list[PlannedAxis]] = {}
    for one in fleet.axes:
        if one.broken is not None:
            raise one.broken
        if one.gateway is not None:
            raise UsageError(
                f"axis '{one.name}' is described on gateway '{one.gateway}', and not here: a fleet "
                "with gateways is not rehearsed; on each of them a file with its own axes can be"
            )
        if one.bus:
            by_bus.setdefault(one.bus, []).append(one)
    buses, names = [], []
    for axes in by_bus.values():
        drives = [_twin(one, fleet.axes.index(one), folder) for one in axes]
        buses.append(BusOfDrives(drives, endpoints_like(parse(axes[0].link))))
        names += [one.name for one in axes]
    return Twins(buses, names)


def _twin(one: PlannedAxis, number: int, folder: Path) -> ServedDrive:
    assert one.axis is not None
    link = parse(one.link)
    profile = load_profile(one.axis.profile, lenient=True) if one.axis.profile else None
    if profile is not None and profile.bus != transport_of(link.scheme).name:
        raise UsageError(
            f"axis '{one.name}': profile '{profile.name}' is for {profile.bus}, its link is "
            f"{link.scheme}://"
        )
    own = profile is None or profile.name.startswith("virtual-")
    defaults = profile.link if profile else None
    return ServedDrive(
        _plant(one, number),
        Memory.at(folder / f"twin-{number}.json"),
        link.integer("unit", 0, 255) or (defaults and defaults.unit) or 1,
        link.integer("node", 1, 127) or (defaults and defaults.node) or FIRST_NODE,
        None if own else profile,
    )


def _plant(one: PlannedAxis, number: int) -> VirtualAxis:
    """What the twin moves.

    The axis that the file names for it, else what was measured of it last, else one that suits its
    motor.
    """
    if one.twin is not None:
        link = parse(f"virtual://{one.twin}")
        options = {"seed": str(number + 1), **link.options}
        return configured(link.place.strip("/"), options)
    axis = one.axis
    assert axis is not None
    measured = _measured(axis, None if one.serial == "none" else one.serial)
    if measured is not None:
        return measured
    asked = axis.limits.torque
    at_motor = asked / axis.mechanics.effort_per_torque if asked else 1.0
    rated = axis.rated_torque or at_motor
    coulomb, viscous, inertia = (share * rated for share in _HEAVY)
    options = {
        "seed": str(number + 1), "rated": f"{rated:.9g}", "peak": f"{3 * rated:.9g}",
        "coulomb": f"{coulomb:.9g}", "viscous": f"{viscous:.9g}", "inertia": f"{inertia:.9g}",
    }  # fmt: skip
    if axis.encoder is not None:
        options["encoder"] = f"{axis.encoder:.9g}"
    if axis.mechanics.held_by == "brake":
        return configured("vertical", {**options, "load": f"{rated / 10:.9g}"})
    return configured("bench", options)


def _measured(axis: Axis, serial: str | None) -> VirtualAxis | None:
    """By the last run of this computer that measured the axis, on the drive that it has now."""
    with Journal(home(), reading=True) as journal:
        run = journal.last_measured(axis.name, serial)
        if run is None:
            return None
        try:
            twin = measured_twin(journal, run, {}, lambda what, unit: None)
        except TwoRelayError:  # it does not tell enough, or its files are gone
            return None
    return twin.axis if axis.mechanics == twin.file.mechanics else None


def on_twins(fleet: Fleet, twins: Twins, links: Sequence[str]) -> Fleet:
    """The fleet with the links of its twins."""
    at = dict(zip(twins.names, links, strict=True))
    axes = []
    for one in fleet.axes:
        assert one.axis is not None
        serial = one.serial if one.serial == "none" else None
        axis = one.axis
        if one.name in at:
            axis = axis.model_copy(update={"link": at[one.name]})
        axes.append(replace(one, axis=axis, serial=serial, gateway=None))
    return replace(fleet, axes=tuple(axes), rehearsed=True)
