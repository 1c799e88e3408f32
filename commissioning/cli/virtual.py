"""tworelay virtual list | serve AXIS..."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from commissioning.cli.helping import HelpfulGroup
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text, say
from profiles.errors import UsageError

if TYPE_CHECKING:
    from drivers.link_text import Link
    from drivers.virtual.axes import VirtualAxis
    from drivers.virtual.served import Endpoints, ServedDrive
    from profiles.schema import Profile

__all__ = ["command"]


@click.group("virtual", cls=HelpfulGroup)
def command() -> None:
    """Virtual drives: to learn on, to rehearse on, and for CI."""


@command.command("list")
@click.option("--habits", is_flag=True, help="The habits that a served one can have.")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def list_axes(habits: bool, as_json: bool) -> None:
    """The virtual axes and their figures."""
    if habits:
        from drivers.virtual.habits import HABITS

        if as_json:
            document(json_text({name: asdict(habit) for name, habit in HABITS.items()}))
            return
        for name, habit in HABITS.items():
            default = f"={habit.default}" if habit.default else ""
            say(f"{name + default:<18} {habit.text} [{', '.join(habit.buses)}]")
        return
    from drivers.virtual.axes import AXES

    if as_json:
        document(json_text([asdict(axis) for axis in AXES.values()]))
        return
    for axis in AXES.values():
        rotary = axis.motion == "rotary"
        j, b, e, p = ("kg.m2", "N.m.s/rad", "N.m", "rad") if rotary else ("kg", "N.s/m", "N", "m")
        say(f"{axis.name:<13} {axis.title}")
        say(
            f"{'':<13} inertia {axis.inertia:g} {j}, viscous {axis.viscous:g} {b}, Coulomb "
            f"{_coulomb(axis)} {e}, load {axis.load:g} {e}, rated {axis.rated:g} {e}, travel "
            f"±{axis.travel:.4g} {p}{', holding brake' if axis.brake else ''}"
        )
        needs = [] if rotary else ['motion = "linear"', "feed = 6.283185307179586"]
        needs += ['held_by = "brake"'] if axis.brake else []
        if needs:
            say(f"{'':<13} served: axis file with [mechanics] {', '.join(needs)}")


@command.command("serve")
@click.argument("axes", nargs=-1, metavar="[AXIS...]")
@click.option(
    "--from",
    "runs",
    multiple=True,
    metavar="RUN",
    help="The twin of the axis that RUN measured, at its motor, on a wire like the run's own "
    "unless one is named; --set is for what it does not tell. Several: on one bus.",
)
@click.option(
    "--ready", type=click.Path(dir_okay=False, path_type=Path), metavar="F",
    help="Write names and links to F as JSON once all are ready, for the program that waits.",
)  # fmt: skip
@click.option(
    "--with-parent", is_flag=True, help="End when the process that started it is no more."
)
@click.option(
    "--axis-file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="With --from: write the twin's axis file to F, to commission it.",
    metavar="F",
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="K=V",
    help="Option of every axis, as in a virtual:// link.",
)
@click.option("--modbus-tcp", metavar="HOST:PORT", help="Modbus TCP; port 0 is any free one.")
@click.option("--modbus-rtu", type=click.Choice(["pty"]), help="Modbus RTU on a pseudo-terminal.")
@click.option("--modbus-rtu-tcp", metavar="HOST:PORT", help="Modbus RTU frames over TCP.")
@click.option("--socketcand", metavar="HOST:PORT", help="CANopen by the socketcand protocol.")
@click.option("--slcan", type=click.Choice(["pty"]), help="CANopen by slcan on a pseudo-terminal.")
@click.option(
    "--profile", metavar="P", help="Behave by this drive's objects or registers: its twin."
)
@click.option(
    "--habit",
    "habits",
    multiple=True,
    metavar="NAME[=VALUE]",
    help="A habit of real drives ('tworelay virtual list --habits').",
)
@click.option("--clock", type=click.Choice(["wall", "step"]), default="wall", show_default=True)
@click.option(
    "--state",
    type=click.Path(dir_okay=False, path_type=Path),
    help="File of its non-volatile memory.",
)
@verbose
def serve_axes(
    axes: tuple[str, ...],
    runs: tuple[str, ...],
    ready: Path | None,
    with_parent: bool,
    axis_file: Path | None,
    changes: tuple[str, ...],
    modbus_tcp: str | None,
    modbus_rtu: str | None,
    modbus_rtu_tcp: str | None,
    socketcand: str | None,
    slcan: str | None,
    profile: str | None,
    habits: tuple[str, ...],
    clock: Literal["wall", "step"],
    state: Path | None,
) -> None:
    """Serve virtual AXES on one bus until Ctrl-C; prints one ready LINK a line.

    Several are units behind one Modbus gateway or on one line, nodes on one CAN bus, with one
    clock: bench?unit=1 bench?unit=2&coulomb=0.2, or node=. Or AXIS is a FLEET.toml: twins of all
    its axes, bus by bus.
    """
    from drivers.virtual.habits import habits_of
    from drivers.virtual.serve import serve
    from drivers.virtual.served import BusOfDrives, Endpoints
    from profiles.library import load_profile

    until = _parent_is_gone() if with_parent else _never
    if ready is not None:  # what is there is of drives that were served before
        try:
            ready.unlink(missing_ok=True)
        except OSError as error:
            raise UsageError(f"--ready {ready}: cannot be written: {error.strerror}") from None
    if len(axes) == 1 and axes[0].endswith(".toml"):
        sys.exit(128 + _serve_fleet(Path(axes[0]), clock, state, ready, until))
    endpoints = Endpoints(
        modbus_tcp=_place(modbus_tcp),
        modbus_rtu_tcp=_place(modbus_rtu_tcp),
        modbus_rtu_pty=modbus_rtu == "pty",
        socketcand=_place(socketcand),
        slcan_pty=slcan == "pty",
    )
    if runs or not axes:
        _no_axes(axes, runs, profile)
        ending = _serve_runs(
            runs, changes, endpoints, clock, state, axis_file, habits, ready, until
        )
        sys.exit(128 + ending)
    if axis_file is not None:
        raise UsageError("--axis-file belongs to --from: a virtual axis needs none")
    links = [_link(axis, changes) for axis in axes]
    named = [link.options.get("habit", "").split(",") for link in links]
    found = habits_of(filter(None, (*(name for each in named for name in each), *habits)))
    found.for_bus("modbus" if endpoints.is_modbus else "canopen")
    twin_of = load_profile(profile) if profile else None
    if twin_of is not None and (
        endpoints.is_modbus if twin_of.bus == "canopen" else endpoints.is_canopen
    ):
        raise UsageError(
            f"profile '{twin_of.name}' is for {twin_of.bus}: its twin is served there only"
        )
    if not (endpoints.is_modbus or endpoints.is_canopen):
        raise UsageError(
            "serve where? Give --modbus-tcp HOST:PORT, --modbus-rtu pty, --modbus-rtu-tcp "
            "HOST:PORT, --socketcand HOST:PORT or --slcan pty"
        )
    if state is not None and len(links) > 1:
        raise UsageError(
            f"--state {state}: {len(links)} drives have a memory each: name them in the axes, "
            "as in bench?state=a.json"
        )
    key = "unit" if endpoints.is_modbus else "node"
    drives = _told_apart((_served(link, n, state, twin_of) for n, link in enumerate(links)), key)
    told = _Ready(ready, axes, endpoints.count)
    sys.exit(128 + serve([BusOfDrives(drives, endpoints, found)], clock, told, until))


def _never() -> bool:
    return False


def _parent_is_gone() -> Callable[[], bool]:
    """Whether the process that started this one has ended since."""
    import os

    parent = os.getppid()
    if os.name != "nt":
        return lambda: os.getppid() != parent
    import psutil

    process = psutil.Process(parent)
    return lambda: not process.is_running()


class _Ready:
    """Says each LINK, and leaves names and links in a file once each drive has one."""

    def __init__(self, path: Path | None, names: Sequence[str], wires: int = 1) -> None:
        self._path, self._names, self._wires = path, names, wires
        self._links: dict[int, list[str]] = {}

    def __call__(self, number: int, link: str) -> None:
        say(link)
        self._links.setdefault(number, []).append(link)
        told = sum(len(links) for links in self._links.values())
        if self._path is not None and told == self._wires * len(self._names):
            named = zip(self._names, (self._links[n] for n in sorted(self._links)), strict=True)
            _write(self._path, json_text([{"name": n, "links": found} for n, found in named]))


def _serve_fleet(
    path: Path,
    clock: Literal["wall", "step"],
    state: Path | None,
    ready: Path | None,
    until: Callable[[], bool],
) -> int:
    """Twins of all axes of a fleet file, on wires like those of the file; a LINK a line."""
    import tempfile

    from commissioning.fleet.loading import load_fleet
    from commissioning.fleet.twins import twins_of
    from drivers.virtual.serve import serve

    if state is not None:
        raise UsageError(f"--state {state}: the drives of a fleet forget what they store")
    with tempfile.TemporaryDirectory() as folder:
        twins = twins_of(load_fleet(path), Path(folder))
        if not twins.buses:
            raise UsageError(f"{path}: all its axes are virtual:// already")
        return serve(twins.buses, clock, _Ready(ready, twins.names), until)


def _no_axes(axes: tuple[str, ...], runs: tuple[str, ...], profile: str | None) -> None:
    if not runs:
        raise UsageError(
            "which? Give an AXIS ('tworelay virtual list'), a FLEET.toml, or --from RUN"
        )
    if axes:
        raise UsageError(f"--from RUN and {axes[0]}: serve them from two commands")
    if profile is not None:
        raise UsageError("--from RUN has the profile of the run: leave --profile out")


def _serve_runs(
    runs: tuple[str, ...],
    changes: tuple[str, ...],
    endpoints: Endpoints,
    clock: Literal["wall", "step"],
    state: Path | None,
    axis_file: Path | None,
    habits: tuple[str, ...],
    ready: Path | None,
    until: Callable[[], bool],
) -> int:
    """Twins of the axes that runs measured, on one bus; a LINK a line."""
    from commissioning.journal import Journal
    from commissioning.session.twin import endpoints_like, measured_twin, numbered
    from drivers.home import home
    from drivers.virtual.habits import habits_of
    from drivers.virtual.serve import serve
    from drivers.virtual.served import BusOfDrives
    from profiles.axis import axis_text

    if len(runs) > 1 and (state or axis_file):
        raise UsageError(f"{state or axis_file}: {len(runs)} drives do not go into one file")
    if axis_file is not None and axis_file.exists():
        raise UsageError(f"--axis-file {axis_file}: is there already: name another file")
    given = _given(changes)
    with Journal(home(), reading=True) as journal:
        twins = [measured_twin(journal, run, given, _asked) for run in runs]
    if not (endpoints.is_modbus or endpoints.is_canopen):
        endpoints = endpoints_like(twins[0].link, twins[0].profile)
    key: Literal["unit", "node"] = "unit" if endpoints.is_modbus else "node"
    numbers = numbered(twins, key)
    drives = [one.served(numbers[n], numbers[n], n, state) for n, one in enumerate(twins)]
    for one, number in zip(twins, numbers, strict=True):
        for line in one.said:
            say(f"{one.axis.name}: {line}", err=True)
        if one.link.integer(key, 1, 247) not in (None, number):
            say(f"{one.axis.name}: {key} {number}, since its own is another's here", err=True)
    left = [twins[0]] if axis_file else []
    is_ready = _Ready(ready, [one.axis.name for one in twins], endpoints.count)

    def told(number: int, link: str) -> None:
        if axis_file is not None and left:
            _write(axis_file, axis_text(left.pop().file.model_copy(update={"link": link})))
        is_ready(number, link)

    bent = habits_of(habits).for_bus("modbus" if endpoints.is_modbus else "canopen")
    return serve([BusOfDrives(drives, endpoints, bent)], clock, told, until)


def _write(path: Path, text: str) -> None:
    from profiles.files import replace

    try:
        replace(path, text.encode())
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _given(changes: tuple[str, ...]) -> dict[str, str]:
    """K=V as options; raises UsageError."""
    pairs = [change.partition("=") for change in changes]
    for key, _, value in pairs:
        if not key or not value:
            raise UsageError(f"--set {key}: must be NAME=VALUE, as in --set inertia=0.001")
    return {key: value for key, _, value in pairs}


def _asked(what: str, unit: str) -> float | None:
    """What a run does not tell, of whoever is at the terminal."""
    if not sys.stdin.isatty():
        return None
    answer: float = click.prompt(f"{what} in {unit}, at the motor", type=float, err=True)
    return answer


def _link(axis: str, changes: tuple[str, ...]) -> Link:
    """AXIS[?OPTIONS], and what is set for every one, as a link."""
    from drivers.link_text import parse

    query = "&".join(changes)
    return parse(f"virtual://{axis}" + (f"{'&' if '?' in axis else '?'}{query}" if query else ""))


def _served(link: Link, n: int, state: Path | None, twin_of: Profile | None) -> ServedDrive:
    """The `n`-th axis of a bus, from 0."""
    from drivers.link import state_file
    from drivers.link_text import Link
    from drivers.virtual.axes import configured
    from drivers.virtual.memory import Memory
    from drivers.virtual.served import FIRST_NODE, FIRST_UNIT, ServedDrive

    ours = {key: value for key, value in link.options.items() if key not in _OF_THE_BUS}
    named = link.options.get("state")
    axis = configured(link.place.strip("/"), ours, state or named)
    for key in ("jitter", "loss", "stamp"):
        if getattr(axis, key):
            raise UsageError(f"{key} is for virtual:// links: a served drive has its wire's own")
    memory = state or state_file(Link(link.text, link.scheme, link.place, {**ours, **_if(named)}))
    return ServedDrive(
        axis,
        Memory.at(memory),
        link.integer("unit", 1, 247) or FIRST_UNIT + n,
        link.integer("node", 1, 127) or FIRST_NODE + n,
        twin_of,
    )


_OF_THE_BUS = "unit", "node", "state", "habit"


def _if(state: str | None) -> dict[str, str]:
    return {} if state is None else {"state": state}


def _told_apart(drives: Iterable[ServedDrive], key: str) -> list[ServedDrive]:
    """Raises UsageError where two are one drive, or have one address: `key`."""
    found: list[ServedDrive] = []
    for drive in drives:
        for other in found:
            if drive.axis.serial == other.axis.serial:
                raise UsageError(
                    f"{drive.axis.name} stands there twice, with one serial number and one memory: "
                    f"tell them apart by an option, as in {drive.axis.name}?seed=2"
                )
            if (number := getattr(drive, key)) == getattr(other, key):
                raise UsageError(
                    f"{other.axis.name} and {drive.axis.name} are both {key} {number} of one bus"
                )
        found.append(drive)
    return found


def _coulomb(axis: VirtualAxis) -> str:
    """What acts in all: a geared axis has friction on either side."""
    if not axis.load_coulomb:
        return f"{axis.coulomb:g}"
    each = f"motor {axis.coulomb:g}, load {axis.load_coulomb:g}"
    return f"{axis.coulomb + axis.load_coulomb:g} ({each})"


def _place(text: str | None) -> tuple[str, int] | None:
    """HOST:PORT, or PORT for loopback."""
    if text is None:
        return None
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise UsageError(f"'{text}': must be HOST:PORT, with port 0…65535")
    return (host.strip("[]") or "127.0.0.1", int(port))
