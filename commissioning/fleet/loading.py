"""A fleet file is read, with its axis files, and what contradicts itself in them is told."""

from __future__ import annotations

import difflib
import glob
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from commissioning.desk import Options
from commissioning.fleet.file import (
    LIMITS,
    MOST_AXES,
    OF_THE_JOB,
    AxisEntry,
    FleetFile,
    Keys,
)
from commissioning.fleet.plan import Fleet, PlannedAxis
from commissioning.result.fleet import FleetJob
from drivers.link import axis_of, check_virtual
from drivers.link_text import parse
from drivers.places import buses, same_place
from profiles.axis import Axis, axis_name, load_axis
from profiles.errors import ProfileError, UnknownName, UsageError
from profiles.toml_files import parse_tree, read_text, validated

__all__ = ["axis_in", "check_joined", "load_fleet", "one_bus_each", "place_in"]

_OF_A_LINE = "baudrate", "parity", "stopbits", "bitrate", "clock"
_NO_AXIS = "file", "serial", "after", "gateway", "twin", *OF_THE_JOB
_ONE_UNIT = "travel", "torque", "speed"  # in rad, N.m, rad/s or m, N, m/s


def load_fleet(path: Path, job: FleetJob | None = None) -> Fleet:
    """Read a fleet file and its axis files; `job`: instead of the one that it asks for.

    An axis file that is broken is kept for the axis; the fleet file itself, and what contradicts
    itself in it, raise UsageError.
    """
    file = _file(path)
    found = [one for n, entry in enumerate(file.axes, 1) for one in _entries(path, file, entry, n)]
    if len(found) > MOST_AXES:
        raise UsageError(f"{path}: has {len(found)} axes: must have {MOST_AXES} at most")
    axes = _with_buses(found)
    _check_names(path, axes)
    _check_order(path, axes)
    _check_places(path, axes)
    _check_units(path, file.defaults, axes)
    return Fleet(
        path, file.name or path.stem, job or file.job, file.confirm, axes, file.zones, file.groups,
        gateways=file.gateways, defaults=file.defaults,
    )  # fmt: skip


def check_joined(fleet: Fleet) -> None:
    """See again what could not be seen before the gateways had told of their axes."""
    for gateway in fleet.gateways:
        _check_places(fleet.path, [one for one in fleet.axes if one.gateway == gateway])
    _check_units(fleet.path, fleet.defaults, fleet.axes)


def axis_in(path: Path, defaults: Keys) -> Axis:
    """An axis as a file of this computer says it, above the defaults of a fleet.

    Raises UsageError.
    """
    of_file = load_axis(path)
    if of_file.link is None:
        raise UsageError(f'{path}: has no link; add link = "modbus-tcp://…"')
    _readable(of_file.link, str(path))
    tree = _over(_over(_of_link(of_file.link), _said(defaults)), _set_in(of_file))
    axis = _axis(tree, str(path))
    return axis.model_copy(update={"profile": _beside(path, axis.profile)})


def _file(path: Path) -> FleetFile:
    """The fleet file; an error counts its axes from 1, and says where it is an axis file."""
    tree = parse_tree(read_text(path), str(path))
    if "link" in tree and "axes" not in tree:
        raise UsageError(
            f"{path}: is an axis file, and no fleet file",
            hint=f"'tworelay commission {path}', or name it in the [[axes]] of a fleet file",
        )
    try:
        return validated(tree, FleetFile, str(path))
    except ProfileError as error:
        text = re.sub(
            r"\[axes\] (\d+):", lambda found: f"[[axes]] number {int(found[1]) + 1}:", error.text
        )
        text = re.sub(
            r"\[axes\.(\d+)([^\]]*)\]",
            lambda found: f"[[axes]] number {int(found[1]) + 1}{found[2].replace('.', ' ')}:",
            text,
        )
        raise ProfileError(text) from None


def _entries(path: Path, file: FleetFile, entry: AxisEntry, number: int) -> Iterator[PlannedAxis]:
    """The axes of one entry."""
    if entry.file is None:
        yield _planned(path, file, entry, None, number)
        return
    if not entry.is_glob:
        yield _planned(path, file, entry, path.parent / entry.file, number)
        return
    matches = sorted(glob.glob(entry.file, root_dir=path.parent))  # noqa: PTH207  Path's takes no absolute one
    if not matches:
        raise UsageError(
            f"{path}: [[axes]] number {number}: no file matches '{entry.file}' in "
            f"{path.parent.resolve()}"
        )
    for match in matches:
        yield _planned(path, file, entry, path.parent / match, number)


