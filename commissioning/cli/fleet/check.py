"""tworelay fleet check FLEET."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commissioning.cli.acting import check_json
from commissioning.cli.helping import Helpful
from commissioning.cli.options import verbose
from commissioning.cli.output import document, json_text
from commissioning.cli.terminal import Screen

if TYPE_CHECKING:
    from commissioning.fleet.looking import Seen
    from commissioning.fleet.plan import Fleet, PlannedAxis
    from commissioning.fleet.running import FleetWishes
    from commissioning.result.fleet import FleetJob

__all__ = ["command", "looked_at"]

_NOT_ALL = 9


@click.command("check", cls=Helpful)
@click.argument("fleet", type=click.Path(path_type=Path))
@click.option("--job", type=click.Choice(["identify", "commission", "verify"]),
              help="Instead of the file's.")  # fmt: skip
@click.option("--only", metavar="EXPR", help="As in 'fleet run'.")
@click.option("--at-once", type=click.IntRange(1, 64), metavar="N", help="As in 'fleet run'.")
@click.option("--accept-serial", "accept", multiple=True, metavar="AXIS",
              help="Its drive was exchanged: the one that is there now belongs to it.")  # fmt: skip
@click.option("--json", "json_target", metavar="F", help="To F, '-' for standard output.")
@verbose
def command(
    fleet: Path,
    job: FleetJob | None,
    only: str | None,
    at_once: int | None,
    accept: tuple[str, ...],
    json_target: str | None,
) -> None:
    """Look at all axes of FLEET: which drives are there, may they be moved, in which order.

    Nothing is written to a drive, or moved.
    """
    from commissioning.fleet.loading import load_fleet
    from commissioning.fleet.running import FleetWishes

    check_json(json_target)
    screen = Screen(json_target, yes=False)
    wishes = FleetWishes(only, at_once)
    sys.exit(looked_at(load_fleet(fleet, job), wishes, screen, json_target, accept=accept))


def looked_at(
    plan: Fleet,
    wishes: FleetWishes,
    screen: Screen,
    json_target: str | None,
    *,
    accept: tuple[str, ...] = (),
    with_writes: bool = False,
) -> int:
    """Look, and show what there is; returns the exit code."""
    from commissioning.fleet.running import check, expected
    from commissioning.interruption import Interruption
    from commissioning.result.codec import tree_of
    from commissioning.result.words import remaining

    def tell(name: str, found: Seen) -> None:
        said = found.error.text if found.error else found.looked and found.looked.identity
        screen.say(f"  {name}: {said}")

    with Interruption() as interruption:
        plan, seen = check(plan, wishes, tell, interruption, screen.say, accept)
    ready = tuple(one.name for one in plan.axes if one.name in seen and not seen[one.name].error)
    begins, seconds = expected(plan, ready, wishes.at_once)
    order = [*begins, *(name for name in seen if name not in begins)]
    rows = [_row(plan.axis(name), seen[name], begins.get(name)) for name in order]
    columns = ["axis", "begins", "state", "serial", "profile", "group", "travel", "torque", "what"]
    screen.table(f"{plan.name}: {plan.job}, in this order", columns, rows, of_words=True)
    if with_writes:
        for name in ready:
            _say_writes(name, seen[name], screen)
    screen.say(
        f"{len(ready)} of {len(seen)} axes can be moved, in about {remaining(seconds)}; nothing "
        "was written or moved"
    )
    if json_target is not None:
        text = json_text({name: tree_of(found) for name, found in seen.items()})
        if json_target == "-":
            document(text)
        else:
            Path(json_target).write_text(text, "utf-8")
    return 0 if len(ready) == len(seen) else _NOT_ALL


def _row(axis: PlannedAxis, found: Seen, begins: float | None) -> list[str]:
    from commissioning.result.words import remaining

    looked = found.looked
    room = looked.room if looked else None
    return [
        axis.name,
        "" if begins is None else f"after {remaining(begins)}" if begins else "at once",
        "can be moved" if found.error is None else str(found.state),
        looked.serial if looked else "",
        looked.profile if looked else "",
        " ".join(filter(None, (axis.group, axis.zone and f"({axis.zone})"))),
        f"±{room.travel:.4g} {room.position_unit}" if room else "",
        f"{room.torque:.4g} {room.effort_unit}" if room else "",
        found.error.text if found.error else "",
    ]


def _say_writes(name: str, found: Seen, screen: Screen) -> None:
    if found.looked is None:
        return
    screen.say(f"{name}: would set, and put back:")
    for line in found.looked.writes:
        screen.say(f"  {line}")
    screen.say("  mode, target torque and controlword, to move the axis")
