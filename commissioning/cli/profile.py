"""tworelay profile list | show P | check P | new."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from commissioning.cli.helping import HelpfulGroup
from commissioning.cli.output import document, json_text, say

if TYPE_CHECKING:
    from profiles.draft import Draft

__all__ = ["command"]


@click.group("profile", cls=HelpfulGroup)
def command() -> None:
    """List, show and check drive profiles."""


@command.command("list")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def list_profiles(as_json: bool) -> None:
    """The built-in profiles."""
    from profiles.library import builtin_names, load_profile

    found = [load_profile(name) for name in builtin_names()]
    if as_json:
        keys = ("name", "version", "bus", "title", "status")
        document(json_text([{key: getattr(p, key) for key in keys} for p in found]))
        return
    for p in found:
        say(f"{p.name:<18} {p.bus:<8} {p.compensation.law:<18} {p.status:<15} {p.title}")


@command.command("show")
@click.argument("profile")
def show(profile: str) -> None:
    """The profile as it is written (TOML)."""
    from profiles.library import source_text

    document(source_text(profile))


@command.command("check")
@click.argument("profiles", nargs=-1, metavar="[PROFILE]...")
def check_profiles(profiles: tuple[str, ...]) -> None:
    """Find what is wrong with each PROFILE, a built-in name or a file; without any, all built-in.

    It is done once to its own twin, in this process: what of it tworelay does not do is an error.
    That shows that it is performed, not that it is true. Errors end with exit code 2.
    """
    from profiles.errors import ProfileError
    from profiles.library import builtin_names

    every = profiles or builtin_names()
    wrong = {name: count for name in every if (count := _errors(name, named=len(every) > 1))}
    if wrong:
        told = ", ".join(f"{name} has {count} error(s)" for name, count in wrong.items())
        raise ProfileError(f"profile {told}")


def _errors(name: str, *, named: bool) -> int:
    """How many errors a profile has; each is said, and each warning, with its name or without."""
    from profiles.library import check, read_profile

    profile = read_profile(name)
    findings = check(profile)
    said = [f"{finding.severity}: {finding.text}" for finding in findings]
    errors = sum(finding.severity == "error" for finding in findings)
    if not errors:  # a profile that contradicts itself is not tried
        from commissioning.performance.acts import performed
        from commissioning.performance.clauses import unheard

        not_done = [f"error: {clause}" for clause in unheard(performed(profile))]
        said, errors = [*not_done, *said], len(not_done)
    for line in said:
        say(f"{name}: {line}" if named else line)
    if not errors:
        say(
            f"{profile.name} {profile.version}: {len(profile.parameters)} parameters, "
            f"{profile.bus}, compensation {profile.compensation.law}: all of it performed on its "
            f"own twin, {len(findings)} warning(s)"
        )
    return errors


@command.command("new")
@click.option("--eds", metavar="F", help="EDS or DCF of a CANopen drive.")
@click.option("--csv", "table", metavar="F", help="Register table of a Modbus drive.")
@click.option("--drive", metavar="LINK", help="CANopen drive that carries its EDS (1021h).")
@click.option("--output", required=True, metavar="F", help="The profile that is written (.toml).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def new(eds: str | None, table: str | None, drive: str | None, output: str, force: bool) -> None:
    """Draft a profile from a description file, the drive itself or a register table.

    Says what these do not tell. Without any, asks for the registers of a Modbus drive one by one.
    """
    from pathlib import Path

    from profiles.errors import UsageError
    from profiles.library import (
        check,
        draft_from_csv,
        draft_from_eds,
        draft_from_stored_eds,
        read_profile,
    )

    target = Path(output)
    if target.suffix != ".toml":
        raise UsageError(f"--output {target}: a profile's file ends with .toml")
    if target.exists() and not force:
        raise UsageError(f"--output {target}: exists already; --force overwrites it")
    if sum(source is not None for source in (eds, table, drive)) > 1:
        raise UsageError("--eds, --csv and --drive: one of them")
    if eds:
        draft = draft_from_eds(Path(eds))
    elif table:
        draft = draft_from_csv(Path(table))
    elif drive:
        from commissioning.ownership import owned
        from drivers.link import stored_eds

        say("reading the drive's own EDS (1021h); some seconds on a slow adapter", err=True)
        with owned(drive, "profile new"):
            draft = draft_from_stored_eds(stored_eds(drive), drive)
    else:
        draft = _asked(target.stem)
    try:
        target.write_text(draft.text, "utf-8")
    except OSError as error:
        raise UsageError(f"--output {target}: cannot be written: {error.strerror}") from None
    for note in draft.notes:
        say(f"note: {note}")
    loaded = read_profile(str(target))
    for finding in check(loaded):
        say(f"{finding.severity}: {finding.text}")
    say(
        f"{target}: profile '{loaded.name}', {len(loaded.parameters)} parameters; what comes next: "
        "docs/bring-your-own-drive.md"
    )


def _asked(name: str) -> Draft:
    """A table of parameters, asked for."""
    import sys

    from profiles.address import WIDTH_BITS
    from profiles.errors import UsageError
    from profiles.library import draft_from_table
    from profiles.parameter import Unit
    from profiles.table_rows import NAMES, Row

    if not sys.stdin.isatty():
        raise UsageError(
            "profile new: give --eds F, --csv F or --drive LINK; questions need a terminal"
        )
    say("Registers as on the wire (813, 0x32D or 32Dh). Enter alone: the drive has none.")
    title = click.prompt("name of the drive", default=name)
    is_cia402 = click.confirm("does it have a controlword (CiA 402)?", default=False)
    left_out = _BY_PROCEDURE if is_cia402 else _CIA402
    rows = []
    for known, (unit, _, what) in NAMES.items():
        if known in left_out:
            continue
        register = click.prompt(f"{known}: {what}", default="", show_default=False)
        if not register:
            continue
        kind = click.prompt("  type", default=_type(known), type=click.Choice(list(WIDTH_BITS)))
        cells = {"name": known, "register": register, "type": kind}
        if unit not in ("1", "increment"):
            counted = click.prompt("  unit", default=unit, type=click.Choice(list(Unit)))
            step = click.prompt(f"  one raw step in {counted}, as 0.001", type=float)
            cells |= {"unit": counted, "scale": str(step)}
        for column, question in _QUESTIONS.get(known, ()):
            answer = click.prompt(f"  {question}", default="", show_default=False)
            if answer:
                cells[column] = answer
        rows.append(Row(known, cells))
    return draft_from_table(rows, title)


def _type(name: str) -> str:
    if "position" in name:
        return "i32"
    return "i16" if name.startswith(("torque", "coulomb")) else "u16"


_CIA402 = ("controlword", "statusword")
_BY_PROCEDURE = ("servo_on", "servo_on_2", "drive_status", "alarm", "fault_reset")
_QUESTIONS = {
    "servo_on": (
        ("on", "written to enable (keys one after the other: 0x55 0xAA)"),
        ("off", "written to disable"),
        ("stop", "written for a quick stop (Enter: there is none)"),
        ("reset", "written to acknowledge a fault (Enter: there is none)"),
    ),
    "servo_on_2": (("on", "written to enable"), ("off", "written to disable")),
    "drive_status": (
        ("mask", "bits that show how it is (0xFFFF: all)"),
        ("on", "what these bits then read while it is enabled (several: 4 5)"),
        ("stopping", "what they read while it brakes (Enter: it does not say)"),
        ("fault_value", "what they read in fault (Enter: there is none)"),
    ),
    "fault_reset": (("on", "written to acknowledge a fault (Enter: 1)"),),
    "mode_of_operation": (
        ("torque", "its value for the torque mode (Enter: 10)"),
        ("position", "its value for the position mode (Enter: 8, or none)"),
    ),
    "store_command": (("on", "written to store (Enter: 1)"),),
    "store_status": (("on", "what it reads once all is stored"),),
    "coulomb_negative": (("minimum", "least raw value (below zero: it is stored with its sign)"),),
}