def _planned(
    path: Path, file: FleetFile, entry: AxisEntry, axis_file: Path | None, number: int
) -> PlannedAxis:
    """One axis: its file, what the entry says above it, the defaults below it."""
    name = _name_of(path, entry, axis_file)
    where = f"{path}: [[axes]] number {number} ({name})"
    if entry.gateway is not None or file.defaults.gateway is not None:
        return _named_only(path, file, entry, where)
    if entry.link is not None:
        _readable(entry.link, where)
    try:
        of_file = load_axis(axis_file) if axis_file else Axis(name=name)
        if axis_file and of_file.link and entry.link is None:
            _readable(of_file.link, str(axis_file))
    except UsageError as error:
        group, zone = place_in(file, where, entry.group, entry.zone)
        return PlannedAxis(
            name, None, Options(), group, zone, tuple(entry.after), entry.serial, broken=error
        )
    name = entry.name or of_file.name
    said = _set_in(of_file)
    for key in ("group", "zone"):
        mine, its = getattr(entry, key), said.get(key)
        if mine and its and mine != its:
            raise UsageError(f"{where}: {key} is '{mine}', and '{its}' in {axis_file}")
    link = entry.link or of_file.link
    tree = _over(_over(_over(_of_link(link), _said(file.defaults)), said), _said(entry))
    tree["name"] = name
    group, zone = place_in(file, where, tree.get("group"), tree.get("zone"))
    axis = _axis(tree, where)
    if axis.link is None:
        broken = UsageError(f'{where}: has no link; add link = "modbus-tcp://…"')
        return PlannedAxis(name, None, Options(), group, zone, tuple(entry.after), broken=broken)
    axis = axis.model_copy(update={"profile": _beside(path, axis.profile)})
    return PlannedAxis(
        name, axis, _options(tree), group, zone, tuple(entry.after), entry.serial,
        twin=tree.get("twin"),
    )  # fmt: skip


def _named_only(path: Path, file: FleetFile, entry: AxisEntry, where: str) -> PlannedAxis:
    """An axis that a gateway has: named here, and described there."""
    tree = {**_said(file.defaults), **_said(entry)}
    gateway = tree["gateway"]
    if entry.name is None or entry.file is not None or entry.link is not None:
        raise UsageError(
            f"{where}: an axis of a gateway is named here (name = …), and described by its file "
            f"on '{gateway}'"
        )
    if gateway not in file.gateways:
        raise UnknownName(f"gateway in {path}", gateway, list(file.gateways))
    group, zone = place_in(file, where, tree.get("group"), tree.get("zone"))
    own = frozenset(key for key in ("group", "zone") if getattr(entry, key) is not None)
    return PlannedAxis(
        entry.name, None, _options(tree), group, zone, tuple(entry.after), entry.serial, gateway,
        tree.get("twin"), said=own,
    )  # fmt: skip


def _axis(tree: Mapping[str, Any], where: str) -> Axis:
    return validated({k: v for k, v in tree.items() if k not in _NO_AXIS}, Axis, where)


def _options(tree: Mapping[str, Any]) -> Options:
    options = {key: tree[key] for key in OF_THE_JOB if tree.get(key) is not None}
    if "method" in options:
        options["method"] = str(options["method"])
    return Options(**options)


def _set_in(axis: Axis) -> dict[str, Any]:
    found: dict[str, Any] = axis.model_dump(exclude_unset=True)
    return found


def _of_link(link: str | None) -> dict[str, Any]:
    """What is known of a virtual axis by its link."""
    return _set_in(axis_of(link)) if link and parse(link).scheme == "virtual" else {}


def _name_of(path: Path, entry: AxisEntry, axis_file: Path | None) -> str:
    """What an axis is called before its file is read; raises UsageError."""
    if entry.name is not None:
        return entry.name
    assert axis_file is not None
    try:
        return axis_name(axis_file.stem)
    except ValueError as error:
        raise UsageError(
            f"{path}: {axis_file!s}: the file's name is the axis' name, which {error}",
            hint='rename it, or say name = "…" in the fleet file',
        ) from None


def _readable(link: str, where: str) -> None:
    """Raises UsageError, which says whose link it is."""
    try:
        parsed = parse(link)
        if parsed.scheme == "virtual":
            check_virtual(parsed)
    except UsageError as error:
        raise UsageError(f"{where}: {error.text}", hint=error.hint) from None


