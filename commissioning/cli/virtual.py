"""tworelay virtual list | serve AXIS."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text, say
from profiles.errors import UsageError

if TYPE_CHECKING:
    from drivers.virtual.axes import VirtualAxis

__all__ = ["command"]


@click.group("virtual")
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
@click.argument("axis")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="K=V",
    help="Option of the axis, as in a virtual:// link.",
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
def serve_axis(
    axis: str,
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
    """Serve the virtual AXIS until Ctrl-C; prints one ready LINK a line."""
    from drivers.link import parse, state_file
    from drivers.virtual.axes import configured
    from drivers.virtual.habits import habits_of
    from drivers.virtual.memory import Memory
    from drivers.virtual.serve import Endpoints, serve
    from profiles.library import load_profile

    query = "&".join(changes)
    link = parse(f"virtual://{axis}" + (f"{'&' if '?' in axis else '?'}{query}" if query else ""))
    options = {k: value for k, value in link.options.items() if k not in ("state", "habit")}
    endpoints = Endpoints(
        modbus_tcp=_place(modbus_tcp),
        modbus_rtu_tcp=_place(modbus_rtu_tcp),
        modbus_rtu_pty=modbus_rtu == "pty",
        socketcand=_place(socketcand),
        slcan_pty=slcan == "pty",
        twin_of=load_profile(profile) if profile else None,
        habits=habits_of(filter(None, (*link.options.get("habit", "").split(","), *habits))),
    )
    modbus = endpoints.modbus_tcp or endpoints.modbus_rtu_tcp or endpoints.modbus_rtu_pty
    other = endpoints.socketcand or endpoints.slcan_pty
    endpoints.habits.for_bus("modbus" if modbus else "canopen")
    if endpoints.twin_of is not None and (modbus if endpoints.twin_of.bus == "canopen" else other):
        raise UsageError(
            f"profile '{endpoints.twin_of.name}' is for {endpoints.twin_of.bus}: its twin is "
            "served there only"
        )
    if endpoints == Endpoints(twin_of=endpoints.twin_of, habits=endpoints.habits):
        raise UsageError(
            "serve where? Give --modbus-tcp HOST:PORT, --modbus-rtu pty, --modbus-rtu-tcp "
            "HOST:PORT, --socketcand HOST:PORT or --slcan pty"
        )
    served = configured(link.place, options, state or link.options.get("state"))
    for key in ("jitter", "loss", "stamp"):
        if getattr(served, key):
            raise UsageError(f"{key} is for virtual:// links: a served drive has its wire's own")
    received = serve(
        served, Memory.at(state or state_file(link)), endpoints, clock,
        say,
    )  # fmt: skip
    sys.exit(128 + received)


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