def _said(keys: Keys) -> dict[str, Any]:
    """What stands in the file, and is no default of ours; a limit by one name."""
    tree = keys.model_dump(exclude_unset=True)
    limits = {**tree.get("limits", {})}
    for option, limit in LIMITS.items():
        if option in tree:
            limits[limit] = tree.pop(option)
    return {**tree, "limits": limits} if limits else tree


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """What the upper says, else the lower; sections key by key."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        merged[key] = _over(under, value) if isinstance(under, dict) else value
    return merged


def _beside(path: Path, profile: str | None) -> str | None:
    """A profile that is a file is looked for beside the fleet file, too."""
    if profile is None or not profile.endswith(".toml"):
        return profile
    beside = path.parent / profile
    return str(beside) if beside.exists() else profile


def place_in(
    file: FleetFile | Fleet, where: str, group: str | None, zone: str | None
) -> tuple[str | None, str | None]:
    """Group and zone, which are declared, and agree; raises UsageError."""
    if group is not None and group not in file.groups:
        raise UsageError(
            f"{where}: the group '{group}' is declared nowhere; there are: "
            f"{', '.join(file.groups) or 'none'} (declare it: [groups.{group}])"
        )
    of_group = file.groups[group].zone if group is not None else None
    if zone and of_group and zone != of_group:
        raise UsageError(
            f"{where}: is in zone '{zone}', and its group '{group}' is in zone '{of_group}'"
        )
    zone = zone or of_group
    if zone is not None and zone not in file.zones:
        raise UsageError(
            f"{where}: the zone '{zone}' is declared nowhere; there are: "
            f"{', '.join(file.zones) or 'none'} (declare it: [zones.{zone}])"
        )
    return group, zone


def _check_names(path: Path, axes: Sequence[PlannedAxis]) -> None:
    if any(one.name == "failed" for one in axes):
        raise UsageError(f"{path}: 'failed' names no axis: --again failed means all that are")
    seen: dict[str, str] = {}
    for one in axes:
        before = seen.get(one.name.casefold())
        seen[one.name.casefold()] = one.name
        if before is not None:
            raise UsageError(
                f"{path}: the axis '{before}' is named twice: an axis is in a fleet once, "
                'and two files of one name want name = "…"'
            )


def _check_order(path: Path, axes: Sequence[PlannedAxis]) -> None:
    """`after` names axes of the fleet, and leads nowhere in a circle."""
    after = {one.name: set(one.after) for one in axes}
    for one in axes:
        for name in one.after:
            if name not in after:
                near = difflib.get_close_matches(name, after, 1)
                hint = f"; did you mean '{near[0]}'?" if near else ""
                raise UsageError(
                    f"{path}: '{one.name}' is to run after '{name}', which is no axis here{hint}"
                )
    left = dict(after)
    while free := [name for name, before in left.items() if not before & left.keys()]:
        for name in free:
            del left[name]
    if left:
        way = [min(left)]
        while (before := min(left[way[-1]] & left.keys())) not in way:
            way.append(before)
        circle = [*way[way.index(before) :], before]
        raise UsageError(f"{path}: 'after' leads in a circle: {' after '.join(circle)}")


def _check_units(path: Path, defaults: Keys, axes: Sequence[PlannedAxis]) -> None:
    """A length in the defaults is of one kind of axis."""
    said = _said(defaults)
    named = [key for key in _ONE_UNIT if key in {**said, **said.get("limits", {})}]
    kinds = {one.axis.position_unit: one.name for one in axes if one.axis is not None}
    if named and len(kinds) > 1:
        raise UsageError(
            f"{path}: {named[0]} in [defaults] would be in rad or N.m for '{kinds['rad']}', and in "
            f"m or N for '{kinds['m']}': say it for each",
        )


def _check_places(path: Path, axes: Sequence[PlannedAxis]) -> None:
    """Each drive once, and one setting of each line."""
    here: dict[str, list[PlannedAxis]] = {}
    for one in axes:
        if one.link:
            here.setdefault(one.bus or one.link, []).append(one)
    for on_bus in here.values():
        first, *others = on_bus
        for n, one in enumerate(others, 1):
            for other in on_bus[:n]:
                if same_place(one.link, other.link):
                    raise UsageError(
                        f"{path}: '{other.name}' and '{one.name}' are one drive ({one.link})"
                    )
            mine, its = parse(one.link).options, parse(first.link).options
            for key in _OF_A_LINE:
                if mine.get(key) != its.get(key):
                    raise UsageError(
                        f"{path}: '{first.name}' and '{one.name}' are on one bus, and say "
                        f"{key}={its.get(key, 'nothing')} and {key}={mine.get(key, 'nothing')}"
                    )


def _with_buses(axes: Sequence[PlannedAxis]) -> tuple[PlannedAxis, ...]:
    """The axes with one name of their bus each."""
    found = one_bus_each([buses(one.link) if one.link else () for one in axes])
    return tuple(replace(one, bus=bus) for one, bus in zip(axes, found, strict=True))


def one_bus_each(names_of: Sequence[Iterable[str]]) -> list[str]:
    """One name of the bus of each: those that share one of its names are on one bus.

    '' where there is none.
    """
    named: list[tuple[set[str], list[int]]] = []
    for n, its_names in enumerate(names_of):
        mine, its = set(its_names), [n]
        if not mine:
            continue
        others = []
        for known, members in named:
            if known & mine:
                mine, its = mine | known, [*members, *its]
            else:
                others.append((known, members))
        named = [*others, (mine, its)]
    bus_of = {n: min(names) for names, members in named for n in members}
    return [bus_of.get(n, "") for n in range(len(names_of))]
